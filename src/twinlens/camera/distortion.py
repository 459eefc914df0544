"""Projections of a camera: from directions to the film. The perspective, and two models of lens distortion.

Film points (x_d, y_d) are in units of the focal length, ``px = K (x_d, y_d, 1)``. The perspective projection and the
Brown-Conrady model start from ideal coordinates (x, y) = (X/Z, Y/Z), which exist in front of the camera only. The
Kannala-Brandt fisheye starts from the angle to the axis, which may exceed 90 degrees.

Coefficients are named and ordered as in OpenCV. Beyond a certain radius a polynomial may fold the image over itself:
directions from there on have no film point, and `check_invertible` refuses a camera whose image reaches beyond it.

Sources: Brown, Decentering distortion of lenses, 1966; Kannala and Brandt, A generic camera model and calibration
method for conventional, wide-angle, and fish-eye lenses, 2006; OpenCV's calib3d documentation for the order.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float, homogeneous, image_border
from twinlens.settings import Setting, Settings

_ITERATIONS = 50
_CONVERGED = 1e-12  # in units of the focal length
_HALVINGS = 8
_PATH_STEPS = 64  # along the lines from the axis to the image's border that are searched for a fold
_NEGLIGIBLE = 1e-100  # a leading coefficient without effect in any image


class FilmProjection(ABC):
    """What a camera does between the directions that it sees and its film. All arrays are float64."""

    @abstractmethod
    def project(self, directions: ArrayLike) -> Float:
        """Film points (..., 2) of directions (..., 3) of any length, camera frame; NaN for those without an image."""

    @abstractmethod
    def unproject(self, film: ArrayLike) -> Float:
        """Unit directions (..., 3) of film points (..., 2); NaN where none, or several, lead there."""

    @property
    def fold(self) -> str:
        """Where the projection folds, for error messages; empty where it does not."""
        return ""

    def undistort(self, film: ArrayLike) -> Float:
        """Ideal coordinates (..., 2) = (X/Z, Y/Z) of film points (..., 2); NaN for directions with Z <= 0."""
        directions = self.unproject(film)
        z = directions[..., 2:]
        with np.errstate(invalid="ignore"):
            return np.asarray(directions[..., :2] / np.where(z > 0, z, np.nan))


class PlaneMap(FilmProjection):
    """A projection that, in front of the camera, is a map of ideal coordinates (x, y) = (X/Z, Y/Z) to film points."""

    @abstractmethod
    def distort(self, xy: ArrayLike) -> Float:
        """Film points (..., 2) of ideal coordinates (..., 2), float64, also beyond the fold."""

    @abstractmethod
    def jacobian(self, xy: ArrayLike) -> Float:
        """d(x_d, y_d)/d(x, y), (..., 2, 2)."""

    @abstractmethod
    def valid(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Whether ideal points (..., 2) are before the first fold."""


class PlanarProjection(PlaneMap):
    """A projection that starts from ideal coordinates, so that directions of 90 degrees and more have no image."""

    @abstractmethod
    def undistort(self, film: ArrayLike) -> Float:
        """Ideal coordinates (..., 2) of film points (..., 2); NaN where there are none."""

    def project(self, directions: ArrayLike) -> Float:
        points = np.asarray(directions, dtype=np.float64)
        z = points[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(z > 0, points[..., :2] / z, np.nan)
        return self.distort(np.where(self.valid(xy)[..., None], xy, np.nan))

    def unproject(self, film: ArrayLike) -> Float:
        directions = homogeneous(self.undistort(film))
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.asarray(directions / length)


class Perspective(PlanarProjection):
    """The projection without distortion: film points are ideal coordinates."""

    def distort(self, xy: ArrayLike) -> Float:
        return np.asarray(xy, dtype=np.float64)

    def undistort(self, film: ArrayLike) -> Float:
        return np.asarray(film, dtype=np.float64)

    def jacobian(self, xy: ArrayLike) -> Float:
        return np.broadcast_to(np.eye(2), (*np.shape(xy), 2))

    def valid(self, xy: ArrayLike) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(xy).all(axis=-1))


PERSPECTIVE = Perspective()


Coefficient = Annotated[
    float, Setting("Coefficient of the model.", least=-1e6, most=1e6)
]


@dataclass(frozen=True)
class _Coefficients(Settings):
    """Base of the two models of distortion."""

    name: ClassVar[str]

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The coefficients in the order of the fields, which is OpenCV's."""
        return astuple(self)


