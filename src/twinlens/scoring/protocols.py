"""The rules by which an error counts: Middlebury v3, ETH3D and KITTI 2015, each one frozen `Protocol` in `PROTOCOLS`.

A protocol is two functions, which pixels have an estimate and what is measured on them, and the lines of text that a
table prints so that its numbers can be cited. Masks and regions are chosen by the caller (`evaluate`), not here.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, unknown
from twinlens.scoring import metrics
from twinlens.scoring.checks import Disparity, Mask
from twinlens.scoring.kitti import interpolate_background

THRESHOLDS = (0.5, 1.0, 2.0, 4.0)
"""Bad-pixel thresholds in pixels of the truth's resolution (Middlebury v3, ETH3D)."""
QUANTILES = (50, 90, 95, 99)
KITTI_PIXELS, KITTI_SHARE = 3.0, 0.05


@dataclass(frozen=True)
class Range:
    """The disparities that the caller says can occur: [low, high] in pixels of the truth, high +inf when not told."""

    low: float = 0.0
    high: float = math.inf


@dataclass(frozen=True)
class Estimate:
    """A method's map made ready for measuring: `disp` (H, W) in pixels, `given` (H, W) where the method answered.

    `disp` may be finite where `given` is not: a protocol that fills gaps scores the filling.
    """

    disp: Disparity
    given: Mask


@dataclass(frozen=True)
class Pixels:
    """What is measured: the evaluated pixels of one region as vectors of one length.

    error: |estimate - truth| in pixels, float64, +inf where nothing was estimated. truth: pixels, float64, finite.
    given: whether the method itself answered there. metres: where a calibration was given, the distance between the
    estimated and the true point and the true point's own from the camera, both in metres.
    """

    error: NDArray[np.float64]
    truth: NDArray[np.float64]
    given: NDArray[np.bool_]
    metres: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


@dataclass(frozen=True)
class Protocol:
    """One benchmark's rules. `prepare` and `measure` are the rules; the strings say them on every table."""

    name: str
    title: str
    source: str
    metrics: tuple[str, ...]
    prepare: Callable[[Disparity, Range], Estimate]
    measure: Callable[[Pixels], dict[str, float]]
    denominator: str
    invalid: str
    clip: str
    resolution: str
    headline: str
    upsampling: tuple[int, ...] = (1,)
    needs_calibration: bool = False

    def lines(self) -> Mapping[str, str]:
        """What a table prints of the protocol, in order: label -> text.

        >>> PROTOCOLS["eth3d"].lines()["clip"]
        'none'
        """
        return MappingProxyType(
            {
                "protocol": f"{self.title} ({self.name})",
                "denominator": self.denominator,
                "invalid": self.invalid,
                "clip": self.clip,
                "resolution": self.resolution,
                "source": self.source,
            }
        )


