import io
import struct
import zlib

import cv2
import numpy as np
import pytest
import skimage.io
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal
from PIL import Image

from twinlens.dataset.codecs.png import decode_png, encode_png, read_png, write_png
from twinlens.errors import FileError

shapes = st.tuples(st.integers(1, 9), st.integers(1, 9)) | st.tuples(
    st.integers(1, 9), st.integers(1, 9), st.just(3)
)
rng = np.random.default_rng(1)
GOOD = encode_png(rng.integers(0, 256, (6, 5, 3), np.uint8))
GOOD_16 = encode_png(rng.integers(0, 65536, (6, 5, 3), np.uint16))


def by_opencv(data):
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return image[..., ::-1] if image.ndim == 3 else image


@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]), shapes))
def test_round_trip_with_our_reader_and_opencv(array):
    data = encode_png(array)
    for back in (decode_png(data), by_opencv(data)):
        assert back.dtype == array.dtype
        assert_array_equal(back, array)


@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]), shapes))
def test_we_read_what_opencv_writes(array):
    data = cv2.imencode(".png", array[..., ::-1] if array.ndim == 3 else array)[
        1
    ].tobytes()
    assert_array_equal(decode_png(data), array)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_smooth_images_use_every_branch_of_the_filter(dtype):
    v, u = np.mgrid[:40, :50]
    array = np.stack([3 * u, 2 * v + u, (u - v) ** 2], axis=-1).astype(dtype)
    assert_array_equal(by_opencv(encode_png(array)), array)


def test_skimage_and_pillow_read_it(tmp_path):
    array = rng.integers(0, 256, (7, 4, 3), np.uint8)
    write_png(tmp_path / "a.png", array)
    assert_array_equal(skimage.io.imread(tmp_path / "a.png"), array)
    assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), array)
    assert_array_equal(read_png(tmp_path / "a.png"), array)


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA"])
def test_other_color_types_are_converted(mode):
    colour = (255,) if mode in "1L" else (204, 102, 51)
    picture = Image.new("RGB", (3, 2), colour * (3 // len(colour)))
    stream = io.BytesIO()
    picture.convert(mode).save(stream, "PNG")
    image = decode_png(stream.getvalue()).reshape(3 * 2, -1)
    assert image.tolist() == [list(colour)] * 6


@pytest.mark.parametrize("sixteen", [False, True])
def test_transparency_is_rejected(sixteen):
    array = np.zeros((2, 2, 4), np.uint16 if sixteen else np.uint8)
    data = cv2.imencode(".png", array)[1].tobytes()
    with pytest.raises(FileError, match="alpha channel"):
        decode_png(data)


def header_only(width, height):
    body = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunk = (
        struct.pack(">I", 13)
        + b"IHDR"
        + body
        + struct.pack(">I", zlib.crc32(b"IHDR" + body))
    )
    return GOOD[:8] + chunk + GOOD[33:]


def test_a_small_file_with_a_large_header_allocates_no_memory(peak_below):
    for size in ((60000, 60000), (8000, 8000), (0, 5), (2**31, 2**31)):
        with peak_below(1 << 20), pytest.raises(FileError, match=r"^big\.png: "):
            decode_png(header_only(*size), "big.png")


def test_every_flipped_bit_is_rejected():
    for good in (GOOD, GOOD_16):
        for place in range(len(good)):
            changed = bytearray(good)
            changed[place] ^= 1
            with pytest.raises(FileError):
                decode_png(bytes(changed))
