"""Reading the disparity maps that users name: PFM or 16-bit PNG."""

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import Place, read_pfm, read_png
from twinlens.errors import FileError


def read_disparity(path: Place) -> NDArray[np.float32]:
    """A disparity map, float32 (H, W), +inf unknown: a PFM, or KITTI's 16-bit PNG (256 d, 0 unknown)."""
    if path.suffix.lower() == ".png":
        stored = read_png(path)
        if stored.ndim != 2 or stored.dtype != np.uint16:
            raise FileError(f"{path}: a disparity PNG must be 16-bit grey (256 d, 0 unknown), as KITTI has it")
        return np.where(stored > 0, stored / np.float32(256), np.inf).astype(np.float32)
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        raise FileError(f"{path}: holds colours; a disparity map has one number a pixel")
    return disparity
