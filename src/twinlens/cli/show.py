"""`twinlens show`: what a sample holds, as a picture."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twinlens.cli.places import PATH, PLACE
from twinlens.cli.samples import open_sample, parse_pair
from twinlens.errors import InputError

if TYPE_CHECKING:
    from twinlens.dataset import Place, StoredSample
    from twinlens.geometry import Float


@click.group("show")
def command() -> None:
    """Draw what a sample holds.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
    """


@command.command("epipolar")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option("-o", "--output", required=True, type=PATH, help="The picture, a PNG.")
@click.option("--cameras", default="0,1", show_default=True, help="The two views, counted from 0.")
@click.option("--points", type=click.IntRange(1, 100), default=9, show_default=True, help="How many.")
@click.option("--json", "as_json", is_flag=True, help="Print the points, F and the epipoles as JSON.")
def epipolar(sample: "Place", output: Path, cameras: str, points: int, as_json: bool) -> None:
    """Draw points, the epipolar curves on which their partners must lie, and the epipoles, over two views.

    The points are true matches that both views see. The curves are those of the calibration: where an error was left
    in it on purpose, the points stand beside their curves by that much.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
    """
    from twinlens.camera.multiview import epipoles, fundamental_matrix, ideal_pixels
    from twinlens.dataset import write_png
    from twinlens.geometry.epipolar import sampson_distance
    from twinlens.report.epipolar_picture import epipolar_picture

    if output.suffix.lower() != ".png":
        raise InputError(f"--output {output}: the picture is written as .png; name it so")
    stored = open_sample(sample)
    rig = stored.rig
    if len(rig) < 2:
        raise InputError(f"{sample}: has one view; epipolar geometry needs two")
    a, b = parse_pair(cameras, len(rig))
    here, there = _matches(stored, a, b, points)
    picture = epipolar_picture((stored.image(a), stored.image(b)), rig, here, there, a, b)
    write_png(output, picture)
    F = fundamental_matrix(rig, a, b)
    off = sampson_distance(F, ideal_pixels(rig.cameras[a], here), ideal_pixels(rig.cameras[b], there))
    if as_json:
        record = {
            "picture": str(output), "cameras": [a, b], "points": {"a": here.tolist(), "b": there.tolist()},
            "off_px": off.tolist(), "fundamental_matrix": F.tolist(),
            "epipoles": [epipole.tolist() for epipole in epipoles(rig, a, b)],
        }  # fmt: skip
        click.echo(json.dumps(record, indent=1))
        return
    click.echo(f"{output}: {len(here)} true matches, at most {off.max():.3g} px off their epipolar lines")


def _matches(stored: "StoredSample", a: int, b: int, count: int) -> "tuple[Float, Float]":
    """Pixels of true matches that both pictures show, far from each other: (N, 2) each."""
    import numpy as np

    from twinlens.report.epipolar_picture import spread_points

    truth = stored.truth(a) if stored.has(f"truth{a}.exr") else None
    if truth is None:
        return _matches_of_disparity(stored, a, b, count)
    pictured = stored.photographed_by
    points = np.where(truth.hit[..., None], truth.position, np.nan)
    here, there = (pictured.project(index, points) for index in (a, b))
    shown = pictured.cameras[a].contains(here) & pictured.cameras[b].contains(there)
    visible = stored.correspondence(a, b).visible
    chosen = spread_points(visible & shown, count)
    if not len(chosen):
        raise InputError(f"{stored.folder}: views {a} and {b} see nothing in common; choose others by --cameras")
    return tuple(seen[chosen[:, 1], chosen[:, 0]] for seen in (here, there))  # type: ignore[return-value]


def _matches_of_disparity(stored: "StoredSample", a: int, b: int, count: int) -> "tuple[Float, Float]":
    """Those of a plain folder: its left disparity map, where both views see the pixel."""
    import numpy as np

    from twinlens.report.epipolar_picture import spread_points

    if (a, b) != (0, 1):
        raise InputError(f"{stored.folder}: has no truth{a}.exr; only views 0,1 can be told from disparities")
    disparity = stored.disp0
    chosen = spread_points(np.isfinite(disparity) & (stored.mask0_nonocc == 255), count)
    here = chosen.astype(np.float64)
    return here, here - np.stack([disparity[chosen[:, 1], chosen[:, 0]], np.zeros(len(chosen))], axis=1)
