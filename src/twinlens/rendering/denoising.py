"""Denoises images with Intel Open Image Denoise, guided by albedo and normals through the same lens.

The image I is filtered in seven steps.

1. Texture. The few samples of an image see textures with noise of their own, above all through a wide aperture. With
   the albedo G of many samples, the albedo G_own of the image's own samples, and the local irradiance
   L = mean(I) / mean(G_own) in windows of 5x5 pixels, the image becomes I + L (G - G_own). This is a control variate:
   the mean of G - G_own over all choices of samples is 0. So the sum is nearly unbiased; not quite, because L is
   computed from the same samples, though from 25 pixels of them.
2. Dark surfaces. Beside white, black is a step that the filter rings at, and I / G is unknown there. So albedos below
   `LEAST_ALBEDO` are raised to it: the image gets L times what they lack, and loses the same after the filter.
3. Filter. The image is divided by sqrt(G), filtered, and multiplied by sqrt(G), which is also the albedo that the
   filter sees. docs/decisions/denoising.md compares other powers of G.
4. Lost details. Highlights and shadows are in no guide. What the filter removed is fitted by the details of its own
   result, in windows, and most of the fit is added to it.
5. Lost texture. The filter blurs textures a little. How much is measured in each image: what the filter removed is
   fitted by the details of sqrt(G) at two scales, and the fit is added to the result. Pixels without light, such as
   those of a sky that cameras do not see, are not in the fit. What smooth coats reflect is in G, and its details have a
   fit of their own.
6. Lost light. The filter works on a scale like a logarithm, on which the mean of noise is too low: images lose up to
   0.6 % of their light. So the result is scaled to the mean of the image in wide windows.
7. Projectors. Light directly from projectors has no noise, and the filter would take its patterns for noise. It is
   known for the image's own samples too: this is subtracted before step 1, and that of all samples is added at the end.

The filter runs in linear radiance, on the processor unless the backend is CUDA and the library supports the GPU, and
does not depend on the number of threads.
"""

import atexit
import contextlib
import functools
import importlib.metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from twinlens.geometry import Float
from twinlens.rendering.backends import backend
from twinlens.rendering.guides import Guides

GUIDE_SAMPLES = 32
"""Samples per pixel of the guides, besides those of the image."""

LEAST_ALBEDO = 0.05
"""Darker surfaces are filtered as if they had this albedo."""

_WINDOW = (5, 5, 1)
_LEAST_MEAN = 0.02
"""Albedo of windows in step 1. In darker ones the light, of highlights, is no measure of the irradiance."""
_LUMINANCE = (0.212671, 0.715160, 0.072169)  # of linear RGB, ITU-R BT.709
_EXPOSURE_BLOCK = 16
_DARK = 1e-8
_MARGIN_PX = 8
_DETAIL_PX = (0.7, 1.5)  # scales of details, standard deviations of blurs
_LEAST_LIGHT = np.float32(
    1e-3
)  # of a pixel in the fit of details, relative to the mean
_REFLECTED_PX = 3.0  # scale of details in reflections
_SURROUNDINGS_PX = 2.0
_MOST_SURROUNDINGS = np.float32(2.0)
"""Limit of the brightness of a pixel's surroundings, relative to its own. Beside a lamp they are far brighter."""
_OWN_DETAIL_PX = 2.0  # scale of an image's own details, standard deviation of a blur
_FIT_PX = 8.0  # windows of their fit, standard deviation
_FAINT = np.float32(0.01)
"""Square of the relative contrast of details in windows, below which they may be noise."""
_PART_RESTORED = np.float32(0.8)
"""Part of the fitted details that is restored."""
_NEAR_PX, _WIDE_PX = 3.0, 16.0  # windows of lost light, standard deviations
_MOST_LOST = 3.0  # light of a pixel, relative to that near it
_MOST_NEAR = np.float32(2.0)  # that light, relative to that of the wide window


