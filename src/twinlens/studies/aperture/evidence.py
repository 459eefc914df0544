"""Prediction of the share of wrong pixels of an image, without a matcher and without fitted parameters.

A pixel is wrong for one of two reasons:

- The window contains more texture of another depth. A point with texture variance V at disparity d, blurred by
  b^2 = (c/4)^2 + airy^2, keeps V s^2 / (s^2 + b^2) in the squares, spread over its blur disk of diameter c, the mean of
  all points at its disparity. Let E(p, d) be the sum in the window around p. The mean squared difference is least where
  A(p, d') = sum over d of E(p, d) exp(-(d - d')^2 / (4 (s^2 + b_d^2)))  is greatest. If that is more than 2 px from the
  true disparity, the match is wrong, with or without noise.
- Noise moves the match far away: `mismatch`, for the texture that blur and diffraction leave in the window. That theory
  averages over random windows, so V is here the mean over 25 px of the same surface; the variance of the window itself
  would count its randomness twice.

Texture is measured on the images at f-number SHARP_AT without diffraction: the product of the slopes of the left image
and of the right image warped by the true disparity, which cancels rendering noise. Grain: s^2 = covariance of the
images / covariance of their gradients; V = s^2 gradient^2. Blur already present in the sharp images is included in s
and V; (c/4)^2 is the additional blur. Approximations: blur disks are squares of the same variance, near surfaces do not
occlude, and texture visible in one image only is ignored.

The noise is that of the luma at the level of the sharp image. Rendering noise is not included but reported.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.camera import ThinLens
from twinlens.matching import StereoMatcher
from twinlens.sensor import Exposure
from twinlens.studies.aperture.mismatch import RIGHT_PX, mismatch_share
from twinlens.studies.aperture.theory import LUMA, SENSOR, airy_of, luma_noise
from twinlens.studies.stage import Stage

Float = NDArray[np.float64]

SHARP_AT = 11.0
"""The f-number of the images on which texture is measured."""
SIDE = StereoMatcher().block_size
"""The matchers' default block size."""
_STRIDE = 3
_AROUND = 25
"""Side of the box for local means: larger than a window, smaller than uniformly lit surfaces."""


class Expected(NamedTuple):
    """Predicted percentage of wrong pixels; median ratio of rendering noise to sensor noise."""

    wrong: float
    path_noise: float


