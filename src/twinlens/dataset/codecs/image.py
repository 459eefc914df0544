"""Reading images that users name, of the usual kinds."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.png import read_png
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
