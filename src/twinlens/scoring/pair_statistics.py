"""Differences between the images of a pair, their appearance, and how hard the scene is (`scene_statistics`).

The differences need the true disparity.

Grey levels are 0.299 R + 0.587 G + 0.114 B on a scale of 0 to 255, linearly scaled from 16 bits. `warped` is the right
image at u - d, by cubic interpolation. Pixels are used where both views see the point and the truth has no jump of more
than 1 px within 3 px.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # imports its parts at their first use; scipy.stats takes 0.7 s
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.errors import InputError
from twinlens.matching import grey
from twinlens.scoring.regions import discontinuity, occluded, textureless
from twinlens.scoring.samples import Pair
from twinlens.scoring.scene_statistics import geometry_statistics, image_statistics

Grey = NDArray[np.float64]
_JUMP_PX, _JUMP_WINDOW = np.nextafter(1.0, 2.0), 7
_LOW_WINDOW, _WINDOW, _BLOCK = 21, 9, 8
_FLAT_SD = 3.0
_MEDIAN_OF_UNIT_NORMAL = 0.6744897501960817  # of the absolute values
_HUBER = 1.345  # 95 % efficiency for normal errors
_ROOT_3 = 3**0.5
_DB2 = np.array([-1 - _ROOT_3, 3 + _ROOT_3, -(3 - _ROOT_3), 1 - _ROOT_3]) / 32**0.5
"""High-pass filter of the wavelet db2."""
_BANDS = {"spectrum_low": (0.02, 0.15), "spectrum_high": (0.2, 0.45)}
"""Cycles per pixel over which the slopes are fitted."""


@dataclass(frozen=True)
class Statistic:
    """A statistic of a pair. real: median, 10 % and 90 % quantile of 24 pairs of Middlebury, ETH3D, KITTI; or NaN.

    needs_truth: whether it is NaN for a pair without true disparity.
    """

    unit: str
    text: str
    real: tuple[float, float, float]
    needs_truth: bool = False


STATISTICS: Mapping[str, Statistic] = {
    "low_sd": Statistic(
        "grey",
        "s.d. of the 21x21 mean of left - warped",
        (2.4, 1.4, 5.4),
        needs_truth=True,
    ),
    "bias": Statistic(
        "grey", "|median of left - warped|", (1.3, 0.2, 8.3), needs_truth=True
    ),
    "gain": Statistic(
        "",
        "|g - 1| of the robust line left = g warped + o",
        (0.013, 0.002, 0.028),
        needs_truth=True,
    ),
    "offset": Statistic("grey", "o of that line", (0.3, -3.4, 4.2), needs_truth=True),
    "noise": Statistic(
        "grey",
        "noise of the left image from its wavelets",
        (0.95, 0.5, 2.0),
    ),
    "flat_noise": Statistic(
        "grey", "noise in the flattest fifth of its 8x8 blocks", (0.5, 0.3, 1.6)
    ),
    "residual": Statistic(
        "grey",
        "1.48 MAD of left - g warped - o - low",
        (1.4, 0.8, 2.1),
        needs_truth=True,
    ),
    "textureless": Statistic("", "share of textureless windows", (0.67, 0.27, 0.90)),
    "flat": Statistic(
        "", "share of 9x9 windows with a s.d. below 3", (0.28, 0.04, 0.50)
    ),
    "contrast": Statistic("grey", "median s.d. of 9x9 windows", (8.0, 4.1, 15.4)),
    "gradient": Statistic(
        "grey/px", "median magnitude of the gradient", (2.8, 1.6, 5.9)
    ),
    "kurtosis": Statistic("", "kurtosis of horizontal differences", (23.0, 14.0, 60.0)),
    "spectrum_low": Statistic(
        "", "slope of the power spectrum, 0.02 to 0.15 cycles/px", (-2.6, -3.0, -2.4)
    ),
    "spectrum_high": Statistic(
        "", "slope of the power spectrum, 0.2 to 0.45 cycles/px", (-3.8, -5.3, -3.0)
    ),
    "correlation": Statistic(
        "",
        "median correlation of 9x9 windows at the true disparity",
        (0.96, 0.90, 0.98),
        needs_truth=True,
    ),
    "occluded": Statistic(
        "",
        "occluded share of the pixels with known truth",
        (0.11, 0.03, 0.18),
        needs_truth=True,
    ),
    "edges": Statistic(
        "",
        "share within 4 px of a disparity jump of 2 px or more",
        (0.17, 0.01, 0.32),
        needs_truth=True,
    ),
    "thin": Statistic(
        "",
        "share of things narrower than 11 px, 2 px or more before the rest of the row",
        (0.014, 0.002, 0.069),
        needs_truth=True,
    ),
    "slant": Statistic(
        "px",
        "median disparity step to the next pixel of the row",
        (0.012, 0.0, 0.052),
        needs_truth=True,
    ),
    "slant_high": Statistic(
        "px", "90 % quantile of these steps", (0.11, 0.004, 0.50), needs_truth=True
    ),
    "range": Statistic(
        "",
        "2 % to 98 % quantile of the disparity over the image width",
        (0.066, 0.023, 0.119),
        needs_truth=True,
    ),
    "unknown": Statistic(
        "", "share without true disparity", (0.025, 0.003, 0.39), needs_truth=True
    ),
    "dark": Statistic("", "share with a grey level below 16", (0.003, 0.0, 0.095)),
    "bright": Statistic("", "share with a grey level above 250", (0.001, 0.0, 0.027)),
    "plain_areas": Statistic(
        "", "share whose 21x21 pixels are textureless to 80 %", (0.31, 0.06, 0.53)
    ),
    "largest_disparity": Statistic(
        "",
        "largest true disparity over the image width",
        (0.09, math.nan, math.nan),
        needs_truth=True,
    ),
    "width": Statistic("px", "image width", (695.0, 450.0, 740.0)),
}


def pair_statistics(pair: Pair) -> dict[str, float]:
    """Every quantity of `STATISTICS` for one pair; NaN where it has no pixels.

    Raises InputError for an image smaller than 32 x 32 pixels. Sources: for noise, Donoho and Johnstone, Biometrika 81
    (1994), section 4.2; for flat_noise, Immerkaer, "Fast noise variance estimation", CVIU 64 (1996).
    """
    height, width = pair.shape
    if min(height, width) < 32:
        raise InputError(
            f"{pair.name}: {width} x {height} pixels; statistics need 32 x 32 or more"
        )
    left, warped, used, hidden = compared_images(pair)
    truth = pair.truth
    has_truth = np.isfinite(truth)
    noise, share = appearance(left)
    down, across = np.gradient(left)
    steps = np.diff(left, axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(left, (_WINDOW, _WINDOW))
    # Row by row, to save memory.
    contrast = np.stack([row.std(axis=(1, 2)) for row in windows])
    occluded_share = largest = math.nan
    if has_truth.any():
        occluded_share = float(hidden.sum() / has_truth.sum())
        largest = float(truth[has_truth].max() / width)
    return {
        **_differences(left, warped, used),
        "noise": math.sqrt(noise),
        "flat_noise": _flat_noise(left),
        "textureless": share,
        "flat": float((contrast < _FLAT_SD).mean()),
        "contrast": float(np.median(contrast)),
        "gradient": float(np.median(np.hypot(down, across))),
        "kurtosis": float(scipy.stats.kurtosis(steps, axis=None, fisher=False)),
        **_spectrum_slopes(left),
        "correlation": _correlation(left, warped, used),
        "occluded": occluded_share,
        **geometry_statistics(truth),
        **image_statistics(left),
        "largest_disparity": largest,
        "width": float(width),
    }


def summarize(
    rows: Sequence[Mapping[str, float]],
) -> dict[str, tuple[float, float, float]]:
    """Median, 10 % and 90 % quantile of each statistic over pairs; pairs without a value are not counted.

    >>> summarize([{"noise": 1.0}, {"noise": 3.0}])
    {'noise': (2.0, 1.2, 2.8)}
    """
    summary = {}
    for name in rows[0] if rows else ():
        values = [row[name] for row in rows if not math.isnan(row[name])]
        summary[name] = (math.nan, math.nan, math.nan)
        if values:
            median, low, high = np.percentile(values, (50, 10, 90)).tolist()
            summary[name] = (median, low, high)
    return summary


def compared_images(
    pair: Pair,
) -> tuple[Grey, Grey, NDArray[np.bool_], NDArray[np.bool_]]:
    """Grey levels of the left and the warped right image, the pixels to compare, and the occluded ones; (H, W) each."""
    truth = pair.truth
    left, warped = grey_levels(pair.im0), warp_right(grey_levels(pair.im1), truth)
    has_truth = np.isfinite(truth)
    hidden = np.zeros_like(has_truth)
    if pair.mask0_nonocc is not None:
        hidden = has_truth & occluded(pair.mask0_nonocc)
    jump = discontinuity(truth, _JUMP_WINDOW, _JUMP_PX)
    return left, warped, np.isfinite(warped) & ~hidden & ~jump, hidden


def appearance(image: Grey) -> tuple[float, float]:
    """Variance of the noise, from wavelets, and share of textureless windows of grey levels (H, W)."""
    share = textureless(np.rint(image).astype(np.uint8)).mean()
    return _wavelet_noise(image) ** 2, float(share)


def grey_levels(image: NDArray[Any]) -> Grey:
    """A uint8 or uint16 image as grey levels, float64 (H, W), 0 to 255."""
    return grey(image / (257.0 if image.dtype == np.uint16 else 1.0))


def warp_right(right: Grey, disparity: NDArray[np.floating[Any]]) -> Grey:
    """The right image at u - d, (H, W), by cubic spline interpolation; NaN where d is unknown or u - d is outside."""
    height, width = right.shape
    columns = np.arange(width) - np.where(np.isfinite(disparity), disparity, np.inf)
    inside = (columns >= 0) & (columns <= width - 1)
    rows = np.broadcast_to(np.arange(height, dtype=np.float64)[:, None], columns.shape)
    warped = ndimage.map_coordinates(
        right, (rows, np.where(inside, columns, 0.0)), order=3, mode="nearest"
    )
    return np.where(inside, warped, np.nan)


def _differences(left: Grey, warped: Grey, used: NDArray[np.bool_]) -> dict[str, float]:
    if np.count_nonzero(used) < _WINDOW**2:
        return dict.fromkeys(("low_sd", "bias", "gain", "offset", "residual"), math.nan)
    difference = left[used] - warped[used]
    low = low_pass(difference, used)
    design = np.stack([warped[used], np.ones_like(warped[used])], axis=1)
    gain, offset = robust_fit(design, left[used], (1.0, 0.0), (1e-2, 1.0))
    rest = left[used] - gain * warped[used] - offset - (low - np.median(low))
    return {
        "low_sd": float(low.std()),
        "bias": float(abs(np.median(difference))),
        "gain": float(abs(gain - 1.0)),
        "offset": float(offset),
        "residual": _mad(rest),
    }


def low_pass(values: Grey, used: NDArray[np.bool_]) -> Grey:
    """21x21 mean of the values of the pixels `used` (H, W), at these pixels; (N,), as `values`."""
    image = np.zeros(used.shape)
    image[used] = values
    # Outside the image and at other pixels both the values and the weights are 0.
    total = ndimage.uniform_filter(image, _LOW_WINDOW, mode="constant")
    weight = ndimage.uniform_filter(used * 1.0, _LOW_WINDOW, mode="constant")
    return np.asarray(total[used] / weight[used])


def robust_fit(
    design: Grey, y: Grey, start: Sequence[float], steps: Any = "jac"
) -> Grey:
    """The p of y = design p by Huber's loss, (M,); its scale is from the median absolute residual at `start`.

    steps : sizes of typical changes of p; by default from the columns of `design`, (N, M).
    """
    scale = max(_HUBER * _mad(y - design @ np.array(start)), 1e-6)
    fit = scipy.optimize.least_squares(
        lambda p: design @ p - y,
        start,
        jac=lambda p: design,
        loss="huber",
        f_scale=scale,
        x_scale=steps,
    )
    return np.asarray(fit.x)


def _mad(values: Grey) -> float:
    return float(scipy.stats.median_abs_deviation(values, scale="normal"))


def _wavelet_noise(image: Grey) -> float:
    """Median of the non-zero diagonal detail coefficients over that of a unit normal, as scikit-image has it."""
    details = image
    for axis, size in enumerate(image.shape):
        margins = [(0, 0), (0, 0)]
        margins[axis] = (3, 3)
        padded = np.pad(details, margins, mode="symmetric")
        # The convolution with the filter, at every second place.
        details = sum(
            weight * padded.take(range(4 - k, size + 6 - k, 2), axis)
            for k, weight in enumerate(_DB2)
        )
    sizes = np.abs(details[details != 0])
    return float(np.median(sizes) / _MEDIAN_OF_UNIT_NORMAL) if sizes.size else 0.0


def _flat_noise(image: Grey) -> float:
    """Immerkaer's estimate, sqrt(pi/2) mean|I * N| / 6, over the fifth of the blocks with the least variance."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    both = np.stack([image, np.abs(ndimage.convolve(image, kernel, mode="mirror"))])
    windows = np.lib.stride_tricks.sliding_window_view(
        both, (_BLOCK, _BLOCK), axis=(1, 2)
    )
    tiles = windows[:, ::_BLOCK, ::_BLOCK]  # blocks that do not overlap
    blocks, responses = tiles.reshape(2, -1, _BLOCK * _BLOCK)
    order = np.argsort(blocks.var(axis=1), kind="stable")
    flattest = order[: max(len(order) // 5, 1)]
    # For normal noise of s.d. s, the mean of |response| is 6 s sqrt(2 / pi).
    return float(math.sqrt(math.pi / 2) / 6 * responses[flattest].mean())


def _spectrum_slopes(image: Grey) -> dict[str, float]:
    """Slopes of log power over log frequency: Hann window, mean power in rings as wide as one frequency step."""
    height, width = image.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    power = np.abs(np.fft.fft2((image - image.mean()) * window)) ** 2
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None])
    step = 1.0 / min(height, width)
    ring = np.rint(radius / step).astype(np.intp).ravel()
    mean = np.bincount(ring, power.ravel()) / np.bincount(ring)
    frequency = np.arange(len(mean)) * step
    slopes = {}
    for name, (low, high) in _BANDS.items():
        rings = (frequency >= low) & (frequency <= high) & (mean > 0)
        slopes[name] = math.nan
        if np.count_nonzero(rings) > 1:
            slope, _ = np.polyfit(np.log(frequency[rings]), np.log(mean[rings]), 1)
            slopes[name] = float(slope)
    return slopes


def _correlation(left: Grey, warped: Grey, used: NDArray[np.bool_]) -> float:
    """Median correlation of the 9x9 windows all of whose pixels are used, without those of constant grey."""
    whole = ndimage.minimum_filter(used, _WINDOW, mode="constant")
    left, warped = left - left.mean(), np.where(used, warped - left.mean(), 0.0)

    def mean(values: Grey) -> Grey:
        return np.asarray(ndimage.uniform_filter(values, _WINDOW)[whole])

    a, b = mean(left), mean(warped)
    variances = (mean(left**2) - a**2) * (mean(warped**2) - b**2)
    covariance = mean(left * warped) - a * b
    textured = variances > 1e-6
    if not textured.any():
        return math.nan
    correlations = covariance[textured] / np.sqrt(variances[textured])
    return float(np.median(correlations))