class Texture:
    """The texture of sharp images, and the disparity that it favours after blur.

    grain: s, pixels. variance: V, (H, W). depth: true disparity in whole pixels, -1 where it is unknown or visible in
    one image only, (H, W). places: the evaluated pixels, bool (H, W). Results are cached.
    """

    def __init__(
        self, grain: float, variance: Float, depth: NDArray[np.int64], places: NDArray[np.bool_], ndisp: int
    ) -> None:
        self.grain, self.depth, self.places, self.ndisp = grain, depth, places, ndisp
        self._textures = (variance, mean_variance(variance, depth))
        self._sums: dict[tuple[int, int, int], Float] = {}
        self._found: dict[tuple[bytes, float], tuple[NDArray[np.intp], Float]] = {}

    def majority(self, disk: Float, least: float) -> tuple[NDArray[np.intp], Float]:
        """The disparity with the greatest A in each window, and its A for the mean variance, (places,).

        disk: additional blur of each pixel, (H, W), pixels. least: s^2 + airy^2.
        """
        pixels = np.bincount(self.depth.ravel() + 1)[1:]
        depths = np.flatnonzero(pixels)
        disks = np.bincount(self.depth.ravel() + 1, disk.ravel())[1:][depths] / pixels[depths]
        key = disks.tobytes(), least
        if key not in self._found:
            spread = least + (disks / 4.0) ** 2
            away = np.arange(self.ndisp) - depths[:, None]
            weights = (self.grain**2 / spread)[:, None] * np.exp(-(away**2) / (4.0 * spread[:, None]))
            boxes = [(int(depth), _box(disk)) for depth, disk in zip(depths, disks, strict=True)]
            own, around = (np.stack([self._window_sum(k, *box) for box in boxes], axis=1) for k in (0, 1))
            found = (own @ weights).argmax(axis=1)
            self._found[key] = found, np.einsum("pd,dp->p", around, weights[:, found])
        return self._found[key]

    def _window_sum(self, kind: int, depth: int, box: int) -> Float:
        """The texture of one disparity, spread over squares of side `box`, summed over the windows, (places,)."""
        key = kind, depth, box
        if key not in self._sums:
            squares = np.where(self.depth == depth, self._textures[kind], 0.0)
            spread = ndimage.uniform_filter(squares, box, mode="constant")
            window = ndimage.uniform_filter(spread, SIDE, mode="constant") * SIDE**2
            self._sums[key] = np.maximum(window[self.places], 0.0)
        return self._sums[key]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the sharp images of a scene provide.

    lens: of the sharp images. blur: their blur disks, (H, W), pixels. levels: (H, W, 3), fractions of white per second.
    texture: of their luma, in squared fractions of white per second, at some of the pixels visible in both images.
    """

    stage: Stage
    lens: ThinLens
    blur: Float
    levels: Float
    texture: Texture

    @staticmethod
    def of(stage: Stage, lens: ThinLens, blur_px: Float, sharp: list[NDArray[np.float32]]) -> "Evidence":
        """From the radiance of both images. blur_px: the signed blur of every pixel, (H, W)."""
        levels = [SENSOR.level_rate(image, camera=stage.camera, lens=lens) for image in sharp]
        both = stage.truth.visible & np.isfinite(stage.truth.disparity)
        disparity = np.where(both, stage.truth.disparity, -1.0)
        left, right = (level @ LUMA for level in levels)
        y, x = np.indices(both.shape, np.float64)
        warped = ndimage.map_coordinates(right, [y, x - disparity], mode="nearest")
        depth = np.rint(disparity).astype(np.int64)
        grain, variance = shared_texture(left, warped, depth)
        places = np.zeros_like(both)
        places[::_STRIDE, ::_STRIDE] = both[::_STRIDE, ::_STRIDE]
        return Evidence(stage, lens, np.abs(blur_px), levels[0], Texture(grain, variance, depth, places, stage.ndisp))

    def expected(
        self, lens: ThinLens, exposure: Exposure, blur_px: Float, diffracts: bool, paths: float = 0.0
    ) -> Expected:
        """The prediction for an image; NaN if no pixels can be evaluated.

        blur_px: the signed blur of every pixel, (H, W). paths: rendering noise relative to the radiance.
        """
        texture, places = self.texture, self.texture.places
        if not places.any():
            return Expected(math.nan, math.nan)
        disk = np.sqrt(np.maximum(blur_px**2 - self.blur**2, 0.0))
        least = texture.grain**2 + airy_of(self.stage, lens, diffracts) ** 2
        found, agreed = texture.majority(disk, least)
        spread = np.sqrt(least + (disk[places] / 4.0) ** 2)
        elsewhere = np.abs(found - self.stage.truth.disparity[places]) > RIGHT_PX
        light = (lens.aperture_diameter / self.lens.aperture_diameter) ** 2 * exposure.time * exposure.gain
        levels = light * self.levels[places]
        luma, sensor = levels @ LUMA, luma_noise(np.minimum(levels, 1.0), exposure.gain)
        snr = np.where(luma < 1.0, light**2 * agreed / (SIDE * sensor) ** 2, 0.0)
        shares = np.where(elsewhere, 1.0, mismatch_share(snr, spread, SIDE, self.stage.ndisp))
        return Expected(100.0 * float(shares.mean()), float(np.median(paths * luma / sensor)))


def _box(disk: float) -> int:
    """The odd side of the square whose variance is nearest to that of a disk of this diameter.

    >>> _box(0.0), _box(6.0), _box(24.0)
    (1, 5, 21)
    """
    return 2 * round((math.sqrt(1.0 + 0.75 * disk**2) - 1.0) / 2.0) + 1


def shared_texture(left: Float, right: Float, depth: NDArray[np.int64]) -> tuple[float, Float]:
    """Grain in pixels, and variance (H, W), of the texture common to two aligned images (H, W).

    depth: disparities in whole pixels, (H, W), -1 where the images are not aligned. Variances are about means over 25
    pixels, which excludes shading. Accurate within 8 % (grain) and 13 % (variance) from 1 to 2 px; at 3 px the means
    remove 11 % and 22 %.
    """
    steep = _slopes(left, right, depth) + _slopes(left.T, right.T, depth.T).T
    seen = depth >= 0
    left, right = (np.where(seen, picture - _local_mean(picture, seen), 0.0) for picture in (left, right))
    alike, total = float((left * right).sum()), float(steep.sum())
    if not (alike > 0 and total > 0):
        return 1.0, np.zeros(depth.shape)
    return math.sqrt(alike / total), np.asarray(alike / total * steep)


def mean_variance(variance: Float, depth: NDArray[np.int64]) -> Float:
    """The mean variance over 25 pixels of the same surface (disparities within 2 px), (H, W)."""
    made = np.zeros(depth.shape)
    for each in np.unique(depth[depth >= 0]):
        mean = _local_mean(variance, (depth >= 0) & (np.abs(depth - each) <= RIGHT_PX))
        made[depth == each] = mean[depth == each]
    return made


def _local_mean(picture: Float, seen: NDArray[np.bool_]) -> Float:
    """The mean of the seen pixels in a box; 0 at unseen pixels."""
    sums = [
        ndimage.uniform_filter(part, _AROUND, mode="constant") for part in (picture * seen, seen.astype(np.float64))
    ]
    return np.where(seen, sums[0] / np.where(seen, sums[1], 1.0), 0.0)


def _slopes(left: Float, right: Float, depth: NDArray[np.int64]) -> Float:
    """The product of the slopes along rows, (H, W). A slope between two depths belongs to the nearer one."""
    one, other = depth[:, :-1], depth[:, 1:]
    slopes = np.where((one >= 0) & (other >= 0), np.diff(left, axis=1) * np.diff(right, axis=1), 0.0)
    made = np.zeros(depth.shape)
    made[:, :-1] += np.where(one >= other, slopes, 0.0)
    made[:, 1:] += np.where(one >= other, 0.0, slopes)
    return made
