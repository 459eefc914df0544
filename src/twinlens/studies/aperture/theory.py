"""Two theories of the best f-number, without a matcher and without fitted parameters, and scale models of scenes.

Median error (`predicted_error`): the error of a good match is the Cramer-Rao bound of a shift, noise / rms slope:
(s^2 + b^2) noise / signal for a texture of grain s and a blur of variance b^2. b^2 is (c/4)^2 for the blur disk, c = A
fx |1/z - k|, plus (0.45 lambda N/p)^2 for the Airy pattern: the Gaussian with the same curvature at the peak, 0.225
lambda/NA (Zhang, Zerubia and Olivo-Marin, Gaussian approximations of fluorescence microscope point-spread function
models, Applied Optics 46(10), 2007). docs/study_results.md explains the parameters.

Wrong pixels (`Evidence.expected`): texture is measured on sharp images (`shared_texture`); blur and diffraction
weaken it. A pixel is wrong if its window contains more texture of another depth (`SharedTexture.majority`), or if
noise moves its match far away (`mismatch`). Blur disks are squares of the same variance, near surfaces do not
occlude, texture visible in one image only is ignored. The threshold effect of noise: Ziv and Zakai, Some lower bounds
on signal parameter estimation, IEEE Trans. Information Theory 15(3), 1969; Weinstein and Weiss, Fundamental
limitations in passive time delay estimation II, ASSP 32(5), 1984.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.interpolate import RegularGridInterpolator

from twinlens.camera import Camera, ThinLens
from twinlens.geometry import Float
from twinlens.matching import StereoMatcher, grey
from twinlens.optics import middle_focus
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.stage import Stage

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
MODES = ("fixed exposure", "equal brightness")
PIXEL_PITCH_UM = 3.45
BLUR_PX, BLURRED_LESS = 24.0, 0.95
"""The blur at f/1 that this fraction of the pixels does not exceed."""
WAVELENGTH = 549e-9
SENSOR = Sensor.preset(
    "machine_vision", wavelengths=(WAVELENGTH,) * 3, vignetting=False
)
LUMA = np.array([0.299, 0.587, 0.114])
_PATCH = 16
RIGHT_PX = 2  # largest error of a correct match
SHARP_AT = 11.0  # f-number of the images on which texture is measured
SIDE = StereoMatcher().block_size
_STRIDE = 3
_AROUND = 25  # side of the box for local means: larger than a window, smaller than uniformly lit surfaces
_SNR = np.geomspace(1e-3, 1e4, 29)
_SPREADS = np.geomspace(0.5, 12.0, 12)
_DRAWS = 4000


@dataclass(frozen=True)
class ScaleModel:
    """A scale model of a scene and its lenses. The scene is rendered at full size, with lenses of the same image."""

    stage: Stage
    scale: float

    @staticmethod
    def of(stage: Stage) -> "ScaleModel":
        """The model scaled so that f/1 blurs the scene by BLUR_PX."""
        focus = middle_focus(*stage.scene.depth_range)
        depth = stage.truth.depth[np.isfinite(stage.truth.depth)]
        from_focus = np.abs(1.0 / depth - 1.0 / focus)
        spread = float(np.quantile(from_focus, BLURRED_LESS))
        blur_px = stage.camera.film_distance * stage.camera.fx * spread
        return ScaleModel(stage, blur_px / BLUR_PX)

    def lens(self, f_number: float) -> ThinLens:
        """The lens of working f-number v/A, focused at the middle of the disparity range."""
        focus = self.scale * middle_focus(*self.stage.scene.depth_range)
        return ThinLens(self.stage.camera.film_distance / f_number, focus)

    def full_size(self, lens: ThinLens) -> ThinLens:
        """The lens that gives the same image of the scene at full size."""
        return ThinLens(
            lens.aperture_diameter / self.scale, lens.focus_distance / self.scale
        )

    def blur(self, lens: ThinLens) -> Float:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        return self.stage.blur(self.full_size(lens))


def grain_px(image: NDArray[np.float32]) -> float:
    """The grain s of the texture, pixels: s^2 = var(I) / (2 var(dI/du)) over patches of 16 pixels, without shading.

    White noise smoothed by a Gaussian of this standard deviation has these slopes, within 7 % from 1 to 2 px.
    """
    windows = np.lib.stride_tricks.sliding_window_view(
        grey(image).astype(np.float64), (_PATCH, _PATCH)
    )
    patches = windows[::_PATCH, ::_PATCH]
    variance = patches.var(axis=(2, 3)).mean()
    steepness = np.diff(patches, axis=3).var(axis=(2, 3)).mean()
    return math.sqrt(variance / (2.0 * steepness))


def airy_px(camera: Camera, lens: ThinLens) -> float:
    """Standard deviation, pixels, of the Gaussian with the Airy pattern's curvature at the peak.

    (2 J1(x)/x)^2 = 1 - x^2/4 + ... with x = pi r / (lambda N), and exp(-r^2 / (2 s^2)) = 1 - r^2 / (2 s^2) + ... agree
    for s = sqrt(2) lambda N / pi = 0.45 lambda N.
    """
    f_number = camera.film_distance / lens.aperture_diameter
    return 0.45 * WAVELENGTH * f_number / (1e-6 * camera.pixel_pitch_um)


def noise_electrons(wells: ArrayLike, gain: float = 1.0) -> Float:
    """Root mean square noise, in electrons, of pixels of SENSOR that hold S electrons.

    Its variance is S + r^2 + d^2 + (g S)^2 + (q_c^2 + q_o^2)/12: read noise r, nonuniformity of dark signal and gain d
    and g, the converter's step q_c, and the 8-bit step q_o = full well / (255 gain t) at slope t of the tone curve.
    """
    held = np.asarray(wells, np.float64)
    level = held * gain / SENSOR.full_well
    # Electrons per step of the converter, and per step of the 8-bit image at slope 1.
    levels = np.array([SENSOR.largest_dn - SENSOR.black_level, 255.0])
    converter, output = 1.0 / levels * SENSOR.full_well / gain
    rounding = (converter**2 + (output / _srgb_slope(level)) ** 2) / 12.0
    nonuniformity = SENSOR.dsnu**2 + (SENSOR.prnu * held) ** 2
    return np.asarray(np.sqrt(held + SENSOR.read_noise**2 + nonuniformity + rounding))


def luma_noise(levels: Float, gain: float = 1.0) -> Float:
    """Root mean square noise (..,) of the luma that is matched, for pixels (.., 3); both in fractions of white.

    The noise of Y' = sum w_c f(L_c), rounded to integers, over dY'/dY = sum w_c f'(L_c) L_c / Y, Y = sum w_c L_c. A
    saturated channel has neither noise nor response; if all are saturated, the noise is infinite.
    """
    response = np.array(SENSOR.quantum_efficiency) * np.array(SENSOR.wavelengths)
    balance = response.max() / response
    held = levels * SENSOR.full_well / (gain * balance)
    rise = LUMA * np.where(levels < 1.0, _srgb_slope(levels), 0.0)
    luma = levels @ LUMA
    mean_rise = (rise * levels).sum(axis=-1) / np.where(luma > 0, luma, 1.0)
    brighter = np.where(luma > 0, mean_rise, _srgb_slope(luma))
    channels = rise * balance * noise_electrons(held, gain) * gain / SENSOR.full_well
    noise = np.sqrt((channels**2).sum(axis=-1) + 1.0 / (12.0 * 255.0**2))
    infinite = np.full(luma.shape, math.inf)
    return np.asarray(np.divide(noise, brighter, out=infinite, where=brighter > 0))


def _srgb_slope(level: Float) -> Float:
    """The derivative of the transfer curve of IEC 61966-2-1."""
    bright = np.maximum(level, 0.0031308)
    return np.where(level <= 0.0031308, 12.92, 1.055 / 2.4 * bright ** (1 / 2.4 - 1))


def shift_bound(
    grain: float, blur_variance: ArrayLike, contrast: ArrayLike, noise: ArrayLike
) -> Float:
    """The Cramer-Rao bound of a shift up to a constant factor: (s^2 + b^2) noise / contrast."""
    return np.asarray(
        (grain**2 + np.asarray(blur_variance))
        * np.asarray(noise)
        / np.asarray(contrast),
        np.float64,
    )


def predicted_error(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32], blur_px: Float, grain: float,
    diffracts: bool,
) -> float:  # fmt: skip
    """The predicted error of an image, the median over its pixels, arbitrary units. blur_px: see `ScaleModel.blur`."""
    has_depth = np.isfinite(stage.truth.depth)
    rate = SENSOR.level_rate(image, camera=stage.camera, lens=lens).mean(axis=-1)
    wells = rate[has_depth] * exposure.time * SENSOR.full_well
    lit = (wells > 0) & (wells * exposure.gain < SENSOR.full_well)
    if not 2 * lit.sum() > lit.size:
        return math.inf
    airy = diffracts * airy_px(stage.camera, lens) ** 2
    variance = (blur_px[has_depth] / 4.0) ** 2 + airy
    noise = noise_electrons(wells, exposure.gain)
    errors = shift_bound(grain, variance, np.where(lit, wells, 1.0), noise)
    return float(np.median(np.where(lit, errors, math.inf)))


class SharedTexture:
    """The texture of sharp images: grain s in pixels, variance V (H, W).

    depth: true disparity in whole pixels, -1 where it is unknown or visible in one image only, (H, W). places: the
    evaluated pixels, bool (H, W). Window sums are cached, because few boxes are distinct.
    """

    def __init__(
        self,
        grain: float,
        variance: Float,
        depth: NDArray[np.int64],
        places: NDArray[np.bool_],
        ndisp: int,
    ) -> None:
        self.grain, self.depth, self.places, self.ndisp = grain, depth, places, ndisp
        mean = np.zeros(depth.shape)
        # Means over 25 pixels of the same surface, whose disparities are within 2 px.
        for disparity in np.unique(depth[depth >= 0]):
            same_surface = (depth >= 0) & (np.abs(depth - disparity) <= RIGHT_PX)
            here = depth == disparity
            mean[here] = _local_mean(variance, same_surface)[here]
        self._textures = (variance, mean)
        self._sums: dict[tuple[int, int], Float] = {}

    def majority(self, disk: Float, least: float) -> tuple[NDArray[np.intp], Float]:
        """The disparity with the greatest A in each window, and its A for the mean variance, (places,).

        disk: additional blur of each pixel, (H, W), pixels. least: s^2 + airy^2.

        Blur of variance b^2 = (disk/4)^2 + airy^2 reduces the texture's variance to V s^2 / (s^2 + b^2), spread over
        the blur disk. E(p, d) is its sum over the pixels of disparity d in the window at p. The mean squared
        difference is least where A(p, d') = sum over d of E(p, d) exp(-(d - d')^2 / (4 (s^2 + b_d^2))) is greatest.
        """
        # Unknown depth is -1: counted from there, and dropped.
        counts = np.bincount(self.depth.ravel() + 1)[1:]
        totals = np.bincount(self.depth.ravel() + 1, disk.ravel())[1:]
        depths = np.flatnonzero(counts)
        disks = totals[depths] / counts[depths]
        spread = (least + (disks / 4.0) ** 2)[:, None]
        away = np.arange(self.ndisp) - depths[:, None]
        weights = self.grain**2 / spread * np.exp(-(away**2) / (4.0 * spread))
        sums = [
            self._window_sums(int(depth), float(diameter))
            for depth, diameter in zip(depths, disks, strict=True)
        ]
        local, mean = np.stack(sums, axis=-1)
        winner = (local @ weights).argmax(axis=1)
        return winner, np.einsum("pd,dp->p", mean, weights[:, winner])

    def _window_sums(self, depth: int, disk: float) -> Float:
        """The two textures of one disparity, spread over a square of the disk's variance, in windows, (2, places)."""
        box = 2 * round((math.sqrt(1.0 + 0.75 * disk**2) - 1.0) / 2.0) + 1
        if (depth, box) not in self._sums:
            sums = []
            for texture in self._textures:
                here = np.where(self.depth == depth, texture, 0.0)
                spread = ndimage.uniform_filter(here, box, mode="constant")
                window = ndimage.uniform_filter(spread, SIDE, mode="constant") * SIDE**2
                sums.append(np.maximum(window[self.places], 0.0))
            self._sums[depth, box] = np.stack(sums)
        return self._sums[depth, box]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements on the sharp images of a scene through `lens`.

    blur: diameters (H, W), pixels. levels: (H, W, 3), fractions of white per second. texture: in squares of levels.
    """

    stage: Stage
    lens: ThinLens
    blur: Float
    levels: Float
    texture: SharedTexture

    @staticmethod
    def of(
        stage: Stage,
        lens: ThinLens,
        blur_px: Float,
        sharp: Sequence[NDArray[np.float32]],
    ) -> "Evidence":
        """From the radiance of both images. blur_px: the signed blur of every pixel, (H, W)."""
        levels = [
            SENSOR.level_rate(image, camera=stage.camera, lens=lens) for image in sharp
        ]
        both = stage.truth.visible & np.isfinite(stage.truth.disparity)
        disparity = np.where(both, stage.truth.disparity, -1.0)
        left, right = (level @ LUMA for level in levels)
        y, x = np.indices(both.shape, np.float64)
        warped = ndimage.map_coordinates(right, [y, x - disparity], mode="nearest")
        depth = np.rint(disparity).astype(np.int64)
        places = np.zeros_like(both)
        places[::_STRIDE, ::_STRIDE] = both[::_STRIDE, ::_STRIDE]
        texture = SharedTexture(
            *shared_texture(left, warped, depth), depth, places, stage.ndisp
        )
        return Evidence(stage, lens, np.abs(blur_px), levels[0], texture)

    def expected(
        self,
        lens: ThinLens,
        exposure: Exposure,
        blur_px: Float,
        diffracts: bool,
        paths: float = 0.0,
    ) -> tuple[float, float]:
        """The predicted percentage of wrong pixels, and the median ratio of rendering to sensor noise, or NaN.

        blur_px: the signed blur of every pixel, (H, W). paths: rendering noise relative to the radiance.
        """
        texture, places = self.texture, self.texture.places
        if not places.any():
            return math.nan, math.nan
        disk = np.sqrt(np.maximum(blur_px**2 - self.blur**2, 0.0))
        least = texture.grain**2 + diffracts * airy_px(self.stage.camera, lens) ** 2
        winner, agreed = texture.majority(disk, least)
        spread = np.sqrt(least + (disk[places] / 4.0) ** 2)
        elsewhere = np.abs(winner - self.stage.truth.disparity[places]) > RIGHT_PX
        aperture = (lens.aperture_diameter / self.lens.aperture_diameter) ** 2
        light = aperture * exposure.time * exposure.gain
        levels = light * self.levels[places]
        luma = levels @ LUMA
        sensor = luma_noise(np.minimum(levels, 1.0), exposure.gain)
        snr = np.where(luma < 1.0, light**2 * agreed / (SIDE * sensor) ** 2, 0.0)
        by_noise = mismatch_share(snr, spread, SIDE, self.stage.ndisp)
        shares = np.where(elsewhere, 1.0, by_noise)
        return 100.0 * float(shares.mean()), float(np.median(paths * luma / sensor))


def shared_texture(
    left: Float, right: Float, depth: NDArray[np.int64]
) -> tuple[float, Float]:
    """Grain s in pixels, and variance V (H, W), of the texture common to two aligned images (H, W).

    s^2 = covariance of the images / covariance of their gradients, V = s^2 gradient^2. Products of two images cancel
    rendering noise; subtracted means over 25 pixels remove shading. depth: whole disparities (H, W), -1 where the
    images are not aligned. Within 8 % (grain) and 13 % (variance) from 1 to 2 px; 11 % and 22 % too low at 3 px.
    """
    steep = _slopes(left, right, depth) + _slopes(left.T, right.T, depth.T).T
    seen = depth >= 0
    left, right = (
        np.where(seen, picture - _local_mean(picture, seen), 0.0)
        for picture in (left, right)
    )
    alike, total = float((left * right).sum()), float(steep.sum())
    if not (alike > 0 and total > 0):
        return 1.0, np.zeros(depth.shape)
    return math.sqrt(alike / total), np.asarray(alike / total * steep)


def _local_mean(picture: Float, seen: NDArray[np.bool_]) -> Float:
    """The mean of the seen pixels in a box; 0 at unseen pixels."""
    total, count = (
        ndimage.uniform_filter(part, _AROUND, mode="constant")
        for part in (picture * seen, 1.0 * seen)
    )
    return np.where(seen, total / np.where(seen, count, 1.0), 0.0)


def _slopes(left: Float, right: Float, depth: NDArray[np.int64]) -> Float:
    """The product of the slopes along rows, (H, W). A slope between two depths belongs to the nearer one."""
    before, after = depth[:, :-1], depth[:, 1:]
    slopes = np.diff(left, axis=1) * np.diff(right, axis=1)
    slopes = np.where((before >= 0) & (after >= 0), slopes, 0.0)
    products = np.zeros(depth.shape)
    products[:, :-1] += np.where(before >= after, slopes, 0.0)
    products[:, 1:] += np.where(before >= after, 0.0, slopes)
    return products


def mismatch_share(snr: ArrayLike, spread: ArrayLike, side: int, ndisp: int) -> Float:
    """`mismatch`, interpolated over log(snr) and log(spread); the arrays are broadcast."""
    log_snr = np.log(np.clip(snr, _SNR[0], _SNR[-1]))
    log_spread = np.log(np.clip(spread, _SPREADS[0], _SPREADS[-1]))
    return np.asarray(_table(side, ndisp)((log_snr, log_spread)), np.float64)


@lru_cache(maxsize=16)
def _table(side: int, ndisp: int) -> RegularGridInterpolator:
    shares = np.stack(
        [mismatch(_SNR, float(spread), side, ndisp) for spread in _SPREADS], axis=1
    )
    return RegularGridInterpolator((np.log(_SNR), np.log(_SPREADS)), shares)


def mismatch(snr: Float, spread: float, side: int, ndisp: int) -> Float:
    """The probability that the least sum of squared differences is more than 2 px from the truth, (K,).

    It is the share of 4000 sampled windows. The texture t of a window has the variance V and the autocorrelation
    exp(-x^2 / (4 g^2)) along each axis; white noise a, b of the two images has the variance sigma^2. snr: V/sigma^2,
    (K,). spread: g, pixels. The sum of squared differences at the shift h is E + T + N:

        E = sum (t(x) - t(x + h))^2,   T = 2 sum (t(x) - t(x + h)) (a(x) - b(x + h)),   N = sum (a(x) - b(x + h))^2

    >>> mismatch(np.array([0.0, 100.0]), 1.2, 9, 32).round(1)
    array([0.9, 0. ])
    """
    texture, both, noise = drawn_sums(spread, side, ndisp)
    shares = []
    for ratio in snr:
        totals = ratio * texture + np.sqrt(ratio) * both + noise
        errors = np.abs(_least(totals) - ndisp // 2)
        shares.append(float((errors > RIGHT_PX).mean()))
    return np.array(shares)


def drawn_sums(spread: float, side: int, ndisp: int) -> Float:
    """E, T and N of sampled windows for V = sigma = 1, (3, 4000, ndisp), at shifts from -(ndisp // 2)."""
    width = side + ndisp - 1
    white, left_noise, right_noise = (
        np.random.default_rng(seed).standard_normal((_DRAWS, side, columns))
        for seed, columns in enumerate((width, side, width))
    )
    textures = _root(side, spread) @ white @ _root(width, spread)
    left = textures[:, :, ndisp // 2 :][:, :, :side]
    sums = np.empty((3, _DRAWS, ndisp))
    for k in range(ndisp):
        texture = left - textures[:, :, k : k + side]
        noise = left_noise - right_noise[:, :, k : k + side]
        sums[0, :, k] = np.einsum("nyx,nyx->n", texture, texture)
        sums[1, :, k] = np.einsum("nyx,nyx->n", 2.0 * texture, noise)
        sums[2, :, k] = np.einsum("nyx,nyx->n", noise, noise)
    return sums


def _root(length: int, spread: float) -> Float:
    """The symmetric square root of the covariance of a row of texture, (length, length)."""
    distance = np.arange(length)[:, None] - np.arange(length)
    values, vectors = np.linalg.eigh(np.exp(-np.square(distance) / (4.0 * spread**2)))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _least(sums: Float) -> Float:
    """The column of each row's least sum, refined by a parabola except at the ends."""
    best = sums.argmin(axis=1)
    inner = np.clip(best, 1, sums.shape[1] - 2)
    below, least, above = (
        np.take_along_axis(sums, (inner + k)[:, None], axis=1)[:, 0] for k in (-1, 0, 1)
    )
    bend = below - 2.0 * least + above
    vertex = 0.5 * (below - above) / np.where(bend > 0, bend, 1.0)
    return np.asarray(best + np.where(best == inner, vertex, 0.0))
