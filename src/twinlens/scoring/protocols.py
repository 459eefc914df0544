"""Scoring rules of Middlebury v3, ETH3D and KITTI 2015, point distances in metres, and measures that need no truth.

Each is a `Protocol`. `evaluate` chooses the pixels, and `consistency.check_views` those of the last.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_known
from twinlens.matching.refine import carried_right
from twinlens.scoring.metrics import (
    BAD,
    SIZES,
    THRESHOLDS,
    Disparity,
    Mask,
    auc_names,
    disparity_map,
    error_sizes,
    percent,
)
from twinlens.scoring.sparsification import Sparsification, sparsification

KITTI_PIXELS, KITTI_SHARE = 3.0, 0.05
MIDDLEBURY_INVALID = 1000.0
"""evaldisp treats an estimate above this multiple of ndisp as no estimate."""
CONSISTENCY = "consistency"
"""The protocol of pairs without truth."""
AGREE_PX = 1.0
"""Two estimates that differ by at most this agree, pixels."""


@dataclass(frozen=True)
class Pixels:
    """The evaluated pixels of one region, as vectors of one length, or those of an image, of its shape.

    estimate (+inf where unknown), truth: disparities. estimated: where the method has an estimate. metres: with a
    calibration, the distance between estimated and true point, and the true point's distance from the camera.
    confidence: the method's, if it has one. of_right: the method's right map at the estimate's match, +inf where it is
    unknown there, NaN where the match is outside the right image or there is no estimate. residual: see
    `consistency.photometric_residual`. Only a protocol that needs no truth has the last two, and its truth is unknown.
    """

    estimate: NDArray[np.floating[Any]]
    truth: NDArray[np.floating[Any]]
    estimated: NDArray[np.bool_]
    metres: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    confidence: NDArray[np.float64] | None = None
    of_right: NDArray[np.float64] | None = None
    residual: NDArray[np.float64] | None = None

    def at(self, mask: NDArray[np.bool_]) -> "Pixels":
        """The pixels of a mask, disparities as float64; all arrays have the mask's shape."""
        return Pixels(
            self.estimate[mask].astype(np.float64),
            self.truth[mask].astype(np.float64),
            self.estimated[mask],
            confidence=None if self.confidence is None else self.confidence[mask],
            of_right=None if self.of_right is None else self.of_right[mask],
            residual=None if self.residual is None else self.residual[mask],
        )

    def sparsified(self, threshold: float) -> Sparsification | None:
        """The curve of errors above the threshold, over the pixels with an estimate; None without a confidence."""
        if self.confidence is None:
            return None
        return sparsification(
            self.confidence[self.estimated], self.estimate_errors > threshold
        )

    @property
    def estimate_errors(self) -> NDArray[np.float64]:
        """|estimate - truth| of the pixels with an estimate."""
        return np.abs(self.estimate[self.estimated] - self.truth[self.estimated])


