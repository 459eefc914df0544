"""PFM, the portable float map: float32 images, in which Middlebury, ETH3D and SceneFlow store disparity maps.

Rows are stored bottom first; the scale's sign gives the byte order, and its magnitude is ignored. Comments (``# ...``)
and CRLF line ends are read, and never written. Unknown pixels are +inf; NaN and -inf are rejected in both directions.

Source: P. Debevec, http://www.pauldebevec.com/Research/HDR/PFM/; Middlebury stereo evaluation v3, its SDK's README.
"""

import contextlib
import math
import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.dataset.codecs.png import decode_png
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

_HEADER = re.compile(
    rb"(P[fF])#(\d{1,9})#(\d{1,9})#([-+0-9.eE]{1,32})".replace(
        b"#", rb"(?:\s|#[^\n]*\n)+"
    )
)
_LINE_END = re.compile(rb"[ \t]*(?:#[^\n]*)?\r?\n|[ \t]")
_HEADER_LIMIT = 1000
_INVALID = "contains NaN or -inf; unknown pixels must be +inf"


def encode_pfm(values: ArrayLike) -> bytes:
    """Encode `values`, (H, W) or (H, W, 3) real numbers or +inf, as little-endian PFM.

    Raises InputError for another shape, NaN, -inf, or a number too large for float32.

    >>> encode_pfm([[1.0, 2.0]])[:14]
    b'Pf\\n2 1\\n-1.0\\n\\x00\\x00'
    """
    source = np.asarray(values)
    if source.dtype.kind not in "fiub":
        raise InputError(f"a PFM holds real numbers, got an array of {source.dtype}")
    if (
        source.ndim not in (2, 3)
        or 0 in source.shape
        or (source.ndim == 3 and source.shape[2] != 3)
    ):
        raise InputError(
            f"a PFM holds (H, W) or (H, W, 3) values, got shape {source.shape}"
        )
    if not (source > -np.inf).all():
        raise InputError(f"PFM values: {_INVALID}")
    with np.errstate(over="ignore"):
        array = source.astype("<f4")
    if (
        source.dtype != np.float32
        and np.isposinf(array).sum() != np.isposinf(source).sum()
    ):
        raise InputError(
            "PFM values: a number is too large for float32; only +inf means unknown"
        )
    header = f"{'Pf' if array.ndim == 2 else 'PF'}\n{array.shape[1]} {array.shape[0]}\n-1.0\n".encode()
    return header + np.ascontiguousarray(array[::-1]).tobytes()


def decode_pfm(data: bytes, name: str = "PFM data") -> NDArray[np.float32]:
    """Decode a PFM to float32 (H, W) or (H, W, 3), top row first. Raises FileError, starting with `name`."""
    header = _HEADER.match(data[:_HEADER_LIMIT])
    if header is None:
        raise FileError(
            f"{name}: not a PFM (a line Pf or PF, a line 'width height', a line with the scale)"
        )
    width = int(header[2])
    height = int(header[3])
    channels = 3 if header[1] == b"PF" else 1
    size = 4 * width * height * channels
    start, scale = len(data) - size, 0.0
    if size < 1 or not _LINE_END.fullmatch(
        data, header.end(), max(start, header.end())
    ):
        raise FileError(
            f"{name}: {max(len(data) - header.end() - 1, 0)} bytes of pixels, but the header specifies {width} x"
            f" {height} x {channels} float32 ({size} bytes); the file is damaged"
        )
    with contextlib.suppress(ValueError):
        scale = float(header[4])
    if not (scale and math.isfinite(scale)):
        raise FileError(
            f"{name}: the scale must be a number other than 0 (negative: little-endian), got {header[4]!r}"
        )
    rows = np.frombuffer(data, "<f4" if scale < 0 else ">f4", offset=start).reshape(
        height, width, channels
    )
    array = rows[::-1].astype(np.float32)
    if not (array > -np.inf).all():
        raise FileError(f"{name}: {_INVALID}")
    return array if channels == 3 else array[..., 0]


def read_pfm(path: Where) -> NDArray[np.float32]:
    """Read a PFM file: float32 (H, W) or (H, W, 3), top row first, +inf unknown. Raises FileError."""
    return decode_pfm(read_bytes(path), str(path))


def read_disparity(path: Where) -> NDArray[np.float32]:
    """The disparity map of a file; see `decode_disparity`. Raises FileError."""
    return decode_disparity(read_bytes(path), str(path))


def decode_disparity(data: bytes, name: str) -> NDArray[np.float32]:
    """A disparity map, float32 (H, W), +inf unknown, from a PFM or a 16-bit PNG as KITTI's (256 d, 0 unknown).

    Raises FileError, whose message starts with the file's `name`, for a file that is neither.
    """
    if name.lower().endswith(".png"):
        codes = decode_png(data, name)
        if codes.ndim != 2 or codes.dtype != np.uint16:
            raise FileError(
                f"{name}: a disparity PNG must be 16-bit grey (256 d, 0 unknown), as KITTI's are"
            )
        return np.where(codes > 0, codes / np.float32(256), np.inf).astype(np.float32)
    disparity = decode_pfm(data, name)
    if disparity.ndim != 2:
        raise FileError(
            f"{name}: has colour channels; a disparity map has one value per pixel"
        )
    return disparity


def write_pfm(path: Where, values: ArrayLike) -> None:
    """Write `values` (H, W) or (H, W, 3) as a little-endian PFM. Raises InputError and OutputError."""
    write_file(path, encode_pfm(values))
