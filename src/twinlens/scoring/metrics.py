"""Checks of maps and masks, error statistics, and the table of metrics: names, units and meanings.

Percentages are 0 to 100; NaN over no pixels.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, SupportsInt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError, check_known

Disparity = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]

EVALUATED = 255  # in a uint8 mask (Middlebury v3, ETH3D)
THRESHOLDS = (
    0.5,
    1.0,
    2.0,
    4.0,
)  # of bad pixels, in pixels of the truth's resolution (Middlebury v3, ETH3D)
QUANTILES = (50, 90, 95, 99)
TIMES = ("time", "time/MP", "time/GD")


def disparity_map(name: str, values: ArrayLike) -> Disparity:
    """`values` as an (H, W) float array in pixels, +inf where unknown; InputError for another shape, NaN or -inf."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        what = type(values).__name__ if array.ndim == 0 else array.dtype
        raise InputError(
            f"{name} is {what}: expected an array of real numbers, float32 pixels with +inf where unknown"
        )
    if array.ndim != 2 or array.size == 0:
        raise InputError(
            f"{name} has shape {array.shape}: expected (height, width), neither of them 0"
        )
    if array.dtype.kind != "f":
        return array.astype(np.float32 if array.dtype.itemsize <= 2 else np.float64)
    for what, wrong in (("NaN", np.isnan(array)), ("-inf", np.isneginf(array))):
        if wrong.any():
            y, x = np.argwhere(wrong)[0]
            raise InputError(
                f"{name} holds {what} at {wrong.sum()} of {array.size} pixels, the first at x={x}, y={y}: mark unknown "
                "as +inf"
            )
    return array


def boolean_mask(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Mask:
    """`values` as an (H, W) boolean mask, where 255 is True for uint8; InputError for another shape or dtype."""
    array = np.asarray(values)
    if array.shape != shape:
        raise InputError(
            f"{name} has shape {array.shape}: expected the truth's, {shape}"
        )
    if array.dtype == np.bool_:
        return array
    if array.dtype != np.uint8:
        raise InputError(
            f"{name} holds {array.dtype}: expected bool, or uint8 with 255 where a pixel is evaluated"
        )
    return np.asarray(array == EVALUATED)


def percent(count: SupportsInt, total: int) -> float:
    """100 count / total."""
    return 100.0 * int(count) / total if total else math.nan


def error_sizes(errors: NDArray[np.float64]) -> dict[str, float]:
    """Mean (avgerr), root mean square (rms) and quantiles A50, A90, A95, A99 of finite absolute errors (N,), float64.

    A_q is sorted(errors)[floor(n q / 100)], without interpolation, as in ETH3D's evaluator (two-view-evaluation,
    `ComputeMetrics`). The index is computed in integers.
    """
    if not errors.size:
        return dict.fromkeys(SIZES, math.nan)
    ranks = [errors.size * q // 100 for q in QUANTILES]
    quantiles = np.partition(errors, sorted(set(ranks)))[ranks].tolist()
    values = (
        float(errors.mean()),
        math.sqrt(float(np.mean(errors * errors))),
        *quantiles,
    )
    return dict(zip(SIZES, values, strict=True))


BAD = tuple(f"bad{t}" for t in THRESHOLDS)
AUC_THRESHOLDS = (1.0, 2.0)  # of bad pixels in sparsification curves, pixels
SIZES = ("avgerr", "rms", *(f"A{q}" for q in QUANTILES))


def auc_names(threshold: float) -> tuple[str, str]:
    """The metrics of a sparsification curve: the area under it, and the smallest possible one."""
    return f"auc{threshold}", f"auc{threshold}_opt"


@dataclass(frozen=True)
class Metric:
    """One column of a board. `unit` is "%", "px", "m" or a unit of time."""

    name: str
    unit: str
    text: str
    lower_is_better: bool = True

    def show(self, value: float) -> str:
        """`value` as a table prints it, without the unit; a dash for NaN.

        >>> METRICS["bad2.0"].show(12.3456), METRICS["time"].show(0.01234), METRICS["rms"].show(float("nan"))
        ('12.35', '0.0123', '–')
        """
        if math.isnan(value):
            return "–"
        if math.isinf(value):
            return "∞"
        return f"{value:.2f}" if self.unit in ("%", "px", "grey") else f"{value:.3g}"


_METRICS = (
    *(Metric(f"bad{t}", "%", f"error above {t} px") for t in THRESHOLDS),
    *(
        Metric(f"totbad{t}", "%", f"error above {t} px, or no estimate")
        for t in THRESHOLDS
    ),
    Metric("avgerr", "px", "mean absolute error"),
    Metric("rms", "px", "root mean squared error"),
    *(Metric(f"A{q}", "px", f"{q}% quantile of the absolute error") for q in QUANTILES),
    Metric("invalid", "%", "pixels without an estimate"),
    Metric("coverage", "%", "pixels with an estimate", lower_is_better=False),
    Metric(
        "D1", "%", "outliers after filling: error above 3 px and above 5% of the truth"
    ),
    Metric("D1_est", "%", "outliers among the estimated pixels"),
    *(
        Metric(f"point_A{q}", "m", f"{q}% quantile of the point distance")
        for q in QUANTILES
    ),
    Metric("point_avgerr", "m", "mean distance between estimated and true point"),
    Metric(
        "point_rms", "m", "root mean squared distance between estimated and true point"
    ),
    Metric(
        "point_rel",
        "%",
        "mean point distance relative to the true point's distance from the camera",
    ),
    *(
        Metric(
            auc_names(t)[0],
            "%",
            f"area under the sparsification curve of errors above {t} px, of estimated pixels",
        )
        for t in AUC_THRESHOLDS
    ),
    *(
        Metric(
            auc_names(t)[1], "%", f"auc{t} of a confidence that ranks without mistakes"
        )
        for t in AUC_THRESHOLDS
    ),
    Metric(
        "confirmed",
        "%",
        "pixels whose estimate the right view's map confirms within 1 px",
        lower_is_better=False,
    ),
    Metric(
        "lr_consistent",
        "%",
        "estimates that the right view's map confirms within 1 px, of those with a match in the right image",
        lower_is_better=False,
    ),
    Metric(
        "photo_mean", "grey", "mean of |left - right image at u - d|, levels of 0..255"
    ),
    *(
        Metric(f"photo_A{q}", "grey", f"{q}% quantile of |left - right image at u - d|")
        for q in (50, 90)
    ),
    Metric("time", "s", "wall time of one match"),
    Metric("time/MP", "s/MP", "seconds per megapixel"),
    Metric(
        "time/GD", "s/GD", "seconds per 10^9 disparity evaluations (pixels x ndisp)"
    ),
)
METRICS: Mapping[str, Metric] = {metric.name: metric for metric in _METRICS}


def find_metric(name: str) -> Metric:
    """The metric of that name; InputError if there is none."""
    check_known("metric", name, METRICS)
    return METRICS[name]