def denoise_image(
    image: NDArray[np.float32],
    guides: Guides,
    own_guides: Guides | None = None,
    fast: bool = False,
) -> NDArray[np.float32]:
    """A linear radiance image (H, W, 3), denoised.

    guides, own_guides : those of other samples, and those of the image's own samples, if these are known.
    fast : take the library's small network, at a quarter of the cost.

    Pixels that are not finite get the light of their neighbours. Those that are black in all samples and hit nothing
    stay 0.
    """
    image = _filled(image)
    has_light = image.any(axis=-1, keepdims=True)
    has_surface = guides.normal.any(axis=-1, keepdims=True)
    # Step 7, its first half: without the light of projectors that the image's own samples have.
    if guides.projected.size:
        image = image - (guides if own_guides is None else own_guides).projected
    # Step 1. From here on the guides are those of all samples. Where a path chose at random between glass and what is
    # behind it, its own albedo is no texture: it is replaced by that of other samples, which follow both ways.
    if own_guides is not None:
        own_guides = own_guides.replaced_where_random(guides)
        guides = guides + own_guides
        image = _with_texture_of(image, own_guides.albedo, guides.albedo)
    # Step 2.
    reflectance = np.minimum(guides.reflectance, np.float32(1))
    albedo = np.maximum(reflectance, np.float32(LEAST_ALBEDO))
    lack = _irradiance(image, reflectance, LEAST_ALBEDO) * (albedo - reflectance)
    # Step 3, on I / sqrt(G), and steps 4 and 5, on the same scale.
    divisor = np.sqrt(albedo)
    demodulated: NDArray[np.float32] = np.divide(
        image + lack, divisor, dtype=np.float32
    )
    filtered = _filtered(demodulated, divisor, guides.normal, fast)
    filtered = _with_lost_details(filtered, demodulated)
    restored = _with_lost_texture(filtered, demodulated, divisor)
    if guides.coat.any():
        restored = _with_lost_reflections(restored, demodulated, divisor, guides.coat)
    restored = restored * divisor
    # Step 6, without what step 2 has added.
    denoised = _with_lost_light(np.maximum(restored - lack, 0), image)
    # Step 7, its second half: with the light of projectors that all samples have.
    if guides.projected.size:
        denoised = denoised + guides.projected
    return np.where(has_light | has_surface, denoised, np.float32(0))


def denoise_parts(
    images: NDArray[np.float32],
    guides: Guides,
    own_guides: Guides | None,
    fractions: Float | None,
) -> NDArray[np.float32]:
    """The images (P, H, W, 3) of parts of an aperture, denoised; `fractions` (P,) are their shares of the light.

    Each part is denoised by itself. The results are scaled so that their sum is the denoised sum of the parts. Without
    `fractions`, `images` is one whole image (H, W, 3).
    """
    if fractions is None:
        return denoise_image(images, guides, own_guides)
    if not fractions.any():
        return images
    parts = np.zeros(images.shape)
    for part, fraction in enumerate(map(float, fractions)):
        if fraction > 0:
            # As bright as the whole image, as if the part were all of the aperture.
            image = images[part] / np.float32(fraction)
            own_of_part = own_guides and own_guides.of_part(part, fraction)
            denoised = denoise_image(image, guides.of_part(part, fraction), own_of_part)
            parts[part] = fraction * denoised
    own_of_all = own_guides and own_guides.of_parts()
    whole = denoise_image(images.sum(axis=0), guides.of_parts(), own_of_all)
    # The share of each part in each pixel; that of its light where all parts are black.
    expected = (fractions / fractions.sum())[:, None, None, None]
    shares = np.broadcast_to(expected, parts.shape).copy()
    total = parts.sum(axis=0)
    np.divide(parts, total, out=shares, where=total > 0)
    return np.asarray(shares * whole, np.float32)


