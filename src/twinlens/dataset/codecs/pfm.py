"""PFM, the portable float map: disparity maps as Middlebury, ETH3D and SceneFlow keep them.

Three header lines (``Pf`` or ``PF``, ``width height``, scale), then float32 rows from the bottom up. The sign of the
scale tells the byte order, negative for little-endian; its size is kept by nobody (Middlebury writes 0.0039) and has no
meaning here. Unknown is +inf; NaN and -inf are refused in both directions.

Source: P. Debevec, http://www.pauldebevec.com/Research/HDR/PFM/; Middlebury stereo evaluation v3, its SDK's README.
"""

import math
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

_HEADER = re.compile(rb"(P[fF])\s+(\d{1,9})\s+(\d{1,9})\s+([-+0-9.eE]{1,32})\s")
_HEADER_LIMIT = 128


def encode_pfm(values: ArrayLike) -> bytes:
    """A little-endian PFM of `values` (H, W) or (H, W, 3): real numbers or +inf, kept as float32.

    Raises InputError for another shape, NaN, -inf, or a number too large for float32.

    >>> encode_pfm([[1.0, 2.0]])[:14]
    b'Pf\\n2 1\\n-1.0\\n\\x00\\x00'
    """
    array = _as_float32(values)
    if array.ndim not in (2, 3) or 0 in array.shape or (array.ndim == 3 and array.shape[2] != 3):
        raise InputError(f"a PFM holds (H, W) or (H, W, 3) values, got shape {array.shape}")
    kind = "Pf" if array.ndim == 2 else "PF"
    header = f"{kind}\n{array.shape[1]} {array.shape[0]}\n-1.0\n".encode()
    return header + np.ascontiguousarray(array[::-1]).tobytes()


def decode_pfm(data: bytes, name: str = "PFM data") -> NDArray[np.float32]:
    """The values of a PFM, float32 (H, W) or (H, W, 3), top row first. Raises FileError beginning with `name`."""
    header = _HEADER.match(data[:_HEADER_LIMIT])
    if header is None:
        raise FileError(f"{name}: not a PFM (a line Pf or PF, a line 'width height', a line with the scale)")
    width, height = int(header[2]), int(header[3])
    channels = 3 if header[1] == b"PF" else 1
    body = memoryview(data)[header.end() :]
    if width < 1 or height < 1 or len(body) != 4 * width * height * channels:
        raise FileError(
            f"{name}: {len(body)} bytes of pixels, but its header says {width} x {height} x {channels} float32"
            f" ({4 * width * height * channels} bytes); the file is damaged"
        )
    rows = np.frombuffer(body, dtype=_byte_order(header[4], name)).reshape(height, width, channels)
    array = rows[::-1].astype(np.float32)
    _refuse_nan(array, name, FileError)
    return array if channels == 3 else array[..., 0]


def read_pfm(path: Where) -> NDArray[np.float32]:
    """The values of a PFM file, float32 (H, W) or (H, W, 3), top row first; +inf is unknown. Raises FileError."""
    return decode_pfm(read_bytes(path), str(path))


def write_pfm(path: Where, values: ArrayLike) -> None:
    """Write `values` (H, W) or (H, W, 3) as a little-endian PFM. Raises InputError and OutputError."""
    write_file(path, encode_pfm(values))


def _byte_order(scale: bytes, name: str) -> str:
    try:
        value = float(scale)
    except ValueError:
        value = math.nan
    if value == 0 or not math.isfinite(value):
        raise FileError(f"{name}: the scale must be a number other than 0 (negative: little-endian), got {scale!r}")
    return "<f4" if value < 0 else ">f4"


def _as_float32(values: ArrayLike) -> NDArray[np.float32]:
    given = np.asarray(values)
    if given.dtype.kind not in "fiub":
        raise InputError(f"a PFM holds real numbers, got an array of {given.dtype}")
    _refuse_nan(given, "PFM values", InputError)
    with np.errstate(over="ignore"):
        array = given.astype("<f4")
    if given.dtype != np.float32 and np.isposinf(array).sum() != np.isposinf(given).sum():
        raise InputError("PFM values: a number is too large for float32; +inf alone means unknown")
    return array


def _refuse_nan(array: NDArray[Any], name: str, error: type[InputError]) -> None:
    if array.dtype.kind == "f" and not (array > -np.inf).all():
        raise error(f"{name}: holds NaN or -inf; +inf is the one mark for unknown")
