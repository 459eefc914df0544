"""The file formats of a sample, one module each: bytes to arrays and back, nothing about stereo.

Every codec is a pair of pure functions (`encode_*`, `decode_*`, the same input gives the same bytes) and a pair that
touches the disk (`read_*`, `write_*`). A reader answers a damaged file with FileError, and never asks for much more
memory than an honest file of that length could fill.
"""

from twinlens.dataset.codecs.calib import Calibration, decode_calib, encode_calib, read_calib, write_calib
from twinlens.dataset.codecs.exr import Exr, decode_exr, encode_exr, read_exr, write_exr
from twinlens.dataset.codecs.image import read_image
from twinlens.dataset.codecs.pfm import decode_pfm, encode_pfm, read_pfm, write_pfm
from twinlens.dataset.codecs.png import decode_png, encode_png, read_png, write_png

__all__ = [
    "Calibration",
    "Exr",
    "decode_calib",
    "decode_exr",
    "decode_pfm",
    "decode_png",
    "encode_calib",
    "encode_exr",
    "encode_pfm",
    "encode_png",
    "read_calib",
    "read_exr",
    "read_image",
    "read_pfm",
    "read_png",
    "write_calib",
    "write_exr",
    "write_pfm",
    "write_png",
]