def _with_texture_of(
    image: NDArray[np.float32],
    own_albedo: NDArray[np.float32],
    albedo: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Step 1: the image with the noise of its texture replaced, I + L (G - G_own)."""
    irradiance = _irradiance(image, own_albedo, _LEAST_MEAN)
    replaced = image + irradiance * (albedo - own_albedo)
    return np.asarray(np.maximum(replaced, 0, dtype=np.float32))


def _irradiance(
    image: NDArray[np.float32], albedo: NDArray[np.float32], least: float
) -> NDArray[np.float32]:
    """The local irradiance over pi, L = mean(I) / mean(G), with means of the albedo of at least `least`."""
    mean_albedo = np.maximum(uniform_filter(albedo, _WINDOW), np.float32(least))
    return np.asarray(uniform_filter(image, _WINDOW) / mean_albedo, np.float32)


def _filtered(
    demodulated: NDArray[np.float32],
    albedo: NDArray[np.float32],
    normal: NDArray[np.float32],
    fast: bool,
) -> NDArray[np.float32]:
    """Step 3: the output of the library's network. The guides are taken as free of noise."""
    import mitsuba_oidn

    quality = mitsuba_oidn.Quality.Fast if fast else mitsuba_oidn.Quality.High
    filtered = mitsuba_oidn.denoise(
        _pad(demodulated),
        albedo=_pad(albedo),
        normal=_pad(normal),
        hdr=True,
        clean_aux=True,
        input_scale=_exposure(demodulated),
        quality=quality,
        device=_device(),
    )
    inside = slice(_MARGIN_PX, -_MARGIN_PX)
    return np.asarray(filtered)[inside, inside]


def _with_lost_details(
    filtered: NDArray[np.float32], unfiltered: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Step 4: `filtered` with the contrast of its own details restored, from `unfiltered`; both (H, W, 3).

    No guide knows of highlights and shadows. The filter took a share of them and left the rest, so that what it removed
    resembles the details D of its result:

        removed = noise + factor D

    Least squares in windows find the factor, mean(D removed) / mean(D^2). It is a little too large: a rest of the noise
    is in D too. So `_PART_RESTORED` of it is used, and `_FAINT` keeps it small where D is little but this rest.
    """
    near = np.maximum(_blurred(filtered, _NEAR_PX), np.float32(_DARK))
    details = filtered - _blurred(filtered, _OWN_DETAIL_PX)
    relative = _mean_of_channels(details / near)
    removed = _mean_of_channels(((unfiltered - filtered) / near).clip(-1, _MOST_LOST))
    products = _blurred(relative * removed, _FIT_PX)
    squares = _blurred(np.square(relative), _FIT_PX)
    factor = (products / (squares + _FAINT)).clip(0, 1)
    restored = filtered + _PART_RESTORED * factor * details
    return np.asarray(np.maximum(restored, 0), np.float32)


def _mean_of_channels(image: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """The mean (H, W, 1) of an image (H, W, 3)."""
    return np.asarray(image.mean(axis=-1, keepdims=True), np.float32)


def _with_lost_texture(
    filtered: NDArray[np.float32],
    unfiltered: NDArray[np.float32],
    texture: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Step 5: `filtered` and what the filter removed of the details of `texture` from `unfiltered`; all (H, W, 3).

    What the filter removed, relative to the image, is noise and details:

        removed = noise + a fine + b coarse + constant

    The noise does not depend on the texture, so that least squares find a and b. A pixel gets details of its
    surroundings' brightness: its own, from the filter, is already blurred at edges.
    """
    # Brightness of the surroundings, relative to the pixel's own: that of details before they were blurred.
    brightness = np.maximum(filtered, np.float32(_DARK))
    relative = _blurred(filtered, _SURROUNDINGS_PX) / brightness
    surroundings = np.minimum(relative, _MOST_SURROUNDINGS)
    # Left side of the fit, and the details of the texture at both scales: it, less its blur, relative to it.
    removed = np.divide(unfiltered - filtered, brightness, dtype=np.float32)
    removed = removed.clip(-1, 1)  # limits outliers
    fine, coarse = (
        surroundings * (texture - _blurred(texture, scale)) / texture
        for scale in _DETAIL_PX
    )
    is_lit = filtered > _LEAST_LIGHT * filtered.mean(dtype=np.float64)
    of_fine, of_coarse = _fitted(removed[is_lit], fine[is_lit], coarse[is_lit])
    details = brightness * (of_fine * fine + of_coarse * coarse)
    return np.asarray(np.maximum(filtered + details, 0), np.float32)


def _with_lost_reflections(
    filtered: NDArray[np.float32],
    unfiltered: NDArray[np.float32],
    divisor: NDArray[np.float32],
    coat: NDArray[np.float32],
) -> NDArray[np.float32]:
    """`filtered` and what the filter removed of the details that smooth coats reflect.

    As for lost texture, with one factor for all coats: the light on what they reflect is not that on them.
    """
    brightness = np.maximum(filtered, np.float32(_DARK))
    removed = ((unfiltered - filtered) / brightness).clip(-1, 1)
    details = (coat - _blurred(coat, _REFLECTED_PX)) / np.square(divisor)
    shows = (coat > 0) & (filtered > _LEAST_LIGHT * filtered.mean(dtype=np.float64))
    if not shows.any() or np.ptp(details[shows]) == 0:
        return filtered
    variance = _covariance(details[shows], details[shows])
    factor = np.float32(_covariance(details[shows], removed[shows]) / variance)
    restored = filtered + brightness * np.where(shows, factor * details, 0)
    return np.asarray(np.maximum(restored, 0), np.float32)


def _with_lost_light(
    denoised: NDArray[np.float32], image: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Step 6: `denoised`, scaled so that the light lost in wide windows comes back, in proportion to the light there.

    Two limits keep a lamp's loss, and a single bright sample, from brightening what is around it: what a pixel has lost
    counts up to `_MOST_LOST` times the light near it, and that light up to `_MOST_NEAR` times that of the window.
    """
    wide = np.maximum(_blurred(denoised, _WIDE_PX), np.float32(_DARK))
    near = np.maximum(_blurred(denoised, _NEAR_PX), np.float32(_DARK))
    relative = ((image - denoised) / near).clip(-1, _MOST_LOST)
    lost = _blurred(relative * np.minimum(near, _MOST_NEAR * wide), _WIDE_PX)
    return np.asarray(denoised * (1 + lost / wide), np.float32)


def _fitted(
    values: NDArray[np.float32],
    first: NDArray[np.float32],
    second: NDArray[np.float32],
) -> NDArray[np.float32]:
    """The factors (2,) of `first` and `second` in the least squares fit of `values` by them and a constant; (N,) each.

    By the normal equations of deviations from the means: the constant drops out.
    """
    if not len(values):
        return np.zeros(2, np.float32)
    both = _covariance(first, second)
    matrix = np.array(
        [[_covariance(first, first), both], [both, _covariance(second, second)]]
    )
    right_side = np.array([_covariance(first, values), _covariance(second, values)])
    factors: Float = np.linalg.lstsq(matrix, right_side, rcond=None)[0]
    return factors.astype(np.float32)


def _covariance(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """The mean product of deviations. Not by BLAS, whose sums depend on its threads."""
    from_mean_a = a - a.mean(dtype=np.float64)
    from_mean_b = b - b.mean(dtype=np.float64)
    return float(np.mean(from_mean_a * from_mean_b))


def _blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(gaussian_filter(image, (sigma, sigma, 0)), np.float32)


def _filled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The image with the mean of finite values in 5x5 pixels where it is not finite."""
    finite = np.isfinite(image)
    if finite.all():
        return image
    sums = uniform_filter(np.where(finite, image, 0), _WINDOW)
    weights = uniform_filter(finite.astype(np.float32), _WINDOW)
    means = sums / np.maximum(weights, np.float32(1e-6))
    return np.where(finite, image, means)


def _pad(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The image with a mirrored margin. Without it the filter is wrong by up to 15 % in the corners of plain images."""
    return np.pad(
        image,
        ((_MARGIN_PX, _MARGIN_PX), (_MARGIN_PX, _MARGIN_PX), (0, 0)),
        mode="symmetric",
    )


def _exposure(image: NDArray[np.float32]) -> float:
    """The scale that takes the geometric mean luminance of 16x16 blocks to 0.18.

    As the library's own, whose sum depends on the number of threads.
    """
    luminance = image.astype(np.float64) @ _LUMINANCE
    means = _block_sums(luminance) / _block_sums(np.ones_like(luminance))
    lit = means[np.isfinite(means) & (means > _DARK)]
    return float(0.18 / np.exp(np.log(lit).mean())) if lit.size else 1.0


def _block_sums(image: Float) -> Float:
    """Sums over 16x16 blocks of an image (H, W), smaller ones at its right and lower edges."""
    rows, columns = (np.arange(0, size, _EXPOSURE_BLOCK) for size in image.shape)
    of_rows = np.add.reduceat(image, rows, axis=0)
    return np.asarray(np.add.reduceat(of_rows, columns, axis=1))


def denoiser_record() -> dict[str, Any]:
    """How this process denoises: method, samples of the guides, and versions."""
    import mitsuba_oidn

    return {
        "method": "Open Image Denoise, albedo and normal guides, demodulated by sqrt(albedo), control variate,"
        " restored details, texture and light; irradiance cache with the integrator 'path'",
        "guide_spp": GUIDE_SAMPLES,
        "oidn": mitsuba_oidn.oidn_version(),
        "mitsuba-oidn": importlib.metadata.version("mitsuba-oidn"),
        "device": _device().type.name.lower(),
    }


@functools.cache
def _device() -> Any:
    from mitsuba_oidn import Device, DeviceType, Error

    atexit.register(
        _device.cache_clear
    )  # nanobind reports what the interpreter's end finds alive
    if backend().name == "cuda":
        with contextlib.suppress(Error):  # the library may lack support for this GPU
            return Device(DeviceType.CUDA)
    return Device(DeviceType.CPU)
