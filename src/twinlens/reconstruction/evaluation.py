"""How good a reconstruction is, in millimetres: accuracy and completeness as DTU and ETH3D define them.

    accuracy      distances from the reconstruction to the true surface: is what is there right?
    completeness  distances from the true surface to the reconstruction: is all of it there?

DTU reports the mean and median of both, leaving out distances beyond a limit (20 mm); ETH3D the share of points within
a tolerance, and the harmonic mean F of the two shares. Both thin the points first, so that no place counts for more.

Sources: Jensen et al., Large scale multi-view stereopsis evaluation, CVPR 2014, and its evaluation code; Schoeps et
al., A multi-view stereo benchmark with high-resolution images and multi-camera videos, CVPR 2017. Simpler than theirs:
the true surface is what the given true points sample, thinning takes one point a cell, and parts that no true point is
near count against accuracy, where ETH3D leaves out what its scanner did not see.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from twinlens.errors import InputError, check_number
from twinlens.geometry import Float
from twinlens.reconstruction.fusion import thinned
from twinlens.reconstruction.surface import Cloud

TOLERANCES_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
MAX_DISTANCE_MM = 20.0


@dataclass(frozen=True)
class Share:
    """Parts, 0 to 1, within one tolerance: of the reconstruction near the truth, of the truth near it, and their F."""

    tolerance_mm: float
    accuracy: float
    completeness: float
    f_score: float


@dataclass(frozen=True)
class Comparison:
    """DTU's means and medians, millimetres, of the distances up to `max_distance_mm`, and ETH3D's shares.

    accuracy_outliers, completeness_outliers : parts, 0 to 1, of the points beyond that distance, which the means leave
    out. points, true_points : how many were compared, after thinning. A mean of no distances is +inf.
    """

    accuracy_mean_mm: float
    accuracy_median_mm: float
    accuracy_outliers: float
    completeness_mean_mm: float
    completeness_median_mm: float
    completeness_outliers: float
    shares: tuple[Share, ...]
    points: int
    true_points: int
    max_distance_mm: float
    spacing_mm: float | None

    def to_dict(self) -> dict[str, Any]:
        """The same as plain data."""
        return asdict(self)


def compare(
    reconstructed: Cloud,
    true: Cloud,
    *,
    spacing_mm: float | None = None,
    tolerances_mm: Sequence[float] = TOLERANCES_MM,
    max_distance_mm: float = MAX_DISTANCE_MM,
) -> Comparison:
    """Accuracy and completeness of a reconstruction against points on the true surface.

    Parameters
    ----------
    spacing_mm : float
        Both clouds are thinned to one point a cell of this side (DTU: 0.2 mm). None compares all points.
    tolerances_mm : sequence of float
        Of the shares. max_distance_mm : float, of the means.

    Distances are from point to nearest point, so they cannot be told below half the spacing of the true points.
    Raises InputError for an empty cloud or a number that is not positive.
    """
    for name, value in [("max_distance_mm", max_distance_mm), *(("tolerances_mm", t) for t in tolerances_mm)]:
        check_number(name, value, "positive numbers of millimetres", above=0)
    if not len(reconstructed) or not len(true):
        raise InputError("comparing needs points in both clouds")
    if spacing_mm is not None:
        check_number("spacing_mm", spacing_mm, "a positive number of millimetres", above=0)
        reconstructed, true = (thinned(cloud, 1e-3 * spacing_mm) for cloud in (reconstructed, true))
    off = 1e3 * distances(reconstructed.points, true.points)
    missed = 1e3 * distances(true.points, reconstructed.points)
    near, near_truth = off[off <= max_distance_mm], missed[missed <= max_distance_mm]
    return Comparison(
        accuracy_mean_mm=_mean(near),
        accuracy_median_mm=_median(near),
        accuracy_outliers=1 - len(near) / len(off),
        completeness_mean_mm=_mean(near_truth),
        completeness_median_mm=_median(near_truth),
        completeness_outliers=1 - len(near_truth) / len(missed),
        shares=tuple(_share(float(t), off, missed) for t in tolerances_mm),
        points=len(off),
        true_points=len(missed),
        max_distance_mm=float(max_distance_mm),
        spacing_mm=spacing_mm,
    )


def distances(points: Float, others: Float) -> Float:
    """Distance (N,), metres, from each of `points` (N, 3) to the nearest of `others` (M, 3)."""
    found: Float = cKDTree(others).query(points)[0]
    return found


def _share(tolerance: float, off: Float, missed: Float) -> Share:
    right, there = float((off <= tolerance).mean()), float((missed <= tolerance).mean())
    return Share(tolerance, right, there, 2 * right * there / (right + there) if right + there else 0.0)


def _mean(values: Float) -> float:
    return float(values.mean()) if len(values) else float("inf")


def _median(values: Float) -> float:
    return float(np.median(values)) if len(values) else float("inf")
