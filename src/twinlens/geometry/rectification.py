"""The rotation that rectifies two views, and resampling of an image by a map.

Source: Bouguet's method, as in OpenCV's stereoRectify; Hartley and Zisserman 2004, section 11.12.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from twinlens.errors import InputError
from twinlens.geometry import Float, skew


def rectified_orientation(world_from_left: Float, world_from_right: Float) -> Float:
    """world_from_rect (3, 3): the mean orientation of two cameras, rotated minimally until x is along the baseline.

    Raises InputError if the right camera is on the left side.
    """
    left, right = (Rotation.from_matrix(pose[:3, :3]) for pose in (world_from_left, world_from_right))
    mean = (left * Rotation.from_rotvec(0.5 * (left.inv() * right).as_rotvec())).as_matrix()
    between = world_from_right[:3, 3] - world_from_left[:3, 3]
    x = between / np.linalg.norm(between)
    cosine = float(mean[:, 0] @ x)
    if cosine < -1e-6:
        raise InputError("the second camera is left of the first: exchange the two cameras")
    turn = skew(np.cross(mean[:, 0], x))
    z = (mean + turn @ mean + turn @ turn @ mean / (1.0 + cosine))[:, 2]
    y = np.cross(z - (z @ x) * x, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def warp(image: NDArray[Any], map_x: NDArray[np.float32], map_y: NDArray[np.float32]) -> NDArray[Any]:
    """`image` (H, W[, C]) at the pixels (map_x, map_y), bilinear, of the same dtype; 0 outside the image.

    Raises InputError if the maps differ in shape.
    """
    if map_x.shape != map_y.shape:
        raise InputError(f"map_x and map_y must be of one shape, got {map_x.shape} and {map_y.shape}")
    planes = image[..., None] if image.ndim == 2 else image
    at = np.stack([map_y, map_x]).astype(np.float64)
    warped = np.stack(
        [map_coordinates(planes[..., c].astype(np.float64), at, order=1) for c in range(planes.shape[-1])], axis=-1
    )
    rounded = np.rint(warped) if np.issubdtype(image.dtype, np.integer) else warped
    return rounded.astype(image.dtype).reshape(*map_x.shape, *image.shape[2:])
