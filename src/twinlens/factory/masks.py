"""An aperture drawn as a picture: a coded aperture, a dirty lens."""

from pathlib import Path

import numpy as np

from twinlens.camera import MaskAperture
from twinlens.dataset import read_image
from twinlens.errors import FileError, InputError


def read_mask(path: Path) -> MaskAperture:
    """The aperture that a grey picture draws: white is open, black is shut, row 0 the top. Raises FileError."""
    mask = read_image(path)
    if mask.ndim == 3:
        if not (mask == mask[..., :1]).all():
            raise FileError(f"{path}: is coloured; an aperture mask is a grey picture, white where light passes")
        mask = mask[..., 0]
    try:
        return MaskAperture(np.ascontiguousarray(mask))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
