"""`twinlens show`: pictures of a sample's geometry, of matching costs, of confidences, and of optical flow."""

import re
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np

from twinlens.camera.multiview import epipoles, fundamental_matrix, ideal_pixels
from twinlens.cli.options import (
    Whole,
    json_option,
    parse_pair,
    parse_pixel,
    print_result,
    search_options,
)
from twinlens.cli.places import FIGURE_FILE, PLACE, PNG_FILE, missing_output
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Place, StoredSample, open_pair, place, write_png
from twinlens.dataset.files import write_file
from twinlens.errors import FileError, InputError, check_int, located
from twinlens.factory import camera_text, default_rig
from twinlens.geometry import Float
from twinlens.geometry.epipolar import sampson_distance
from twinlens.matching import CostCurve, cost_curve, parse_method
from twinlens.rendering import correspondence
from twinlens.report.confidence_picture import confidence_picture
from twinlens.report.cost_picture import cost_picture
from twinlens.report.epipolar_picture import (
    epipolar_picture,
    found_matches,
    true_matches,
)
from twinlens.report.flow_picture import flow_picture, largest_flow
from twinlens.scenes import load_scene
from twinlens.scoring import (
    ConfidenceScores,
    Pair,
    load_pair,
    motorcycle,
    reason_of,
    score_confidences,
    with_search,
)
from twinlens.scoring.doubts import doubt_of_order
from twinlens.scoring.reasons import Reason
from twinlens.settings import NUMBER

COST_METHODS = "sad,zncc,census,sgm"

_figure_option = click.option(
    "-o",
    "--output",
    type=FIGURE_FILE,
    help="The figure, a PNG or SVG file.  [required without --json]",
)
_lens_option = click.option(
    "--lens",
    type=Whole(0),
    default=0,
    show_default=True,
    help="The sample's lens, counted from 0.",
)


@click.group("show")
def command() -> None:
    """Draw the geometry of a sample, the costs of one of its pixels, the confidence of a matcher, or true flow.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
              twinlens show costs out/staircase --at 120,80 -o costs.png
              twinlens show confidence out/staircase --method sgm -o confidence.png
              twinlens show flow moving.toml --target 0@0.2 -o flow.png
    """


@command.command("flow")
@click.argument("scene", metavar="SCENE")
@click.option(
    "-o", "--output", required=True, type=PNG_FILE, help="The picture, a PNG file."
)
@click.option(
    "--source",
    default="0@0",
    show_default=True,
    metavar="CAMERA@SECONDS",
    help="The camera and the time of the picture's pixels.",
)
@click.option(
    "--target",
    required=True,
    metavar="CAMERA@SECONDS",
    help="The camera and the time to which the flow leads.",
)
@click.option("--size", help="Image size, WIDTHxHEIGHT.  [default: 640x480]")
@json_option("lengths and shares of pixels")
def flow(
    scene: str,
    output: Path,
    source: str,
    target: str,
    size: str | None,
    as_json: bool,
) -> None:
    """Draw the exact optical flow between two times of a scene that moves, without rendering images.

    SCENE is a bundled name or a scene file, of which [[motion]] says what moves. The colour of a pixel is the direction
    of its flow (red to the right, cyan to the left), and its saturation the length. Where nothing is hit it is black.
    Pixels whose point the target does not see are coloured too.

    \b
    Example:  twinlens show flow moving.toml --source 0@0 --target 0@0.2 -o flow.png
    """
    instants = _parse_instant("--source", source), _parse_instant("--target", target)
    width, height = camera_text.parse_size(size)
    loaded = load_scene(scene)
    if not loaded.motion and instants[0][0] == instants[1][0]:
        raise InputError(
            f"{scene}: nothing moves: add [[motion]] to the scene file, or name two cameras"
        )
    rig = default_rig(loaded, width, height)
    with progress_bar("tracing"), located(scene):
        answer = correspondence(loaded, rig, *instants)
    longest = largest_flow(answer.flow)
    visible = float(answer.visible.mean())
    write_png(output, flow_picture(answer.flow))
    record = {
        "picture": str(output), "source": instants[0], "target": instants[1], "largest_px": longest,
        "hit": float(np.isfinite(answer.flow[..., 0]).mean()), "visible": visible,
    }  # fmt: skip
    text = (
        f"{output}: longest flow {longest:.2f} px, {100 * visible:.1f} % of the pixels are visible in the "
        "target"
    )
    print_result(as_json, record, text)


