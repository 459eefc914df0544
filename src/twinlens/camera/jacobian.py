"""How far a pixel moves when a point does: the derivative of a camera's projection, distortion and all."""

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from twinlens.camera.distortion import BrownConrady, Distortion, KannalaBrandt
from twinlens.camera.intrinsics import Camera
from twinlens.errors import InputError
from twinlens.geometry import Float


def projection_jacobian(camera: Camera, points_cam: ArrayLike) -> Float:
    """d(u, v)/d(X, Y, Z), pixels per metre, (..., 2, 3) at camera-frame points (..., 3).

    By the chain rule diag(fx, fy) D [[1, 0, -x], [0, 1, -y]] / Z, with D the distortion's own Jacobian at (x, y).
    Raises InputError where a point is not finite, at or behind the camera's plane, or beyond a distortion's fold.
    """
    points = np.asarray(points_cam, dtype=np.float64)
    if not (np.isfinite(points).all() and (points[..., 2] > 0).all()):
        raise InputError(
            "a projection's derivative needs finite points in front of the camera (z > 0): leave out others"
        )
    xy, z = points[..., :2] / points[..., 2:], points[..., 2, None, None]
    through = np.zeros((*points.shape[:-1], 2, 3))
    through[..., :2], through[..., 2] = np.eye(2), -xy
    if camera.distortion is not None:
        if not camera.distortion.valid(xy).all():
            raise InputError(
                "a projection's derivative needs points before the fold of the distortion: leave out others"
            )
        through = distortion_jacobian(camera.distortion, xy) @ through
    jacobian: Float = np.array([[camera.fx], [camera.fy]]) * through / z
    return jacobian


def distortion_jacobian(model: Distortion, xy: ArrayLike) -> Float:
    """d(x_d, y_d)/d(x, y), (..., 2, 2) at ideal coordinates (..., 2)."""
    return model.jacobian(xy) if isinstance(model, BrownConrady) else _fisheye(model, np.asarray(xy, dtype=np.float64))


def _fisheye(model: KannalaBrandt, xy: Float) -> Float:
    """Along the radius d theta_d / dr = theta_d' / (1 + r^2), across it theta_d / r; both are 1 on the axis."""
    k1, k2, k3, k4 = model.coefficients
    angle_d = Polynomial([0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4])
    radius = np.linalg.norm(xy, axis=-1)
    angle = np.arctan(radius)
    along = angle_d.deriv()(angle) / (1.0 + radius**2)
    across = np.divide(angle_d(angle), radius, out=np.ones_like(radius), where=radius > 0)
    unit = np.divide(xy, radius[..., None], out=np.zeros_like(xy), where=radius[..., None] > 0)
    radial = unit[..., :, None] * unit[..., None, :]
    jacobian: Float = across[..., None, None] * np.eye(2) + (along - across)[..., None, None] * radial
    return jacobian
