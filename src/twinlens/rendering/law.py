"""The camera law in Dr.Jit, said once: the ray of a film position and a point of the aperture.

A pixel that looks along (x, y, 1) and the aperture point a send the ray o = a, d = (x - k ax, y - k ay, 1) in the
camera frame of `twinlens.geometry`. All values are opaque to the compiler, so that other cameras reuse the kernel.
"""

import functools
from typing import Any

import drjit as dr
import numpy as np

from twinlens.camera import Camera
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.warp import CornerTable


def corner_directions(camera: Camera) -> Float:
    """(x, y) of the directions (x, y, 1) at the corners of the pixels, (H + 1, W + 1, 2)."""
    rows, columns = np.mgrid[: camera.height + 1, : camera.width + 1]
    return camera.unproject(np.stack([columns, rows], axis=-1) - 0.5)[..., :2]


class CameraLaw:
    """One camera at one pose."""

    def __init__(self, camera: Camera, world_from_cam: Float) -> None:
        mi = mitsuba()
        opaque = functools.partial(dr.opaque, mi.Float)
        self.principal = opaque(camera.cx), opaque(camera.cy)
        self.focal = opaque(camera.fx), opaque(camera.fy)
        self.undistorted = None if camera.distortion is None else CornerTable(corner_directions(camera))
        self.x, self.y, self.z, self.origin = (
            mi.Vector3f(*(opaque(world_from_cam[row, column]) for row in range(3))) for column in range(4)
        )

    def looks_along(self, u: Any, v: Any) -> tuple[Any, Any]:
        """(x, y) of the chief ray through a film position in pixels, counted from pixel centres."""
        if self.undistorted is not None:
            direction = self.undistorted(u + 0.5, v + 0.5)
            return direction.x, direction.y
        return (u - self.principal[0]) / self.focal[0], (v - self.principal[1]) / self.focal[1]

    def ray(self, u: Any, v: Any, ax: Any, ay: Any, k: Any) -> tuple[Any, Any]:
        """Origin and unit direction in the world, from pixels (u, v) and metres (ax, ay), at vergence `k` in 1/m."""
        x, y = self.looks_along(u, v)
        direction = (x - k * ax) * self.x + (y - k * ay) * self.y + self.z
        return mitsuba().Point3f(self.origin + ax * self.x + ay * self.y), dr.normalize(direction)
