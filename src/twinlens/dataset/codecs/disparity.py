"""Disparity maps as users have them: PFM, or KITTI's 16-bit PNG."""

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.pfm import read_pfm
from twinlens.dataset.codecs.png import read_png
from twinlens.dataset.storage import Where, place
from twinlens.errors import FileError


def read_disparity(path: Where) -> NDArray[np.float32]:
    """A disparity map, float32 (H, W), +inf unknown, from a PFM or a 16-bit PNG (256 d, 0 unknown).

    Raises FileError for a file that is neither.
    """
    if place(path).suffix.lower() == ".png":
        codes = read_png(path)
        if codes.ndim != 2 or codes.dtype != np.uint16:
            raise FileError(f"{path}: a disparity PNG must be 16-bit grey (256 d, 0 unknown), as KITTI's are")
        return np.where(codes > 0, codes / np.float32(256), np.inf).astype(np.float32)
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        raise FileError(f"{path}: has colour channels; a disparity map has one value per pixel")
    return disparity
