"""`twinlens export`: a dataset in the layout that another reader opens."""

import json
from typing import TYPE_CHECKING

import click

from twinlens.cli.places import PLACE
from twinlens.cli.progress import progress_bar

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("export")
@click.argument("dataset", type=PLACE)
@click.option(
    "--to", "layout", required=True, help="carla, eth3d, kitti2015, middlebury, parquet, sceneflow, sintel, webdataset."
)
@click.option("-o", "--output", required=True, type=PLACE, help="Folder to make.")
@click.option("--lens", type=click.IntRange(min=0), default=0, show_default=True, help="Which lens's images.")
@click.option("--split", help="Only the samples of this split.")
@click.option("--overwrite", is_flag=True, help="Replace an earlier export.")
@click.option("--json", "as_json", is_flag=True, help="Print the files and their sizes as JSON.")
def command(
    dataset: "Place", layout: str, output: "Place", lens: int, split: str | None, overwrite: bool, as_json: bool
) -> None:
    """Write DATASET in the layout of another dataset, so that its readers (torchvision's among them) open it.

    \b
    Example:  twinlens export out --to kitti2015 -o out-kitti
    """
    from twinlens.dataset import Dataset
    from twinlens.dataset.export import export

    samples = Dataset(dataset) if split is None else Dataset(dataset).split(split)
    with progress_bar("exporting") as report:
        sizes = export(samples, output, layout, lens, overwrite, report)
    if as_json:
        click.echo(json.dumps({"output": str(output), "layout": layout, "files": sizes}, indent=1))
        return
    size = sum(sizes.values()) / 1e6
    count = f"{len(samples)} sample" + "s" * (len(samples) != 1)
    click.echo(f"{output}: {count}, {len(sizes)} files, {size:.1f} MB in the layout of {layout}")