@dataclass(frozen=True)
class Protocol:
    """The rules of one benchmark, and their description as printed with every table.

    prepare: (map, lowest, highest possible disparity) -> (map to measure, where the method has an estimate). It may
    fill gaps. measure: the metrics of a region.
    upsampling: allowed ratios of the truth's size to the map's. rounds_integers: estimates are rounded if the
    calibration has isint=1. needs: the data of a `Pair` without which the protocol does not apply. headline: the metric
    that ranks methods. columns: the metrics of a table by default.
    auc_threshold: the error in pixels above which a pixel is bad in sparsification curves, None for no curves. Their
    metrics, `auc_metrics`, are the last; only methods with a confidence have them.
    """

    name: str
    title: str
    source: str
    metrics: tuple[str, ...]
    prepare: Callable[[Disparity, float, float], tuple[Disparity, Mask]]
    measure: Callable[[Pixels], dict[str, float]]
    denominator: str
    invalid: str
    headline: str
    columns: tuple[str, ...]
    clip: str = "none"
    resolution: str = "the truth's"
    upsampling: tuple[int, ...] = (1,)
    rounds_integers: bool = False
    needs: tuple[str, ...] = ("disp0",)
    auc_threshold: float | None = None

    def applies_to(self, pair: Any) -> bool:
        """Whether a `Pair` has the data that the protocol needs."""
        return all(getattr(pair, data) is not None for data in self.needs)

    @property
    def needs_truth(self) -> bool:
        """Whether maps are compared with the true disparity."""
        return "disp0" in self.needs

    @property
    def needs_calibration(self) -> bool:
        """Whether errors are in metres."""
        return "calibration" in self.needs

    @property
    def auc_metrics(self) -> tuple[str, ...]:
        """The names of the area under the sparsification curve, and of the smallest possible one."""
        return () if self.auc_threshold is None else auc_names(self.auc_threshold)

    def lines(self) -> Mapping[str, str]:
        """Description for tables and board files, label -> text."""
        names = ("denominator", "invalid", "clip", "resolution", "source")
        return {
            "protocol": f"{self.title} ({self.name})",
            **{name: getattr(self, name) for name in names},
        }


def find_protocol(name: str | Protocol) -> Protocol:
    """The protocol of that name, or the protocol itself; InputError if there is none."""
    if isinstance(name, Protocol):
        return name
    check_known("protocol", name, PROTOCOLS)
    return PROTOCOLS[name]


def _middlebury_prepare(
    disp: Disparity, low: float, high: float
) -> tuple[Disparity, Mask]:
    estimated = np.isfinite(disp) & (disp <= MIDDLEBURY_INVALID * (high - low))
    return np.where(estimated, np.clip(disp, low, high), np.inf), estimated


def _middlebury_measure(pixels: Pixels) -> dict[str, float]:
    errors, total = pixels.estimate_errors, pixels.truth.size
    missing = total - errors.size
    # All rates are of all pixels; a pixel without an estimate is in totbad, and not in bad.
    bad = {f"bad{t}": int(np.count_nonzero(errors > t)) for t in THRESHOLDS}
    totals = {f"tot{name}": count + missing for name, count in bad.items()}
    return {
        **{name: percent(count, total) for name, count in (bad | totals).items()},
        **error_sizes(errors),
        "invalid": percent(missing, total),
        "coverage": percent(errors.size, total),
    }


def _eth3d_prepare(disp: Disparity, low: float, high: float) -> tuple[Disparity, Mask]:
    """No clipping; a disparity above the image's width is no estimate (two-view-evaluation, `ComputeMetrics`)."""
    estimated = np.isfinite(disp) & (np.abs(disp) <= disp.shape[1])
    return np.where(estimated, disp, np.inf), estimated


def _eth3d_measure(pixels: Pixels) -> dict[str, float]:
    errors, total = pixels.estimate_errors, pixels.truth.size
    if total and not errors.size:  # ETH3D's result for a map without any estimate
        return {
            **dict.fromkeys(BAD, 100.0),
            **dict.fromkeys(SIZES, math.inf),
            "coverage": 0.0,
        }
    bad = {
        f"bad{t}": percent(np.count_nonzero(errors > t), errors.size)
        for t in THRESHOLDS
    }
    return {**bad, **error_sizes(errors), "coverage": percent(errors.size, total)}


def _kitti_prepare(disp: Disparity, low: float, high: float) -> tuple[Disparity, Mask]:
    """KITTI's 16-bit format holds no negative disparity: it is filled like a gap. A gap that stays is -1 px."""
    estimated = np.isfinite(disp) & (disp >= 0)
    filled = interpolate_background(np.where(estimated, disp, np.inf))
    return np.where(np.isfinite(filled), filled, disp.dtype.type(-1.0)), estimated


