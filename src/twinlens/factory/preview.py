"""preview.png: a contact sheet of a dataset, with left images and their disparities in colour.

The samples are spread evenly over the dataset, at most `MOST`, and do not depend on interruptions.
"""

import contextlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from twinlens.dataset import Row, StoredSample
from twinlens.dataset.card import contact_sheet, tile
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.storage import Place
from twinlens.errors import FileError
from twinlens.factory.ledger import repairable
from twinlens.factory.plan import sample_name

NAME = "preview.png"
MOST = 48


def write_preview(folder: Place, count: int, rows: Sequence[Row], tiles: dict[int, Image.Image]) -> None:
    """Write the sheet of a dataset that will have `count` samples; the `tiles` of earlier calls are not read again."""
    places = chosen(count)
    made = {int(row.name) for row in rows}
    for index in sorted(made & {*places} - {*tiles}):
        sample = folder / sample_name(index)
        with repairable(sample):
            tiles[index] = sample_tile(StoredSample(sample, sample.name))
    if tiles:
        sheet = contact_sheet([tiles.get(index) for index in places])
        write_file(folder / NAME, encode_png(np.asarray(sheet)))


def chosen(count: int) -> list[int]:
    """The samples on the sheet: all of them, or `MOST` spread evenly.

    >>> chosen(3), len(chosen(1000)), chosen(1000)[:2]
    ([0, 1, 2], 48, [0, 20])
    """
    shown = min(count, MOST)
    return [k * count // shown for k in range(shown)]


def sample_tile(sample: StoredSample) -> Image.Image:
    """The first image and, where there is one, the first disparity map below it."""
    parts = [np.asarray(tile(sample.im0))]
    with contextlib.suppress(FileError):  # a rig that is not rectified has no disparity
        parts.append(np.asarray(tile(colored(sample.disp0))))
    return Image.fromarray(np.concatenate(parts))


def colored(disparity: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Disparity in the colour map `turbo`, from its 1st to its 99th percentile; black where unknown."""
    import matplotlib

    known = np.isfinite(disparity)
    if not known.any():
        return np.zeros((*disparity.shape, 3), np.uint8)
    low, high = np.percentile(disparity[known], (1, 99))
    level = np.clip((np.where(known, disparity, low) - low) / max(high - low, 1e-6), 0, 1)
    colors = (np.asarray(matplotlib.colormaps["turbo"](level))[..., :3] * 255).astype(np.uint8)
    return np.where(known[..., None], colors, 0).astype(np.uint8)
