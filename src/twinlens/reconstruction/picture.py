"""Images of a coloured point cloud from any pose: each point is a small square, hidden by nearer ones."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera
from twinlens.geometry import Float, check_rigid, inverse, rigid, transform_points
from twinlens.reconstruction.surface import Cloud


def splat(cloud: Cloud, camera: Camera, world_from_cam: ArrayLike, size_px: int = 2) -> NDArray[np.uint8]:
    """The image uint8 (H, W, 3) of the cloud: white background, grey points if it has no colours.

    size_px : side of a point's square, pixels.
    """
    pose = check_rigid(world_from_cam, "world_from_cam")
    cam = transform_points(inverse(pose), cloud.points)
    pixels = camera.project(cam)
    inside = camera.contains(pixels)
    colors = np.full((len(cloud), 3), 128, np.uint8) if cloud.colors is None else cloud.colors
    order = np.argsort(-cam[inside, 2], kind="stable")  # far points first
    corner = np.floor(pixels[inside][order] - 0.5 * (size_px - 1) + 0.5).astype(int)
    picture = np.full((camera.height, camera.width, 3), 255, np.uint8)
    depth = np.full((camera.height, camera.width), np.inf)
    for dv in range(size_px):
        for du in range(size_px):
            _paint(picture, depth, corner + np.array([du, dv]), cam[inside, 2][order], colors[inside][order])
    return picture


def orbit(world_from_cam: ArrayLike, target: ArrayLike, angle_deg: float, rise_deg: float = 0.0) -> Float:
    """The camera's pose rotated about `target` (3,): `angle_deg` about the camera's y axis, `rise_deg` about x."""
    pose, centre = check_rigid(world_from_cam, "world_from_cam"), np.asarray(target, dtype=np.float64)
    a, b = np.radians([angle_deg, rise_deg])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turn = pose[:3, :3] @ about_y @ about_x @ pose[:3, :3].T
    return rigid(turn @ pose[:3, :3], centre + turn @ (pose[:3, 3] - centre))


def _paint(
    picture: NDArray[np.uint8], depth: Float, pixels: NDArray[np.int64], z: Float, colors: NDArray[np.uint8]
) -> None:
    u, v = pixels.T
    fits = (u >= 0) & (v >= 0) & (u < picture.shape[1]) & (v < picture.shape[0])
    u, v, z = u[fits], v[fits], z[fits]
    nearest = depth.copy()
    np.minimum.at(nearest, (v, u), z)
    wins = z <= nearest[v, u]
    picture[v[wins], u[wins]] = colors[fits][wins]
    depth[:] = nearest
