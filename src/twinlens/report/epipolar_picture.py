"""Two images side by side with points, the curves on which their partners must lie, and the epipoles in view."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from twinlens.camera import Rig
from twinlens.camera.multiview import check_pair, epipolar_curve, epipole_in_image
from twinlens.errors import InputError
from twinlens.geometry import Float

# Okabe and Ito's colours, told apart by every eye; their black would not show on an image.
COLORS = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167))

_FINE = 3  # the picture is drawn this many times larger and made smaller: smooth lines
_GAP = 12  # pixels between the images
_NEAR, _FAR, _STEPS = 1e-3, 1e5, 4000  # of the baseline: depths along which a curve is followed
_LEAP = 0.25  # of the image's diagonal: steps longer than this are no line but a jump
_MARGIN = 0.06  # of the image's sides, where no points are looked for
_R2 = 1.32471795724474602596 ** -np.array([1.0, 2.0])  # the plastic number's powers
_EDGE = (20, 20, 20)


def epipolar_picture(
    images: Sequence[NDArray[Any]], rig: Rig, here: ArrayLike, there: ArrayLike | None = None, a: int = 0, b: int = 1
) -> NDArray[np.uint8]:
    """Cameras a's and b's images beside each other, each with its points and the other's epipolar curves.

    Parameters
    ----------
    images : uint8 or uint16 (H, W[, 3]) of camera a, and of camera b.
    rig : Rig
        Whose epipolar geometry is drawn: half-lines, from infinity to the camera, bent as the lenses bend them.
    here, there : (N, 2)
        Pixels of camera a, and their partners in b; None draws the curves in b alone.

    Returns
    -------
    uint8 (H', W', 3). Epipoles inside an image are crosses in a ring.

    Raises InputError where the cameras have no epipolar geometry, or pixels are not finite (N, 2).
    """
    check_pair(rig, a, b)
    points = _points(here, None if there is None else there)
    pictures = [_rgb(image) for image in images]
    lines = [_curves(rig, points[1], b, a), _curves(rig, points[0], a, b)]
    marks = [epipole_in_image(rig, a, b), epipole_in_image(rig, b, a)]
    panels = [_panel(*parts) for parts in zip(pictures, lines, points, marks, strict=True)]
    return _beside(panels)


def spread_points(allowed: ArrayLike, count: int) -> NDArray[np.int64]:
    """Up to `count` of the pixels (u, v), (N, 2), that are allowed, bool (H, W): evenly spread over rows and columns.

    Each is the allowed pixel nearest to a point of the R2 sequence, which fills the image but for a margin. Source:
    Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018.

    >>> spread_points(np.ones((30, 40), bool), 3).tolist()
    [[11, 4], [3, 18], [29, 7]]
    """
    v, u = np.nonzero(np.asarray(allowed, dtype=bool))
    pixels = np.stack([u, v], axis=1)
    if not len(pixels):
        return pixels
    size = np.array(np.shape(allowed)[::-1]) - 1
    wanted = size * (_MARGIN + (1 - 2 * _MARGIN) * ((0.5 + np.outer(np.arange(1, count + 1), _R2)) % 1.0))
    nearest = [int(np.argmin(np.square(pixels - point).sum(axis=1))) for point in wanted]
    return pixels[list(dict.fromkeys(nearest))]


def _points(here: ArrayLike, there: ArrayLike | None) -> tuple[Float, Float]:
    first = np.asarray(here, dtype=np.float64)
    second = np.empty((0, 2)) if there is None else np.asarray(there, dtype=np.float64)
    if first.ndim != 2 or first.shape[1] != 2 or (there is not None and second.shape != first.shape):
        raise InputError(f"points must be as many (N, 2) in both images, got {first.shape} and {second.shape}")
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise InputError("points must be finite pixels: leave out those that a camera does not see")
    return first, second


def _curves(rig: Rig, points: Float, a: int, b: int) -> list[Float]:
    """What b sees of each of a's pixels along its ray: (_STEPS, 2) each, NaN where it sees nothing."""
    depths = rig.baseline(a, b) * np.geomspace(_NEAR, _FAR, _STEPS)
    return [epipolar_curve(rig, pixel, depths, a, b) for pixel in points]


