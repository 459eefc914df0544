"""`texture`: how contrast and grain decide the error of a match, and how close matchers come to the best there can be.

The bound is Cramer and Rao's for a shift: two windows with the same signal and independent noise of standard deviation
sigma cannot tell their shift better than  sd(d) >= sqrt(2 sigma^2 / sum of (dI/du)^2)  over the window (Robinson and
Milanfar, Fundamental Performance Limits in Image Registration, TIP 13(9), 2004). The noise is measured from two
pictures of one light, the slopes on the light itself. It holds for small errors: where matches are blunders, wrong by
a pixel or more, it says nothing, and what is concluded leaves such cases out.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, ndimage

from twinlens.camera import Camera, Pinhole, Rig
from twinlens.matching import grey, parse_method
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.bootstrap import Interval, log_slope, over_scenes
from twinlens.studies.model import Figure, Finding, Measured, Setup, Study, agrees
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table
from twinlens.studies.targets import noise_plane

Float = NDArray[np.float64]

CONTRASTS = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.16, 0.32)
SCALES_PX = (0.7, 1.0, 1.5, 2.5, 4.0)
SCALE_PX, CONTRAST = 1.0, 0.16
"""What one has while the other is swept."""
PHASES = (0.0, 0.25, 0.5, 0.75)
DEPTH, BASELINE = 2.0, 0.1
SENSOR = Sensor.preset("machine_vision", filters="mono", output="linear", bits=16, prnu=0.0, dsnu=0.0)
_RIM = 16
_BLUNDER_PX = 1.0
_MOST_BLUNDERS = 2.0
_EXPONENT_TOLERANCE = 0.15
_MIDDLE = 0.04
_NOISY = (0.03, 0.04, 0.06, 0.08)
"""Contrasts: where the bound is neither near a pixel nor below what sub-pixel fits are good for."""
_LEAST_CONTRASTS = 3
"""Of fewer, an exponent is no more than a ratio."""
_NONE = Interval(math.nan, math.nan, math.nan)
_LEFT_OUT = f"where {_MOST_BLUNDERS:g} % or more of a case's matches are wrong by a pixel, it is left out"


def measure(setup: Setup) -> Measured:
    """A row for every seed, matcher, contrast and grain."""
    rows: list[Row] = []
    cases = [(contrast, SCALE_PX, "contrast") for contrast in CONTRASTS]
    cases += [(CONTRAST, scale, "grain") for scale in SCALES_PX]
    for done, seed in enumerate(setup.seeds):
        for k, (contrast, scale, swept) in enumerate(cases):
            setup.progress((done + k / len(cases)) / len(setup.seeds), f"contrast {contrast:g}, grain {scale:g}")
            rows += _case(setup, seed, contrast, scale, swept)
    return Measured(rows, notes={"depth_m": DEPTH, "baseline_m": BASELINE}, remarks={"blunders": _LEFT_OUT})


def _case(setup: Setup, seed: int, contrast: float, scale: float, swept: str) -> list[Row]:
    fx = Camera.from_fov(setup.width, setup.height, 50.0).fx
    camera = Camera(setup.width, setup.height, fx, fx, 0.5 * (setup.width - 1), 0.5 * (setup.height - 1))
    rig = Rig.stereo(camera, BASELINE, np.eye(4))
    scene = noise_plane(rig, DEPTH, seed, scale_px=scale, contrast=contrast)
    errors: dict[str, list[Float]] = {method: [] for method in setup.methods}
    bounds: dict[str, list[Float]] = {method: [] for method in setup.methods}
    for k, phase in enumerate(PHASES):
        stage = Stage(scene, Rig((camera, camera.replace(cx=camera.cx + phase)), rig.world_from_cams))
        radiance = stage.photograph(Pinhole(), setup.spp, stream(seed, 0, k))
        exposure = Exposure(_time(radiance[0], stage))
        shots = [stage.expose(radiance, Pinhole(), stream(seed, 1, k, eye), SENSOR, exposure) for eye in range(2)]
        sigma = float(np.std(grey(shots[0][0]).astype(np.float64) - grey(shots[1][0]))) / math.sqrt(2)
        slopes = _slopes(0.5 * (shots[0][0] + shots[1][0].astype(np.float64)), radiance[0])
        for method in setup.methods:
            found = stage.match(shots[0], method) - stage.truth.disparity
            errors[method].append(_inner(found.astype(np.float64)))
            side = parse_method(method).matcher().block_size
            bounds[method].append(_inner(math.sqrt(2) * sigma / np.sqrt(_window_sum(slopes**2, side))))
    return [
        _row(seed, method, contrast, scale, swept, np.concatenate(errors[method]), np.concatenate(bounds[method]))
        for method in setup.methods
    ]


def _time(light: NDArray[np.float32], stage: Stage) -> float:
    """Seconds that bring the mean light to a quarter of the full well."""
    rate = float(SENSOR.level_rate(light, camera=stage.camera, lens=Pinhole()).mean())
    return 0.25 / rate


def _slopes(picture: Float, light: NDArray[np.float32]) -> Float:
    """dI/du of the light (H, W), in the picture's grey levels a pixel: of a cubic spline through each row."""
    flat = light.mean(axis=-1).astype(np.float64)
    gain, _ = np.polyfit(flat.ravel(), picture.ravel(), 1)
    curve = interpolate.CubicSpline(np.arange(flat.shape[1]), flat, axis=1)
    slopes: Float = gain * curve(np.arange(flat.shape[1]), 1)
    return slopes


