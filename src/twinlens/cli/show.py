"""`twinlens show`: pictures of a sample's geometry."""

from pathlib import Path

import click

from twinlens.camera.multiview import epipoles, fundamental_matrix, ideal_pixels
from twinlens.cli.options import Whole, json_option, parse_pair, print_result
from twinlens.cli.places import PLACE, PNG_FILE
from twinlens.dataset import Place, open_sample, write_png
from twinlens.geometry.epipolar import sampson_distance
from twinlens.report.epipolar_picture import epipolar_picture, true_matches


@click.group("show")
def command() -> None:
    """Draw the geometry of a sample.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
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