def find_protocol(name: str | Protocol) -> Protocol:
    """The protocol of that name, or the protocol itself.

    Raises
    ------
    InputError
        No such name; the nearest is suggested.

    >>> find_protocol("eth3d").title
    'ETH3D two-view'
    """
    if isinstance(name, Protocol):
        return name
    if name not in PROTOCOLS:
        raise unknown("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]


def _middlebury_prepare(disp: Disparity, allowed: Range) -> Estimate:
    given = np.isfinite(disp)
    return Estimate(np.where(given, np.clip(disp, allowed.low, allowed.high), disp), given)


def _middlebury_measure(pixels: Pixels) -> dict[str, float]:
    errors, total = pixels.error[pixels.given], pixels.error.size
    counts = {t: metrics.bad_count(errors, t) for t in THRESHOLDS}
    missing = total - errors.size
    return {
        **{f"bad{t}": metrics.percent(n, total) for t, n in counts.items()},
        **{f"totbad{t}": metrics.percent(n + missing, total) for t, n in counts.items()},
        **_sizes(errors),
        "invalid": metrics.percent(missing, total),
        "coverage": metrics.percent(errors.size, total),
    }


def _eth3d_prepare(disp: Disparity, allowed: Range) -> Estimate:
    """No clipping; what is wider than the image is no estimate (two-view-evaluation, `ComputeMetrics`)."""
    given = np.isfinite(disp) & (np.abs(disp) <= disp.shape[1])
    return Estimate(np.where(given, disp, np.asarray(np.inf, disp.dtype)), given)


def _eth3d_measure(pixels: Pixels) -> dict[str, float]:
    errors, total = pixels.error[pixels.given], pixels.error.size
    if total and not errors.size:
        return _eth3d_worst()
    return {
        **{f"bad{t}": metrics.percent(metrics.bad_count(errors, t), errors.size) for t in THRESHOLDS},
        **_sizes(errors),
        "coverage": metrics.percent(errors.size, total),
    }


def _eth3d_worst() -> dict[str, float]:
    """ETH3D's answer for a map without one estimate: everything bad, every error infinite."""
    names = ("avgerr", "rms", *(f"A{q}" for q in QUANTILES))
    return {**{f"bad{t}": 100.0 for t in THRESHOLDS}, **dict.fromkeys(names, math.inf), "coverage": 0.0}


def _kitti_prepare(disp: Disparity, allowed: Range) -> Estimate:
    """A negative disparity cannot be written in KITTI's 16-bit format: it is no estimate, and is filled like a gap."""
    given = np.isfinite(disp) & (disp >= 0)
    return Estimate(interpolate_background(np.where(given, disp, np.asarray(np.inf, disp.dtype))), given)


def _kitti_measure(pixels: Pixels) -> dict[str, float]:
    def d1(chosen: Mask) -> float:
        count = metrics.kitti_outliers(pixels.error[chosen], pixels.truth[chosen], KITTI_PIXELS, KITTI_SHARE)
        return metrics.percent(count, int(np.count_nonzero(chosen)))

    total = pixels.error.size
    return {
        "D1": d1(np.ones(total, np.bool_)),
        "D1_est": d1(pixels.given),
        "coverage": metrics.percent(int(np.count_nonzero(pixels.given)), total),
    }


def _points_prepare(disp: Disparity, allowed: Range) -> Estimate:
    return Estimate(disp, np.isfinite(disp))


def _points_measure(pixels: Pixels) -> dict[str, float]:
    if pixels.metres is None:
        raise InputError("errors in metres need a calibration: evaluate(..., calibration=...)")
    there = pixels.given & np.isfinite(pixels.metres[0])
    distances, ranges = pixels.metres[0][there], pixels.metres[1][there]
    sizes = {f"point_{name}": value for name, value in _sizes(distances).items()}
    relative = 100.0 * float(np.mean(distances / ranges)) if distances.size else math.nan
    return {**sizes, "point_rel": relative, "coverage": metrics.percent(distances.size, pixels.error.size)}


def _sizes(errors: metrics.Errors) -> dict[str, float]:
    return {"avgerr": metrics.avgerr(errors), "rms": metrics.rms(errors), **metrics.quantiles(errors, QUANTILES)}


_BAD = tuple(f"bad{t}" for t in THRESHOLDS)
_SIZES = ("avgerr", "rms", *(f"A{q}" for q in QUANTILES))

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {
        "middlebury-v3": Protocol(
            name="middlebury-v3",
            title="Middlebury v3",
            source="Scharstein et al., GCPR 2014; MiddEval3 SDK, evaldisp.cpp",
            metrics=(*_BAD, *(f"tot{b}" for b in _BAD), *_SIZES, "invalid", "coverage"),
            prepare=_middlebury_prepare,
            measure=_middlebury_measure,
            denominator="bad, totbad, invalid, coverage: known truth in the region; avgerr, rms, A: its estimated part",
            invalid="counted apart from bad; totbad = bad + invalid",
            clip="estimates to [0, ndisp], or to [m, m + ndisp] where disparities begin at m < 0",
            resolution="the truth's; a map of 1/2 or 1/4 its size is repeated and scaled up",
            headline="totbad2.0",
            upsampling=(1, 2, 4),
        ),
        "eth3d": Protocol(
            name="eth3d",
            title="ETH3D two-view",
            source="Schöps et al., CVPR 2017; ETH3D/two-view-evaluation, main.cc",
            metrics=(*_BAD, *_SIZES, "coverage"),
            prepare=_eth3d_prepare,
            measure=_eth3d_measure,
            denominator="bad, avgerr, rms, A: estimated pixels with known truth in the region; coverage: known truth",
            invalid="left out of every error, reported as coverage; |d| > image width is no estimate",
            clip="none",
            resolution="the truth's",
            headline="bad1.0",
        ),
        "kitti2015": Protocol(
            name="kitti2015",
            title="KITTI 2015 D1",
            source="Menze and Geiger, CVPR 2015; KITTI scene flow devkit, evaluate_scene_flow.cpp",
            metrics=("D1", "D1_est", "coverage"),
            prepare=_kitti_prepare,
            measure=_kitti_measure,
            denominator="D1, coverage: known truth in the region; D1_est: the estimated of these",
            invalid="filled by background interpolation, then scored; still empty is an outlier; d < 0 is no estimate",
            clip="none; outlier where |e| > 3 px and |e| > 5% of the truth",
            resolution="the truth's",
            headline="D1",
        ),
        "points": Protocol(
            name="points",
            title="Points in metres",
            source="distance between the estimated and the true point of one pixel, which lie on one viewing ray",
            metrics=(*(f"point_{name}" for name in _SIZES), "point_rel", "coverage"),
            prepare=_points_prepare,
            measure=_points_measure,
            denominator="all errors: estimated pixels with known truth in the region; coverage: known truth",
            invalid="left out of every error, reported as coverage; d + doffs <= 0 is no point, hence no estimate",
            clip="none",
            resolution="the truth's",
            headline="point_avgerr",
            needs_calibration=True,
        ),
    }
)
"""Every protocol by name."""
