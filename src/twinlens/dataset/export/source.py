"""A sample as the layouts read it: 8-bit images, disparities within a layout's range, one file name per sample."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import read_bytes
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import Disparity
from twinlens.errors import InputError

SIGNED_LAYOUTS = ("parquet", "webdataset")
"""The layouts that can hold negative disparities."""


@dataclass(frozen=True)
class Source:
    """A sample to export: number `index` of its dataset, with the images of lens number `lens`."""

    sample: StoredSample
    index: int
    lens: int = 0

    def check(self) -> None:
        """Raise InputError unless the sample is a rectified pair, as every layout requires."""
        if self.sample.has("sample.json") and not self.sample.has("calib.txt"):
            raise InputError(f"{self.sample.name}: is not a rectified pair, as every export layout requires")

    @property
    def name(self) -> str:
        """The sample's name as one folder name: train/0001 becomes train-0001."""
        return self.sample.name.replace("/", "-")

    @property
    def calib(self) -> bytes:
        """The sample's calib.txt."""
        return encode_calib(self.sample.calibration).encode()

    def image(self, i: int) -> bytes:
        """View i as an 8-bit PNG: the sample's file, or its 16 bits rounded to 8."""
        shot = self.sample.lens(self.lens)
        pixels = shot.image(i)
        if pixels.dtype == np.uint8:
            return read_bytes(shot.folder / f"im{i}.png")
        return encode_png(np.round(pixels / 257.0).astype(np.uint8))

    def mask(self, i: int) -> bytes:
        """View i's mask as PNG: 255 visible in both, 128 occluded or out of frame, 0 unknown."""
        return encode_png(self.sample.mask_nonocc(i))

    def disparity(self, i: int, largest: float = np.inf) -> Disparity:
        """View i's disparity. Raises InputError unless its known values are in [0, largest], the range of the layout.

        Readers of layouts that could store a sign take the absolute value, so negative values are rejected there too.
        """
        disparity = self.sample.disparity(i)
        known = disparity[np.isfinite(disparity)]
        if known.size and not (known.min() >= 0 and known.max() <= largest):
            limits = "0 or more" if np.isinf(largest) else f"0 to {largest:.6g}"
            others = f"layouts without this limit: {', '.join(SIGNED_LAYOUTS)}"
            raise InputError(
                f"{self.sample.name}: has disparities from {known.min():.6g} to {known.max():.6g} px, and this layout"
                f" holds {limits}; {others}"
            )
        return disparity


def fixed_point(disparity: Disparity, scale: float) -> NDArray[np.uint32]:
    """round(scale d), at least 1; 0 where unknown. A known disparity of 0 therefore becomes 1, that is 1/scale px."""
    known = np.isfinite(disparity)
    counts = np.round(np.where(known, disparity, 0.0).astype(np.float64) * scale)
    return np.where(known, np.maximum(counts, 1), 0).astype(np.uint32)
