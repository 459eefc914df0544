"""Errors in metres: how far the reconstructed points are from the true ones. Knows disparity and calibration alone.

Two questions, two answers. `point_errors` compares the two points of one pixel; both lie on its viewing ray, so their
distance is the whole 3-D error. `cloud_errors` forgets the pixels and asks each cloud for the other's nearest point
(accuracy and completeness: Seitz et al., CVPR 2006; F-score: Knapitsch et al., Tanks and Temples, 2017).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.geometry import depth_from_disparity
from twinlens.scoring.checks import Mask, disparity_map, mask_of

Float = NDArray[np.float64]


def depths(disp: ArrayLike, calibration: Calibration) -> Float:
    """z = fx B / (d + doffs) in metres, any shape; +inf where d is unknown or d + doffs <= 0, which is no point.

    >>> c = Calibration((100.0, 100.0, 0.0, 0.0), (100.0, 100.0, 0.0, 0.0), 0.1, 3, 1, 0.0)
    >>> depths([5.0, 0.0, np.inf], c).tolist()
    [2.0, inf, inf]
    """
    values = np.asarray(disp, np.float64)
    there = np.where(values + calibration.doffs > 0, values, np.inf)
    return np.asarray(depth_from_disparity(there, calibration.fx, calibration.baseline, calibration.doffs))


def ray_lengths(pixels: NDArray[np.intp], calibration: Calibration) -> Float:
    """|(x, y, 1)| of the left camera's viewing rays at `pixels` (N, 2), rows of (v, u): distance by z.

    >>> c = Calibration((4.0, 4.0, 0.0, 0.0), (4.0, 4.0, 0.0, 0.0), 0.1, 3, 1, 0.0)
    >>> ray_lengths(np.array([[0, 0], [0, 3]]), c).tolist()
    [1.0, 1.25]
    """
    fx, fy, cx, cy = calibration.cam0
    return np.sqrt(1.0 + ((pixels[:, 1] - cx) / fx) ** 2 + ((pixels[:, 0] - cy) / fy) ** 2)


def point_errors(found: Float, true: Float, pixels: NDArray[np.intp], calibration: Calibration) -> tuple[Float, Float]:
    """Of N pixels: metres between the estimated and the true point, and metres from the camera to the true one.

    found, true: (N,) disparities; pixels: (N, 2) rows of (v, u). The first is +inf where either is no point.
    """
    lengths = ray_lengths(pixels, calibration)
    z_found, z_true = depths(found, calibration), depths(true, calibration)
    there = np.isfinite(z_found) & np.isfinite(z_true)
    with np.errstate(invalid="ignore"):
        return np.where(there, np.abs(z_found - z_true) * lengths, np.inf), z_true * lengths


def points(disp: ArrayLike, calibration: Calibration, mask: ArrayLike | None = None) -> Float:
    """The cloud of a disparity map (H, W): (N, 3) points of the left camera's frame, in metres, unknown ones left out.

    >>> c = Calibration((100.0, 100.0, 1.0, 0.0), (100.0, 100.0, 1.0, 0.0), 0.1, 3, 1, 0.0)
    >>> points([[np.inf, 5.0, 5.0]], c).tolist()
    [[0.0, 0.0, 2.0], [0.02, 0.0, 2.0]]
    """
    z = depths(disparity_map("disp", disp), calibration)
    chosen: Mask = np.isfinite(z)
    if mask is not None:
        chosen = chosen & mask_of("mask", mask, z.shape)
    (v, u), depth = np.nonzero(chosen), z[chosen]
    fx, fy, cx, cy = calibration.cam0
    return np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth], axis=1)


def cloud_errors(found: ArrayLike, true: ArrayLike, threshold_m: float) -> dict[str, float]:
    """Two clouds (N, 3) and (M, 3) against each other, nearest point to nearest point.

    accuracy, completeness: the mean distance in metres from found to true, and from true to found. precision, recall:
    the share in % that is nearer than threshold_m, strictly. fscore: their harmonic mean. NaN where a cloud is empty.

    >>> cloud_errors([[0, 0, 1], [0, 0, 3]], [[0, 0, 1]], 0.5)
    {'accuracy': 1.0, 'completeness': 0.0, 'precision': 50.0, 'recall': 100.0, 'fscore': 66.66666666666667}
    """
    clouds = [np.asarray(cloud, np.float64) for cloud in (found, true)]
    for name, cloud in zip(("found", "true"), clouds, strict=True):
        if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.isfinite(cloud).all():
            raise InputError(f"cloud {name!r} has shape {cloud.shape}: expected (N, 3) finite metres")
    if not threshold_m > 0:
        raise InputError(f"threshold_m is {threshold_m}: expected a positive distance in metres")
    if not (clouds[0].size and clouds[1].size):
        return dict.fromkeys(("accuracy", "completeness", "precision", "recall", "fscore"), math.nan)
    there, back = (KDTree(b).query(a)[0] for a, b in (clouds, clouds[::-1]))
    precision, recall = (100.0 * float(np.mean(d < threshold_m)) for d in (there, back))
    both = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return {
        "accuracy": float(there.mean()),
        "completeness": float(back.mean()),
        "precision": precision,
        "recall": recall,
        "fscore": both,
    }