def _parse_instant(option: str, text: str) -> tuple[int, float]:
    """The camera and the time of `0@0.4`; without a time, 0. Raises InputError."""
    parts = re.fullmatch(rf"([0-9]{{1,6}})(?:@({NUMBER}))?", text.strip())
    if parts is None:
        raise InputError(
            f"{option} must be CAMERA@SECONDS, such as 0@0.4, got {text!r}"
        )
    return int(parts[1]), float(parts[2] or 0.0)


@command.command("epipolar")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option(
    "-o", "--output", required=True, type=PNG_FILE, help="The picture, a PNG file."
)
@click.option(
    "--cameras", default="0,1", show_default=True, help="The two views, counted from 0."
)
@click.option(
    "--points",
    type=Whole(1, 100),
    default=9,
    show_default=True,
    help="Number of points.",
)
@json_option("the points, F and the epipoles")
def epipolar(
    sample: Place, output: Path, cameras: str, points: int, as_json: bool
) -> None:
    """Draw points of two views, the epipolar curves that contain their matches, and the epipoles.

    The points are true matches visible in both views. The curves follow from the calibration, so in a sample
    with simulated calibration errors the points are off their curves by these errors. Without truth, the points are
    matches of image features, which use no calibration: their distances show how well the pair is rectified.

    \b
    Example:  twinlens show epipolar out/staircase -o epipolar.png
    """
    stored = open_pair(sample)
    _check_calibrated(stored)
    rig = stored.rig
    a, b = parse_pair(cameras, sample, len(rig))
    features = None
    if stored.has_truth(a) or stored.has_disparity(0):
        here, there = true_matches(stored, a, b, points)
    else:
        with progress_bar("matching features"):
            here, there, distances, disparities = found_matches(stored, a, b, points)
        features = distances, disparities
    images = stored.image(a), stored.image(b)
    write_png(output, epipolar_picture(images, rig, here, there, a, b))
    F = fundamental_matrix(rig, a, b)
    ideal_here = ideal_pixels(rig.cameras[a], here)
    off = sampson_distance(F, ideal_here, ideal_pixels(rig.cameras[b], there))
    record = {
        "picture": str(output), "cameras": [a, b], "points": {"a": here, "b": there},
        "off_px": off, "fundamental_matrix": F, "epipoles": epipoles(rig, a, b),
    }  # fmt: skip
    if features is None:
        most = _pixels(float(off.max()))
        text = f"{len(here)} true matches, at most {most} px off their epipolar lines"
    else:
        record["features"], text = _features(stored, a, b, len(here), *features)
    print_result(as_json, record, f"{output}: {text}")


def _features(
    stored: StoredSample,
    a: int,
    b: int,
    shown: int,
    off: Float,
    disparities: Float,
) -> tuple[dict[str, Any], str]:
    """What `epipolar` prints of a pair without truth: the record of all matches of features, and its text.

    shown : number of the matches in the picture. off, disparities : of all matches, in pixels.
    """
    quantiles = np.percentile(off, (50, 90)).tolist()
    record: dict[str, Any] = {"matches": len(off), "off_px": quantiles}
    half, most = map(_pixels, quantiles)
    text = (
        f"{shown} of {len(off)} matches of features, without truth; "
        f"half are at most {half} px off their epipolar lines, 90 % at most {most} px"
    )
    if stored.rig.is_rectified(a, b):
        low, high = np.percentile(disparities, (5, 95)).tolist()
        record["disparity_px"] = [low, high]
        text += f"; 90 % have disparities from {low:.1f} to {high:.1f} px"
        if doubt := doubt_of_order(disparities, 0.0):
            warnings.warn(f"{stored.folder}: {doubt}", stacklevel=2)
    return record, text


