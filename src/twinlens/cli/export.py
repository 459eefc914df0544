"""`twinlens export`: a dataset in the layout of another one."""

from typing import Any

import click

from twinlens.cli.options import Whole, json_option, print_result
from twinlens.cli.places import PLACE
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Dataset, Place
from twinlens.dataset.export import LAYOUTS, export
from twinlens.errors import counted


@click.command("export")
@click.argument("dataset", type=PLACE)
@click.option("--to", "layout", required=True, help=", ".join(LAYOUTS) + ".")
@click.option("-o", "--output", required=True, type=PLACE, help="Folder of the export.")
@click.option(
    "--lens",
    type=Whole(0),
    default=0,
    show_default=True,
    help="Lens to export; 0 is first.",
)
@click.option(
    "--object",
    "objects",
    multiple=True,
    metavar="NAME",
    help="Export the masks and poses of the objects NAME only (bop, coco, kitti2015). May be repeated.",
)
@click.option("--split", help="Export only the samples of this split.")
@click.option("--overwrite", is_flag=True, help="Replace an earlier export.")
@json_option("the files and their sizes")
def command(
    dataset: Place,
    layout: str,
    output: Place,
    as_json: bool,
    split: str | None,
    **options: Any,
) -> None:
    """Write DATASET in the layout of another dataset, so that readers of that layout (such as torchvision's) open it.

    \b
    Example:  twinlens export out --to kitti2015 -o out-kitti
              twinlens export out --to bop --object nut --object bolt -o out-bop
    """
    samples = Dataset(dataset) if split is None else Dataset(dataset).split(split)
    with progress_bar("exporting") as report:
        sizes = export(samples, output, layout, progress=report, **options)
    size = sum(sizes.values()) / 1e6
    counts = f"{counted(len(samples), 'sample')}, {counted(len(sizes), 'file')}"
    text = f"{output}: {counts}, {size:.1f} MB in the layout of {layout}"
    print_result(
        as_json, {"output": str(output), "layout": layout, "files": sizes}, text
    )
