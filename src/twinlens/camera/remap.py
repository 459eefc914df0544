"""Maps that carry a picture from one camera's pixels to another's: distortion undone, views turned into rows."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError, format_value

_OUTSIDE_PX = -1e4  # what a map says where there is no source pixel: outside for any interpolation kernel


def undistort_maps(
    camera: Camera, to_camera: Camera, to_from_camera: ArrayLike | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(map_x, map_y), float32 (H, W) of `to_camera`: the pixel of `camera` that each of its pixels looks at.

    As `cv2.remap` takes them. `to_from_camera` (3, 3) turns directions of `camera` into `to_camera`'s: a rectifying
    rotation; none by default. A pixel that `camera` does not see is given a place far outside its image.
    """
    try:
        rotation = np.eye(3) if to_from_camera is None else np.asarray(to_from_camera, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"to_from_camera must be a 3x3 rotation, got {format_value(to_from_camera)}") from error
    if rotation.shape != (3, 3):
        raise InputError(f"to_from_camera must be a 3x3 rotation, got shape {rotation.shape}")
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise InputError(f"to_from_camera must be a rotation of determinant +1, got {format_value(rotation)}")
    for each in (camera, to_camera):
        if not isinstance(each, Camera):
            raise InputError(f"undistort_maps needs two cameras, got {format_value(each)}")
    directions = to_camera.unproject(to_camera.pixel_grid()) @ rotation
    pixels = np.nan_to_num(camera.project(directions), nan=_OUTSIDE_PX).astype(np.float32)
    return pixels[..., 0].copy(), pixels[..., 1].copy()
