"""OpenEXR: named float32 and integer channels without loss, and text beside them.

One scan-line part, ZIP-compressed: of the lossless methods the smallest on truth maps, and as quick to write as any
that compresses them well (benchmarks/bench_codecs.py). The bytes depend on the channels and the text only.

Source: Technical Introduction to OpenEXR, https://openexr.com/en/latest/TechnicalIntroduction.html.
"""

import contextlib
import io
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

Channel = NDArray[np.float32] | NDArray[np.uint32]

_MAGIC = b"\x76\x2f\x31\x01"
_LARGEST_RATIO = 1100  # of pixels to file, in bytes: what DEFLATE can reach, and a little for the blocks' headers
_OWN = "twinlens."  # prefix of the text attributes
_READING = threading.Lock()


@dataclass(frozen=True, eq=False)
class Exr:
    """What an EXR file holds: `channels`, name -> float32 or uint32 (H, W), and `text`, name -> string."""

    channels: Mapping[str, Channel]
    text: Mapping[str, str] = field(default_factory=dict)


def encode_exr(channels: Mapping[str, ArrayLike], text: Mapping[str, str] | None = None) -> bytes:
    """An EXR of named (H, W) channels: floats are kept as float32, booleans and integers as uint32, all without loss.

    `text` becomes string attributes named ``twinlens.<name>``. Raises InputError when shapes differ, there is no
    channel, an integer does not fit, or a float64 lies outside float32's range.
    """
    if not channels:
        raise InputError("an EXR needs one channel or more")
    planes = {name: _storable(name, values) for name, values in channels.items()}
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) > 1:
        raise InputError(f"the channels of an EXR must be of one shape, got {sorted(shapes)}")
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {_OWN + name: value for name, value in (text or {}).items()}
    stream = io.BytesIO()
    OpenEXR.File(header, planes).write(stream)
    return stream.getvalue()


def decode_exr(data: bytes, name: str = "EXR data") -> Exr:
    """The channels of a one-part EXR, half floats widened to float32. Raises FileError beginning with `name`."""
    if data[:4] != _MAGIC:
        raise FileError(f"{name}: not an OpenEXR file")
    _check_size(_opened(data, name, header_only=True), len(data), name)
    part = _opened(data, name)
    channels = {key: _plane(channel.pixels) for key, channel in sorted(part.channels.items())}
    if not channels or any(plane is None or plane.ndim != 2 for plane in channels.values()):
        raise FileError(f"{name}: has no readable channels; the file is damaged")
    text = {
        key.removeprefix(_OWN): value
        for key, value in part.header.items()
        if key.startswith(_OWN) and isinstance(value, str)
    }
    return Exr(channels, text)


def read_exr(path: Where) -> Exr:
    """The channels and text of an EXR file; see `decode_exr`. Raises FileError."""
    return decode_exr(read_bytes(path), str(path))


def write_exr(path: Where, channels: Mapping[str, ArrayLike], text: Mapping[str, str] | None = None) -> None:
    """Write named (H, W) channels; see `encode_exr`. Raises InputError and OutputError."""
    write_file(path, encode_exr(channels, text))


def _storable(name: str, values: ArrayLike) -> Channel:
    array = np.asarray(values)
    if array.ndim != 2 or 0 in array.shape:
        raise InputError(f"EXR channel {name!r} must be (H, W), got shape {array.shape}")
    # OpenEXR reads the buffer from its start, whatever the strides say.
    if array.dtype.kind in "biu":
        if array.dtype.kind != "b" and (array.min() < 0 or array.max() > np.iinfo(np.uint32).max):
            raise InputError(f"EXR channel {name!r} holds integers outside 0 to 2^32 - 1")
        return np.ascontiguousarray(array, dtype=np.uint32)
    if array.dtype.kind != "f":
        raise InputError(f"EXR channel {name!r} must hold numbers, got {array.dtype}")
    with np.errstate(over="ignore"):
        plane = np.ascontiguousarray(array, dtype=np.float32)
    if array.dtype.itemsize > 4 and np.isinf(plane).sum() != np.isinf(array).sum():
        raise InputError(f"EXR channel {name!r} holds numbers too large for float32")
    return plane


def _plane(pixels: Any) -> Any:
    return pixels if pixels is None or pixels.dtype == np.uint32 else pixels.astype(np.float32)


def _opened(data: bytes, name: str, header_only: bool = False) -> Any:
    # OpenEXR reports damaged pixels by a line on sys.stdout, where a command's answer belongs: send it to stderr. The
    # lock keeps two threads from restoring each other's stream.
    with _READING, contextlib.redirect_stdout(sys.stderr):
        try:
            file = OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=header_only)
            parts = file.parts
        # RuntimeError, ValueError, UnicodeDecodeError, MemoryError: by where the damage lies.
        except Exception as error:
            raise FileError(f"{name}: not a readable OpenEXR file; the file is damaged ({error})") from None
    if len(parts) != 1:
        raise FileError(f"{name}: needs exactly one readable part, has {len(parts)}")
    return parts[0]


def _check_size(part: Any, length: int, name: str) -> None:
    """Refuse, before memory is asked for, sizes that the file cannot fill."""
    low, high = part.header["dataWindow"]
    width, height = (int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
    channels = len(part.header["channels"])
    if width < 1 or height < 1 or width * height * channels > _LARGEST_RATIO * length:
        raise FileError(
            f"{name}: {length} bytes cannot hold {channels} channels of {width} x {height} pixels; the file is damaged"
        )
