"""Reading images that users name, of the usual kinds."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.png import read_png
from twinlens.errors import FileError

_COLOURS = {"1": "L", "L": "L", "P": "RGB", "RGB": "RGB", "YCbCr": "RGB", "CMYK": "RGB"}
_DEEP = ("I;16", "I;16B", "I")
_FORMATS = ["PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM"]  # all of Pillow's would include PostScript, run by Ghostscript


def read_image(path: Path) -> NDArray[Any]:
    """A uint8 or uint16 image, (H, W) or (H, W, 3): PNG, JPEG, TIFF, BMP, WebP or PPM.

    Raises FileError for a file that holds no such image, or one of another kind: with alpha, or of floats.
    """
    if path.suffix.lower() == ".png":
        return read_png(path)
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=_FORMATS) as image:
            if image.mode in _COLOURS:
                return np.asarray(image.convert(_COLOURS[image.mode]))
            deep = np.asarray(image) if image.mode in _DEEP else None
            if deep is None or deep.min() < 0 or deep.max() > np.iinfo(np.uint16).max:
                raise FileError(f"{path}: an image of mode {image.mode}; save it as PNG, grey or RGB, without alpha")
            return deep.astype(np.uint16)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, ValueError) as error:
        raise FileError(f"{path}: not an image that can be read ({error})") from None
