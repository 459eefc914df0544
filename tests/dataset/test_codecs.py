"""The laws of all codecs: equal arrays give equal bytes, and damaged files are errors that allocate little memory.

The files of single formats have what is special to them, and compare with other libraries.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_array_equal

from tests.dataset.dataset_damage import damaged
from twinlens.dataset.codecs.exr import decode_exr, encode_exr
from twinlens.dataset.codecs.pfm import decode_pfm, encode_pfm
from twinlens.dataset.codecs.png import decode_png, encode_png
from twinlens.errors import FileError, InputError, TwinlensError

RNG = np.random.default_rng(1)
PLANE = np.arange(20 * 15, dtype=np.float32).reshape(20, 15)


@dataclass(frozen=True)
class Codec:
    """A format: an array that it holds, others that it does not, and the most bytes of pixels for a byte of a file."""

    encode: Callable[[Any], bytes]
    decode: Callable[..., Any]
    array: Any
    unsupported: tuple[Any, ...]
    most: int

    @property
    def good(self):
        return self.encode(self.array)


CODECS = {
    "exr": Codec(
        lambda array: encode_exr({"z": array}),
        lambda *given: decode_exr(*given).channels["z"],
        PLANE,
        (
            PLANE[0],
            np.zeros((0, 4), np.float32),
            np.array([[-1]]),
            np.array([[1 << 32]]),
            np.array([[1e39]]),
        ),
        4 * 1100,
    ),
    "pfm": Codec(
        encode_pfm,
        decode_pfm,
        PLANE[:5, :7],
        (
            np.zeros(3),
            np.zeros((2, 2, 2)),
            np.zeros((0, 3)),
            np.array([["a"]]),
            np.array([[1j]]),
            np.array([[1e39]]),
            np.array([[1, np.nan]]),
            np.array([[1, -np.inf]]),
        ),
        1,
    ),
    "png of 8 bits": Codec(
        encode_png,
        decode_png,
        RNG.integers(0, 256, (6, 5, 3), np.uint8),
        (
            np.zeros((2, 2)),
            np.zeros((2, 2), np.int32),
            np.zeros((2, 2, 4), np.uint8),
            np.zeros((0, 2), np.uint8),
            np.broadcast_to(np.uint8(0), (10_000, 10_000)),
        ),
        2 * 1032,
    ),
    "png of 16 bits": Codec(
        encode_png, decode_png, RNG.integers(0, 65536, (6, 5, 3), np.uint16), (), 2064
    ),
}
each_codec = pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS.keys())


@each_codec
def test_strides_and_byte_order_do_not_matter(codec):
    array = codec.array
    for view in (
        array[::-1, ::-1],
        np.swapaxes(array, 0, 1),
        array[::2, 1::2],
        array.astype(array.dtype.newbyteorder(">")),
        np.asfortranarray(array),
        np.broadcast_to(array[:1, :1], array.shape),
    ):
        assert_array_equal(codec.decode(codec.encode(view)), view)
        contiguous = np.ascontiguousarray(view, array.dtype)
        assert codec.encode(view) == codec.encode(contiguous)


@each_codec
def test_unsupported_arrays_are_rejected(codec):
    for array in codec.unsupported:
        with pytest.raises(InputError):
            codec.encode(array)


@each_codec
def test_every_truncation_is_rejected(codec):
    good = codec.good
    for length in range(len(good)):
        with pytest.raises(FileError, match=r"^name\.x: "):
            codec.decode(good[:length], "name.x")


@each_codec
@settings(max_examples=150)
@given(data=st.data())
def test_damaged_files_are_read_or_rejected(codec, data):
    file = data.draw(damaged(codec.good))
    try:
        array = codec.decode(file)
    except (TwinlensError, KeyError):
        return
    assert array.nbytes <= codec.most * len(file)
