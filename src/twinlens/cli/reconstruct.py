"""`twinlens reconstruct`: points and a surface from a sample's views, compared with its truth."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import POSITIVE, Whole, json_option, print_result
from twinlens.cli.places import PATH, PLACE, check_new
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Place, open_sample
from twinlens.dataset.files import write_folder
from twinlens.errors import counted, located
from twinlens.matching import parse_method
from twinlens.reconstruction.of_sample import RECORD, reconstruct


@click.command("reconstruct")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option(
    "-o", "--output", required=True, type=PATH, help="Folder of the reconstruction."
)
@click.option(
    "--method",
    default="truth",
    show_default=True,
    help="truth, or a matcher: sgm, zncc:block_size=11, ...",
)
@click.option(
    "--cell-mm",
    type=POSITIVE,
    help="Cell size of the surface.  [default: 1/160 of the points' extent]",
)
@click.option(
    "--min-views",
    type=Whole(1),
    default=1,
    show_default=True,
    help="Views required per point.",
)
@click.option(
    "--far", type=POSITIVE, help="Largest depth to use, metres.  [default: no limit]"
)
@click.option(
    "--spacing-mm",
    type=POSITIVE,
    help="Point spacing of the comparison.  [default: half a cell]",
)
@click.option("--overwrite", is_flag=True, help="Replace an earlier reconstruction.")
@json_option("the comparison")
def command(
    sample: Place,
    output: Path,
    method: str,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Reconstruct a sample from the true or matched depth maps of all its views.

    Matched depths are computed between neighbouring views. Neighbours that are not a rectified pair are rectified
    first. OUTPUT contains the fused points (points.ply), the surface (mesh.ply, mesh.glb), the comparison of both with
    the true surface in millimetres (reconstruction.json), and a picture from two viewpoints (reconstruction.png).

    \b
    Example:  twinlens reconstruct out/tabletop --method sgm -o rebuilt
    """
    check_new(output, overwrite, RECORD, "a reconstruction")
    with located("--method is 'truth' or a matcher"):
        matcher = None if method == "truth" else parse_method(method).matcher
    for name in ("cell", "spacing"):
        size = options.pop(f"{name}_mm")
        options[name] = None if size is None else 1e-3 * size
    options["far"] = options["far"] or math.inf
    with progress_bar("reconstructing") as report:
        result = reconstruct(open_sample(sample), matcher, progress=report, **options)
    record = {
        "sample": str(sample),
        "method": method,
        "min_views": options["min_views"],
        **result.record(),
    }
    write_folder(output, result.files(record), overwrite)
    sizes = (
        f"{counted(record['points'], 'point')}, {counted(record['faces'], 'triangle')}"
    )
    lines = [f"{output}: {sizes} from {counted(record['views'], 'depth map')}"]
    for name, scores in record["against_truth"].items():
        lines.append(f"{name}: {_score_text(scores)}")
    print_result(as_json, record, *lines)


def _score_text(scores: Mapping[str, Any]) -> str:
    """The comparison of points or a surface with the truth, on one line."""
    means = f"accuracy {scores['accuracy_mean_mm']:.3g} mm, completeness {scores['completeness_mean_mm']:.3g} mm"
    shares = ", ".join(
        f"{share['f_score']:.1%} at {share['tolerance_mm']:g} mm"
        for share in scores["shares"]
    )
    return f"{means} (means up to {scores['max_distance_mm']:g} mm), F {shares}"
