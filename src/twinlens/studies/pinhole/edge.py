"""The slanted edge of the study `pinhole`: its scene, and the modulation transfer function of its image (ISO 12233).

1. The edge line is fitted to the centroids of the rows' derivatives.
2. The edge-spread function averages pixels by their distance from the line, in bins of a quarter pixel.
3. Its derivative, times a Hamming window, is Fourier transformed; the magnitude is divided by its value at 0.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera
from twinlens.errors import InputError
from twinlens.scenes import Scene
from twinlens.studies.stage import GLOW, centred_camera, glowing

Float = NDArray[np.float64]

FILM, PITCH, WAVELENGTH, DEPTH = 0.05, 25e-6, 550e-9, 10.0
"""Film distance, pixel pitch, wavelength and distance of the edge, metres."""
SLANT = math.radians(5.0)
"""Angle between the edge and the vertical."""
OVERSAMPLING = 4


def edge_camera(finer: int = 1) -> Camera:
    """The camera with film distance FILM and pixel pitch PITCH, or a pitch smaller by an integer factor."""
    return centred_camera(finer * 420, finer * 90, finer * FILM / PITCH)


def edge_scene() -> Scene:
    """A luminous half plane at DEPTH, its edge near the axis."""
    size, sine, cosine = 4.0, math.sin(SLANT), math.cos(SLANT)
    pose = np.diag([size, -size, -1.0, 1.0])
    pose[:2, :2] = size * np.array([[cosine, sine], [sine, -cosine]])
    pose[:3, 3] = -size * cosine, -size * sine, DEPTH
    return glowing("edge", [("half", {"type": "rectangle"}, pose, GLOW)], DEPTH)


def edge_spread(picture: ArrayLike) -> tuple[Float, Float]:
    """The edge-spread function: (distance from the edge in pixels, mean grey level), in bins of a quarter pixel.

    picture: (H, W) linear grey levels with one nearly vertical edge through every row. Distances are perpendicular to
    the edge. Raises InputError if a row has no edge, or if the edge spans less than a pixel from top to bottom.
    """
    image = np.asarray(picture, np.float64)
    slopes = np.abs(np.diff(image, axis=1))
    if image.ndim != 2 or not (slopes.sum(axis=1) > 0).all():
        raise InputError("the slanted edge needs a grey image with an edge through every row")
    middles, rows = np.arange(slopes.shape[1]) + 0.5, np.arange(slopes.shape[0])
    near = slopes
    for _ in range(4):  # the line u = slope v + intercept, refitted to the slopes near the previous one
        total = near.sum(axis=1)
        good = total > 0
        line = np.polyfit(rows[good], (near * middles).sum(axis=1)[good] / total[good], 1)
        near = slopes * (np.abs(middles - np.polyval(line, rows)[:, None]) < 0.25 * len(middles))
    if abs(line[0]) * image.shape[0] < 1:
        raise InputError("the edge is not slanted: it must span more than a pixel from top to bottom")
    away = (np.arange(image.shape[1]) - np.polyval(line, rows)[:, None]) * math.cos(math.atan(line[0]))
    bins = np.rint(away * OVERSAMPLING).astype(np.intp)
    first = int(bins.min())
    count = np.bincount((bins - first).ravel())
    total = np.bincount((bins - first).ravel(), weights=image.ravel())
    places = (np.arange(len(count)) + first) / OVERSAMPLING
    full = count >= 0.5 * np.median(count)
    span = np.flatnonzero(full)
    inner = slice(span[0], span[-1] + 1)
    return places[inner], np.interp(places[inner], places[full], total[full] / count[full])


def modulation_transfer(picture: ArrayLike) -> tuple[Float, Float]:
    """(frequency in cycles/pixel up to 1, MTF) of the whole system, pixels included.

    The derivative over two bins attenuates by a sinc, which is divided out.
    """
    _, spread = edge_spread(picture)
    line_spread = np.gradient(spread) * OVERSAMPLING
    centre = int(np.argmax(np.convolve(np.abs(line_spread), np.ones(OVERSAMPLING), mode="same")))
    half = min(centre, len(line_spread) - 1 - centre)
    lines = line_spread[centre - half : centre + half + 1] * np.hamming(2 * half + 1)
    length = 1 << max(len(lines) * 4 - 1, 1).bit_length()
    spectrum = np.abs(np.fft.rfft(lines, length))
    frequency = np.fft.rfftfreq(length, 1.0 / OVERSAMPLING)
    known = frequency <= 1.0
    damping = np.sinc(2.0 * frequency[known] / OVERSAMPLING)
    return np.asarray(frequency[known], np.float64), np.asarray(spectrum[known] / spectrum[0] / damping)


def frequency_at(picture: ArrayLike, contrast: float) -> float:
    """The frequency in cycles/pixel at which the MTF first falls below `contrast`: 0.5 for MTF50, 0.1 for MTF10.

    >>> from scipy import special
    >>> u, v = np.meshgrid(np.arange(80.0), np.arange(60.0))
    >>> edge = 0.5 + 0.5 * special.erf((u - 39.3 - 0.09 * v) / np.hypot(1, 0.09) / (np.sqrt(2) * 2.0))
    >>> gaussian = np.sqrt(np.log(2) / 2) / (np.pi * 2.0)
    >>> bool(abs(frequency_at(edge, 0.5) / gaussian - 1) < 0.01)
    True
    """
    return crossing(*modulation_transfer(picture), contrast)


def crossing(frequency: Float, transfer: Float, contrast: float) -> float:
    """The interpolated frequency at which the transfer first falls below `contrast`; the highest if it does not."""
    below = np.flatnonzero(transfer < contrast)
    if not below.size or below[0] == 0:
        return float(frequency[-1])
    k = int(below[0])
    share = (transfer[k - 1] - contrast) / (transfer[k - 1] - transfer[k])
    return float(frequency[k - 1] + share * (frequency[k] - frequency[k - 1]))
