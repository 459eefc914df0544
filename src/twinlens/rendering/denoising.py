"""Denoises images with Intel Open Image Denoise, guided by albedo and normals through the same lens.

The samples of an image see textures with noise of their own, above all through a wide aperture. Guides of the very same
samples show it: with the albedo G of many samples, G_own of the image's, and the local irradiance L = mean(I) /
mean(G_own) in windows of 5x5 pixels, the image I becomes I + L (G - G_own). The expectation of this control variate is
nearly 0: L is of the same samples, but of 25 pixels. The result is divided by sqrt(G) before filtering and multiplied
by it after, and sqrt(G) is the albedo that the filter sees. docs/decisions/denoising.md compares other powers of G.

The filter blurs textures a little. How much is measured in each image: what the filter removed is fitted by the details
of sqrt(G) at two scales, and the fit is added to the result.

Light directly from projectors has no noise, and the filter would take its patterns for noise. It is known for the
image's samples too: it is subtracted before filtering, and that of all samples is added after.

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

LEAST_ALBEDO = 0.02
_WINDOW = (5, 5, 1)
_LUMINANCE = (0.212671, 0.715160, 0.072169)
_EXPOSURE_BLOCK = 16
_DARK = 1e-8
_MARGIN_PX = 8
_DETAIL_PX = (0.7, 1.5)
_SURROUNDINGS_PX = 2.0
_MOST_SURROUNDINGS = np.float32(2.0)
"""Limit of the brightness of a pixel's surroundings, relative to its own. Beside a lamp they are far brighter."""


def denoise_image(
    image: NDArray[np.float32],
    guides: Guides,
    own: Guides | None = None,
    fast: bool = False,
) -> NDArray[np.float32]:
    """A linear radiance image (H, W, 3), denoised.

    guides, own : the guides of other samples, and those of the image's own samples, if they are known.
    fast : take the library's small network, at a quarter of the cost.

    Pixels that are not finite get the light of their neighbours. Those that are black in all samples and hit nothing
    stay 0.
    """
    import mitsuba_oidn

    image = _filled(image)
    seen = image.any(axis=-1, keepdims=True) | guides.normal.any(axis=-1, keepdims=True)
    if guides.projected.size:
        image = image - (guides if own is None else own).projected
    if own is not None:
        own = own.replaced_where_random(guides)
        guides = guides + own
        image = _replace_texture(image, own.albedo, guides.albedo)
    divisor = np.sqrt(np.maximum(guides.albedo, np.float32(LEAST_ALBEDO)))
    demodulated: NDArray[np.float32] = np.divide(image, divisor, dtype=np.float32)
    filtered = mitsuba_oidn.denoise(
        _pad(demodulated),
        albedo=_pad(divisor),
        normal=_pad(guides.normal),
        hdr=True,
        clean_aux=True,
        input_scale=_exposure(demodulated),
        quality=mitsuba_oidn.Quality.Fast if fast else mitsuba_oidn.Quality.High,
        device=_device(),
    )
    inside = np.asarray(filtered)[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX]
    denoised = _with_lost_texture(inside, demodulated, divisor) * divisor
    if guides.projected.size:
        denoised = denoised + guides.projected
    return np.where(seen, denoised, np.float32(0))


def denoise_parts(
    images: NDArray[np.float32],
    guides: Guides,
    own: Guides | None,
    fractions: Float | None,
) -> NDArray[np.float32]:
    """The images (P, H, W, 3) of parts of an aperture, denoised; `fractions` (P,) are their shares of the light.

    Each part is denoised on its own. The results are scaled so that their sum is the denoised sum of the parts. Without
    `fractions`, `images` is one whole image (H, W, 3).
    """
    if fractions is None:
        return denoise_image(images, guides, own)
    if not fractions.any():
        return images
    found = np.zeros(images.shape)
    for part, fraction in enumerate(map(float, fractions)):
        if fraction > 0:
            image = images[part] / np.float32(fraction)
            found[part] = fraction * denoise_image(
                image,
                guides.of_part(part, fraction),
                own and own.of_part(part, fraction),
            )
    total = denoise_image(images.sum(axis=0), guides.of_parts(), own and own.of_parts())
    shares = np.broadcast_to(
        (fractions / fractions.sum())[:, None, None, None], found.shape
    ).copy()
    np.divide(found, found.sum(axis=0), out=shares, where=found.sum(axis=0) > 0)
    return np.asarray(shares * total, np.float32)


