"""`twinlens show`: pictures of a sample's geometry and of matching costs."""

from pathlib import Path

import click
import numpy as np

from twinlens.camera.multiview import epipoles, fundamental_matrix, ideal_pixels
from twinlens.cli.options import Whole, json_option, parse_pair, parse_pixel, print_result
from twinlens.cli.places import FIGURE_FILE, PLACE, PNG_FILE, missing_output
from twinlens.dataset import Place, StoredSample, open_sample, place, write_png
from twinlens.dataset.files import write_file
from twinlens.errors import check_int
from twinlens.geometry.epipolar import sampson_distance
from twinlens.matching import cost_curve
from twinlens.report.cost_picture import cost_picture
from twinlens.report.epipolar_picture import epipolar_picture, true_matches
from twinlens.scoring import load_pair, motorcycle

COST_METHODS = "sad,zncc,census,sgm"


@click.group("show")
def command() -> None:
    """Draw the geometry of a sample, or the costs of one of its pixels.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
              twinlens show costs out/staircase --at 120,80 -o costs.png
    """


@command.command("epipolar")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option("-o", "--output", required=True, type=PNG_FILE, help="The picture, a PNG file.")
@click.option("--cameras", default="0,1", show_default=True, help="The two views, counted from 0.")
@click.option("--points", type=Whole(1, 100), default=9, show_default=True, help="Number of points.")
@json_option("the points, F and the epipoles")
def epipolar(sample: Place, output: Path, cameras: str, points: int, as_json: bool) -> None:
    """Draw points of two views, the epipolar curves that contain their matches, and the epipoles.

    The points are true matches visible in both views. The curves follow from the calibration, so in a sample
    with simulated calibration errors the points are off their curves by these errors.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
    """
    stored = open_sample(sample)
    rig = stored.rig
    a, b = parse_pair(cameras, sample, len(rig))
    here, there = true_matches(stored, a, b, points)
    write_png(output, epipolar_picture((stored.image(a), stored.image(b)), rig, here, there, a, b))
    F = fundamental_matrix(rig, a, b)
    off = sampson_distance(F, ideal_pixels(rig.cameras[a], here), ideal_pixels(rig.cameras[b], there))
    record = {
        "picture": str(output), "cameras": [a, b], "points": {"a": here, "b": there},
        "off_px": off, "fundamental_matrix": F, "epipoles": epipoles(rig, a, b),
    }  # fmt: skip
    text = f"{output}: {len(here)} true matches, at most {off.max():.3g} px off their epipolar lines"
    print_result(as_json, record, text)


@command.command("costs")
@click.argument("sample", metavar="DATASET/SAMPLE")
@click.option("--at", "pixel", required=True, metavar="U,V", help="The left image's pixel: column and row, from 0.")
@click.option("-o", "--output", type=FIGURE_FILE, help="The figure, a PNG or SVG file.  [required without --json]")
@click.option(
    "--methods", multiple=True, help=f"Comma-separated methods of twinlens. Repeatable.  [default: {COST_METHODS}]"
)
@click.option("--lens", type=Whole(0), default=0, show_default=True, help="The sample's lens, counted from 0.")
@json_option("the curves")
def costs(sample: str, pixel: str, output: Path | None, methods: tuple[str, ...], lens: int, as_json: bool) -> None:
    """Draw the cost of a pixel as a function of disparity, for each method, with the true disparity.

    SAMPLE may also be "motorcycle". Beside each curve are the pixel's window in the left image, and the windows in
    the right image at the true disparity, at the winner, and at the rival: the lowest other minimum.

    \b
    Example:  twinlens show costs out/staircase --at 120,80 --methods sad,zncc,sgm -o costs.png
    """
    if output is None and not as_json:
        raise missing_output()
    pair = load_pair(
        motorcycle() if sample == "motorcycle" and not Path(sample).exists() else _shot(sample, lens), lens
    )
    height, width = pair.disp0.shape
    u, v = parse_pixel(pixel, width, height)
    curves = cost_curve(pair.im0, pair.im1, u, v, methods or (COST_METHODS,), **pair.search)
    truth = float(pair.disp0[v, u])
    if output is not None:
        write_file(output, cost_picture((pair.im0, pair.im1), curves, truth, output.suffix.lower()[1:]))
    record = {
        "picture": None if output is None else str(output), "at": [u, v], "truth": truth,
        "curves": {
            name: {field: getattr(curve, field) for field in ("disparity", "winner", "rival", "disparities", "costs")}
            for name, curve in curves.items()
        },
    }  # fmt: skip
    lines = [
        f"{output}: pixel ({u}, {v}), true disparity {truth:.2f} px"
        if np.isfinite(truth)
        else f"{output}: pixel ({u}, {v}), truth unknown"
    ]
    for name, curve in curves.items():
        rival = "none" if curve.rival is None else f"{curve.rival} (cost {curve.cost_at(curve.rival):.4g})"
        lines.append(
            f"{name}: winner {curve.disparity:.2f} px (cost {curve.cost_at(curve.disparity):.4g}), rival {rival}, "
            f"cost at the truth {curve.cost_at(truth):.4g}"
        )
    print_result(as_json, record, *lines)


def _shot(sample: str, lens: int) -> StoredSample:
    stored = open_sample(place(sample))
    check_int("--lens", lens, 0, stored.num_lenses - 1)
    return stored
