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
    for name, value in [
        ("max_distance_mm", max_distance_mm),
        *(("tolerances_mm", t) for t in tolerances_mm),
    ]:
        check_number(name, value, "positive numbers of millimetres", above=0)
    if not len(reconstructed) or not len(true):
        raise InputError("comparing needs points in both clouds")
    if spacing_mm is not None:
        check_number(
            "spacing_mm", spacing_mm, "a positive number of millimetres", above=0
        )
        reconstructed, true = (
            thinned(cloud, 1e-3 * spacing_mm) for cloud in (reconstructed, true)
        )
    to_truth = 1e3 * cKDTree(true.points).query(reconstructed.points)[0]
    from_truth = 1e3 * cKDTree(reconstructed.points).query(true.points)[0]
    near, near_truth = (d[d <= max_distance_mm] for d in (to_truth, from_truth))
    (mean, median), (mean_of_truth, median_of_truth) = (
        (float(np.mean(d)), float(np.median(d))) if d.size else (math.inf, math.inf)
        for d in (near, near_truth)
    )
    shares = []
    for tolerance in map(float, tolerances_mm):
        a, c = (
            float((to_truth <= tolerance).mean()),
            float((from_truth <= tolerance).mean()),
        )
        shares.append(Share(tolerance, a, c, 2 * a * c / (a + c) if a + c else 0.0))
    return Comparison(
        accuracy_mean_mm=mean,
        accuracy_median_mm=median,
        accuracy_outliers=1 - len(near) / len(to_truth),
        completeness_mean_mm=mean_of_truth,
        completeness_median_mm=median_of_truth,
        completeness_outliers=1 - len(near_truth) / len(from_truth),
        shares=tuple(shares),
        points=len(to_truth),
        true_points=len(from_truth),
        max_distance_mm=float(max_distance_mm),
        spacing_mm=spacing_mm,
    )