def _pixels(distance: float) -> str:
    """A distance in two digits, to the millionth of a pixel, below which it is rounding."""
    return f"{round(distance, 6):.2g}"


def _check_calibrated(stored: StoredSample) -> None:
    """Raise FileError for a plain folder without calibration, from which epipolar lines follow."""
    if not stored.has("sample.json") and not stored.has("calib.txt"):
        raise FileError(
            f"{stored.path('calib.txt')}: no such file; epipolar lines follow from the calibration"
        )


@command.command("costs")
@click.argument("sample", metavar="DATASET/SAMPLE")
@click.option(
    "--at",
    "pixel",
    required=True,
    metavar="U,V",
    help="The left image's pixel: column and row, from 0.",
)
@_figure_option
@click.option(
    "--methods",
    multiple=True,
    help=f"Comma-separated methods of twinlens. Repeatable.  [default: {COST_METHODS}]",
)
@_lens_option
@search_options
@json_option("the curves")
def costs(
    sample: str,
    pixel: str,
    output: Path | None,
    methods: tuple[str, ...],
    lens: int,
    num_disparities: int | None,
    min_disparity: int | None,
    as_json: bool,
) -> None:
    """Draw the cost of a pixel as a function of disparity, for each method, and print why it is right or wrong.

    SAMPLE may also be "motorcycle". Beside each curve are the pixel's window in the left image, and the windows in
    the right image at the true disparity, at the winner, and at the rival: the lowest other minimum. The reasons are
    those of a board's page (docs/benchmark.md); without truth, what may be wrong (docs/real_pairs.md).

    \b
    Example:  twinlens show costs out/staircase --at 120,80 --methods sad,zncc,sgm -o costs.png
    """
    if output is None and not as_json:
        raise missing_output()
    pair = _pair(sample, lens, num_disparities, min_disparity)
    height, width = pair.shape
    u, v = parse_pixel(pixel, width, height)
    curves = cost_curve(
        pair.im0, pair.im1, u, v, methods or (COST_METHODS,), **pair.search
    )
    truth = float(pair.truth[v, u])
    reasons = {name: reason_of(pair, curve) for name, curve in curves.items()}
    if output is not None:
        kind = output.suffix.lower()[1:]
        write_file(output, cost_picture((pair.im0, pair.im1), curves, truth, kind))
    record = {
        "picture": None if output is None else str(output), "at": [u, v], "truth": truth,
        "curves": {name: _curve_record(curve, reasons[name]) for name, curve in curves.items()},
    }  # fmt: skip
    truth_text = "truth unknown"
    if pair.disp0 is None:
        truth_text = "no truth"
    elif np.isfinite(truth):
        truth_text = f"true disparity {truth:.2f} px"
    lines = [f"{output}: pixel ({u}, {v}), {truth_text}"]
    lines += [
        f"{name}: {_describe(curve, truth)}. {reasons[name].text}"
        for name, curve in curves.items()
    ]
    print_result(as_json, record, *lines)


def _curve_record(curve: CostCurve, reason: Reason) -> dict[str, Any]:
    """The keys of a curve in the JSON."""
    return {
        "disparity": curve.disparity,
        "winner": curve.winner,
        "rival": curve.rival,
        "disparities": curve.disparities,
        "costs": curve.costs,
        "reason": reason._asdict(),
    }


def _describe(curve: CostCurve, truth: float) -> str:
    """The winner and the rival of a curve with their costs, and the cost of the true disparity where it has one."""
    winner = rival = "none"
    if curve.winner is not None:
        # The disparity is the winner's, refined to fractions of a pixel.
        cost = curve.cost_at(curve.winner)
        winner = f"{curve.disparity:.2f} px (cost {cost:.4g})"
    if curve.rival is not None:
        rival = f"{curve.rival} px (cost {curve.cost_at(curve.rival):.4g})"
    text = f"winner {winner}, rival {rival}"
    cost = curve.cost_at(truth) if np.isfinite(truth) else np.inf
    return f"{text}, cost at the truth {cost:.4g}" if np.isfinite(cost) else text


