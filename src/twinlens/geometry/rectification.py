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
    """world_from_rect (3, 3): the mean orientation of two cameras, by the smallest rotation with x along the baseline.

    Raises InputError if the right camera is left of the left one.
    """
    left, right = (Rotation.from_matrix(pose[:3, :3]) for pose in (world_from_left, world_from_right))
    mean = (left * Rotation.from_rotvec(0.5 * (left.inv() * right).as_rotvec())).as_matrix()
    baseline = world_from_right[:3, 3] - world_from_left[:3, 3]
    x = baseline / np.linalg.norm(baseline)
    cosine = float(mean[:, 0] @ x)
    if cosine < -1e-6:
        raise InputError("the second camera is left of the first: exchange the two cameras")
    v = skew(np.cross(mean[:, 0], x))  # Rodrigues' formula: I + v + v v / (1 + cosine) rotates the mean x to x
    z = (mean + v @ mean + v @ v @ mean / (1.0 + cosine))[:, 2]
    y = np.cross(z - (z @ x) * x, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def warp(image: NDArray[Any], map_x: NDArray[np.float32], map_y: NDArray[np.float32]) -> NDArray[Any]:
    """Sample `image` (H, W[, C]) bilinearly at pixels (map_x, map_y); 0 beyond the outermost pixel centres; same dtype.

    Raises InputError if the maps differ in shape.
    """
    if map_x.shape != map_y.shape:
        raise InputError(f"map_x and map_y must have the same shape, got {map_x.shape} and {map_y.shape}")
    planes = image[..., None] if image.ndim == 2 else image
    yx = np.stack([map_y, map_x]).astype(np.float64)
    warped = np.stack(
        [map_coordinates(planes[..., c].astype(np.float64), yx, order=1) for c in range(planes.shape[-1])], axis=-1
    )
    rounded = np.rint(warped) if np.issubdtype(image.dtype, np.integer) else warped
    return rounded.astype(image.dtype).reshape(*map_x.shape, *image.shape[2:])
