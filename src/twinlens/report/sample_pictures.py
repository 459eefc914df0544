"""Small pictures of a stored sample for a page: its left image, and a strip of tiles of its images and maps.

All tiles of a strip have one size. Maps are shown every n-th pixel; their colours span the 1st to the 99th percentile.
"""

import contextlib
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from twinlens.dataset.channels import IMAGE, MASK
from twinlens.dataset.pictures import colourise, rgb8
from twinlens.dataset.stored import StoredSample
from twinlens.errors import FileError

TILE_WIDTH, THUMBNAIL_WIDTH = 320, 160
_MOST_IMAGES = 4
_QUALITY = 80
_PERCENTILES = (1.0, 99.0)
_NOTHING = (0, 0, 0)
_LEAST_SPAN = 1e-6

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Tile:
    """A picture with its title, what its colours span as text, and the file of the sample that it shows, if any."""

    title: str
    pixels: Pixels
    span: str = ""
    file: str = ""


def encode_webp(picture: Image.Image) -> bytes:
    """The picture as WebP."""
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=_QUALITY, method=2)
    return stream.getvalue()


def thumbnail(image: NDArray[Any]) -> Image.Image:
    """An image (H, W[, 3]) of 8 or 16 bits, scaled to a width of 160 pixels."""
    return _scaled(rgb8(image), THUMBNAIL_WIDTH)


def strip(tiles: list[Tile]) -> Image.Image:
    """The tiles side by side, each 320 pixels wide; padded to the height of the first."""
    pictures = [_scaled(tile.pixels, TILE_WIDTH) for tile in tiles]
    size = pictures[0].size
    padded = [ImageOps.pad(picture, size, color="black") for picture in pictures]
    return Image.fromarray(np.hstack([np.asarray(picture) for picture in padded]))


def _scaled(pixels: Pixels, width: int) -> Image.Image:
    picture = Image.fromarray(pixels)
    height = max(1, round(width * picture.height / picture.width))
    return picture.resize((width, height), Image.Resampling.BOX)


def tiles_of(sample: StoredSample) -> list[Tile]:
    """The images of a sample and the maps of its left view, as far as it has them. Raises FileError without im0.png."""
    tiles = [*_images(sample)]
    for title, shown in _MAPS.items():
        # Channels that the sample does not have, or that cannot be read.
        with contextlib.suppress(FileError):
            tiles.append(shown(title, sample))
    return tiles


def _images(sample: StoredSample) -> Iterator[Tile]:
    """The images of up to four views, and the left images of up to three further lenses."""
    for view in range(_MOST_IMAGES):
        name = IMAGE.name(view)
        if view == 0 or sample.has(name):
            title = ("left", "right")[view] if view < 2 else f"view {view}"
            yield Tile(title, rgb8(sample.image(view)), file=name)
    for number in range(1, min(sample.num_lenses, _MOST_IMAGES)):
        shot = sample.lens(number)
        name = f"{shot.entry.folder.rstrip('/')}/{IMAGE.name(0)}"
        yield Tile(f"left, {shot.label}", rgb8(shot.im0), file=name)


def _every(values: NDArray[Any]) -> NDArray[Any]:
    """Every n-th pixel of a map (H, W[, C]), so that it is about as wide as a tile."""
    step = max(1, values.shape[1] // TILE_WIDTH)
    return values[::step, ::step]


def _span(values: NDArray[Any]) -> tuple[float, float]:
    """Between which values most known ones are; the first is less than the second."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _PERCENTILES) if known.size else (0.0, 1.0)
    return float(low), float(max(high, low + _LEAST_SPAN))


def _false_colours(title: str, values: NDArray[Any], colormap: str, unit: str) -> Tile:
    low, high = _span(values)
    pixels = colourise(values, low, high, colormap, unknown_colour=_NOTHING)
    return Tile(title, pixels, f"{low:.3g} to {high:.3g} {unit}")


def _disparity(title: str, sample: StoredSample) -> Tile:
    return _false_colours(title, _every(sample.disp0), "turbo", "px")


def _mask(title: str, sample: StoredSample) -> Tile:
    if not sample.has(MASK.name(0)):
        raise FileError(f"{sample.folder}: has no mask")
    return Tile(title, rgb8(_every(sample.mask0_nonocc)), file=MASK.name(0))


def _depth(title: str, sample: StoredSample) -> Tile:
    return _false_colours(title, _every(sample["depth0"]), "viridis", "m")


def _normal(title: str, sample: StoredSample) -> Tile:
    normals = _every(sample["normal0"])
    return Tile(title, np.rint((normals + 1) * 127.5).astype(np.uint8))


def _ids(title: str, sample: StoredSample) -> Tile:
    """Numbers of objects in colours that repeat after many; black where nothing was hit."""
    numbers = _every(sample["object_id0"]).astype(np.int64)
    # Steps of the golden ratio around the colour circle put neighbours far apart.
    hues = np.mod(numbers * 0.618, 1.0)
    pixels = colourise(hues, 0, 1, "hsv")
    return Tile(title, np.where(numbers[..., None] > 0, pixels, 0).astype(np.uint8))


def _blur(title: str, sample: StoredSample) -> Tile:
    """The signed blur circle, black where the image is sharp. Raises FileError for a pinhole."""
    values = _every(sample["blur_circle_px0"])
    high = _span(np.abs(values))[1]
    if not np.any(values[np.isfinite(values)]):
        raise FileError(f"{sample.folder}: nothing is blurred")
    pixels = colourise(values, -high, high, "berlin", unknown_colour=_NOTHING)
    return Tile(title, pixels, f"-{high:.3g} to {high:.3g} px")


_MAPS: dict[str, Callable[[str, StoredSample], Tile]] = {
    "disparity": _disparity,
    "visible in both": _mask,
    "depth": _depth,
    "normals": _normal,
    "objects": _ids,
    "blur circle": _blur,
}
"""The maps by title; a function raises FileError for a sample without the map."""