@command.command("confidence")
@click.argument("sample", metavar="DATASET/SAMPLE")
@_figure_option
@click.option(
    "--method", default="zncc", show_default=True, help="A method of twinlens."
)
@_lens_option
@search_options
@json_option("the areas and the curves")
def confidence(
    sample: str,
    output: Path | None,
    method: str,
    lens: int,
    num_disparities: int | None,
    min_disparity: int | None,
    as_json: bool,
) -> None:
    """Draw the confidence measures of a method on a sample, and their sparsification curves.

    SAMPLE may also be "motorcycle". The curves are of pixels visible in both views, or of all if the sample has no
    mask. Without truth there are no curves.

    \b
    Example:  twinlens show confidence out/staircase --method sgm -o confidence.png
    """
    if output is None and not as_json:
        raise missing_output()
    pair = _pair(sample, lens, num_disparities, min_disparity)
    spec = parse_method(method)
    with progress_bar("matching"), located(f"--method {spec.name}"):
        scored = score_confidences(pair, spec.matcher(**pair.search))
    if output is not None:
        kind, title = output.suffix.lower()[1:], f"{spec.name} on {pair.name}"
        write_file(output, confidence_picture(pair.im0, scored, title, kind))
    if pair.disp0 is None:
        _print_unscored(output, spec.name, scored, as_json)
        return
    first = next(iter(scored.scores.values()))
    # The last point of a curve has all pixels; these three are the same for every measure.
    rate = first.sparsification[-1]
    pixels = first.estimated
    smallest = first["auc2.0_opt"]
    measures = {
        measure: {"auc2.0": scores["auc2.0"], "sparsification": scores.sparsification}
        for measure, scores in scored.scores.items()
    }
    record = {
        "picture": None if output is None else str(output), "method": spec.name, "pixels": pixels,
        "bad2.0": rate, "auc2.0_opt": smallest, "measures": measures,
    }  # fmt: skip
    lines = [
        f"{output}: {spec.name}, {rate:.2f} % of {pixels} estimates are off by more than 2 px"
    ]
    for measure, values in measures.items():
        lines.append(f"{measure:12} auc2.0 {values['auc2.0']:.2f} %")
    print_result(as_json, record, *lines, f"{'smallest':12} auc2.0 {smallest:.2f} %")


def _print_unscored(
    output: Path | None, method: str, scored: ConfidenceScores, as_json: bool
) -> None:
    """Print the confidences of a pair without truth: the estimates, and the quartiles of each measure."""
    pixels = scored.estimates
    lines = [
        f"{output}: {method}, {pixels} estimates; without truth nothing says how well a measure ranks them"
    ]
    measures = {}
    for name, values in scored.maps.items():
        low, middle, high = np.percentile(values, (25, 50, 75)).tolist()
        measures[name] = {"quartiles": [low, middle, high]}
        lines.append(
            f"{name:12} median {middle:.4g}, quartiles {low:.4g} and {high:.4g}"
        )
    record = {
        "picture": None if output is None else str(output), "method": method, "pixels": pixels, "bad2.0": None,
        "auc2.0_opt": None, "measures": measures,
    }  # fmt: skip
    print_result(as_json, record, *lines)


def _pair(
    sample: str, lens: int, num_disparities: int | None, min_disparity: int | None
) -> Pair:
    """The pair of a lens of a sample, or "motorcycle", with the range of the search that the options name."""
    if sample == "motorcycle" and not Path(sample).exists():
        check_int("--lens", lens, 0, 0)
        return with_search(motorcycle(), num_disparities, min_disparity)
    stored = open_pair(place(sample))
    check_int("--lens", lens, 0, stored.num_lenses - 1)
    pair = with_search(load_pair(stored, lens), num_disparities, min_disparity)
    if pair.disp0 is None:
        pair.warn_of_search()
    return pair
