"""Accuracy and completeness of a reconstruction in millimetres, after DTU and ETH3D.

Accuracy: distances from the reconstruction to the true surface; completeness: the reverse. Sources: Jensen et al.,
Large scale multi-view stereopsis evaluation, CVPR 2014; Schoeps et al., A multi-view stereo benchmark with
high-resolution images and multi-camera videos, CVPR 2017. For the differences see docs/reconstruction.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from twinlens.errors import InputError, check_number
from twinlens.geometry import Float
from twinlens.reconstruction.fusion import thinned
from twinlens.reconstruction.surface import Cloud


@dataclass(frozen=True)
class Share:
    """Shares, 0 to 1, within a tolerance: of the reconstruction, of the truth, and their F."""

    tolerance_mm: float
    accuracy: float
    completeness: float
    f_score: float


@dataclass(frozen=True)
class Comparison:
    """DTU's means and medians, millimetres, of the distances up to `max_distance_mm`, and ETH3D's shares.

    accuracy_outliers, completeness_outliers : shares, 0 to 1, of the points beyond that distance.
    points, true_points : numbers of points after thinning. Mean and median of no distances are +inf.
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


def compare(
    reconstructed: Cloud,
    true: Cloud,
    *,
    spacing_mm: float | None = None,
    tolerances_mm: Sequence[float] = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0),
    max_distance_mm: float = 20.0,
) -> Comparison:
    """Accuracy and completeness of a reconstruction against points on the true surface.

    spacing_mm : both clouds are thinned to one point per cell of this side (DTU: 0.2 mm). None compares all points.
    tolerances_mm : of the shares. max_distance_mm : limit of the means and medians.

    Distances are between points: they are not meaningful below half the spacing of the true points.
    Raises InputError for an empty cloud or a number that is not positive.
    """
    allowed = "positive numbers of millimetres"
    check_number("max_distance_mm", max_distance_mm, allowed, above=0)
    for tolerance in tolerances_mm:
        check_number("tolerances_mm", tolerance, allowed, above=0)
    if not len(reconstructed) or not len(true):
        raise InputError("comparing needs points in both clouds")
    if spacing_mm is not None:
        allowed = "a positive number of millimetres"
        check_number("spacing_mm", spacing_mm, allowed, above=0)
        reconstructed = thinned(reconstructed, 1e-3 * spacing_mm)
        true = thinned(true, 1e-3 * spacing_mm)
    to_truth = _distances_mm(reconstructed, true)
    from_truth = _distances_mm(true, reconstructed)
    accuracy = _Distances.of(to_truth, max_distance_mm)
    completeness = _Distances.of(from_truth, max_distance_mm)
    shares = [_share(to_truth, from_truth, float(limit)) for limit in tolerances_mm]
    return Comparison(
        accuracy_mean_mm=accuracy.mean,
        accuracy_median_mm=accuracy.median,
        accuracy_outliers=accuracy.outliers,
        completeness_mean_mm=completeness.mean,
        completeness_median_mm=completeness.median,
        completeness_outliers=completeness.outliers,
        shares=tuple(shares),
        points=len(to_truth),
        true_points=len(from_truth),
        max_distance_mm=float(max_distance_mm),
        spacing_mm=spacing_mm,
    )


@dataclass(frozen=True)
class _Distances:
    """Mean and median of the distances up to a limit, +inf if there are none, and the share beyond it."""

    mean: float
    median: float
    outliers: float

    @staticmethod
    def of(distances: Float, limit: float) -> "_Distances":
        near = distances[distances <= limit]
        outliers = 1 - len(near) / len(distances)
        if not near.size:
            return _Distances(math.inf, math.inf, outliers)
        return _Distances(float(np.mean(near)), float(np.median(near)), outliers)


def _distances_mm(cloud: Cloud, target: Cloud) -> Float:
    """The distance (N,) of each point of a cloud to the nearest point of another, millimetres."""
    distances, _ = cKDTree(target.points).query(cloud.points)
    return np.asarray(1e3 * distances)


def _share(to_truth: Float, from_truth: Float, tolerance: float) -> Share:
    accuracy = float((to_truth <= tolerance).mean())
    completeness = float((from_truth <= tolerance).mean())
    total = accuracy + completeness
    f_score = 2 * accuracy * completeness / total if total else 0.0
    return Share(tolerance, accuracy, completeness, f_score)