def _rgb(image: NDArray[Any]) -> NDArray[np.uint8]:
    eight = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image.astype(np.uint8)
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else eight


def _panel(image: NDArray[np.uint8], curves: list[Float], points: Float, epipole: Float | None) -> Image.Image:
    height, width = image.shape[:2]
    large = Image.fromarray(image).resize((width * _FINE, height * _FINE), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(large)
    stroke = max(1.0, height / 400)
    for k, curve in enumerate(curves):
        for part in _parts(curve, width, height):
            _stroke(draw, part, COLORS[k % len(COLORS)], stroke)
    for k, point in enumerate(points):
        _mark(draw, point, COLORS[k % len(COLORS)], stroke, str(k + 1))
    if epipole is not None:
        _cross(draw, epipole, stroke)
    return large.resize((width, height), Image.Resampling.LANCZOS)


def _parts(curve: Float, width: int, height: int) -> list[Float]:
    """The pieces of a curve on the image, and a little beyond."""
    near = np.all(np.isfinite(curve) & (curve > (-width, -height)) & (curve < (2 * width, 2 * height)), axis=1)
    steps = np.linalg.norm(np.diff(np.where(near[:, None], curve, 0.0), axis=0), axis=1)
    broken = ~(near[1:] & near[:-1]) | (steps > _LEAP * np.hypot(width, height))
    pieces = np.split(np.arange(len(curve)), np.flatnonzero(broken) + 1)
    return [curve[piece] for piece in pieces if len(piece) > 1]


def _canvas(points: Float) -> list[tuple[float, float]]:
    """Pixels (N, 2), centres at integers, in the enlarged picture's coordinates, which begin at its corner."""
    return [(float(u), float(v)) for u, v in (np.atleast_2d(points) + 0.5) * _FINE - 0.5]


def _stroke(draw: ImageDraw.ImageDraw, points: Float, color: tuple[int, int, int], stroke: float) -> None:
    path = _canvas(points)
    draw.line(path, fill=_EDGE, width=round(2.6 * stroke * _FINE), joint="curve")
    draw.line(path, fill=color, width=round(1.4 * stroke * _FINE), joint="curve")


def _mark(draw: ImageDraw.ImageDraw, point: Float, color: tuple[int, int, int], stroke: float, name: str) -> None:
    ((x, y),) = _canvas(point)
    for radius, fill in ((4.2, _EDGE), (3.2, color), (1.1, _EDGE)):
        r = radius * stroke * _FINE
        draw.ellipse((x - r, y - r, x + r, y + r), fill=fill)
    font = ImageFont.load_default(10 * stroke * _FINE)
    place = (x + 5 * stroke * _FINE, y - 14 * stroke * _FINE)
    draw.text(place, name, fill=color, font=font, stroke_width=round(stroke * _FINE), stroke_fill=_EDGE)


def _cross(draw: ImageDraw.ImageDraw, point: Float, stroke: float) -> None:
    ((x, y),) = _canvas(point)
    r = 9 * stroke * _FINE
    for width, fill in ((3.2, _EDGE), (1.6, (255, 255, 255))):
        size = round(width * stroke * _FINE)
        draw.ellipse((x - r, y - r, x + r, y + r), outline=fill, width=size)
        draw.line((x - r, y, x + r, y), fill=fill, width=size)
        draw.line((x, y - r, x, y + r), fill=fill, width=size)


def _beside(panels: list[Image.Image]) -> NDArray[np.uint8]:
    width = sum(panel.width for panel in panels) + _GAP * (len(panels) - 1)
    whole = Image.new("RGB", (width, max(panel.height for panel in panels)), (255, 255, 255))
    x = 0
    for panel in panels:
        whole.paste(panel, (x, 0))
        x += panel.width + _GAP
    return np.asarray(whole)
