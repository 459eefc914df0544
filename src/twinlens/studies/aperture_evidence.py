"""The share of wrong pixels that theory expects of a photograph. No matcher in it, and nothing fitted.

Wrong in either of two ways:

- Noise takes the match far away: `aperture_mismatch`, for the texture that blur and diffraction leave in the window.
- The window sees more texture of another depth. A point of texture variance V at disparity d is blurred by
  b^2 = (c/4)^2 + airy^2 and leaves V s^2 / (s^2 + b^2) in the squares, spread over its blur disk, whose diameter c is
  one for all of a disparity. In a window around p let E(p, d) be their sum. The squared differences are then least, in
  the mean, where  A(p, d') = sum over d of E(p, d) exp(-(d - d')^2 / (4 (s^2 + b_d^2)))  is most; if that is more than
  2 px from p's true disparity, the match is wrong, whatever the noise: edges, and slopes, where blur mixes depths.

Texture is measured once, on the pictures that the narrow lens SHARP_AT takes without diffraction, as what both eyes see
alike: the product of their slopes, the right picture's brought to the left by the true disparity. So the noise of light
paths, which the eyes do not share, is none. Grain: s^2 = covariance of the eyes / covariance of their gradients;
V = s^2 gradient^2. Blur disks are taken as squares of the same variance, near surfaces as veils that hide nothing. What
one eye alone sees speaks for no depth.

The noise is that of the luma which matchers compare, at the level of the sharp picture. It is the camera's: what light
paths leave in the radiance is not counted, but set beside it, as the pictures have it too.
"""

import math
from dataclasses import dataclass, field
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
_PATCH = 17


class Expected(NamedTuple):
    """The percentage of wrong pixels; the noise of the light paths over that of the sensor, the picture's median."""

    wrong: float
    path_noise: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """What texture, at which depths, the sharp pictures of a scene hold.

    lens: the one that took them. levels: (H, W, 3), shares of white a second. texture: V, (H, W), of their luma, in
    squared shares of white a second. grain: s, pixels. depth: (H, W), the true disparity in whole pixels, -1 where it
    is unknown or one eye alone sees. places: (H, W), where theory is asked: some of those that both eyes see.
    """

    stage: Stage
    lens: ThinLens
    levels: Float
    texture: Float
    grain: float
    depth: NDArray[np.int64]
    places: NDArray[np.bool_]
    _seen: dict[tuple[int, int], Float] = field(default_factory=dict)
    _found: dict[tuple[bytes, float], tuple[NDArray[np.intp], Float]] = field(default_factory=dict)

    @staticmethod
    def of(stage: Stage, lens: ThinLens, sharp: list[NDArray[np.float32]]) -> "Evidence":
        """Of the radiance of both eyes."""
        levels = [SENSOR.level_rate(eye, camera=stage.camera, lens=lens) for eye in sharp]
        both = stage.truth.visible & np.isfinite(stage.truth.disparity)
        disparity = np.where(both, stage.truth.disparity, -1.0)
        left, right = (level @ LUMA for level in levels)
        y, x = np.indices(both.shape, np.float64)
        brought = ndimage.map_coordinates(right, [y, x - disparity], mode="nearest")
        depth = np.rint(disparity).astype(np.int64)
        grain, texture = shared_texture(left, brought, depth)
        places = np.zeros_like(both)
        places[::_STRIDE, ::_STRIDE] = both[::_STRIDE, ::_STRIDE]
        return Evidence(stage, lens, levels[0], texture, grain, depth, places)

    def expected(
        self, lens: ThinLens, exposure: Exposure, blur_px: Float, diffracts: bool, paths: float = 0.0
    ) -> Expected:  # fmt: skip
        """What theory expects of a photograph; NaN where there are no places.

        blur_px: of every pixel's depth, signed, (H, W). paths: noise that light paths leave, in parts of the light.
        """
        if not self.places.any():
            return Expected(math.nan, math.nan)
        disk = np.abs(blur_px)
        least = self.grain**2 + self._airy(lens, diffracts) ** 2
        found, agreed = self._majority(disk, least)
        spread = np.sqrt(least + (disk[self.places] / 4.0) ** 2)
        elsewhere = np.abs(found - self.stage.truth.disparity[self.places]) > RIGHT_PX
        light = (lens.aperture_diameter / self.lens.aperture_diameter) ** 2 * exposure.time * exposure.gain
        levels = light * self.levels[self.places]
        luma, sensor = levels @ LUMA, luma_noise(np.minimum(levels, 1.0), exposure.gain)
        snr = np.where(luma < 1.0, light**2 * agreed / (SIDE * sensor) ** 2, 0.0)
        shares = np.where(elsewhere, 1.0, mismatch_share(snr, spread, SIDE, self.stage.ndisp))
        return Expected(100.0 * float(shares.mean()), float(np.median(paths * luma / sensor)))

    def _airy(self, lens: ThinLens, diffracts: bool) -> float:
        camera = self.stage.camera
        return airy_px(camera.film_distance / lens.aperture_diameter, camera.pixel_pitch_um) if diffracts else 0.0

    def _majority(self, disk: Float, least: float) -> tuple[NDArray[np.intp], Float]:
        """The disparity for which most texture in the window speaks, and A of it, (places,); `least`: s^2 + airy^2."""
        pixels = np.bincount(self.depth.ravel() + 1)[1:]
        depths = np.flatnonzero(pixels)
        disks = np.bincount(self.depth.ravel() + 1, disk.ravel())[1:][depths] / pixels[depths]
        key = disks.tobytes(), least
        if key not in self._found:
            spread = least + (disks / 4.0) ** 2
            seen = np.stack([self._of_layer(int(d), _box(c)) for d, c in zip(depths, disks, strict=True)], axis=1)
            away = np.arange(self.stage.ndisp) - depths[:, None]
            agreed = (seen * self.grain**2 / spread) @ np.exp(-(away**2) / (4.0 * spread[:, None]))
            self._found[key] = agreed.argmax(axis=1), agreed.max(axis=1)
        return self._found[key]

    def _of_layer(self, depth: int, box: int) -> Float:
        """The texture of one disparity in the window around every place, spread over squares of this side, (places,).

        Before it is weakened.
        """
        key = depth, box
        if key not in self._seen:
            squares = np.where(self.depth == depth, self.texture, 0.0)
            spread = ndimage.uniform_filter(squares, box, mode="constant")
            window = ndimage.uniform_filter(spread, SIDE, mode="constant") * SIDE**2
            self._seen[key] = np.maximum(window[self.places], 0.0)
        return self._seen[key]


