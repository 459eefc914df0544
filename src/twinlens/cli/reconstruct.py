"""`twinlens reconstruct`: points and a surface from a sample's views, compared with its truth."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.cli.places import PATH, PLACE, check_free, check_replaceable
from twinlens.cli.progress import progress_bar

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("reconstruct")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option("-o", "--output", required=True, type=PATH, help="Folder of the reconstruction.")
@click.option("--method", default="truth", show_default=True, help="truth, or a matcher: sgm, zncc:block_size=11, ...")
@click.option("--cell-mm", type=float, help="Cell size of the fused surface.  [default: 1/160 of the longest side]")
@click.option("--min-views", type=click.IntRange(min=1), default=1, show_default=True, help="Views required per point.")
@click.option("--far", type=float, default=math.inf, help="Leave out depths beyond this, metres.  [default: none]")
@click.option("--spacing-mm", type=float, help="Point spacing of the comparison.  [default: half a cell]")
@click.option("--overwrite", is_flag=True, help="Replace an earlier reconstruction.")
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON.")
def command(
    sample: "Place",
    output: Path,
    method: str,
    cell_mm: float | None,
    min_views: int,
    far: float,
    spacing_mm: float | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Reconstruct a sample from the true or matched depth maps of all its views.

    Matched depths are computed between neighbouring views. Neighbours that are not a rectified pair are rectified
    first. OUTPUT gets the fused points (points.ply), the surface (mesh.ply, mesh.glb), the comparison of both with the
    true surface in millimetres (reconstruction.json), and a picture from two viewpoints (reconstruction.png).

    \b
    Example:  twinlens reconstruct out/tabletop --method sgm -o rebuilt
    """
    from twinlens.dataset import open_sample
    from twinlens.dataset.files import write_folder
    from twinlens.matching import parse_method
    from twinlens.reconstruction.of_sample import RECORD, reconstruct

    check_free(output, overwrite)
    check_replaceable(output, RECORD, "reconstruction")
    matcher = None if method == "truth" else parse_method(method).matcher
    cell, spacing = (None if size is None else 1e-3 * size for size in (cell_mm, spacing_mm))
    with progress_bar("reconstructing") as report:
        made = reconstruct(
            open_sample(sample), matcher, cell=cell, min_views=min_views, far=far, spacing=spacing, progress=report
        )
    record = {"sample": str(sample), "method": method, "min_views": min_views, **made.record()}
    write_folder(output, made.files(record), overwrite)
    click.echo(json.dumps(record, indent=1) if as_json else _summary(output, record))


def _summary(output: Path, record: dict[str, Any]) -> str:
    lines = [f"{output}: {record['points']} points, {record['faces']} triangles from {record['views']} depth maps"]
    for name, found in record["against_truth"].items():
        means = f"accuracy {found['accuracy_mean_mm']:.3g} mm, completeness {found['completeness_mean_mm']:.3g} mm"
        shares = ", ".join(f"{share['f_score']:.1%} at {share['tolerance_mm']:g} mm" for share in found["shares"])
        lines.append(f"{name}: {means} (means up to {found['max_distance_mm']:g} mm), F {shares}")
    return "\n".join(lines)
