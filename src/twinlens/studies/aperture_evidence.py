"""The share of wrong pixels that theory expects of a photograph. No matcher in it, and nothing fitted.

Wrong in either of two ways:

- The window sees more texture of another depth. A point of texture variance V at disparity d is blurred by
  b^2 = (c/4)^2 + airy^2 and leaves V s^2 / (s^2 + b^2) in the squares, spread over its blur disk, whose diameter c is
  one for all of a disparity. In a window around p let E(p, d) be their sum. The squared differences are then least, in
  the mean, where  A(p, d') = sum over d of E(p, d) exp(-(d - d')^2 / (4 (s^2 + b_d^2)))  is most; if that is more than
  2 px from p's true disparity, the match is wrong, whatever the noise: edges, and slopes, where blur mixes depths.
- Noise takes the match far away: `aperture_mismatch`, for the texture that blur and diffraction leave in the window.
  That theory draws what a window happens to hold, so it is told the variance of the texture all around: here V is the
  mean over 25 px of the same surface. The window's own, of before the blur, would count the luck of the draw twice; and
  it says little of a window that is blurred by more than its width, into which light comes from outside.

Texture is measured once, on the pictures that the narrow lens SHARP_AT takes without diffraction, as what both eyes see
alike: the product of their slopes, the right picture's brought to the left by the true disparity. So the noise of light
paths, which the eyes do not share, is none. Grain: s^2 = covariance of the eyes / covariance of their gradients;
V = s^2 gradient^2. What that lens blurs is in s and V: (c/4)^2 is only what another lens blurs more. Blur disks are
taken as squares of the same variance, near surfaces as veils that hide nothing. What one eye alone sees speaks for no
depth.

The noise is that of the luma which matchers compare, at the level of the sharp picture. It is the camera's: what light
paths leave in the radiance is not counted, but set beside it, as the pictures have it too.
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
from twinlens.studies.aperture_mismatch import RIGHT_PX, mismatch_share
from twinlens.studies.aperture_theory import LUMA, SENSOR, airy_px, luma_noise
from twinlens.studies.stage import Stage

Float = NDArray[np.float64]

SHARP_AT = 11.0
"""The f-number whose pictures tell the texture."""
SIDE = StereoMatcher().block_size
"""Of the window: the matchers' own, unless they are told otherwise."""
_STRIDE = 3
_AROUND = 25
"""Well more than a window and less than what is lit or made alike: over so many pixels texture is judged."""


class Expected(NamedTuple):
    """The percentage of wrong pixels; the noise of the light paths over that of the sensor, the picture's median."""

    wrong: float
    path_noise: float


class Layers:
    """The texture of each disparity in the windows around some places, spread by blur; what was asked once is kept.

    texture: V, (H, W). depth: the true disparity in whole pixels, -1 where it is unknown or one eye alone sees, (H, W).
    places: (H, W).
    """

    def __init__(self, texture: Float, depth: NDArray[np.int64], places: NDArray[np.bool_]) -> None:
        self._texture, self._depth, self._places = texture, depth, places
        self._seen: dict[tuple[int, int], Float] = {}

    def seen(self, depth: int, box: int) -> Float:
        """Of one disparity, spread over squares of this side but not weakened: its sum in the windows, (places,)."""
        key = depth, box
        if key not in self._seen:
            squares = np.where(self._depth == depth, self._texture, 0.0)
            spread = ndimage.uniform_filter(squares, box, mode="constant")
            window = ndimage.uniform_filter(spread, SIDE, mode="constant") * SIDE**2
            self._seen[key] = np.maximum(window[self._places], 0.0)
        return self._seen[key]


