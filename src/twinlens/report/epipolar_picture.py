"""Two images side by side with points, their epipolar curves, and the epipoles inside the images."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from twinlens.camera import Rig
from twinlens.camera.multiview import (
    check_pair,
    epipolar_curve,
    epipole_in_image,
    fundamental_matrix,
    ideal_pixels,
)
from twinlens.dataset import StoredSample
from twinlens.dataset.pictures import rgb8
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.geometry.epipolar import sampson_distance
from twinlens.matching import feature_matches

# Okabe and Ito's colours, distinguishable with colour blindness, without black.
COLORS = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)

_SCALE = 3  # drawn at this scale and reduced, for smooth lines
_GAP = 12  # pixels between the images
_NEAR, _FAR, _STEPS = 1e-3, 1e5, 4000  # depths of the points of a curve, in baselines
_MAX_STEP = 0.25  # of the image's diagonal: a longer step interrupts a curve
_MARGIN = 0.06  # of the image's sides, without points
_R2 = 1.32471795724474602596 ** -np.array([1.0, 2.0])  # the plastic number's powers
_EDGE = (20, 20, 20)
_NORMAL_MAD = (
    1.4826  # standard deviation over median absolute deviation of a normal distribution
)


def epipolar_picture(
    images: Sequence[NDArray[Any]],
    rig: Rig,
    points_a: ArrayLike,
    points_b: ArrayLike | None = None,
    a: int = 0,
    b: int = 1,
) -> NDArray[np.uint8]:
    """The images of cameras a and b side by side, each with its points and the epipolar curves of the other's points.

    The curves are half-lines from infinity to the camera, with lens distortion. A cross in a ring marks an epipole.
    images: uint8 or uint16 (H, W[, 3]) of camera a and of camera b. points_a, points_b: (N, 2) pixels of camera a and
    their matches in b; None draws the curves in b only. Returns uint8 (H', W', 3). Raises InputError where the cameras
    have no baseline, or pixels are not finite (N, 2).
    """
    check_pair(rig, a, b)
    first, second = _checked_points(points_a, points_b)
    depths = rig.baseline(a, b) * np.geomspace(_NEAR, _FAR, _STEPS)
    curves_in_a = [epipolar_curve(rig, point, depths, b, a) for point in second]
    curves_in_b = [epipolar_curve(rig, point, depths, a, b) for point in first]
    left = _panel(rgb8(images[0]), curves_in_a, first, epipole_in_image(rig, a, b))
    right = _panel(rgb8(images[1]), curves_in_b, second, epipole_in_image(rig, b, a))
    size = left.width + _GAP + right.width, max(left.height, right.height)
    whole = Image.new("RGB", size, (255, 255, 255))
    whole.paste(left, (0, 0))
    whole.paste(right, (left.width + _GAP, 0))
    return np.asarray(whole)


def _checked_points(
    points_a: ArrayLike, points_b: ArrayLike | None
) -> tuple[Float, Float]:
    """Both arrays of points, (0, 2) for None; InputError unless they are finite (N, 2)."""
    first = np.asarray(points_a, dtype=np.float64)
    second = np.empty((0, 2))
    if points_b is not None:
        second = np.asarray(points_b, dtype=np.float64)
    is_list = first.ndim == 2 and first.shape[1] == 2
    if not is_list or (points_b is not None and second.shape != first.shape):
        raise InputError(
            f"points must be (N, 2), with the same N in both images, got {first.shape} and {second.shape}"
        )
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise InputError(
            "points must be finite pixels: leave out those that a camera does not see"
        )
    return first, second


def spread_points(allowed: ArrayLike, count: int) -> NDArray[np.int64]:
    """Up to `count` pixels (u, v), (N, 2), where `allowed`, bool (H, W), is true, spread evenly over the image.

    Each is the allowed pixel nearest to a point of the R2 sequence in the image without a margin. Source: Roberts,
    The Unreasonable Effectiveness of Quasirandom Sequences, 2018.
    """
    v, u = np.nonzero(np.asarray(allowed, dtype=bool))
    pixels = np.stack([u, v], axis=1)
    if not len(pixels):
        return pixels
    size = np.array(np.shape(allowed)[::-1]) - 1
    sequence = (0.5 + np.outer(np.arange(1, count + 1), _R2)) % 1.0
    targets = size * (_MARGIN + (1 - 2 * _MARGIN) * sequence)
    nearest = [
        int(np.argmin(np.square(pixels - target).sum(axis=1))) for target in targets
    ]
    return pixels[list(dict.fromkeys(nearest))]


def true_matches(
    stored: StoredSample, a: int, b: int, count: int
) -> tuple[Float, Float]:
    """Pixels (N, 2) of view a and of view b that show the same points, N <= `count`, spread over the image.

    They come from the sample's truth or, in a folder without it, from the left disparity map. Raises InputError where
    the views have nothing in common.
    """
    if not stored.has_truth(a):
        if (a, b) != (0, 1):
            raise InputError(
                f"{stored.folder}: has no truth{a}.exr; its disparity map matches cameras 0,1 only"
            )
        return _matches_of_disparity(stored, count)
    truth, rig = stored.truth(a), stored.photographed_by
    points = np.where(truth.hit[..., None], truth.position, np.nan)
    pixels_a, pixels_b = rig.project(a, points), rig.project(b, points)
    inside_a = rig.cameras[a].contains(pixels_a)
    inside_b = rig.cameras[b].contains(pixels_b)
    visible = stored.correspondence(a, b).visible
    chosen = spread_points(visible & inside_a & inside_b, count)
    if not len(chosen):
        raise InputError(
            f"{stored.folder}: views {a} and {b} see no common point; choose other cameras"
        )
    u, v = chosen.T
    return pixels_a[v, u], pixels_b[v, u]


def found_matches(
    stored: StoredSample, a: int, b: int, count: int
) -> tuple[Float, Float, Float, Float]:
    """Pixels (N, 2) of views a and b of a sample without truth, N <= `count`; distances and disparities of all matches.

    They are matches of features, which use no calibration: the distances (M,), in pixels, from their epipolar lines are
    what the calibration, or the rectification, is off by. Gross outliers, more than 5 robust standard deviations and
    1 px above the median, are left out. The disparities (M,) are u_a - u_b. Raises InputError without a match.
    """
    rig = stored.rig
    here, there = feature_matches(stored.image(a), stored.image(b))
    if not len(here):
        raise InputError(
            f"{stored.folder}: no features of views {a} and {b} match; the images need texture"
        )
    fundamental = fundamental_matrix(rig, a, b)
    off = sampson_distance(
        fundamental,
        ideal_pixels(rig.cameras[a], here),
        ideal_pixels(rig.cameras[b], there),
    )
    middle = np.median(off)
    spread = _NORMAL_MAD * np.median(np.abs(off - middle))
    plausible = off <= middle + 5 * spread + 1
    here, there, off = here[plausible], there[plausible], off[plausible]
    height, width = stored.image(a).shape[:2]
    # One match a pixel; `spread_points` takes those nearest to evenly spread places.
    index = np.full((height, width), -1)
    columns, rows = np.rint(here).astype(int).T
    index[rows, columns] = np.arange(len(here))
    u, v = spread_points(index >= 0, count).T
    chosen = index[v, u]
    return here[chosen], there[chosen], off, here[:, 0] - there[:, 0]


def _matches_of_disparity(stored: StoredSample, count: int) -> tuple[Float, Float]:
    disparity = stored.disp0
    visible = np.isfinite(disparity) & (stored.mask0_nonocc == 255)
    chosen = spread_points(visible, count)
    u, v = chosen.T
    shift = np.stack([disparity[v, u], np.zeros(len(chosen))], axis=1)
    return chosen.astype(np.float64), chosen - shift


def _panel(
    image: NDArray[np.uint8], curves: list[Float], points: Float, epipole: Float | None
) -> Image.Image:
    """The image with the curves, the numbered points and the epipole."""
    height, width = image.shape[:2]
    enlarged = width * _SCALE, height * _SCALE
    large = Image.fromarray(image).resize(enlarged, Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(large)
    stroke = _SCALE * max(1.0, height / 400)
    for number, curve in enumerate(curves):
        color = COLORS[number % len(COLORS)]
        for part in _parts(curve, width, height):
            path = _canvas(part)
            draw.line(path, fill=_EDGE, width=round(2.6 * stroke), joint="curve")
            draw.line(path, fill=color, width=round(1.4 * stroke), joint="curve")
    for number, point in enumerate(_canvas(points)):
        _draw_point(draw, point, number, stroke)
    if epipole is not None:
        _draw_epipole(draw, _canvas(epipole)[0], stroke)
    return large.resize((width, height), Image.Resampling.LANCZOS)


def _draw_point(
    draw: ImageDraw.ImageDraw, point: tuple[float, float], number: int, stroke: float
) -> None:
    """A dot with a dark edge and centre, and its number beside it."""
    color = COLORS[number % len(COLORS)]
    for radius, fill in ((4.2, _EDGE), (3.2, color), (1.1, _EDGE)):
        draw.circle(point, radius * stroke, fill=fill)
    x, y = point
    draw.text(
        (x + 5 * stroke, y - 14 * stroke),
        str(number + 1),
        fill=color,
        font=ImageFont.load_default(10 * stroke),
        stroke_width=round(stroke),
        stroke_fill=_EDGE,
    )


def _draw_epipole(
    draw: ImageDraw.ImageDraw, point: tuple[float, float], stroke: float
) -> None:
    """A white cross in a ring, with a dark edge."""
    (x, y), radius = point, 9 * stroke
    for width, fill in (
        (round(3.2 * stroke), _EDGE),
        (round(1.6 * stroke), (255, 255, 255)),
    ):
        draw.circle(point, radius, outline=fill, width=width)
        draw.line((x - radius, y, x + radius, y), fill=fill, width=width)
        draw.line((x, y - radius, x, y + radius), fill=fill, width=width)


def _parts(curve: Float, width: int, height: int) -> list[Float]:
    """The connected parts of a curve in the image and one image size around it."""
    above = curve > (-width, -height)
    below = curve < (2 * width, 2 * height)
    near = np.all(np.isfinite(curve) & above & below, axis=1)
    steps = np.linalg.norm(np.diff(np.where(near[:, None], curve, 0.0), axis=0), axis=1)
    broken = ~(near[1:] & near[:-1]) | (steps > _MAX_STEP * np.hypot(width, height))
    pieces = np.split(np.arange(len(curve)), np.flatnonzero(broken) + 1)
    return [curve[piece] for piece in pieces if len(piece) > 1]


def _canvas(points: Float) -> list[tuple[float, float]]:
    """Pixels (N, 2) in the coordinates of the enlarged image, whose origin is its corner."""
    enlarged = (np.atleast_2d(points) + 0.5) * _SCALE - 0.5
    return [(float(x), float(y)) for x, y in enlarged]
