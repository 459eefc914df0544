"""What each metric's name means: unit, better direction, one line of text. Nothing is computed here."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from twinlens.errors import unknown
from twinlens.scoring.protocols import QUANTILES, THRESHOLDS


@dataclass(frozen=True)
class Metric:
    """One column of a board. `unit` is "%", "px", "m" or a unit of time; `lower_is_better` gives the sorting."""

    name: str
    unit: str
    text: str
    lower_is_better: bool = True

    def show(self, value: float) -> str:
        """`value` as a table prints it, without the unit; a dash where there is none.

        >>> METRICS["bad2.0"].show(12.3456), METRICS["time"].show(0.01234), METRICS["rms"].show(float("nan"))
        ('12.35', '0.0123', '–')
        """
        if value != value:
            return "–"
        if value == float("inf"):
            return "∞"
        return f"{value:.2f}" if self.unit in ("%", "px") else f"{value:.3g}"


def _table() -> dict[str, Metric]:
    found = [Metric(f"bad{t}", "%", f"estimates off by more than {t} px") for t in THRESHOLDS]
    found += [Metric(f"totbad{t}", "%", f"off by more than {t} px, or no estimate") for t in THRESHOLDS]
    found += [
        Metric("avgerr", "px", "mean absolute error"),
        Metric("rms", "px", "root mean squared error"),
        *(Metric(f"A{q}", "px", f"error that {q}% of the pixels stay below") for q in QUANTILES),
        Metric("invalid", "%", "pixels without an estimate"),
        Metric("coverage", "%", "pixels with an estimate", lower_is_better=False),
        Metric("D1", "%", "outliers after filling: off by more than 3 px and 5%"),
        Metric("D1_est", "%", "outliers among the estimated pixels"),
        *(Metric(f"point_A{q}", "m", f"distance that {q}% of the points stay below") for q in QUANTILES),
        Metric("point_avgerr", "m", "mean distance between estimated and true point"),
        Metric("point_rms", "m", "root mean squared distance between estimated and true point"),
        Metric("point_rel", "%", "mean of that distance over the point's own from the camera"),
        Metric("time", "s", "wall time of one call"),
        Metric("time/MP", "s/MP", "seconds a megapixel"),
        Metric("time/GD", "s/GD", "seconds for 10^9 disparity hypotheses (pixels x ndisp)"),
    ]
    return {metric.name: metric for metric in found}


METRICS: Mapping[str, Metric] = MappingProxyType(_table())
"""Every metric by name."""
TIMES = ("time", "time/MP", "time/GD")


def find_metric(name: str) -> Metric:
    """The metric of that name; InputError with the nearest one if there is none.

    >>> find_metric("coverage").lower_is_better
    False
    """
    if name not in METRICS:
        raise unknown("metric", name, METRICS)
    return METRICS[name]