def _replace_texture(
    image: NDArray[np.float32], own: NDArray[np.float32], albedo: NDArray[np.float32]
) -> NDArray[np.float32]:
    irradiance = uniform_filter(image, _WINDOW) / np.maximum(
        uniform_filter(own, _WINDOW), LEAST_ALBEDO
    )
    return np.asarray(
        np.maximum(image + irradiance * (albedo - own), 0, dtype=np.float32)
    )


def _with_lost_texture(
    filtered: NDArray[np.float32],
    unfiltered: NDArray[np.float32],
    texture: NDArray[np.float32],
) -> NDArray[np.float32]:
    """`filtered` and what the filter removed of the details of `texture` from `unfiltered`; all are (H, W, 3).

    What it removed, relative to the image, is noise and details. The noise does not depend on the texture, so that a
    least squares fit by a constant and the details of the texture, at two scales, finds the removed details. A pixel
    gets details of its surroundings' brightness: its own, from the filter, is already blurred at edges.
    """
    brightness = np.maximum(filtered, np.float32(_DARK))
    surroundings = np.minimum(
        _blurred(filtered, _SURROUNDINGS_PX) / brightness, _MOST_SURROUNDINGS
    )
    removed = np.divide(unfiltered - filtered, brightness, dtype=np.float32).clip(
        -1, 1
    )  # limits outliers
    fine, coarse = (
        surroundings * (texture - _blurred(texture, scale)) / texture
        for scale in _DETAIL_PX
    )

    def covariance(
        a: NDArray[np.float32], b: NDArray[np.float32]
    ) -> float:  # that of BLAS depends on its threads
        return float(
            np.mean((a - a.mean(dtype=np.float64)) * (b - b.mean(dtype=np.float64)))
        )

    both = covariance(fine, coarse)
    matrix = np.array(
        [[covariance(fine, fine), both], [both, covariance(coarse, coarse)]]
    )
    of_removed = np.array([covariance(fine, removed), covariance(coarse, removed)])
    of_fine, of_coarse = np.linalg.lstsq(matrix, of_removed, rcond=None)[0].astype(
        np.float32
    )
    return np.asarray(
        np.maximum(filtered + brightness * (of_fine * fine + of_coarse * coarse), 0),
        np.float32,
    )


def _blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(gaussian_filter(image, (sigma, sigma, 0)), np.float32)


def _filled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The image with the mean of finite values in 5x5 pixels where it is not finite."""
    known = np.isfinite(image)
    if known.all():
        return image
    values = uniform_filter(np.where(known, image, 0), _WINDOW)
    weights = uniform_filter(known.astype(np.float32), _WINDOW)
    return np.where(known, image, values / np.maximum(weights, np.float32(1e-6)))


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
    rows, columns = (np.arange(0, size, _EXPOSURE_BLOCK) for size in luminance.shape)
    counts = np.add.reduceat(
        np.add.reduceat(np.ones_like(luminance), rows, axis=0), columns, axis=1
    )
    means = (
        np.add.reduceat(np.add.reduceat(luminance, rows, axis=0), columns, axis=1)
        / counts
    )
    lit = means[np.isfinite(means) & (means > _DARK)]
    return float(0.18 / np.exp(np.log(lit).mean())) if lit.size else 1.0


def denoiser_record() -> dict[str, Any]:
    """How this process denoises: method, samples of the guides, and versions."""
    import mitsuba_oidn

    return {
        "method": "Open Image Denoise, albedo and normal guides, demodulated by sqrt(albedo), control variate,"
        " restored texture; irradiance cache with the integrator 'path'",
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