def _kitti_measure(pixels: Pixels) -> dict[str, float]:
    """Like the devkit: error and ratio in float32, limits in float64, so that a ratio of exactly 5% is an outlier."""
    truth = pixels.truth.astype(np.float32)
    error = np.abs(pixels.estimate.astype(np.float32) - truth)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (error / np.abs(truth)).astype(np.float64)
    outlier = (error > KITTI_PIXELS) & (ratio > KITTI_SHARE)
    estimates = int(np.count_nonzero(pixels.estimated))
    return {
        "D1": percent(np.count_nonzero(outlier), truth.size),
        "D1_est": percent(np.count_nonzero(outlier & pixels.estimated), estimates),
        "coverage": percent(estimates, truth.size),
    }


def _points_measure(pixels: Pixels) -> dict[str, float]:
    if pixels.metres is None:
        raise InputError(
            "errors in metres need a calibration: evaluate(..., calibration=...)"
        )
    distances, ranges = pixels.metres
    defined = pixels.estimated & np.isfinite(distances)
    distances, ranges = distances[defined], ranges[defined]
    sizes = {f"point_{name}": value for name, value in error_sizes(distances).items()}
    relative = math.nan
    if distances.size:
        relative = 100.0 * float(np.mean(distances / ranges))
    return {
        **sizes,
        "point_rel": relative,
        "coverage": percent(distances.size, pixels.truth.size),
    }


def _consistency_measure(pixels: Pixels) -> dict[str, float]:
    if pixels.residual is None:
        raise InputError(
            f"protocol {CONSISTENCY!r} compares no truth: use scoring.check_views"
        )
    total = pixels.estimate.size
    confirmed = lr_consistent = math.nan
    if pixels.of_right is not None:
        has_match = ~np.isnan(pixels.of_right)
        # A right pixel without an estimate, +inf, confirms nothing.
        differences = np.abs(pixels.estimate[has_match] - pixels.of_right[has_match])
        agreeing = np.count_nonzero(differences <= AGREE_PX)
        confirmed = percent(agreeing, total)
        lr_consistent = percent(agreeing, differences.size)
    residuals = error_sizes(pixels.residual[~np.isnan(pixels.residual)])
    return {
        "confirmed": confirmed,
        "lr_consistent": lr_consistent,
        "coverage": percent(np.count_nonzero(pixels.estimated), total),
        "photo_mean": residuals["avgerr"],
        "photo_A50": residuals["A50"],
        "photo_A90": residuals["A90"],
    }


def interpolate_background(disp: Disparity) -> Disparity:
    """`disp` (H, W) in pixels, +inf where unknown, with its gaps filled as KITTI 2015 does; the dtype is kept.

    A gap within a row takes the smaller of the two disparities next to it. The ends of a row repeat its first and last
    estimate. Then the ends of every column repeat that column's first and last value. A row without estimates stays
    unknown if it lies between rows with estimates. Source: KITTI devkit, `io_disp.h`, `interpolateBackground`.

    >>> row = np.array([[np.inf, 5, np.inf, 3, np.inf]], np.float32)
    >>> interpolate_background(row).tolist()
    [[5.0, 5.0, 3.0, 3.0, 3.0]]
    """
    disp = disparity_map("disp", disp)
    from_left = carried_right(disp)
    from_right = carried_right(disp[:, ::-1])[:, ::-1]
    # In a gap both are known, and the smaller is taken; beyond the ends of a row one of them is +inf.
    rows = np.minimum(from_left, from_right)
    has_estimate = np.isfinite(rows)
    # Above its first known row, and below its last one, a column repeats them.
    first = has_estimate.argmax(axis=0)
    last = len(rows) - 1 - has_estimate[::-1].argmax(axis=0)
    sources = np.clip(np.arange(len(rows))[:, None], first, last)
    return np.take_along_axis(rows, sources, axis=0)