class Texture:
    """For which disparities the texture of sharp pictures speaks, as lenses blur it; what was asked once is kept.

    grain: s, pixels. variance, depth, places: of `Layers`.
    """

    def __init__(
        self, grain: float, variance: Float, depth: NDArray[np.int64], places: NDArray[np.bool_], ndisp: int
    ) -> None:
        self.grain, self.depth, self.places, self.ndisp = grain, depth, places, ndisp
        self._own = Layers(variance, depth, places)
        self._usual = Layers(usual(variance, depth), depth, places)
        self._found: dict[tuple[bytes, float], tuple[NDArray[np.intp], Float]] = {}

    def majority(self, disk: Float, least: float) -> tuple[NDArray[np.intp], Float]:
        """The disparity for which most of it in each window speaks, and A of what usually speaks for it, (places,).

        disk: how much wider than in the sharp pictures each pixel's blur is, (H, W), pixels. least: s^2 + airy^2.
        """
        pixels = np.bincount(self.depth.ravel() + 1)[1:]
        depths = np.flatnonzero(pixels)
        disks = np.bincount(self.depth.ravel() + 1, disk.ravel())[1:][depths] / pixels[depths]
        key = disks.tobytes(), least
        if key not in self._found:
            spread = least + (disks / 4.0) ** 2
            away = np.arange(self.ndisp) - depths[:, None]
            speaks = (self.grain**2 / spread)[:, None] * np.exp(-(away**2) / (4.0 * spread[:, None]))
            boxes = [(int(depth), _box(disk)) for depth, disk in zip(depths, disks, strict=True)]
            own, around = (
                np.stack([layers.seen(*box) for box in boxes], axis=1) for layers in (self._own, self._usual)
            )
            found = (own @ speaks).argmax(axis=1)
            self._found[key] = found, np.einsum("pd,dp->p", around, speaks[:, found])
        return self._found[key]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the sharp pictures of a scene hold.

    lens: the one that took them. blur: its blur disks, (H, W), pixels. levels: (H, W, 3), shares of white a second.
    texture: of their luma, in squared shares of white a second; its places, where theory is asked, are some of those
    that both eyes see.
    """

    stage: Stage
    lens: ThinLens
    blur: Float
    levels: Float
    texture: Texture

    @staticmethod
    def of(stage: Stage, lens: ThinLens, blur_px: Float, sharp: list[NDArray[np.float32]]) -> "Evidence":
        """Of the radiance of both eyes. blur_px: of every pixel's depth, signed, (H, W)."""
        levels = [SENSOR.level_rate(eye, camera=stage.camera, lens=lens) for eye in sharp]
        both = stage.truth.visible & np.isfinite(stage.truth.disparity)
        disparity = np.where(both, stage.truth.disparity, -1.0)
        left, right = (level @ LUMA for level in levels)
        y, x = np.indices(both.shape, np.float64)
        brought = ndimage.map_coordinates(right, [y, x - disparity], mode="nearest")
        depth = np.rint(disparity).astype(np.int64)
        grain, variance = shared_texture(left, brought, depth)
        places = np.zeros_like(both)
        places[::_STRIDE, ::_STRIDE] = both[::_STRIDE, ::_STRIDE]
        return Evidence(stage, lens, np.abs(blur_px), levels[0], Texture(grain, variance, depth, places, stage.ndisp))

    def expected(
        self, lens: ThinLens, exposure: Exposure, blur_px: Float, diffracts: bool, paths: float = 0.0
    ) -> Expected:
        """What theory expects of a photograph; NaN where there are no places.

        blur_px: of every pixel's depth, signed, (H, W). paths: noise that light paths leave, in parts of the light.
        """
        texture, places = self.texture, self.texture.places
        if not places.any():
            return Expected(math.nan, math.nan)
        disk = np.sqrt(np.maximum(blur_px**2 - self.blur**2, 0.0))
        least = texture.grain**2 + self._airy(lens, diffracts) ** 2
        found, agreed = texture.majority(disk, least)
        spread = np.sqrt(least + (disk[places] / 4.0) ** 2)
        elsewhere = np.abs(found - self.stage.truth.disparity[places]) > RIGHT_PX
        light = (lens.aperture_diameter / self.lens.aperture_diameter) ** 2 * exposure.time * exposure.gain
        levels = light * self.levels[places]
        luma, sensor = levels @ LUMA, luma_noise(np.minimum(levels, 1.0), exposure.gain)
        snr = np.where(luma < 1.0, light**2 * agreed / (SIDE * sensor) ** 2, 0.0)
        shares = np.where(elsewhere, 1.0, mismatch_share(snr, spread, SIDE, self.stage.ndisp))
        return Expected(100.0 * float(shares.mean()), float(np.median(paths * luma / sensor)))

    def _airy(self, lens: ThinLens, diffracts: bool) -> float:
        camera = self.stage.camera
        return airy_px(camera.film_distance / lens.aperture_diameter, camera.pixel_pitch_um) if diffracts else 0.0


def _box(disk: float) -> int:
    """The odd side of the square whose variance is nearest to that of a disk, by their widths.

    >>> _box(0.0), _box(6.0), _box(24.0)
    (1, 5, 21)
    """
    return 2 * round((math.sqrt(1.0 + 0.75 * disk**2) - 1.0) / 2.0) + 1


def shared_texture(left: Float, right: Float, depth: NDArray[np.int64]) -> tuple[float, Float]:
    """Grain in pixels and variance, (H, W), of the texture that two aligned pictures (H, W) share.

    depth: disparities in whole pixels, (H, W), -1 where the pictures are not aligned. A picture's variance is about its
    means over 25 pixels, so that shading does not count as texture. True within 8 % (grain) and 13 % (variance) from 1
    to 2 px: above, those means take texture with them, at 3 px 11 % and 22 % of it.
    """
    steep = _slopes(left, right, depth) + _slopes(left.T, right.T, depth.T).T
    alike = float((_about_mean(left, depth >= 0) * _about_mean(right, depth >= 0)).sum())
    total = float(steep.sum())
    if not (alike > 0 and total > 0):
        return 1.0, np.zeros(depth.shape)
    return math.sqrt(alike / total), np.asarray(alike / total * steep)


def usual(variance: Float, depth: NDArray[np.int64]) -> Float:
    """The mean variance of the same surface all around each pixel, over 25 pixels, (H, W): see `shared_texture`.

    Of the same surface is what has the same disparity within 2 px, so that slopes are not cut up.
    """
    made = np.zeros(depth.shape)
    for each in np.unique(depth[depth >= 0]):
        mean = _mean_around(variance, (depth >= 0) & (np.abs(depth - each) <= RIGHT_PX))
        made[depth == each] = mean[depth == each]
    return made


def _about_mean(picture: Float, seen: NDArray[np.bool_]) -> Float:
    return np.where(seen, picture - _mean_around(picture, seen), 0.0)


def _mean_around(picture: Float, seen: NDArray[np.bool_]) -> Float:
    """Of what is seen; 0 where that is not."""
    sums = [
        ndimage.uniform_filter(part, _AROUND, mode="constant") for part in (picture * seen, seen.astype(np.float64))
    ]
    return np.where(seen, sums[0] / np.where(seen, sums[1], 1.0), 0.0)


def _slopes(left: Float, right: Float, depth: NDArray[np.int64]) -> Float:
    """The product of the slopes along rows, (H, W). One between two depths is the nearer's: an edge moves with it."""
    one, other = depth[:, :-1], depth[:, 1:]
    slopes = np.where((one >= 0) & (other >= 0), np.diff(left, axis=1) * np.diff(right, axis=1), 0.0)
    made = np.zeros(depth.shape)
    made[:, :-1] += np.where(one >= other, slopes, 0.0)
    made[:, 1:] += np.where(one >= other, 0.0, slopes)
    return made
