"""`texture`: how contrast and grain of the texture limit the sub-pixel error of a match.

The Cramer-Rao bound of a shift, for two windows with the same signal and independent noise sigma, is  sd(d) >=
sqrt(2 sigma^2 / sum of (dI/du)^2)  over the window (Robinson and Milanfar, Fundamental Performance Limits in Image
Registration, TIP 13(9), 2004). Noise is measured on two exposures of the same radiance, slopes on the radiance.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, ndimage

from twinlens.camera import Camera, Pinhole
from twinlens.geometry import Float
from twinlens.matching import grey, parse_method
from twinlens.scoring.intervals import Interval
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.findings import Finding, Needs, open_claim, power_law
from twinlens.studies.intervals import over_scenes
from twinlens.studies.model import Figure, Measured, Setup, Study, sweep
from twinlens.studies.stage import noise_planes, stream
from twinlens.studies.table import Column, Row, Table

CONTRASTS = (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.16, 0.32)
SCALES_PX = (0.7, 1.0, 1.5, 2.5, 4.0)
SCALE_PX, CONTRAST = 1.0, 0.16  # while the other is swept
DEPTH, BASELINE = 2.0, 0.1
SENSOR = Sensor.preset(
    "machine_vision", filters="mono", output="linear", bits=16, prnu=0.0, dsnu=0.0
)
_MEAN_LEVEL = 0.25  # of the images, in units of the full well
_RIM = 16  # pixels along the edges that are left out
_GROSS_PX = 1.0
_MAX_GROSS = 2.0  # percentage from which a case is excluded
_EXPONENT_TOLERANCE = 0.15
_MIDDLE = 0.04  # contrast at which matchers are compared
_NOISY = (0.03, 0.04, 0.06, 0.08)
"""Contrasts at which the bound is well below a pixel and above the bias of sub-pixel fits."""
_MIN_CONTRASTS = 3  # needed to fit an exponent
NEEDS = Needs(pixels=112 * 84)
"""The rim leaves 200 independent blocks of all phases: the standard error of an rms error is 5 %."""


def measure(setup: Setup) -> Measured:
    """A row for every seed, matcher, contrast and grain."""
    cases = [(contrast, SCALE_PX, "contrast") for contrast in CONTRASTS]
    cases += [(CONTRAST, scale, "grain") for scale in SCALES_PX]
    rows: list[Row] = []
    for seed, case in sweep(setup, setup.seeds, cases):
        rows += _case(setup, seed, *case)
    remark = f"cases with {_MAX_GROSS:g} % or more errors of {_GROSS_PX:g} px or more are excluded from the findings"
    return Measured(
        rows,
        notes={"depth_m": DEPTH, "baseline_m": BASELINE},
        remarks={"gross errors": remark},
    )


def _case(
    setup: Setup, seed: int, contrast: float, scale: float, swept: str
) -> list[Row]:
    """Errors and bounds of every matcher, over planes at all sub-pixel positions."""
    camera = Camera.from_fov(setup.width, setup.height, 50.0)
    planes = noise_planes(
        camera, BASELINE, DEPTH, seed, scale_px=scale, contrast=contrast
    )
    samples: dict[str, list[Float]] = {method: [] for method in setup.methods}
    for phase, stage in enumerate(planes):
        radiance = stage.photograph(Pinhole(), setup.spp, stream(seed, 0, phase))
        rate = SENSOR.level_rate(radiance[0], camera=camera, lens=Pinhole()).mean()
        exposure = Exposure(_MEAN_LEVEL / float(rate))
        first, second = (
            stage.expose(
                radiance, Pinhole(), stream(seed, 1, phase, repeat), SENSOR, exposure
            )
            for repeat in range(2)
        )
        sigma, mean = _noise_and_mean(first[0], second[0])
        slopes = _slopes(mean, radiance[0])
        for method in setup.methods:
            errors = stage.match(first, method) - stage.truth.disparity
            block_size = parse_method(method).matcher().block_size
            bounds = _bounds(slopes, sigma, block_size)
            both = np.stack([errors.astype(np.float64), bounds])
            inner = both[:, _RIM:-_RIM, _RIM:-_RIM]
            samples[method].append(inner.reshape(2, -1))
    case: Row = {
        "scene": "plane",
        "seed": seed,
        "swept": swept,
        "contrast": contrast,
        "grain_px": scale,
    }
    return [
        {**case, "method": method, **_errors(*np.hstack(parts))}
        for method, parts in samples.items()
    ]


def _noise_and_mean(first: NDArray[Any], second: NDArray[Any]) -> tuple[float, Float]:
    """Standard deviation of the noise of two exposures of one scene, and their mean (H, W, 3)."""
    # The difference of two exposures has the variance of two noises, their mean half that of one.
    difference = grey(first).astype(np.float64) - grey(second)
    sigma = float(np.std(difference)) / math.sqrt(2)
    return sigma, 0.5 * (first + second.astype(np.float64))


def _errors(errors: Float, bounds: Float) -> Row:
    """The error and its bound, rms, and the percentage of gross errors, which the first leaves out."""
    fine = errors[np.abs(errors) < _GROSS_PX]
    gross = 100.0 * (errors.size - fine.size) / errors.size
    return {"error_px": _rms(fine), "bound_px": _rms(bounds), "blunders": gross}


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def _slopes(image: Float, radiance: NDArray[np.float32]) -> Float:
    """dI/du, (H, W), in grey levels of `image` per pixel: the slope of cubic splines through rows of the radiance."""
    grey_radiance = radiance.mean(axis=-1).astype(np.float64)
    gain, _ = np.polyfit(grey_radiance.ravel(), image.ravel(), 1)
    u = np.arange(grey_radiance.shape[1])
    return np.asarray(gain * interpolate.CubicSpline(u, grey_radiance, axis=1)(u, 1))


def _bounds(slopes: Float, sigma: float, side: int) -> Float:
    window_sum = ndimage.uniform_filter(slopes**2, side, mode="nearest") * side**2
    return np.asarray(math.sqrt(2) * sigma / np.sqrt(window_sum))


def conclude(table: Table) -> list[Finding]:
    """No error is below the bound; the matcher nearest to it, of several; the error's dependence on contrast."""
    sound = table.where(lambda row: float(row["blunders"]) < _MAX_GROSS)
    smallest = float(min(_ratios(sound), default=math.nan))
    # A minimum has no interval.
    seeds = len(table.values("seed"))
    least = Interval(smallest, math.nan, math.nan, seeds, "plane")
    text = f"No matcher beats the Cramer-Rao bound in cases with fewer than {_MAX_GROSS:g} % gross errors"
    above = Finding(
        text,
        least,
        least.value >= 1.0,
        result="the least error of all cases is {} times the bound",
        needs=NEEDS,
    )
    if len(table.values("method")) == 1:
        return [above, _inverse(table)]
    return [above, _nearest(sound), _inverse(table)]


