"""What a layout may ask of a sample, converted to what the readers of the layouts share: 8-bit images, plain names."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import read_bytes
from twinlens.dataset.stored import Disparity, StoredSample
from twinlens.errors import InputError


@dataclass(frozen=True)
class Source:
    """A sample to be exported: the `index`-th of its dataset, seen through its lens number `lens`."""

    sample: StoredSample
    index: int
    lens: int = 0

    def check(self) -> None:
        """Raise InputError where the sample is no rectified pair: no layout here holds another."""
        if self.sample.has("sample.json") and not self.sample.has("calib.txt"):
            raise InputError(f"{self.sample.name}: is no rectified pair, and these layouts hold nothing else")

    @property
    def name(self) -> str:
        """The sample's name as one folder's: train/0001 becomes train-0001."""
        return self.sample.name.replace("/", "-")

    def image(self, i: int) -> bytes:
        """View i as an 8-bit PNG: the file as it is, or its 16 bits rounded to 8."""
        shot = self.sample.lens(self.lens)
        pixels = shot.image(i)
        if pixels.dtype == np.uint8:
            return read_bytes(shot.folder / f"im{i}.png")
        return encode_png(np.round(pixels / 257.0).astype(np.uint8))

    def disparity(self, i: int, largest: float = np.inf) -> Disparity:
        """View i's disparity if its known values lie in [0, largest], or InputError: the layout's numbers end there.

        Readers of layouts that could hold a sign drop it, so that negative values would come back positive.
        """
        disparity = self.sample.disparity(i)
        known = disparity[np.isfinite(disparity)]
        if known.size and not (known.min() >= 0 and known.max() <= largest):
            bounds = f"0 to {largest:.6g}" if np.isfinite(largest) else "no negative ones"
            raise InputError(
                f"{self.sample.name}: has disparities from {known.min():.6g} to {known.max():.6g} px, and this layout"
                f" holds {bounds}; choose another layout, or make the samples anew with a smaller image or doffs"
            )
        return disparity


def scaled(disparity: Disparity, scale: float) -> NDArray[np.uint32]:
    """round(scale d), 0 where unknown; a known disparity is at least 1, so that it is not taken for unknown."""
    known = np.isfinite(disparity)
    counts = np.round(np.where(known, disparity, 0.0).astype(np.float64) * scale)
    return np.where(known, np.maximum(counts, 1), 0).astype(np.uint32)
