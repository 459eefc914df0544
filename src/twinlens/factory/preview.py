"""preview.png: a contact sheet of a dataset, with left images and their disparities in colour.

The samples are spread evenly over the dataset, at most `MOST`, and do not depend on interruptions.
"""

import contextlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import StoredSample
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.storage import Place
from twinlens.errors import FileError
from twinlens.factory.ledger import repairable
from twinlens.factory.plan import sample_name

NAME = "preview.png"
MOST = 48
_COLUMNS = 8
_WIDTH = 160
_GAP = 4
_EMPTY = 40  # grey

Image = NDArray[np.uint8]


class Preview:
    """The sheet of a dataset at `folder` that will have `count` samples."""

    def __init__(self, folder: Place, count: int) -> None:
        self.folder = folder
        self.chosen = chosen(count)
        self._tiles: dict[int, Image] = {}

    def write(self, done: Sequence[int]) -> None:
        """Draw the samples of `done` that are on the sheet, and write it, whole or not at all."""
        there = set(done)
        for index in self.chosen:
            if index in there and index not in self._tiles:
                folder = self.folder / sample_name(index)
                with repairable(folder):
                    self._tiles[index] = tile(StoredSample(folder, folder.name))
        if self._tiles:
            write_file(self.folder / NAME, encode_png(sheet([self._tiles.get(index) for index in self.chosen])))


def chosen(count: int) -> list[int]:
    """The samples on the sheet: all of them, or `MOST` spread evenly.

    >>> chosen(3), len(chosen(1000)), chosen(1000)[:2]
    ([0, 1, 2], 48, [0, 20])
    """
    shown = min(count, MOST)
    return [k * count // shown for k in range(shown)]


def tile(sample: StoredSample) -> Image:
    """The first image and, where there is one, the first disparity map below it, `_WIDTH` px wide."""
    image = sample.im0
    grey = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    parts = [_narrow((grey / float(np.iinfo(grey.dtype).max) * 255).astype(np.uint8))]
    with contextlib.suppress(FileError):  # a rig that is not rectified has no disparity
        parts.append(_narrow(colored(sample.disp0)))
    return np.concatenate(parts)


def colored(disparity: NDArray[np.float32]) -> Image:
    """Disparity in the colour map `turbo`, from its 1st to its 99th percentile; black where unknown."""
    import matplotlib

    known = np.isfinite(disparity)
    if not known.any():
        return np.zeros((*disparity.shape, 3), np.uint8)
    low, high = np.percentile(disparity[known], (1, 99))
    level = np.clip((np.where(known, disparity, low) - low) / max(high - low, 1e-6), 0, 1)
    colors = (np.asarray(matplotlib.colormaps["turbo"](level))[..., :3] * 255).astype(np.uint8)
    return np.where(known[..., None], colors, 0).astype(np.uint8)


def sheet(tiles: Sequence[Image | None]) -> Image:
    """Tiles row by row; missing ones are grey."""
    sizes = [part.shape[:2] for part in tiles if part is not None]
    height, width = (max(size[axis] for size in sizes) for axis in (0, 1))
    columns = min(_COLUMNS, len(tiles))
    rows = -(-len(tiles) // columns)
    step = (height + _GAP, width + _GAP)
    page = np.zeros((rows * step[0] + _GAP, columns * step[1] + _GAP, 3), np.uint8)
    for k, part in enumerate(tiles):
        y, x = _GAP + k // columns * step[0], _GAP + k % columns * step[1]
        page[y : y + height, x : x + width] = _EMPTY
        if part is not None:
            page[y : y + part.shape[0], x : x + part.shape[1]] = part
    return page


def _narrow(image: Image) -> Image:
    """At most `_WIDTH` px wide, by the mean of whole blocks of pixels: the same bytes on every machine."""
    block = -(-image.shape[1] // _WIDTH)
    height, width = max(image.shape[0] // block, 1), max(image.shape[1] // block, 1)
    cut = image[: height * block, : width * block]
    if cut.shape[0] < block:
        return cut[:, ::block]
    means: NDArray[np.float64] = cut.reshape(height, block, width, block, 3).mean(axis=(1, 3))
    return means.astype(np.uint8)