def _box(disk: float) -> int:
    """The odd side of the square whose variance is nearest to that of a disk, by their widths.

    >>> _box(0.0), _box(6.0), _box(24.0)
    (1, 5, 21)
    """
    return 2 * round((math.sqrt(1.0 + 0.75 * disk**2) - 1.0) / 2.0) + 1


def shared_texture(left: Float, right: Float, depth: NDArray[np.int64]) -> tuple[float, Float]:
    """Grain in pixels and variance, (H, W), of the texture that two aligned pictures (H, W) share.

    depth: disparities in whole pixels, (H, W), -1 where the pictures are not aligned. A picture's variance is about its
    means over 17 pixels, so that shading does not count as texture.
    """
    steep = _slopes(left, right, depth) + _slopes(left.T, right.T, depth.T).T
    alike = float((_about_mean(left, depth >= 0) * _about_mean(right, depth >= 0)).sum())
    total = float(steep.sum())
    if not (alike > 0 and total > 0):
        return 1.0, np.zeros(depth.shape)
    return math.sqrt(alike / total), np.asarray(alike / total * steep)


def _about_mean(picture: Float, seen: NDArray[np.bool_]) -> Float:
    sums = [ndimage.uniform_filter(part, _PATCH, mode="constant") for part in (picture * seen, seen.astype(np.float64))]
    return np.where(seen, picture - sums[0] / np.where(seen, sums[1], 1.0), 0.0)


def _slopes(left: Float, right: Float, depth: NDArray[np.int64]) -> Float:
    """The product of the slopes along rows, (H, W). One between two depths is the nearer's: an edge moves with it."""
    one, other = depth[:, :-1], depth[:, 1:]
    slopes = np.where((one >= 0) & (other >= 0), np.diff(left, axis=1) * np.diff(right, axis=1), 0.0)
    made = np.zeros(depth.shape)
    made[:, :-1] += np.where(one >= other, slopes, 0.0)
    made[:, 1:] += np.where(one >= other, 0.0, slopes)
    return made
