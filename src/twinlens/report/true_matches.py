"""True matches between two views of a stored sample, spread over the image, to draw on it."""

import numpy as np

from twinlens.dataset import StoredSample
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.report.epipolar_picture import spread_points


def true_matches(stored: StoredSample, a: int, b: int, count: int) -> tuple[Float, Float]:
    """Pixels (N, 2) of view a and of view b that show the same points, N <= `count`.

    They come from the sample's truth or, in a folder without it, from the left disparity map. Raises InputError where
    the views have nothing in common.
    """
    if not stored.has(f"truth{a}.exr"):
        return _from_disparity(stored, a, b, count)
    truth, pictured = stored.truth(a), stored.photographed_by
    points = np.where(truth.hit[..., None], truth.position, np.nan)
    pixels = [pictured.project(view, points) for view in (a, b)]
    inside = pictured.cameras[a].contains(pixels[0]) & pictured.cameras[b].contains(pixels[1])
    chosen = spread_points(stored.correspondence(a, b).visible & inside, count)
    if not len(chosen):
        raise InputError(f"{stored.folder}: views {a} and {b} see no common point; choose other cameras")
    here, there = (seen[chosen[:, 1], chosen[:, 0]] for seen in pixels)
    return here, there


def _from_disparity(stored: StoredSample, a: int, b: int, count: int) -> tuple[Float, Float]:
    if (a, b) != (0, 1):
        raise InputError(f"{stored.folder}: has no truth{a}.exr; its disparity map matches cameras 0,1 only")
    disparity = stored.disp0
    chosen = spread_points(np.isfinite(disparity) & (stored.mask0_nonocc == 255), count)
    here = chosen.astype(np.float64)
    return here, here - np.stack([disparity[chosen[:, 1], chosen[:, 0]], np.zeros(len(chosen))], axis=1)