def _window_sum(values: Float, side: int) -> Float:
    total: Float = ndimage.uniform_filter(values, side, mode="nearest") * side**2
    return total


def _inner(values: Float) -> Float:
    return values[_RIM:-_RIM, _RIM:-_RIM].ravel()


def _row(seed: int, method: str, contrast: float, scale: float, swept: str, errors: Float, bounds: Float) -> Row:
    blunders = ~(np.abs(errors) < _BLUNDER_PX)
    fine = errors[~blunders]
    return {
        "scene": "plane", "seed": seed, "swept": swept, "method": method, "contrast": contrast, "grain_px": scale,
        "error_px": float(np.sqrt(np.mean(fine**2))) if fine.size else math.nan,
        "bound_px": float(np.sqrt(np.mean(bounds**2))), "blunders": 100.0 * float(blunders.mean()),
    }  # fmt: skip


def conclude(table: Table) -> list[Finding]:
    """Nobody beats the bound; how near the best comes; error falls as 1/contrast while noise rules."""
    sound = table.where(lambda row: float(row["blunders"]) < _MOST_BLUNDERS)
    return [_above(sound), _nearest(sound), _inverse(table)]


def _ratios(rows: Table) -> Float:
    return rows.numbers("error_px") / rows.numbers("bound_px")


def _above(rows: Table) -> Finding:
    """The least ratio of all; no interval, since every resampling of a minimum ends at the minimum itself."""
    ratios = _ratios(rows)
    least = float(ratios.min()) if ratios.size else math.nan
    text = (
        f"No matcher beats the Cramer-Rao bound of its window where fewer than {_MOST_BLUNDERS:g} % of the matches are "
        "blunders: the least error of all cases is {} times the bound"
    )
    return Finding(text, Interval(least, math.nan, math.nan), least >= 1.0)


def _nearest(rows: Table) -> Finding:
    """At medium contrast: of the matchers, the nearest to its bound."""
    middle = rows.where(swept="contrast", contrast=_MIDDLE)
    ratios = {str(method): over_scenes(middle.where(method=method), _ratios) for method in middle.values("method")}
    if not ratios:
        return Finding(f"At contrast {_MIDDLE:g} every matcher blunders; least error {{}}", _NONE, False)
    best = min(ratios, key=lambda method: ratios[method].value)
    text = f"At contrast {_MIDDLE:g} the nearest to its bound is {best}, whose error is {{}} times the bound"
    return Finding(text, ratios[best], True, answer=best)


def _inverse(table: Table) -> Finding:
    """d log(error) / d log(contrast) over the low contrasts at which no matcher and seed blunders, all matchers."""
    low = table.where(swept="contrast", contrast=_NOISY)
    sound = [
        float(c) for c in low.values("contrast") if max(low.where(contrast=c).numbers("blunders")) < _MOST_BLUNDERS
    ]
    claim = "While noise rules, error is in proportion to 1/contrast"
    if len(sound) < _LEAST_CONTRASTS:
        text = f"{claim}: takes {_LEAST_CONTRASTS} contrasts of {_said(_NOISY)} without blunders"
        return Finding(text, _NONE, holds=False, asked=False)
    slope = log_slope("contrast", "error_px")
    used = low.where(contrast=tuple(sound))
    measured = over_scenes(used, lambda unit: [slope(part) for _, part in unit.groups("method")])
    return Finding(
        f"{claim}: over the contrasts {_said(sound)} its exponent is {{}}", measured,
        agrees(measured, -1.0, _EXPONENT_TOLERANCE), "", -1.0, _EXPONENT_TOLERANCE,
    )  # fmt: skip


def _said(contrasts: Sequence[float]) -> str:
    return ", ".join(f"{contrast:g}" for contrast in contrasts)


STUDY: Study = Study(
    name="texture",
    question="How much texture does a matcher need, and how near does it come to the Cramer-Rao bound?",
    columns=(
        Column("swept", "", "what is swept"),
        Column("method", "", "matcher"),
        Column("contrast", "", "contrast, standard deviation / mean"),
        Column("grain_px", "px", "grain of the texture"),
        Column("error_px", "px", "sub-pixel error, rms"),
        Column("bound_px", "px", "Cramer-Rao bound"),
        Column("blunders", "%", "wrong by a pixel or more"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure(
            "contrast", "Sub-pixel error and its bound against contrast", "contrast", "error_px", by="method",
            log_x=True, log_y=True, where={"swept": "contrast"}, also=("bound_px",),
        ),
        Figure(
            "grain", "Sub-pixel error and its bound against the texture's grain", "grain_px", "error_px", by="method",
            log_x=True, log_y=True, where={"swept": "grain"}, also=("bound_px",),
        ),
        Figure("blunders", "Blunders against contrast", "contrast", "blunders", by="method", log_x=True,
               where={"swept": "contrast"}),
    ),
    defaults=Setup((), ("sad", "ssd", "zncc", "census"), (0, 1, 2), width=240, height=180, spp=64),
)  # fmt: skip
