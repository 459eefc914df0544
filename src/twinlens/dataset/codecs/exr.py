"""OpenEXR: named float32 and integer channels, lossless, with string attributes.

Files have one scan-line part with ZIP compression, the smallest lossless method on truth maps
(benchmarks/bench_codecs.py).

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

from twinlens.dataset.files import read_bytes
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError

Plane = NDArray[np.float16] | NDArray[np.float32] | NDArray[np.uint32]

# Decoded pixels to bytes: the limit of DEFLATE, plus the headers of blocks.
_MAX_RATIO = 1100
# Of the string attributes.
_PREFIX = "twinlens."
_READING = threading.Lock()


@dataclass(frozen=True, eq=False)
class Exr:
    """Content of an EXR file: `channels`, name -> float32 or uint32 (H, W), and `text`, name -> string."""

    channels: Mapping[str, Plane]
    text: Mapping[str, str] = field(default_factory=dict)


def encode_exr(
    channels: Mapping[str, ArrayLike], text: Mapping[str, str] | None = None
) -> bytes:
    """Encode named (H, W) channels: floats as float16 or float32, booleans and integers as uint32, without loss.

    `text` becomes string attributes named ``twinlens.<name>``. Raises InputError when shapes differ, there is no
    channel, an integer is outside uint32, or a float64 is outside float32.
    """
    planes = {name: _to_plane(name, values) for name, values in channels.items()}
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) != 1:
        raise InputError(
            f"an EXR needs one or more channels of the same shape, got shapes {sorted(shapes)}"
        )
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
    }
    header |= {_PREFIX + name: value for name, value in (text or {}).items()}
    stream = io.BytesIO()
    OpenEXR.File(header, planes).write(stream)
    return stream.getvalue()


def decode_exr(data: bytes, name: str = "EXR data") -> Exr:
    """Decode an EXR with one part; half floats become float32. Raises FileError, whose message starts with `name`."""
    if data[:4] != b"\x76\x2f\x31\x01":
        raise FileError(f"{name}: not an OpenEXR file")
    header = _open(data, name, header_only=True).header
    low, high = header["dataWindow"]
    width, height = (int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
    count = len(header["channels"])
    # Checked before memory is allocated for the pixels.
    is_larger = width * height * count > _MAX_RATIO * len(data)
    if width < 1 or height < 1 or is_larger:
        size = f"{count} channels of {width} x {height} pixels"
        raise FileError(
            f"{name}: {len(data)} bytes cannot hold {size}; the file is damaged"
        )
    part = _open(data, name)
    channels = {key: channel.pixels for key, channel in sorted(part.channels.items())}
    if not channels or any(
        pixels is None or pixels.ndim != 2 for pixels in channels.values()
    ):
        raise FileError(f"{name}: has no readable channels; the file is damaged")
    planes = {
        key: plane if plane.dtype == np.uint32 else plane.astype(np.float32)
        for key, plane in channels.items()
    }
    text = {
        key.removeprefix(_PREFIX): value
        for key, value in part.header.items()
        if key.startswith(_PREFIX) and isinstance(value, str)
    }
    return Exr(planes, text)


def read_exr(path: Where) -> Exr:
    """Read the channels and text of an EXR file; see `decode_exr`. Raises FileError."""
    return decode_exr(read_bytes(path), str(path))


def _to_plane(name: str, values: ArrayLike) -> Plane:
    """float16, float32 or uint32 (H, W), contiguous: OpenEXR ignores the strides of a buffer."""
    array = np.asarray(values)
    if array.ndim != 2 or 0 in array.shape:
        raise InputError(
            f"EXR channel {name!r} must be (H, W), got shape {array.shape}"
        )
    if array.dtype.kind in "biu":
        if array.dtype.kind != "b" and (
            array.min() < 0 or array.max() > np.iinfo(np.uint32).max
        ):
            raise InputError(
                f"EXR channel {name!r} holds integers outside 0 to 2^32 - 1"
            )
        return np.ascontiguousarray(array, dtype=np.uint32)
    if array.dtype.kind != "f":
        raise InputError(f"EXR channel {name!r} must hold numbers, got {array.dtype}")
    if array.dtype == np.float16:
        return np.ascontiguousarray(array, dtype=np.float16)
    with np.errstate(over="ignore"):
        plane = np.ascontiguousarray(array, dtype=np.float32)
    if array.dtype.itemsize > 4 and np.isinf(plane).sum() != np.isinf(array).sum():
        raise InputError(f"EXR channel {name!r} holds numbers too large for float32")
    return plane


def _open(data: bytes, name: str, header_only: bool = False) -> Any:
    # OpenEXR prints errors in pixel data to sys.stdout, where a command prints its result: redirect them to stderr. The
    # lock keeps two threads from restoring each other's stream.
    with _READING, contextlib.redirect_stdout(sys.stderr):
        try:
            parts = OpenEXR.File(
                io.BytesIO(data), separate_channels=True, header_only=header_only
            ).parts
        # RuntimeError, ValueError, UnicodeDecodeError or MemoryError.
        except Exception as error:
            raise FileError(
                f"{name}: not a readable OpenEXR file; the file is damaged ({error})"
            ) from None
    if len(parts) != 1:
        raise FileError(f"{name}: needs exactly one readable part, has {len(parts)}")
    return parts[0]
