"""Rectification of any calibrated pair: rotation of both cameras that makes epipolar lines rows.

The cameras keep their centres, take one orientation whose x axis is the baseline, and lose their distortion. Images
are resampled by `maps`. Ground truth is cast again through `rectified_rig`, never resampled.

Source: Bouguet's method, as in OpenCV's stereoRectify; Hartley and Zisserman 2004, section 11.12.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from twinlens.camera.intrinsics import Camera, undistort_maps
from twinlens.camera.multiview import check_pair, epipole_in_image
from twinlens.camera.rig import ALIGNED, Misalignment, Rig, misaligned
from twinlens.errors import InputError, check_known
from twinlens.geometry import Float, homogeneous, image_border, rigid, skew

_MAX_TAN = math.tan(math.radians(85))  # the widest direction in a rectified image
_MAX_TURN = math.radians(45)  # of a wide view from the rectified axis, to be cropped
_BISECTIONS = 60

FITS = ("focal", "all", "valid", "opencv")
CROPPING = ("focal", "valid")
"""The fits that show a part of a view that is too wide for a rectified image."""


@dataclass(frozen=True, eq=False)
class Rectification:
    """A pair and its rectified pair. `side` is 0 for the first camera, 1 for the second.

    `aligned_rig` is rectified exactly; `rectified_rig`, that of the images, is misaligned if this was asked for.
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
        """Distance of the centres, metres; rectification does not change it."""
        return self.pair.baseline()

    def rotation(self, side: int) -> Float:
        """rect_from_cam (3, 3): from the original camera's axes to the rectified ones."""
        rect_from_world = self.rectified_rig.world_from_cams[side][:3, :3].T
        return np.asarray(rect_from_world @ self.pair.world_from_cams[side][:3, :3])

    def maps(self, side: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(map_x, map_y), float32 (H, W): the original pixel of each rectified one, for `cv2.remap`."""
        return undistort_maps(
            self.pair.cameras[side],
            self.rectified_rig.cameras[side],
            self.rotation(side),
        )

    def warp(self, side: int, image: NDArray[Any]) -> NDArray[Any]:
        """The original image (H, W[, C]) rectified, bilinear, of its dtype; 0 outside the original image."""
        return warp(image, *self.maps(side))

    def valid(self, side: int) -> NDArray[np.bool_]:
        """Whether the source of a rectified pixel is between the outermost pixel centres of its image, bool (H, W)."""
        return _within(
            self.pair.cameras[side],
            self.source_pixels(side, self.rectified_rig.cameras[side].pixel_grid()),
        )

    def source_pixels(self, side: int, rectified: ArrayLike) -> Float:
        """Original pixels (..., 2), float64, of rectified pixels (..., 2); NaN where there are none."""
        rays = self.rectified_rig.cameras[side].rays(rectified) @ self.rotation(side)
        return self.pair.cameras[side].project(rays)

    def rectified_pixels(self, side: int, source: ArrayLike) -> Float:
        """Rectified pixels (..., 2), float64, of original pixels (..., 2); the inverse of `source_pixels`."""
        rays = self.pair.cameras[side].rays(source) @ self.rotation(side).T
        return self.rectified_rig.cameras[side].project(rays)


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
    """Rectify the pair (left, right) of `rig`, any poses, intrinsics and distortion.

    width, height : size of the rectified images, pixels; by default the left camera's.
    fit : how fx = fy is chosen. "focal": the mean focal length of the two cameras; "all": the largest that shows all of
    both images; "valid": the smallest for which every rectified pixel has a source; "opencv": the mean fy,
    and centres from the corners of the images, as `cv2.stereoRectify` with alpha = -1 has them.
    Of a fisheye that sees 85 degrees or more from the rectified axis, "focal" and "valid" show the part around the
    middle of its image.
    zero_doffs : give both cameras one principal point, so that infinity has disparity 0. If False, each image is
    centred on its camera's field of view, which suits converging cameras, and `doffs` is not 0.
    misalignment : calibration error of the second rectified camera.

    Raises InputError where the centres coincide, an epipole is in its image, the right camera is left of the left one,
    or a pixel is 85 degrees or more from the rectified axis and cannot be left out.
    """
    check_pair(rig, left, right)
    check_known("fit", fit, FITS)
    pair = rig.pair(left, right)
    _check_epipoles(pair, (left, right), fit)
    world_from_rect = rectified_orientation(*pair.world_from_cams)
    outlines = [_outline(pair, side, world_from_rect, fit) for side in (0, 1)]
    first = pair.cameras[0]
    size = (
        first.width if width is None else width,
        first.height if height is None else height,
    )
    if fit == "opencv":
        middles = [_mean_of_corners(pair, side, world_from_rect) for side in (0, 1)]
    else:
        middles = [
            _middle(pair, side, world_from_rect, outline)
            for side, outline in enumerate(outlines)
        ]
    centres = _centres(middles, zero_doffs)
    focal = _focal_length(fit, pair, world_from_rect, outlines, centres, size)
    cameras = [
        _facing(camera, centre, focal, size)
        for camera, centre in zip(pair.cameras, centres, strict=True)
    ]
    poses = [rigid(world_from_rect, pose[:3, 3]) for pose in pair.world_from_cams]
    projectors = pair.projectors_from(poses[0])
    aligned = Rig(cameras, poses, projectors=projectors, motion=pair.motion)
    if misalignment == ALIGNED:
        return Rectification(pair, aligned, aligned)
    rectified = misaligned(aligned, (ALIGNED, misalignment))
    return Rectification(pair, aligned, rectified)


def _check_epipoles(pair: Rig, indices: tuple[int, int], fit: str) -> None:
    """InputError if a camera of the pair sees the other one's centre, unless that part of its view is cropped.

    indices : those of the cameras in their rig.
    """
    for side, index in enumerate(indices):
        pixel = epipole_in_image(pair, side, 1 - side)
        if pixel is None:
            continue
        if _turn(pair, side) <= _MAX_TURN:
            _check_can_be_cropped(pair, side, fit)
            continue
        reason = "looks along the baseline (the epipole is in its image) and cannot be rectified"
        raise InputError(f"camera {index} {reason}; use cameras side by side")


def _facing(
    camera: Camera, centre: Float, focal: float, size: tuple[int, int]
) -> Camera:
    """The rectified camera of a view, undistorted, that sees the direction `centre` (x, y) in its middle."""
    # Rounding errors of the focal length would move half pixels.
    cx, cy = np.round(0.5 * (np.array(size) - 1) - focal * centre, 9).tolist()
    return Camera(*size, focal, focal, cx, cy, None, camera.pixel_pitch_um, camera.band)


def _rectified_rays(
    pair: Rig, side: int, world_from_rect: Float, pixels: Float
) -> Float:
    """Unit directions (N, 3) in the rectified frame of pixels (N, 2) of an original image."""
    rays = pair.cameras[side].rays(pixels)
    return np.asarray(rays @ pair.world_from_cams[side][:3, :3].T @ world_from_rect)


def _outline(pair: Rig, side: int, world_from_rect: Float, fit: str) -> Float:
    """The border of an original image in ideal coordinates (x, y) of the rectified frame: (N, 2).

    Directions of a wide view beyond 85 degrees are moved to 85 degrees. Raises InputError where `fit` needs them.
    """
    camera = pair.cameras[side]
    border = image_border(camera.width, camera.height)
    x, y, z = _rectified_rays(pair, side, world_from_rect, border).T
    across = np.hypot(x, y)
    is_beyond = across >= _MAX_TAN * z
    if is_beyond.any():
        _check_can_be_cropped(pair, side, fit)
    # The depth at which a direction of this length across the axis is 85 degrees from it.
    depth = np.where(is_beyond, across / _MAX_TAN, z)
    return np.stack([x / depth, y / depth], axis=1)


def _check_can_be_cropped(pair: Rig, side: int, fit: str) -> None:
    """Raise InputError unless the part of a too wide view that is around the middle of its image can be shown."""
    too_wide = (
        f"camera {side} of the pair sees 85 degrees or more from the rectified axis"
    )
    if _turn(pair, side) > _MAX_TURN:
        raise InputError(
            f"{too_wide}: use a narrower field of view, or cameras with more similar directions"
        )
    if fit not in CROPPING:
        raise InputError(
            f"{too_wide}, which fit {fit!r} would show; {' and '.join(map(repr, CROPPING))} show the part around the "
            "middle of its image"
        )


def _middle_ray(pair: Rig, side: int, world_from_rect: Float) -> Float:
    """The direction (3,) in the rectified frame of the middle of an original image."""
    camera = pair.cameras[side]
    middle = 0.5 * np.array([[camera.width - 1.0, camera.height - 1.0]])
    return np.asarray(_rectified_rays(pair, side, world_from_rect, middle)[0])


def _turn(pair: Rig, side: int) -> float:
    """The angle, radians, from the rectified axis to where the middle of an original image looks."""
    world_from_rect = rectified_orientation(*pair.world_from_cams)
    x, y, z = _middle_ray(pair, side, world_from_rect)
    return math.atan2(math.hypot(x, y), z)


def _middle(pair: Rig, side: int, world_from_rect: Float, outline: Float) -> Float:
    """The ideal coordinates (x, y) of the middle of what a camera sees; of a cropped view, of its image's middle."""
    is_cropped = np.hypot(*outline.T).max() >= _MAX_TAN * (1 - 1e-12)
    if is_cropped:
        x, y, z = _middle_ray(pair, side, world_from_rect)
        return np.array([x / z, y / z])
    return np.asarray(0.5 * (outline.min(axis=0) + outline.max(axis=0)))


def _mean_of_corners(pair: Rig, side: int, world_from_rect: Float) -> Float:
    """The mean of the ideal coordinates (x, y) of the four corner pixels of an original image, as OpenCV takes it."""
    camera = pair.cameras[side]
    right, bottom = camera.width - 1.0, camera.height - 1.0
    corners = np.array([(0, 0), (right, 0), (0, bottom), (right, bottom)])
    x, y, z = _rectified_rays(pair, side, world_from_rect, corners).T
    return np.array([(x / z).mean(), (y / z).mean()])


def _centres(middles: list[Float], zero_doffs: bool) -> list[Float]:
    """The direction (x, y) at the middle of each rectified image: y is that of both, and x too for `zero_doffs`."""
    mean = 0.5 * (middles[0] + middles[1])
    if zero_doffs:
        return [mean, mean]
    return [np.array([middle[0], mean[1]]) for middle in middles]


def _focal_length(
    fit: str,
    pair: Rig,
    world_from_rect: Float,
    outlines: list[Float],
    centres: list[Float],
    size: tuple[int, int],
) -> float:
    """The focal length of the rectified cameras in pixels; see `rectify`."""
    mean = float(np.mean([(camera.fx, camera.fy) for camera in pair.cameras]))
    if fit == "focal":
        return mean
    if fit == "opencv":
        return float(np.mean([camera.fy for camera in pair.cameras]))
    half_size = 0.5 * (np.array(size) - 1)
    reaches = [
        np.abs(outline - centre).max(axis=0)
        for outline, centre in zip(outlines, centres, strict=True)
    ]
    # The outline that reaches farthest from the centre of its image just fits.
    low = float((half_size / np.max(reaches, axis=0)).min())
    if fit == "all":
        return low
    # What is covered at a focal length is covered at larger ones: bisect the logarithm.
    high = 1e3 * mean
    offsets = image_border(*size) - half_size
    if not _covered(pair, world_from_rect, centres, offsets / high):
        raise InputError(
            "fit='valid' needs the middle of the rectified image in both views: try zero_doffs=False"
        )
    for _ in range(_BISECTIONS):
        middle = math.sqrt(low * high)
        if _covered(pair, world_from_rect, centres, offsets / middle):
            high = middle
        else:
            low = middle
    return high


def _covered(
    pair: Rig, world_from_rect: Float, centres: list[Float], border: Float
) -> bool:
    """Whether the borders (N, 2) of both rectified images, from their centres, have sources in the original images."""
    for camera, pose, centre in zip(
        pair.cameras, pair.world_from_cams, centres, strict=True
    ):
        cam_from_rect = pose[:3, :3].T @ world_from_rect
        rays = homogeneous(centre + border) @ cam_from_rect.T
        if not _within(camera, camera.project(rays)).all():
            return False
    return True


def _within(camera: Camera, pixels: Float) -> NDArray[np.bool_]:
    """Whether pixels (..., 2) are between the outermost pixel centres; False for NaN."""
    last = camera.width - 1, camera.height - 1
    inside = (pixels >= 0) & (pixels <= last)
    return np.asarray(inside.all(axis=-1))


def rectified_orientation(world_from_left: Float, world_from_right: Float) -> Float:
    """world_from_rect (3, 3): the mean orientation of two cameras, by the smallest rotation with x along the baseline.

    Raises InputError if the right camera is left of the left one.
    """
    left = Rotation.from_matrix(world_from_left[:3, :3])
    right = Rotation.from_matrix(world_from_right[:3, :3])
    # Half of the rotation from the left to the right camera, after the left one.
    halfway = Rotation.from_rotvec(0.5 * (left.inv() * right).as_rotvec())
    mean = (left * halfway).as_matrix()
    baseline = world_from_right[:3, 3] - world_from_left[:3, 3]
    x = baseline / np.linalg.norm(baseline)
    cosine = float(mean[:, 0] @ x)
    if cosine < -1e-6:
        raise InputError(
            "the second camera is left of the first: exchange the two cameras"
        )
    # Rodrigues' formula: I + v + v v / (1 + cosine) rotates the mean x to x. Only the viewing direction z is needed.
    v = skew(np.cross(mean[:, 0], x))
    z = (mean + v @ mean + v @ v @ mean / (1.0 + cosine))[:, 2]
    # Rounding errors leave z not quite perpendicular to x: y is taken from its perpendicular part.
    y = np.cross(z - (z @ x) * x, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def warp(
    image: NDArray[Any], map_x: NDArray[np.float32], map_y: NDArray[np.float32]
) -> NDArray[Any]:
    """Sample `image` (H, W[, C]) bilinearly at pixels (map_x, map_y); 0 beyond the outermost pixel centres; same dtype.

    Raises InputError if the maps differ in shape.
    """
    if map_x.shape != map_y.shape:
        raise InputError(
            f"map_x and map_y must have the same shape, got {map_x.shape} and {map_y.shape}"
        )
    planes = image[..., None] if image.ndim == 2 else image
    yx = np.stack([map_y, map_x]).astype(np.float64)
    warped = np.stack(
        [
            map_coordinates(planes[..., c].astype(np.float64), yx, order=1)
            for c in range(planes.shape[-1])
        ],
        axis=-1,
    )
    rounded = np.rint(warped) if np.issubdtype(image.dtype, np.integer) else warped
    return rounded.astype(image.dtype).reshape(*map_x.shape, *image.shape[2:])
