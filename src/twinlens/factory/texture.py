"""How much of a photograph has texture that both eyes see, whatever its noise.

Noise looks like texture in one picture; the eyes' noise is independent. So a window counts as textured where the left
picture and the right one, brought to it by the true correspondence, vary together: their covariance is the variance of
what both show, and that of noise averages to nothing. Over a window's n pixels it does so down to 1/sqrt(n) of the
pictures' own variance. So a window's covariance must be that of the least contrast, and three times what chance leaves:
with n = 256, of the windows with fine texture of half the noise's deviation some 60 % count, of those with a third of
it a tenth. This takes the noise of neighbouring pixels for independent: demosaicing makes flat windows pass more often,
2 to 4 % of them for strong noise instead of 0.1 %, and noise blurred by a Gaussian of one pixel would make it a tenth.
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
_CHANCE = 3.0  # standard deviations of the correlation of mere noise
_LEAST_KNOWN = 0.5  # of a window's pixels, for it to have a say

Grey = NDArray[np.float32]


def grey(image: NDArray[Any], sensor: Sensor) -> Grey:
    """The picture's mean channel in 0..1, (H, W); of a raw mosaic the mean of 2x2 pixels, which hold all colours."""
    black, white = 0.0, float(np.iinfo(image.dtype).max)
    if sensor.output == "raw":
        black, white = sensor.black_level, float(sensor.largest_dn)
    mean = image.mean(axis=-1, dtype=np.float32) if image.ndim == 3 else image.astype(np.float32)
    if sensor.output == "raw" and sensor.filters in BAYER:
        below = np.pad(mean, ((0, 1), (0, 1)), mode="reflect")
        mean = (below[:-1, :-1] + below[1:, :-1] + below[:-1, 1:] + below[1:, 1:]) / 4
    return np.asarray((mean - black) / (white - black), dtype=np.float32)


def textured(greys: Sequence[Grey], rig: Rig, truths: Sequence[Truth]) -> float:
    """The share of the first view's windows that have texture, of those that its partner sees at least half of.

    A single camera is its own partner, and its noise is texture too. 1 where no window can be judged.
    """
    partner = rig.partner(0)
    if partner is None:
        return textured_windows(greys[0], greys[0], np.ones(greys[0].shape, bool))
    moved, known = seen_by(greys[partner], rig, truths[0], partner)
    return textured_windows(greys[0], moved, known)


def seen_by(other: Grey, rig: Rig, truth: Truth, partner: int) -> tuple[Grey, NDArray[np.bool_]]:
    """What the partner's picture shows of each pixel's point, the nearest pixel of it; and where it sees the point."""
    known = truth.visible & truth.hit
    camera = rig.cameras[partner]
    points = transform_points(inverse(rig.world_from_cams[partner]), truth.position[known])
    u, v = np.floor(camera.project(points) + 0.5).astype(int).T
    moved = np.zeros(known.shape, np.float32)
    moved[known] = other[v.clip(0, camera.height - 1), u.clip(0, camera.width - 1)]
    return moved, known


def textured_windows(left: Grey, right: Grey, known: NDArray[np.bool_]) -> float:
    """The share of windows in which two pictures of the same points vary together."""
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
    """Sums over the windows that tile an image; what is left over at its right and lower border is left out."""
    rows, columns = (side // WINDOW for side in values.shape)
    cut = values[: rows * WINDOW, : columns * WINDOW]
    sums: NDArray[np.float64] = cut.reshape(rows, WINDOW, columns, WINDOW).sum(axis=(1, 3))
    return sums