_PROTOCOLS = (
    Protocol(
        name="middlebury-v3",
        title="Middlebury v3",
        source="Scharstein et al., GCPR 2014; MiddEval3 SDK, evaldisp.cpp",
        metrics=(
            *BAD,
            *(f"tot{b}" for b in BAD),
            *SIZES,
            "invalid",
            "coverage",
            *auc_names(2.0),
        ),
        prepare=_middlebury_prepare,
        measure=_middlebury_measure,
        denominator="bad, totbad, invalid, coverage: pixels with known truth; avgerr, rms, A: those with an estimate",
        invalid="pixels without an estimate are not in bad; totbad = bad + invalid",
        clip="to [0, ndisp], or to [m, m + ndisp] if the smallest disparity m is negative; rounded if isint=1",
        resolution="the truth's; a map of 1/2 or 1/4 of it is enlarged, and its values are scaled",
        headline="totbad2.0",
        columns=("totbad2.0", *BAD, "avgerr", "rms", "A50", "A95", "invalid"),
        upsampling=(1, 2, 4),
        rounds_integers=True,
        auc_threshold=2.0,
    ),
    Protocol(
        name="eth3d",
        title="ETH3D two-view",
        source="Schöps et al., CVPR 2017; ETH3D/two-view-evaluation, main.cc",
        metrics=(*BAD, *SIZES, "coverage", *auc_names(1.0)),
        prepare=_eth3d_prepare,
        measure=_eth3d_measure,
        denominator="bad, avgerr, rms, A: pixels with known truth and an estimate; coverage: pixels with known truth",
        invalid="pixels without an estimate are in no error, only in coverage; |d| > image width is no estimate",
        headline="bad1.0",
        columns=(*BAD, "avgerr", "rms", "A50", "A95", "coverage"),
        auc_threshold=1.0,
    ),
    Protocol(
        name="kitti2015",
        title="KITTI 2015 D1",
        source="Menze and Geiger, CVPR 2015; KITTI scene flow devkit, evaluate_scene_flow.cpp",
        metrics=("D1", "D1_est", "coverage"),
        prepare=_kitti_prepare,
        measure=_kitti_measure,
        denominator="D1, coverage: pixels with known truth; D1_est: those with an estimate",
        invalid="filled by background interpolation; a gap that stays counts as -1 px; d < 0 is no estimate",
        clip="none; outlier where |e| > 3 px and |e| > 5% of the truth",
        headline="D1",
        columns=("D1", "D1_est", "coverage"),
    ),
    Protocol(
        name="points",
        title="Points in metres",
        source="distance between the estimated and the true point of a pixel, both on its viewing ray",
        metrics=(*(f"point_{name}" for name in SIZES), "point_rel", "coverage"),
        prepare=lambda disp, low, high: (disp, np.isfinite(disp)),
        measure=_points_measure,
        denominator="all errors: pixels with known truth and an estimate; coverage: pixels with known truth",
        invalid="pixels without an estimate are in no error, only in coverage; d + doffs <= 0 is no estimate",
        headline="point_avgerr",
        columns=(
            "point_avgerr",
            "point_rms",
            "point_A50",
            "point_A90",
            "point_A99",
            "point_rel",
            "coverage",
        ),
        needs=("disp0", "calibration"),
    ),
    Protocol(
        name=CONSISTENCY,
        title="Consistency, without truth",
        source="left-right check: Fua, Machine Vision and Applications 6 (1993); residual: warped right image",
        metrics=(
            "confirmed",
            "lr_consistent",
            "coverage",
            "photo_mean",
            "photo_A50",
            "photo_A90",
        ),
        prepare=lambda disp, low, high: (disp, np.isfinite(disp)),
        measure=_consistency_measure,
        denominator="confirmed, coverage: all pixels; others: estimates whose match is in the right image",
        invalid="pixels without an estimate are not confirmed, and in no residual",
        resolution="the left image's; a map of 1/2 or 1/4 of it is enlarged, and its values are scaled",
        headline="confirmed",
        columns=("confirmed", "lr_consistent", "coverage", "photo_mean", "photo_A50"),
        upsampling=(1, 2, 4),
        needs=(),
    ),
)
PROTOCOLS: Mapping[str, Protocol] = {protocol.name: protocol for protocol in _PROTOCOLS}
