"""Points where the rays of a camera meet the light of a column or row of a projector."""

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.intrinsics import Camera
from twinlens.camera.rig import Rig
from twinlens.errors import InputError, check_int, check_known
from twinlens.geometry import Float, float_array, inverse, rotate, transform_points

_MOST_STEPS = 50
_CLOSE_PX = 1e-9


def light_plane_points(
    rig: Rig, camera: int, projector: int, position: ArrayLike, axis: str = "u"
) -> Float:
    """World points (H, W, 3), metres, of the pixels of a camera that see these positions of a projector's pattern.

    Pixels of the column x = (u - cx) / fx of a projector without distortion lie in the plane X - x Z = 0 of its frame.
    The ray o + t d of the camera meets it at t = -(o_x - x o_z) / (d_x - x d_z). With distortion, x is corrected by the
    difference of u and the column in which the point is projected, until they agree.

    position : (H, W), projector pixels along the axis, +inf where unknown, as `structured_light.Decoded` has them.
    axis : "u" for columns, "v" for rows.

    Points are +inf in all coordinates where the position is, and where there is none in front of both.
    Raises InputError for another camera, projector, axis or shape.
    """
    check_int("camera", camera, 0, len(rig) - 1)
    check_int("projector", projector, 0, len(rig.projectors) - 1)
    check_known("axis", axis, ("u", "v"))
    film, lamp = rig.cameras[camera], rig.projectors[projector].intrinsics
    positions = float_array("positions", position)
    if positions.shape != (film.height, film.width):
        raise InputError(
            f"positions must be (H, W) = {(film.height, film.width)}, got {positions.shape}"
        )
    has_position = np.isfinite(positions)
    world_from_lamp = rig.world_from_projectors[projector]
    lamp_from_camera = inverse(world_from_lamp) @ rig.world_from_cams[camera]
    pixels = film.pixel_grid()[has_position]
    rays = rotate(lamp_from_camera, film.unproject(pixels))
    centre = lamp_from_camera[:3, 3]
    points = _lit_points(centre, rays, lamp, positions[has_position], axis)
    is_met = np.isfinite(points).all(axis=-1, keepdims=True)
    met = transform_points(world_from_lamp, np.where(is_met, points, 0.0))
    world = np.full((*positions.shape, 3), np.inf)
    world[has_position] = np.where(is_met, met, np.inf)
    return world


def _lit_points(
    origin: Float, directions: Float, lamp: Camera, target: Float, axis: str
) -> Float:
    """Points (N, 3) of rays, in the projector's frame, that it projects at `target` (N,) along the axis; NaN for none.

    The column of a distorted projector is a curved surface of light. It is found by a fixed-point iteration over the
    plane X - x Z = 0: x += (target - u(x)) / fx, with u(x) the column of the point in which the ray meets the plane.
    Distortion changes u slowly beside the pinhole's fx, so every step shrinks the difference.
    """
    coordinate = 0 if axis == "u" else 1
    focal = (lamp.fx, lamp.fy)[coordinate]
    centre = (lamp.cx, lamp.cy)[coordinate]
    slope = (target - centre) / focal
    for _ in range(_MOST_STEPS):
        points = _on_plane(origin, directions, slope, coordinate)
        difference = target - lamp.project(points)[..., coordinate]
        step = np.where(np.isfinite(difference), difference, 0.0)
        if np.abs(step).max(initial=0.0) < _CLOSE_PX:
            break
        slope = slope + step / focal
    return np.where(np.isfinite(difference)[:, None], points, np.nan)


def _on_plane(origin: Float, directions: Float, slope: Float, coordinate: int) -> Float:
    """Points (N, 3) of rays in planes of light; NaN where a ray does not meet its plane in front of both devices."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -(origin[coordinate] - slope * origin[2]) / (
            directions[:, coordinate] - slope * directions[:, 2]
        )
        points = origin + depth[:, None] * directions
    in_front = np.isfinite(depth) & (depth > 0) & (points[:, 2] > 0)
    return np.where(in_front[:, None], points, np.nan)
