"""Two cameras turned, not moved, until their rows agree: rectification of any calibrated pair.

The cameras keep their centres; both take one orientation, whose x axis is the baseline, and lose their distortion. What
they would see is given by the pixels of the old images (`maps`), or, as a `Rig`, to whoever casts rays: ground truth is
cast again through `rectified_rig`, never resampled.

    the two orientations, met half way -> the smallest turn that lays x along the baseline -> K that holds both images

Source: Bouguet's method, as in OpenCV's stereoRectify; Hartley and Zisserman 2004, section 11.12.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from twinlens.camera import ALIGNED, Camera, Misalignment, Rig, undistort_maps
from twinlens.errors import InputError, unknown
from twinlens.geometry import Float, rigid
from twinlens.geometry.epipolar import check_pair, epipole_in_image, skew

_WIDEST = math.tan(math.radians(85))  # a rectified plane holds what lies up to here from its axis
_BORDER = 33  # points along each side of an image by which its outline is followed
_BISECTIONS = 60


@dataclass(frozen=True, eq=False)
class Rectification:
    """A pair and its rectified twin; `side` is 0 for the first camera, 1 for the second.

    pair : Rig of two, the cameras as they are.
    aligned_rig : Rig of two, rectified exactly: ``aligned_rig.is_rectified()``.
    rectified_rig : Rig of two, the cameras whose images the maps make; `aligned_rig` unless misalignment was left in.
    """

    pair: Rig
    aligned_rig: Rig
    rectified_rig: Rig

    @property
    def doffs(self) -> float:
        """cx_right - cx_left, pixels."""
        return self.aligned_rig.doffs()

    @property
    def baseline(self) -> float:
        """Distance of the centres, metres: the same before and after."""
        return self.pair.baseline()

    def rotation(self, side: int) -> Float:
        """rect_from_cam (3, 3): a camera's old directions in its rectified frame."""
        turn: Float = self.rectified_rig.world_from_cams[side][:3, :3].T @ self.pair.world_from_cams[side][:3, :3]
        return turn

    def maps(self, side: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(map_x, map_y), float32 (H, W): the old pixel that each rectified one takes, for `cv2.remap`."""
        return undistort_maps(self.pair.cameras[side], self.rectified_rig.cameras[side], self.rotation(side))

    def warp(self, side: int, image: NDArray[Any]) -> NDArray[Any]:
        """The old image (H, W[, C]) as the rectified camera sees it, bilinear, of its dtype; 0 where it has none."""
        return warp(image, *self.maps(side))

    def valid(self, side: int) -> NDArray[np.bool_]:
        """Whether a rectified pixel looks at the old image, between its outermost pixel centres: bool (H, W)."""
        return _within(self.pair.cameras[side], self.source_pixels(side, self.rectified_rig.cameras[side].pixel_grid()))

    def source_pixels(self, side: int, rectified: ArrayLike) -> Float:
        """Old pixels (..., 2), float64, that rectified pixels (..., 2) look at; NaN where the old camera has none."""
        return self.pair.cameras[side].project(
            self.rectified_rig.cameras[side].unproject(rectified) @ self.rotation(side)
        )

    def rectified_pixels(self, side: int, source: ArrayLike) -> Float:
        """Rectified pixels (..., 2), float64, of old pixels (..., 2); the inverse of `source_pixels`."""
        return self.rectified_rig.cameras[side].project(
            self.pair.cameras[side].unproject(source) @ self.rotation(side).T
        )


def rectify(
    rig: Rig,
    left: int = 0,
    right: int = 1,
    *,
    width: int | None = None,
    height: int | None = None,
    fit: str = "focal",
    zero_doffs: bool = True,
    misalignment: Misalignment = ALIGNED,
) -> Rectification:
    """The pair (left, right) of `rig`, any poses, intrinsics and distortion, rectified.

    Parameters
    ----------
    width, height : int
        Of the rectified images, pixels; the left camera's unless said.
    fit : {"focal", "all", "valid"}
        What settles fx = fy: the mean focal length of the two cameras; or that all of both images falls inside; or that
        every pixel has a source in its image.
    zero_doffs : bool
        Give both one principal point, so that infinity has disparity 0. Otherwise each image is centred on what it
        sees, as cameras that look inwards need, and doffs tells.
    misalignment : Misalignment
        Left in the second rectified camera on purpose.

    Raises InputError where the centres coincide, where one camera sees the other's place (the epipole lies in its
    image), where the right camera stands left of the left one, or where some pixel looks 85 degrees or more aside.
    """
    check_pair(rig, left, right)
    pair = rig.pair(left, right)
    _refuse_epipoles(pair, (left, right))
    world_from_rect = _orientation(pair)
    outlines = [_outline(pair, side, world_from_rect) for side in (0, 1)]
    first = pair.cameras[0]
    size = first.width if width is None else width, first.height if height is None else height
    centres = _centres(outlines, zero_doffs)
    focal = _fitted(fit)(pair, world_from_rect, outlines, centres, size)
    cameras = [_camera(size, focal, centre, old) for centre, old in zip(centres, pair.cameras, strict=True)]
    poses = [rigid(world_from_rect, pose[:3, 3]) for pose in pair.world_from_cams]
    aligned = Rig(cameras, poses)
    return Rectification(pair, aligned, aligned if misalignment == ALIGNED else misalignment.applied(aligned))


def _refuse_epipoles(pair: Rig, names: tuple[int, int]) -> None:
    for side in (0, 1):
        if epipole_in_image(pair, side, 1 - side):
            raise InputError(
                f"camera {names[side]} looks along the baseline (the epipole lies in its image): no plane can rectify "
                "it; use cameras that stand side by side"
            )


def _orientation(pair: Rig) -> Float:
    """world_from_rect (3, 3): half way between the cameras', then turned least until x is the baseline."""
    first, second = (Rotation.from_matrix(pose[:3, :3]) for pose in pair.world_from_cams)
    middle = (first * Rotation.from_rotvec(0.5 * (first.inv() * second).as_rotvec())).as_matrix()
    between = pair.world_from_cams[1][:3, 3] - pair.world_from_cams[0][:3, 3]
    x = between / np.linalg.norm(between)
    cosine = float(middle[:, 0] @ x)
    if cosine < -1e-6:
        raise InputError("the second camera stands left of the first as the two look: give them the other way round")
    turn = skew(np.cross(middle[:, 0], x))
    z = (middle + turn @ middle + turn @ turn @ middle / (1.0 + cosine))[:, 2]
    y = np.cross(z - (z @ x) * x, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _outline(pair: Rig, side: int, world_from_rect: Float) -> Float:
    """(x, y) of the rectified frame's directions (x, y, 1), (N, 2), along the border pixels of the old image."""
    camera = pair.cameras[side]
    rays = camera.unproject(_border(camera.width, camera.height))
    x, y, z = (rays @ pair.world_from_cams[side][:3, :3].T @ world_from_rect).T
    if not (np.hypot(x, y) < _WIDEST * z).all():
        raise InputError(
            f"camera {side} of the pair sees directions 85 degrees and more from the rectified axis, which no image "
            "plane holds: use a narrower view, or cameras that look more alike and less along the baseline"
        )
    return np.stack([x / z, y / z], axis=1)


def _border(width: int, height: int) -> Float:
    """Points (N, 2) along the outermost pixel centres of an image."""
    u, v = np.linspace(0, width - 1, _BORDER), np.linspace(0, height - 1, _BORDER)
    ends = np.ones(_BORDER)
    sides = [(u, 0 * ends), (u, (height - 1) * ends), (0 * ends, v), ((width - 1) * ends, v)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def _centres(outlines: list[Float], zero_doffs: bool) -> list[Float]:
    """The direction (x, y) that the middle of each rectified image looks along: of its own outline, or both's."""
    own = [0.5 * (outline.min(axis=0) + outline.max(axis=0)) for outline in outlines]
    mean = 0.5 * (own[0] + own[1])
    return [np.array([mean[0] if zero_doffs else centre[0], mean[1]]) for centre in own]


Fit = Callable[[Rig, Float, list[Float], list[Float], tuple[int, int]], float]


def _fitted(fit: str) -> Fit:
    if fit not in FITS:
        raise unknown("fit", fit, FITS)
    return FITS[fit]


def _fit_focal(pair: Rig, *_: object) -> float:
    return float(np.mean([(camera.fx, camera.fy) for camera in pair.cameras]))


def _fit_all(
    pair: Rig, world_from_rect: Float, outlines: list[Float], centres: list[Float], size: tuple[int, int]
) -> float:
    reach = np.max([np.abs(outline - centre).max(axis=0) for outline, centre in zip(outlines, centres, strict=True)], 0)
    return float((0.5 * (np.array(size) - 1) / reach).min())


def _fit_valid(
    pair: Rig, world_from_rect: Float, outlines: list[Float], centres: list[Float], size: tuple[int, int]
) -> float:
    """The shortest focal length whose rectified borders all have sources, found between bounds by bisection."""
    low, high = _fit_all(pair, world_from_rect, outlines, centres, size), 1e3 * _fit_focal(pair)

    def covered(focal: float) -> bool:
        offsets = (_border(*size) - 0.5 * (np.array(size) - 1)) / focal
        return all(_sees(pair, side, world_from_rect, centres[side] + offsets) for side in (0, 1))

    if not covered(high):
        raise InputError(
            "fit='valid' needs both cameras to see the middle of the rectified image: try zero_doffs=False"
        )
    for _ in range(_BISECTIONS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if covered(middle) else (middle, high)
    return high


FITS: dict[str, Fit] = {"focal": _fit_focal, "all": _fit_all, "valid": _fit_valid}
"""What settles the focal length of rectified cameras, by name."""


def _sees(pair: Rig, side: int, world_from_rect: Float, xy: Float) -> bool:
    directions = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    camera = pair.cameras[side]
    rays = directions @ world_from_rect.T @ pair.world_from_cams[side][:3, :3]
    return bool(_within(camera, camera.project(rays)).all())


def _within(camera: Camera, pixels: Float) -> NDArray[np.bool_]:
    """Whether pixels (..., 2) lie between the outermost pixel centres; NaN does not."""
    inside: NDArray[np.bool_] = np.all((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1)), axis=-1)
    return inside


def _camera(size: tuple[int, int], focal: float, centre: Float, old: Camera) -> Camera:
    cx, cy = 0.5 * (np.array(size) - 1) - focal * centre
    return Camera(*size, focal, focal, float(cx), float(cy), pixel_pitch_um=old.pixel_pitch_um)


def warp(image: NDArray[Any], map_x: NDArray[np.float32], map_y: NDArray[np.float32]) -> NDArray[Any]:
    """`image` (H, W[, C]) at the pixels (map_x, map_y), bilinear, of the same dtype; 0 where a map leads outside.

    Raises InputError for maps of unlike shapes.
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
