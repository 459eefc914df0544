"""Reading the files that users name: images of the usual kinds, disparity maps as PFM or 16-bit PNG."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import read_pfm, read_png
from twinlens.errors import FileError

_FORMATS = ["PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM"]  # all of Pillow's would include PostScript, run by Ghostscript


def read_image(path: Path) -> NDArray[Any]:
    """A uint8 or uint16 image, (H, W) or (H, W, 3): PNG, JPEG, TIFF, BMP, WebP or PPM. Raises FileError."""
    if path.suffix.lower() == ".png":
        return read_png(path)
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=_FORMATS) as image:
            return np.asarray(image.convert("L" if image.mode == "L" else "RGB"))
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, ValueError) as error:
        raise FileError(f"{path}: not an image that can be read ({error})") from None


def read_disparity(path: Path) -> NDArray[np.float32]:
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
