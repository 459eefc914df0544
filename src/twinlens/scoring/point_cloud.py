"""Errors in metres between reconstructed and true points: of each pixel, and of clouds by nearest neighbours.

Source of the latter: Seitz et al., CVPR 2006 (accuracy, completeness); Knapitsch et al., Tanks and Temples, 2017
(F-score).
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
    """z = fx B / (d + doffs) in metres, any shape; +inf where d is unknown or d + doffs <= 0.

    >>> c = Calibration((100.0, 100.0, 0.0, 0.0), (100.0, 100.0, 0.0, 0.0), 0.1, 3, 1, 0.0)
    >>> depths([5.0, 0.0, np.inf], c).tolist()
    [2.0, inf, inf]
    """
    values = np.asarray(disp, np.float64)
    valid = np.where(values + calibration.doffs > 0, values, np.inf)
    return np.asarray(depth_from_disparity(valid, calibration.fx, calibration.baseline, calibration.doffs))


def point_errors(found: Float, true: Float, pixels: NDArray[np.intp], calibration: Calibration) -> tuple[Float, Float]:
    """(distance between estimated and true point, distance from the camera to the true point), each (N,) in metres.

    found, true: (N,) disparities; pixels: (N, 2) rows of (v, u). The first is +inf where either point is undefined.
    """
    fx, fy, cx, cy = calibration.cam0
    distance_of_z = np.sqrt(1.0 + ((pixels[:, 1] - cx) / fx) ** 2 + ((pixels[:, 0] - cy) / fy) ** 2)
    z_found, z_true = depths(found, calibration), depths(true, calibration)
    valid = np.isfinite(z_found) & np.isfinite(z_true)
    with np.errstate(invalid="ignore"):
        return np.where(valid, np.abs(z_found - z_true) * distance_of_z, np.inf), z_true * distance_of_z


def points(disp: ArrayLike, calibration: Calibration, mask: ArrayLike | None = None) -> Float:
    """Points (N, 3) in metres of a disparity map (H, W), in the left camera's frame, without unknown pixels.

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
    """Nearest-neighbour errors between the clouds `found` (N, 3) and `true` (M, 3), in metres.

    accuracy, completeness: mean distance from found to true, and from true to found. precision, recall: percentage of
    those distances below threshold_m. fscore: harmonic mean of precision and recall. All are NaN if a cloud is empty.

    >>> cloud_errors([[0, 0, 1], [0, 0, 3]], [[0, 0, 1]], 0.5)
    {'accuracy': 1.0, 'completeness': 0.0, 'precision': 50.0, 'recall': 100.0, 'fscore': 66.66666666666667}
    """
    clouds = {"found": np.asarray(found, np.float64), "true": np.asarray(true, np.float64)}
    for name, cloud in clouds.items():
        if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.isfinite(cloud).all():
            raise InputError(f"cloud {name!r} has shape {cloud.shape}: expected (N, 3) finite metres")
    if not threshold_m > 0:
        raise InputError(f"threshold_m is {threshold_m}: expected a positive distance in metres")
    if not all(cloud.size for cloud in clouds.values()):
        return dict.fromkeys(("accuracy", "completeness", "precision", "recall", "fscore"), math.nan)
    forward, _ = KDTree(clouds["true"]).query(clouds["found"])
    backward, _ = KDTree(clouds["found"]).query(clouds["true"])
    precision, recall = (100.0 * float(np.mean(d < threshold_m)) for d in (forward, backward))
    return {
        "accuracy": float(forward.mean()),
        "completeness": float(backward.mean()),
        "precision": precision,
        "recall": recall,
        "fscore": 2 * precision * recall / (precision + recall) if precision + recall else 0.0,
    }
