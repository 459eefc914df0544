"""The share of an image with texture that both views show, regardless of noise.

Noise resembles texture in one image but is independent between views. A window counts as textured if the left image
and the right one, warped by the true correspondence, covary: their covariance is the variance of the common signal,
and that of noise averages to 0, over n pixels down to 1/sqrt(n) of the images' variance. The covariance must exceed a
minimum contrast and three standard deviations of that chance correlation. With n = 256, about 60 % of windows count
if their fine texture has half the noise's standard deviation, a tenth if it has a third. The noise of neighbouring
pixels is assumed independent. After demosaicing, 2 to 4 % of flat windows with strong noise pass instead of 0.1 %;
noise blurred by a Gaussian of one pixel would make that a tenth.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.geometry import inverse, transform_points
from twinlens.sensor import Sensor
from twinlens.sensor.picture import BAYER

WINDOW = 16
_LEAST_CONTRAST = 0.01  # of the range, rms: about two grey levels of eight bits
_CHANCE = 3.0  # standard deviations of the correlation of noise
_LEAST_KNOWN = 0.5  # of a window's pixels, for it to be evaluated

Grey = NDArray[np.float32]


def grey(image: NDArray[Any], sensor: Sensor) -> Grey:
    """The mean channel of an image in 0..1, (H, W); for a raw mosaic the mean of 2x2 pixels, which have all colours."""
    black, white = 0.0, float(np.iinfo(image.dtype).max)
    if sensor.output == "raw":
        black, white = sensor.black_level, float(sensor.largest_dn)
    mean = image.mean(axis=-1, dtype=np.float32) if image.ndim == 3 else image.astype(np.float32)
    if sensor.output == "raw" and sensor.filters in BAYER:
        below = np.pad(mean, ((0, 1), (0, 1)), mode="reflect")
        mean = (below[:-1, :-1] + below[1:, :-1] + below[:-1, 1:] + below[1:, 1:]) / 4
    return np.asarray((mean - black) / (white - black), dtype=np.float32)


def textured(greys: Sequence[Grey], rig: Rig, truths: Sequence[Truth]) -> float:
    """The share of textured windows among those of the first view that its partner sees at least half of.

    A single camera is its own partner, and its noise counts as texture. 1 if there is no such window.
    """
    partner = rig.partner(0)
    if partner is None:
        return textured_windows(greys[0], greys[0], np.ones(greys[0].shape, bool))
    moved, known = seen_by(greys[partner], rig, truths[0], partner)
    return textured_windows(greys[0], moved, known)


def seen_by(other: Grey, rig: Rig, truth: Truth, partner: int) -> tuple[Grey, NDArray[np.bool_]]:
    """The partner's image warped to the first view (nearest pixel), and where the partner sees the pixel's point."""
    known = truth.visible & truth.hit
    camera = rig.cameras[partner]
    points = transform_points(inverse(rig.world_from_cams[partner]), truth.position[known])
    u, v = np.floor(camera.project(points) + 0.5).astype(int).T
    moved = np.zeros(known.shape, np.float32)
    moved[known] = other[v.clip(0, camera.height - 1), u.clip(0, camera.width - 1)]
    return moved, known


def textured_windows(left: Grey, right: Grey, known: NDArray[np.bool_]) -> float:
    """The share of windows in which two images of the same points covary."""
    weight = _sums(known.astype(np.float64))
    judged = weight >= _LEAST_KNOWN * WINDOW**2
    if not judged.any():
        return 1.0
    a, b = (np.where(known, picture, 0.0).astype(np.float64) for picture in (left, right))
    count = weight[judged]
    mean_a, mean_b, ab, aa, bb = (_sums(product)[judged] / count for product in (a, b, a * b, a * a, b * b))
    shared = ab - mean_a * mean_b
    chance = np.sqrt(np.maximum((aa - mean_a**2) * (bb - mean_b**2), 0.0) / count)
    return float((shared > np.maximum(_LEAST_CONTRAST**2, _CHANCE * chance)).mean())


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the windows that tile an image, without incomplete ones at the right and lower border."""
    rows, columns = (side // WINDOW for side in values.shape)
    cut = values[: rows * WINDOW, : columns * WINDOW]
    sums: NDArray[np.float64] = cut.reshape(rows, WINDOW, columns, WINDOW).sum(axis=(1, 3))
    return sums
