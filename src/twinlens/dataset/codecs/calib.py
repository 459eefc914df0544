"""calib.txt in a sample's folder, which may be in a bucket: the calibration of its rectified pair."""

from twinlens.calibrations.middlebury import (
    Calibration as Calibration,
    decode_calib as decode_calib,
    encode_calib as encode_calib,
    tidy as tidy,
)
from twinlens.dataset.files import read_text, write_file
from twinlens.dataset.storage import Where


def read_calib(path: Where) -> Calibration:
    """Read a calib.txt. Raises FileError."""
    return decode_calib(read_text(path), str(path))


def write_calib(path: Where, calibration: Calibration) -> None:
    """Write a calib.txt. Raises OutputError."""
    write_file(path, encode_calib(calibration).encode())
