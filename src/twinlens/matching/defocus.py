"""Inverse depth 1/z from images of one view through different apertures, parts of an aperture, or focus settings.

A lens with vergence k (1/focus_distance) images a point at depth z through the aperture point a where a pinhole at the
origin does, moved by -fx a (1/z - k). So its image is the pinhole's, convolved with the aperture scaled by
fx (1/z - k). This is one model for defocus, the halves of dual pixels, the views of a light field, and stereo pairs.

Maps are (H, W) float32 in 1/m, +inf where unknown. The disparity of a pair with a baseline is fx baseline / z - doffs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage

from twinlens.errors import InputError, check_int, check_number, counted, format_value
from twinlens.matching.images import grey, to_working_dtype

Float = NDArray[np.float64]
InverseDepth = NDArray[np.float32]

REGULARISATION = 1e-4
"""Noise-to-signal ratio of the texture: frequencies that all kernels weaken below it do not count."""

_LARGEST_REACH = 4096  # pixels


@dataclass(frozen=True, eq=False)
class ApertureSamples:
    """Where the light of an image passed the aperture.

    points : (N, 2) metres, x right and y down, from the pinhole whose map is computed; one point for a pinhole.
    weights : (N,), the relative light of each point.
    vergence : k in 1/m, for which all points give the same image.

    Points without light are left out. `tl.aperture_points` gives those of a lens and of its parts.
    """

    points: Float
    weights: Float
    vergence: float

    def __init__(
        self, points: ArrayLike, weights: ArrayLike | None = None, vergence: float = 0.0
    ) -> None:
        places = _numbers("points of aperture samples", points, 2)
        light = np.ones(len(places))
        if weights is not None:
            light = _numbers("weights of aperture samples", weights, 1)
        if places.ndim != 2 or places.shape[1] != 2 or light.shape != places.shape[:1]:
            raise InputError(
                f"aperture samples need points (N, 2) and weights (N,), got {places.shape}, {light.shape}"
            )
        lights = (light >= 0).all() and 0 < light.sum() < math.inf
        if not (np.isfinite(places).all() and lights):
            raise InputError(
                "aperture samples need finite points, and weights >= 0 with a positive sum"
            )
        check_number("vergence", vergence, "a finite number of 1/m")
        lit = light > 0
        fields = {
            "points": places[lit],
            "weights": light[lit] / light.sum(),
            "vergence": float(vergence),
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)


def inverse_depth_from_defocus(
    images: Sequence[ArrayLike],
    apertures: Sequence[ApertureSamples],
    fx: float,
    near: float,
    far: float = math.inf,
    *,
    steps: int = 64,
    block_size: int = 15,
) -> InverseDepth:
    """The inverse depth at which one texture best explains all images in a window, by maximum likelihood.

    For each candidate 1/z with kernels h_j, the texture that fits the images best is
    S = sum_j conj(H_j) F_j / (sum_j |H_j|^2 + eps), as spectra; the cost is the sum of the squared differences
    F_j - H_j S over the window, which follows the kernel's centre. Two images through a wide and a narrow aperture, or
    with two focus distances, give depth from defocus; the halves of an aperture, dual-pixel matching with the halves
    of the blur disk; many points of the aperture, the plane sweep of a light field. A parabola through the least cost
    and its neighbours refines it.

    Parameters
    ----------
    images : sequence of (H, W) or (H, W, 3)
        Images of equal size and exposure, with linear values and equal noise.
    apertures : sequence of ApertureSamples
        One for each image.
    fx : float
        Focal length in pixels; pixels are square.
    near, far : float
        Depths between which to search, in metres.
    steps : int
        Number of candidates, equally spaced in 1/z. The blur, or shift, should change by at most a pixel between them.
    block_size : int
        Side of the window in pixels, odd.

    Returns
    -------
    (H, W) float32
        1/z in 1/m, +inf where the least cost is at an end of the search.

    Raises
    ------
    InputError
        For images of different sizes, fewer than two images, and numbers outside their ranges.

    Source: Zhou, Lin and Nayar, Coded aperture pairs for depth from defocus and defocus deblurring, IJCV 93(1), 2011,
    with a white prior of the texture; for unknown texture as in Favaro and Soatto, PAMI 27(3), 2005.
    """
    pictures = _stack(images, 2)
    _check(pictures, apertures, fx, block_size)
    candidates = _candidates(near, far, steps)
    plane = _Plane(pictures.shape[1:], _reach(apertures, fx, candidates))
    spectra = plane.spectra(pictures)
    costs = np.empty((steps, *pictures.shape[1:]), np.float32)
    for k, candidate in enumerate(candidates):
        kernels = plane.kernels(apertures, fx, candidate)
        differences = spectra - kernels * _best_texture(kernels, spectra)
        # Moved by the kernels' centres, the differences of one point of the scene are at one pixel.
        centred = differences * plane.centring(apertures, fx, candidate)
        costs[k] = plane.energy(centred, block_size)
    return _maximum(-costs, candidates)


def inverse_depth_bound(
    sharp: ArrayLike,
    apertures: Sequence[ApertureSamples],
    fx: float,
    inverse_depth: float,
    noise: float,
    *,
    block_size: int = 15,
) -> Float:
    """The Cramer-Rao bound (H, W) of the standard deviation of 1/z, in 1/m, for windows of one depth.

    For unknown texture S and white noise sigma in every image,
    variance >= sigma^2 / sum over the window and images of g_j^2, with the spectra
    G_j = H'_j S - H_j (sum_i conj(H_i) H'_i) S / sum_i |H_i|^2 and H' the derivative by 1/z. For two pinholes this is
    the bound of a shift, 2 sigma^2 / sum (dI/du)^2, divided by (fx baseline)^2.

    sharp: the image of a pinhole without noise, (H, W) or (H, W, 3); noise: sigma of the images. The other parameters
    are as in `inverse_depth_from_defocus`.
    """
    picture = _stack([sharp], 1)
    _check(picture, apertures, fx, block_size, count=len(apertures))
    check_number("noise", noise, "a positive number", above=0)
    check_number("inverse_depth", inverse_depth, "a finite number of 1/m")
    plane = _Plane(picture.shape[1:], _reach(apertures, fx, np.array([inverse_depth])))
    kernels = plane.kernels(apertures, fx, inverse_depth)
    slopes = plane.slopes(apertures, fx, inverse_depth)
    # H'_j without what another texture explains: with the best texture for the images H'_j in place of F_j.
    visible = slopes - kernels * _best_texture(kernels, slopes)
    centred = visible * plane.centring(apertures, fx, inverse_depth)
    information = plane.energy(centred * plane.spectra(picture)[0], block_size)
    with np.errstate(divide="ignore"):
        return np.asarray(noise / np.sqrt(information))


def inverse_depth_from_focus(
    stack: Sequence[ArrayLike],
    vergences: ArrayLike,
    *,
    block_size: int = 15,
    neighbours: int = 1,
) -> InverseDepth:
    """The inverse focus distance at which a window of a focal stack is sharpest.

    The focus measure is `sharpness`. A Gaussian in 1/z, fitted to the
    largest measure and its neighbours, gives the maximum. `inverse_depth_from_defocus` finds the depth of a stack more
    precisely, but needs the aperture.

    Parameters
    ----------
    stack : sequence of (H, W) or (H, W, 3)
        At least three images of equal size and exposure, with linear values.
    vergences : (N,)
        1/focus_distance of each image, in 1/m, increasing or decreasing.
    block_size : int
        Side of the window in pixels, odd.
    neighbours : int
        Images on each side of the sharpest one to which the Gaussian is fitted. Those with at most 2 px of blur help;
        with the one of the source, images should be about 1.5 px of blur apart.

    Returns
    -------
    (H, W) float32
        1/z in 1/m, +inf where the sharpest image is the first or the last.

    Raises
    ------
    InputError
        For fewer than three images, other sizes than that of the first, and vergences that do not fit.

    Source: Nayar and Nakagawa, Shape from focus, PAMI 16(8), 1994.
    """
    pictures = _stack(stack, 3)
    places = _numbers("vergences", vergences)
    one_each = places.shape == (len(pictures),)
    if not (one_each and np.isfinite(places).all() and _is_monotonic(places)):
        raise InputError(
            f"vergences must be {len(pictures)} increasing or decreasing numbers, one for each image"
        )
    check_int("neighbours", neighbours, 1)
    _check_block(block_size)
    measures = np.array([sharpness(picture, block_size) for picture in pictures])
    # The logarithm of a Gaussian is a parabola.
    logarithms = np.log(np.maximum(measures, np.finfo(np.float64).tiny))
    return _maximum(logarithms, places, neighbours)


def sharpness(image: ArrayLike, window: int = 9) -> Float:
    """The sum-modified Laplacian |2I - I(x-1) - I(x+1)| + |2I - I(y-1) - I(y+1)|, float64 (H, W), without threshold.

    `image` is (H, W) or (H, W, 3), of which the channels are averaged first; the sum is over `window` x `window`
    pixels, an odd number. Images are reflected at their border. Raises InputError for another window, and for images
    of other shapes or without finite numbers.

    Source: Nayar and Nakagawa, Shape from focus, 1994.
    """
    check_int("window", window, 1)
    if window % 2 == 0:
        raise InputError(f"window must be odd, got {window}")
    pixels = _colour_stack([image])[0]
    pixels = pixels.mean(axis=-1) if pixels.ndim == 3 else pixels
    second_difference = [-1.0, 2.0, -1.0]
    vertical = np.abs(ndimage.correlate1d(pixels, second_difference, axis=0))
    horizontal = np.abs(ndimage.correlate1d(pixels, second_difference, axis=1))
    mean = ndimage.uniform_filter(vertical + horizontal, window)
    total: Float = window**2 * mean
    return total


def all_in_focus(
    images: Sequence[ArrayLike], window: int = 9
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """The image of the sharpest pixels of one camera's focal stack, and the number (H, W) of each pixel's image.

    Raises InputError for images of different sizes, and as `sharpness`.
    """
    stack = _colour_stack(images)
    sharpest = np.argmax([sharpness(image, window) for image in stack], axis=0)
    rows, columns = np.indices(sharpest.shape)
    return stack[sharpest, rows, columns].astype(np.float32), sharpest


def _colour_stack(images: Sequence[ArrayLike]) -> Float:
    """The images as float64 (N, H, W) or (N, H, W, 3)."""
    needed = "one or more images (H, W) or (H, W, 3) of one size and of finite numbers are needed"
    try:
        stack = np.array(images, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{needed}, got {format_value(images)}") from error
    has_shape = stack.ndim == 3 or stack.shape[3:] == (3,)
    if not (has_shape and stack.size and np.isfinite(stack).all()):
        raise InputError(f"{needed}, got shape {stack.shape}")
    return stack


def _maximum(scores: NDArray[Any], places: Float, neighbours: int = 1) -> InverseDepth:
    """The place of the highest score (N, H, W), by a parabola fitted to it and its neighbours; +inf at both ends."""
    best = np.argmax(scores, axis=0)
    result = np.full(best.shape, np.inf, np.float32)
    for k in range(1, len(places) - 1):
        pixels = best == k
        if not pixels.any():
            continue
        near = slice(max(k - neighbours, 0), k + neighbours + 1)
        # In units of the step to the next place, with the origin at the highest score.
        unit = places[k + 1] - places[k]
        steps = (places[near] - places[k]) / unit
        values = scores[near, pixels].astype(np.float64)
        bend, slope, _ = np.polyfit(steps, values, 2)
        peaked = bend < 0
        vertex = np.zeros_like(bend)
        np.divide(-0.5 * slope, bend, out=vertex, where=peaked)
        place = places[k] + unit * np.clip(vertex, -1.0, 1.0)
        result[pixels] = np.where(peaked, place, np.inf)
    return result


def _stack(images: Sequence[ArrayLike], least: int) -> Float:
    """The images as grey float64 (N, H, W)."""
    if not isinstance(images, Sequence | np.ndarray):
        raise InputError(
            f"at least {least} images of one size are needed, got {format_value(images)}"
        )
    try:
        arrays = [np.asarray(image) for image in images]
    except ValueError as error:
        raise InputError(
            "an image has rows of unequal length; (H, W) or (H, W, 3) is needed"
        ) from error
    pictures = [
        grey(to_working_dtype(array, f"{k}.")).astype(np.float64)
        for k, array in enumerate(arrays)
    ]
    if len(pictures) < least or len({picture.shape for picture in pictures}) > 1:
        sizes = ", ".join(str(picture.shape) for picture in pictures)
        raise InputError(
            f"at least {least} images of one size are needed, got {sizes or 'none'}"
        )
    return np.array(pictures)


def _check(
    pictures: Float,
    apertures: Sequence[ApertureSamples],
    fx: float,
    block_size: int,
    count: int | None = None,
) -> None:
    if not isinstance(apertures, Sequence):
        raise InputError(
            f"apertures must be a list of ApertureSamples, got {format_value(apertures)}"
        )
    wrong = [item for item in apertures if not isinstance(item, ApertureSamples)]
    if wrong or len(apertures) != (count or len(pictures)):
        got = f"{len(apertures)} for {counted(len(pictures), 'image')}"
        if wrong:
            got = format_value(wrong[0])
        raise InputError(
            f"apertures must be ApertureSamples, one for each image, got {got}"
        )
    check_number("fx", fx, "a positive number of pixels", above=0)
    _check_block(block_size)


def _check_block(block_size: int) -> None:
    check_int("block_size", block_size, 1)
    if block_size % 2 == 0:
        raise InputError(f"block_size must be odd, got {block_size}")


def _is_monotonic(values: Float) -> bool:
    return bool(np.all(np.diff(values) > 0) or np.all(np.diff(values) < 0))


def _candidates(near: float, far: float, steps: int) -> Float:
    check_number("near", near, "a positive number of metres", above=0)
    if not (isinstance(far, Real) and far > near):
        raise InputError(
            f"far must be greater than near, {near:g} m, got {format_value(far)}"
        )
    check_int("steps", steps, 3)
    return np.linspace(1.0 / far, 1.0 / near, steps)


def _numbers(name: str, values: ArrayLike, least_dimensions: int = 0) -> Float:
    try:
        return np.array(values, np.float64, ndmin=least_dimensions)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name} must be an array of numbers, got {format_value(values)}"
        ) from error


def _reach(apertures: Sequence[ApertureSamples], fx: float, candidates: Float) -> int:
    """The largest distance, in whole pixels, by which the apertures move light."""
    moves = [
        np.abs(candidates - aperture.vergence).max() * np.abs(aperture.points).max()
        for aperture in apertures
    ]
    reach = fx * float(max(moves))
    if reach > _LARGEST_REACH:
        raise InputError(
            f"the apertures move light by up to {reach:.0f} px; use a larger near, or check fx and metres"
        )
    return math.ceil(reach)


class _Plane:
    """Spectra of images that are continued by reflection, and the way back.

    Kernels are sums of shifts by fx (1/z - k) a, which are exact in the spectrum: exp(i shift . frequency).
    """

    def __init__(self, size: tuple[int, ...], radius: int) -> None:
        self.size, self.radius = size, radius
        self.padded = [fft.next_fast_len(side + 2 * radius, real=True) for side in size]
        # Angular frequencies in radians per pixel.
        self.rows = 2 * np.pi * fft.fftfreq(self.padded[0])
        self.columns = 2 * np.pi * fft.rfftfreq(self.padded[1])

    def spectra(self, images: Float) -> NDArray[Any]:
        """The spectra (N, rows, columns) of the images (N, H, W)."""
        margins = [
            (self.radius, padded - side - self.radius)
            for side, padded in zip(self.size, self.padded, strict=True)
        ]
        padded = np.pad(images, ((0, 0), *margins), mode="symmetric")
        return np.asarray(fft.rfft2(padded))

    def energy(self, spectra: NDArray[Any], side: int) -> Float:
        """The sum of squares of all images over windows, (H, W)."""
        inner = tuple(slice(self.radius, self.radius + size) for size in self.size)
        squares = np.square(fft.irfft2(spectra, self.padded)).sum(axis=0)
        means = ndimage.uniform_filter(squares, side, mode="nearest")
        return np.asarray(side**2 * means[inner])

    def kernels(
        self, apertures: Sequence[ApertureSamples], fx: float, inverse_depth: float
    ) -> NDArray[Any]:
        """The spectra (N, H, W) of the kernels at a depth."""
        return np.array(
            [
                self._sum(aperture, fx, inverse_depth, aperture.weights)
                for aperture in apertures
            ]
        )

    def slopes(
        self, apertures: Sequence[ApertureSamples], fx: float, inverse_depth: float
    ) -> NDArray[Any]:
        """The derivatives (N, H, W) of these spectra by 1/z."""
        slopes = []
        for aperture in apertures:
            # The derivative of each term brings down i fx a . frequency.
            along_x, along_y = (
                self._sum(aperture, fx, inverse_depth, aperture.weights * coordinate)
                for coordinate in aperture.points.T
            )
            moved = self.columns * along_x + self.rows[:, None] * along_y
            slopes.append(1j * fx * moved)
        return np.array(slopes)

    def centring(
        self, apertures: Sequence[ApertureSamples], fx: float, inverse_depth: float
    ) -> NDArray[Any]:
        """The spectra (N, H, W) of the moves of the kernels' centres to the origin."""
        centres = [
            ApertureSamples(aperture.weights @ aperture.points, None, aperture.vergence)
            for aperture in apertures
        ]
        return np.asarray(np.conj(self.kernels(centres, fx, inverse_depth)))

    def _sum(
        self, aperture: ApertureSamples, fx: float, inverse_depth: float, weights: Float
    ) -> NDArray[Any]:
        """The sum over the points a of weight exp(i fx (1/z - k) a . frequency)."""
        shift = fx * (inverse_depth - aperture.vergence)
        x, y = 1j * shift * aperture.points.T[..., None]
        # The exponential factors into rows and columns: a product of matrices sums over the points.
        by_row = weights[:, None] * np.exp(y * self.rows)
        return np.asarray(by_row.T @ np.exp(x * self.columns))


def _best_texture(kernels: NDArray[Any], spectra: NDArray[Any]) -> NDArray[Any]:
    """The texture S with the least sum of |F_j - H_j S|^2 over the images."""
    power = np.square(np.abs(kernels)).sum(axis=0) + REGULARISATION
    return np.asarray((np.conj(kernels) * spectra).sum(axis=0) / power)