@dataclass(frozen=True)
class BrownConrady(_Coefficients, PlanarProjection, noun="brown-conrady distortion"):
    """Radial and tangential distortion with OpenCV's eight coefficients.

    With r^2 = x^2 + y^2 and R = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)::

        x_d = x R + 2 p1 x y + p2 (r^2 + 2 x^2)
        y_d = y R + p1 (r^2 + 2 y^2) + 2 p2 x y

    >>> BrownConrady(k1=-0.1).distort([0.5, 0.0]).tolist()
    [0.4875, 0.0]
    """

    name: ClassVar[str] = "brown-conrady"
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0
    k5: Coefficient = 0.0
    k6: Coefficient = 0.0

    def distort(self, xy: ArrayLike) -> Float:
        x, y = np.moveaxis(np.asarray(xy, dtype=np.float64), -1, 0)
        r2 = x * x + y * y
        over, under = self._parts
        radial = over(r2) / under(r2)
        x_d = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        y_d = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([x_d, y_d], axis=-1)

    def jacobian(self, xy: ArrayLike) -> Float:
        x, y = np.moveaxis(np.asarray(xy, dtype=np.float64), -1, 0)
        r2 = x * x + y * y
        over, under = self._parts
        radial = over(r2) / under(r2)
        # With s = r^2 and R = over / under, dR/ds = (over' - R under') / under. As ds/dx = 2 x, dR/dx = slope x with
        # slope = 2 dR/ds, and dR/dy = slope y.
        slope = 2 * (over.deriv()(r2) - radial * under.deriv()(r2)) / under(r2)
        mixed = slope * x * y + 2 * self.p1 * x + 2 * self.p2 * y
        dxx = radial + slope * x * x + 2 * self.p1 * y + 6 * self.p2 * x
        dyy = radial + slope * y * y + 6 * self.p1 * y + 2 * self.p2 * x
        # The matrix is symmetric: the model is the gradient of a potential.
        rows = np.stack([dxx, mixed], axis=-1), np.stack([mixed, dyy], axis=-1)
        return np.stack(rows, axis=-2)

    def valid(self, xy: ArrayLike) -> NDArray[np.bool_]:
        # the radial part increases, and det J > 0
        x, y = np.moveaxis(np.asarray(xy, dtype=np.float64), -1, 0)
        before = x * x + y * y < self._fold_radius2
        with np.errstate(all="ignore"):
            return np.asarray(before & (np.linalg.det(self.jacobian(xy)) > 0))

    def undistort(self, film: ArrayLike) -> Float:
        """Ideal coordinates (..., 2) of film points (..., 2), to 1e-12; NaN where there are none.

        Newton's method for e(x) = distort(x) - film = 0 from the film point itself: x <- x - J^-1 e, with the Jacobian
        J of the distortion. Far from the solution a full step may overshoot the fold or a pole of R, so each step is
        halved until it reduces max |e|, as in Dennis and Schnabel, Numerical Methods for Unconstrained Optimization,
        1983, section 6.3. Near the solution full steps converge quadratically.
        """
        film = np.asarray(film, dtype=np.float64)
        target = film.reshape(-1, 2)
        with np.errstate(all="ignore"):  # a step may reach a pole of R
            xy, error = target.copy(), self.distort(target) - target
            # Only points that have not converged, and that a step brought nearer, are iterated.
            active = np.flatnonzero(np.isfinite(error).all(axis=1))
            for _ in range(_ITERATIONS):
                size = np.abs(error[active]).max(axis=1)
                active = active[size > _CONVERGED]
                if not active.size:
                    break
                active = self._move_closer(xy, error, target, active)
            # One more full step, which near the solution squares the error.
            xy -= self._newton_step(xy, error)
            solved = (np.abs(error).max(axis=1) <= _CONVERGED) & self.valid(xy)
        return np.where(solved[:, None], xy, np.nan).reshape(film.shape)

    def _move_closer(
        self, xy: Float, error: Float, target: Float, active: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Move the active points by the largest of the steps 1, 1/2, 1/4, ... that reduces their error.

        Changes xy and error (N, 2). Returns the indices of the points that moved.
        """
        start, step = xy[active], self._newton_step(xy[active], error[active])
        size = np.abs(error[active]).max(axis=1)
        closer = np.zeros(len(active), dtype=bool)
        for halving in range(_HALVINGS):
            trial = start - 0.5**halving * step
            residual = self.distort(trial) - target[active]
            take = ~closer & (np.abs(residual).max(axis=1) < size)
            xy[active[take]], error[active[take]] = trial[take], residual[take]
            closer |= take
            if closer.all():
                break
        return active[closer]

    def _newton_step(self, xy: Float, error: Float) -> Float:
        """J^-1 error for (N, 2) points; not finite where J has no inverse."""
        (a, b), (c, d) = np.moveaxis(self.jacobian(xy), 0, -1)
        ex, ey = error.T
        # Cramer's rule: [[a, b], [c, d]]^-1 = [[d, -b], [-c, a]] / (a d - b c).
        adjugate_error = np.stack([d * ex - b * ey, a * ey - c * ex], axis=1)
        determinant = a * d - b * c
        return np.asarray(adjugate_error / determinant[:, None])

    @cached_property
    def _parts(self) -> tuple[Polynomial, Polynomial]:
        """The numerator and the denominator of R, of r^2."""
        over = Polynomial([1.0, self.k1, self.k2, self.k3])
        under = Polynomial([1.0, self.k4, self.k5, self.k6])
        return over, under

    @property
    def fold(self) -> str:
        fold_deg = math.degrees(math.atan(math.sqrt(self._fold_radius2)))
        if fold_deg < 90:
            return f"its radial part folds at {fold_deg:.4g} degrees from the axis"
        return "its tangential part folds"

    @cached_property
    def _fold_radius2(self) -> float:
        """The first r^2 at which d(r R)/dr = 0 or R has a pole; inf if there is none."""
        # d(r R)/dr = R + 2 s dR/ds, with s = r^2 and R = over / under. Over the common denominator under^2 the
        # numerator is (over + 2 s over') under - 2 s over under'; its first positive root is the fold.
        s = Polynomial([0.0, 1.0])
        over, under = self._parts
        rise = (over + 2 * s * over.deriv()) * under - 2 * s * over * under.deriv()
        return min(_first_positive_root(rise), _first_positive_root(under))


@dataclass(frozen=True)
class KannalaBrandt(_Coefficients, PlaneMap, noun="kannala-brandt distortion"):
    """OpenCV's fisheye: theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8), theta the angle from the axis.

    ``(x_d, y_d) = theta_d (X, Y) / hypot(X, Y)`` for the direction (X, Y, Z) at the angle theta, which may exceed 90
    degrees. The image folds where theta_d falls. `distort`, `undistort`, `jacobian` and `valid` are those of OpenCV: of
    ideal coordinates, where r = tan(theta), which end at 90 degrees.

    >>> KannalaBrandt().project([1.0, 0.0, 0.0]).round(6).tolist()
    [1.570796, 0.0]
    """

    name: ClassVar[str] = "kannala-brandt"
    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0

    def project(self, directions: ArrayLike) -> Float:
        points = np.asarray(directions, dtype=np.float64)
        across = np.linalg.norm(points[..., :2], axis=-1)
        angle = np.arctan2(across, points[..., 2])
        imaged = (angle < self._fold_angle) & points.any(axis=-1)
        film_radius = np.where(imaged, self._angle(angle), np.nan)
        # On the axis the film point is (0, 0), whatever its direction.
        scale = film_radius / np.where(across > 0, across, 1.0)
        return np.asarray(points[..., :2] * scale[..., None])

    def unproject(self, film: ArrayLike) -> Float:
        film = np.asarray(film, dtype=np.float64)
        radius = np.linalg.norm(film, axis=-1)
        angle = self._angle_of(radius)
        scale = np.sin(angle) / np.where(radius > 0, radius, 1.0)
        return np.concatenate(
            [film * scale[..., None], np.cos(angle)[..., None]], axis=-1
        )

    def _angle_of(self, radius: Float) -> Float:
        """The angle before the fold whose theta_d is `radius` (...); NaN where there is none.

        Newton's method, kept inside a bracket that shrinks: theta_d rises from 0 to the fold.
        """
        low, high = np.zeros_like(radius), np.full_like(radius, self._fold_angle)
        reached = radius < self._angle(self._fold_angle)
        # Radii beyond would end at the fold, where the slope is 0.
        radius = np.where(reached, radius, 0.0)
        angle = np.minimum(radius, 0.5 * self._fold_angle)
        for _ in range(_ITERATIONS):
            error = self._angle(angle) - radius
            # The polynomial rises, so the sign of the error says on which side of the solution the angle is.
            low = np.where(error < 0, angle, low)
            high = np.where(error > 0, angle, high)
            if (np.abs(error) <= _CONVERGED).all():
                break
            step = angle - error / self._angle.deriv()(angle)
            # A step that leaves the bracket is replaced by its middle.
            inside = (step > low) & (step < high)
            angle = np.where(inside, step, 0.5 * (low + high))
        angle -= error / self._angle.deriv()(angle)
        return np.where(reached, angle, np.nan)

    def distort(self, xy: ArrayLike) -> Float:
        xy = np.asarray(xy, dtype=np.float64)
        radius = np.linalg.norm(xy, axis=-1, keepdims=True)
        angle = self._angle(np.arctan(radius))
        scale = np.divide(angle, radius, out=np.ones_like(radius), where=radius > 0)
        return np.asarray(xy * scale)

    def valid(self, xy: ArrayLike) -> NDArray[np.bool_]:
        radius = np.linalg.norm(np.asarray(xy, dtype=np.float64), axis=-1)
        return np.asarray(np.arctan(radius) < self._fold_angle)

    def jacobian(self, xy: ArrayLike) -> Float:
        # The map is radial, x_d = theta_d(atan r) x / r. Its Jacobian has the eigenvalues d theta_d / dr =
        # theta_d' / (1 + r^2) along the radius and theta_d / r across it, both 1 on the axis. With the unit vector u of
        # the radius, J = across I + (along - across) u u^T.
        xy = np.asarray(xy, dtype=np.float64)
        radius = np.linalg.norm(xy, axis=-1)
        angle = np.arctan(radius)
        along = self._angle.deriv()(angle) / (1.0 + radius**2)
        across = np.divide(
            self._angle(angle), radius, out=np.ones_like(radius), where=radius > 0
        )
        unit = np.divide(
            xy, radius[..., None], out=np.zeros_like(xy), where=radius[..., None] > 0
        )
        radial = unit[..., :, None] * unit[..., None, :]
        isotropic = across[..., None, None] * np.eye(2)
        return np.asarray(isotropic + (along - across)[..., None, None] * radial)

    @cached_property
    def _angle(self) -> Polynomial:
        return Polynomial(
            [0.0, 1.0, 0.0, self.k1, 0.0, self.k2, 0.0, self.k3, 0.0, self.k4]
        )

    @property
    def fold(self) -> str:
        fold_deg = math.degrees(self._fold_angle)
        return f"theta_d falls beyond {fold_deg:.4g} degrees" if fold_deg < 180 else ""

    @cached_property
    def _fold_angle(self) -> float:
        return min(_first_positive_root(self._angle.deriv()), math.pi)


Distortion = BrownConrady | KannalaBrandt


def check_invertible(
    projection: FilmProjection, K: Float, width: int, height: int
) -> None:
    """Raise InputError if the projection folds the image over itself, or the image is of more than all directions.

    On the lines from the image's border to the axis every point must have an inverse before the first fold.
    """
    # The border of the pixels, half a pixel outside the outermost centres, in units of the focal length.
    border = image_border(width, height, margin=0.5)
    ends = (border - K[:2, 2]) / (K[0, 0], K[1, 1])
    path = np.linspace(0.0, 1.0, _PATH_STEPS)[:, None, None] * ends
    lost = np.isnan(projection.unproject(path)).any(axis=(0, 2))
    if not lost.any():
        return
    u, v = border[np.argmax(lost)]
    pixel = f"pixel ({u:g}, {v:g})"
    remedy = "use smaller coefficients, a smaller image, or a larger fx and fy"
    if projection.fold:
        fold = f"folds the image over itself before {pixel}: no ray, or more than one, reaches it, as {projection.fold}"
    else:
        fold = f"does not reach {pixel}, which is more than 180 degrees from the axis"
    raise InputError(f"distortion {projection} {fold}; {remedy}")


def _first_positive_root(polynomial: Polynomial) -> float:
    roots = polynomial.trim(_NEGLIGIBLE).roots()
    is_real = np.abs(roots.imag) <= 1e-9 * np.abs(roots.real)
    positive = roots.real[is_real & (roots.real > 0)]
    return float(positive.min()) if positive.size else math.inf
