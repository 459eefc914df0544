"""Images of a coloured point cloud from any pose: each point is a small square, hidden by nearer ones."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from twinlens.camera import Camera
from twinlens.geometry import Float, check_rigid, inverse, rigid, transform_points
from twinlens.reconstruction.surface import Cloud


def splat(
    cloud: Cloud, camera: Camera, world_from_cam: ArrayLike, size_px: int = 2
) -> NDArray[np.uint8]:
    """The image uint8 (H, W, 3) of the cloud: white background, grey points if it has no colours.

    size_px : side of a point's square, pixels.
    """
    pose = check_rigid(world_from_cam, "world_from_cam")
    cam = transform_points(inverse(pose), cloud.points)
    pixels = camera.project(cam)
    inside = camera.contains(pixels)
    # Every pixel (u, v) of every square, and the number of its point.
    corner = np.floor(pixels[inside] - 0.5 * (size_px - 1) + 0.5).astype(int)
    rows, columns = np.mgrid[:size_px, :size_px].reshape(2, -1, 1)
    u, v = (columns + corner[:, 0]).ravel(), (rows + corner[:, 1]).ravel()
    point = np.tile(np.flatnonzero(inside), size_px**2)
    fits = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    # Painter's algorithm: near points come last and stay.
    far_to_near = np.argsort(-cam[point[fits], 2], kind="stable")
    order = np.flatnonzero(fits)[far_to_near]
    colors = cloud.colors
    if colors is None:
        colors = np.full((len(cloud), 3), 128, np.uint8)
    picture = np.full((camera.height, camera.width, 3), 255, np.uint8)
    picture[v[order], u[order]] = colors[point[order]]
    return picture


def orbit(
    world_from_cam: ArrayLike,
    target: ArrayLike,
    angle_deg: float,
    rise_deg: float = 0.0,
) -> Float:
    """The camera's pose rotated about `target` (3,): `angle_deg` about the camera's y axis, `rise_deg` about x."""
    pose = check_rigid(world_from_cam, "world_from_cam")
    centre = np.asarray(target, dtype=np.float64)
    turn_in_cam = Rotation.from_euler("YX", [angle_deg, rise_deg], degrees=True)
    axes = pose[:3, :3]
    turn = axes @ turn_in_cam.as_matrix() @ axes.T  # in world coordinates
    return rigid(turn @ axes, centre + turn @ (pose[:3, 3] - centre))
