"""Rigid transforms, projection, epipolar geometry, triangulation and rectification of matrices and arrays.

Nothing here depends on a camera class: `twinlens.camera` applies these functions to cameras and rigs.

Conventions of twinlens:

- Camera frame as in OpenCV: x right, y down, z forward, in metres. `world_from_cam` is the 4x4 rigid transform from
  camera coordinates to world coordinates, so that names cancel when transforms compose:
  ``px_from_world = px_from_cam @ cam_from_world``.
- Pixel centres are at integer coordinates (u, v). An image covers [-0.5, W-0.5] x [-0.5, H-0.5], and a centred
  principal point is ((W-1)/2, (H-1)/2). Arrays are indexed [y, x]; sizes are given as width, height.
- Depth is z along the optical axis (the distance along a ray is called `ray_distance`). A ray that hits nothing has
  depth +inf.
- Disparity is u_left - u_right in pixels, stored as float32, and ``z = fx * B / (d + doffs)`` with
  ``doffs = cx_right - cx_left``. Unknown or invalid disparity is +inf; NaN and -inf are errors.
- Metres, radians and seconds. Names of values in other units end in the unit (`pixel_pitch_um`, `fov_x_deg`).

Source: Hartley and Zisserman, Multiple View Geometry in Computer Vision, 2nd ed., 2004.
"""

from twinlens.geometry.projection import (
    depth_from_disparity,
    disparity_from_depth,
    film_from_cam,
    image_border,
    px_from_film,
)
from twinlens.geometry.transforms import (
    Float,
    check_rigid,
    dehomogeneous,
    homogeneous,
    inverse,
    look_at,
    rigid,
    rotate,
    skew,
    transform_points,
)

__all__ = [
    "Float",
    "check_rigid",
    "dehomogeneous",
    "depth_from_disparity",
    "disparity_from_depth",
    "film_from_cam",
    "homogeneous",
    "image_border",
    "inverse",
    "look_at",
    "px_from_film",
    "rigid",
    "rotate",
    "skew",
    "transform_points",
]
