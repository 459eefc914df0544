"""Large arrays in a record, as aperture masks are: packed into one text, where each number would take twenty letters.

    {"type": "array", "shape": [H, W], "levels": 255, "zlib": "eJxj..."}

The text is base64 of zlib of the numbers, row by row, little-endian: uint8 or uint16, to be divided by `levels` (255 or
65535), where that gives exactly the array; else float64, and `levels` is null.
"""

import base64
import binascii
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError

TYPE = "array"
LARGE = 1024
"""Arrays of more numbers than this are packed; smaller ones are lists that a person can read."""
MOST = 4096 * 4096
"""Numbers that a packed array may have: as many as an aperture mask. More are lists."""
_DIMENSIONS = 4
_DTYPES: dict[int | None, str] = {255: "<u1", 65535: "<u2", None: "<f8"}


def pack(array: NDArray[Any]) -> dict[str, Any]:
    """An array of numbers, none of them NaN, as it stands in a record."""
    levels, numbers = _numbers(np.asarray(array, np.float64))
    body = base64.b64encode(zlib.compress(numbers.tobytes(), 9)).decode()
    return {"type": TYPE, "shape": list(array.shape), "levels": levels, "zlib": body}


def unpack(value: Mapping[str, Any]) -> NDArray[np.float64]:
    """The array back from `pack`'s answer, or InputError.

    >>> unpack(pack(np.array([[0.0, 1.0], [0.2, 0.25]])))
    array([[0.  , 1.  ],
           [0.2 , 0.25]])
    """
    shape, levels, body = value.get("shape"), value.get("levels"), value.get("zlib")
    if not (isinstance(shape, list) and 0 < len(shape) <= _DIMENSIONS and all(type(n) is int and n > 0 for n in shape)):
        raise InputError(f"an array's shape must be 1 to {_DIMENSIONS} positive whole numbers, got {str(shape)[:40]}")
    if not (levels is None or type(levels) is int) or levels not in _DTYPES or not isinstance(body, str):
        raise InputError('an array must have "levels" (255, 65535 or null) and "zlib" (a text)')
    dtype, count = np.dtype(_DTYPES[levels]), math.prod(shape)
    if count > MOST:
        raise InputError(f"an array of a record may have {MOST} numbers, got {count}")
    data = _inflated(body, count * dtype.itemsize)
    numbers = np.frombuffer(data, dtype).reshape(shape).astype(np.float64)
    if np.isnan(numbers).any():
        raise InputError("an array of a record is damaged (it holds NaN)")
    return numbers if levels is None else numbers / levels


def _numbers(array: NDArray[np.float64]) -> tuple[int | None, NDArray[Any]]:
    """The levels of the smallest exact form, and the numbers in it."""
    for levels in (255, 65535):
        whole = np.rint(array * levels)
        if ((whole >= 0) & (whole <= levels)).all() and np.array_equal(whole / levels, array):
            return levels, whole.astype(_DTYPES[levels])
    return None, array.astype(_DTYPES[None])


def _inflated(body: str, size: int) -> bytes:
    try:
        reader = zlib.decompressobj()
        data = reader.decompress(base64.b64decode(body, validate=True), size + 1)
    except (binascii.Error, ValueError, zlib.error) as error:
        raise InputError(f"an array of a record is damaged ({error})") from None
    if len(data) != size or not reader.eof or reader.unused_data:
        raise InputError(f"an array of a record is damaged (its shape asks for {size} bytes)")
    return data