def _ratios(rows: Table) -> Float:
    return rows.numbers("error_px") / rows.numbers("bound_px")


def _nearest(rows: Table) -> Finding:
    middle = rows.where(swept="contrast", contrast=_MIDDLE)
    ratios = {
        str(method): over_scenes(part, _ratios)
        for (method,), part in middle.groups("method")
    }
    claim = f"At contrast {_MIDDLE:g}, "
    if not ratios:
        return open_claim(
            f"{claim}one matcher is nearest to its bound: all have too many gross errors"
        )
    best = min(ratios, key=lambda method: ratios[method].value)
    text = f"{claim}{best} is the nearest to its bound, with an error of {{}} times the bound"
    return Finding(text, ratios[best], True, answer=best, needs=NEEDS)


def _inverse(table: Table) -> Finding:
    """The error's exponent in contrast, over low contrasts where no matcher and seed has too many gross errors."""
    low = table.where(swept="contrast", contrast=_NOISY)
    sound = [
        float(contrast)
        for contrast in low.values("contrast")
        if max(low.where(contrast=contrast).numbers("blunders")) < _MAX_GROSS
    ]
    claim = "At low contrast, the error is proportional to contrast^p with p = "
    if len(sound) < _MIN_CONTRASTS:
        return open_claim(
            f"{claim}-1: needs {_MIN_CONTRASTS} of the contrasts {_listed(_NOISY)} without gross errors"
        )
    return power_law(
        f"{claim}{{}} (contrasts {_listed(sound)})",
        low.where(contrast=sound),
        "contrast",
        "error_px",
        -1.0,
        _EXPONENT_TOLERANCE,
        ["method"],
        needs=NEEDS,
    )


def _listed(contrasts: Sequence[float]) -> str:
    return ", ".join(f"{contrast:g}" for contrast in contrasts)


def _figure(
    name: str,
    title: str,
    x: str,
    y: str = "error_px",
    also: tuple[str, ...] = ("bound_px",),
) -> Figure:
    swept = "grain" if name == "grain" else "contrast"
    return Figure(
        name,
        title,
        x,
        y,
        by="method",
        log_x=True,
        log_y=bool(also),
        where={"swept": swept},
        also=also,
    )


LAW = (
    "Noise of standard deviation σ in both images limits how well a window can be located: no unbiased match has "
    "a standard deviation below sqrt(2 σ² / Σ (dI/du)²), where the sum over the window is of the squared slopes "
    "of the image along the row (the Cramer-Rao bound). The bound is proportional to 1/contrast. It is compared "
    "with the errors of matchers on textured planes, at several sub-pixel positions."
)
STUDY = Study(
    name="texture",
    question="How much texture does a matcher need, and how close is it to the Cramer-Rao bound?",
    columns=(
        Column("swept", "", "swept quantity"),
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
        _figure(
            "contrast", "Sub-pixel error and its bound against contrast", "contrast"
        ),
        _figure(
            "grain",
            "Sub-pixel error and its bound against the texture's grain",
            "grain_px",
        ),
        _figure(
            "blunders", "Gross errors against contrast", "contrast", "blunders", ()
        ),
    ),
    law=LAW,
    docs="docs/study_results.md#texture",
    lesson="docs/course/11_sliding_window.py",
    defaults=Setup(
        (), ("sad", "ssd", "zncc", "census"), (0, 1, 2), width=240, height=180, spp=64
    ),
)
