"""`twinlens export`: a dataset in the layout that another reader opens."""

from pathlib import Path

import click


@click.command("export")
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option(
    "--to", "layout", required=True, help="carla, eth3d, kitti2015, middlebury, parquet, sceneflow, sintel, webdataset."
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder to make.")
@click.option("--lens", type=click.IntRange(min=0), default=0, show_default=True, help="Which lens's images.")
def command(dataset: Path, layout: str, output: Path, lens: int) -> None:
    """Write DATASET in the layout of another dataset, so that its readers (torchvision's among them) open it.

    \b
    Example:  twinlens export out --to kitti2015 -o out-kitti
    """
    from twinlens.dataset import Dataset
    from twinlens.dataset.export import export

    files = export(Dataset(dataset), output, layout, lens)
    click.echo(f"{output}: {len(files)} files in the layout of {layout}")
