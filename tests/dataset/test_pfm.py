import re

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from tests.dataset.dataset_damage import damaged
from twinlens.dataset.codecs.pfm import decode_pfm, encode_pfm, read_pfm, write_pfm
from twinlens.errors import FileError, InputError, OutputError, TwinlensError

values = st.floats(width=32, allow_nan=False, allow_infinity=False) | st.just(np.inf)
shapes = st.tuples(st.integers(1, 9), st.integers(1, 9)) | st.tuples(
    st.integers(1, 5), st.integers(1, 5), st.just(3)
)
GOOD = encode_pfm(np.arange(35, dtype=np.float32).reshape(5, 7))


@given(hnp.arrays(np.float32, shapes, elements=values))
def test_round_trip_is_bit_exact(array):
    back = decode_pfm(encode_pfm(array))
    assert back.dtype == np.float32
    assert back.flags.c_contiguous
    assert back.flags.writeable
    np.testing.assert_array_equal(back.view(np.uint32), array.view(np.uint32))


@given(
    hnp.arrays(
        np.float32, st.tuples(st.integers(2, 9), st.integers(2, 9)), elements=values
    )
)
def test_strides_and_byte_order_of_the_array_do_not_matter(array):
    for view in (
        array[::-1, ::-1],
        array.T,
        array[::2, 1::2],
        array.astype(">f4"),
        array.astype(np.float64),
    ):
        np.testing.assert_array_equal(
            decode_pfm(encode_pfm(view)), np.array(view, np.float32)
        )


@pytest.mark.parametrize("color", [False, True])
def test_round_trip_with_opencv(tmp_path, color):
    rng = np.random.default_rng(0)
    array = rng.normal(size=(5, 8, 3) if color else (5, 8)).astype(np.float32)
    write_pfm(tmp_path / "ours.pfm", array)
    theirs = cv2.imread(str(tmp_path / "ours.pfm"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(theirs[..., ::-1] if color else theirs, array)
    cv2.imwrite(str(tmp_path / "theirs.pfm"), array[..., ::-1] if color else array)
    np.testing.assert_array_equal(read_pfm(tmp_path / "theirs.pfm"), array)


def test_both_byte_orders_are_read_bottom_up():
    rows = np.array([[1, 2, 3], [4, 5, np.inf]], np.float32)
    for order, scale in (("<f4", b"-1.0"), (">f4", b"1"), ("<f4", b"-0.003922")):
        data = b"Pf\n3 2\n" + scale + b"\n" + rows[::-1].astype(order).tobytes()
        np.testing.assert_array_equal(decode_pfm(data), rows)


def test_the_header_suits_torchvision():
    # torchvision splits the header by lines and matches the second with this expression.
    first, second, third, body = GOOD.split(b"\n", 3)
    assert first == b"Pf"
    assert re.match(rb"^(\d+)\s(\d+)\s$", second + b"\n").groups() == (b"7", b"5")
    assert float(third.rstrip()) == -1.0
    assert np.frombuffer(body[:4], "<f4")[0] == 28.0


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_nan_and_minus_infinity_are_rejected_in_both_directions(bad):
    array = np.array([[1, bad]], np.float32)
    with pytest.raises(InputError, match="NaN or -inf"):
        encode_pfm(array)
    with pytest.raises(FileError, match=r"^a\.pfm: contains NaN or -inf"):
        decode_pfm(b"Pf\n2 1\n-1.0\n" + array.tobytes(), "a.pfm")


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(3),
        np.zeros((2, 2, 2)),
        np.zeros((0, 3)),
        np.array([["a"]]),
        np.array([[1j]]),
        np.array([[1e39]]),
    ],
)
def test_unsupported_arrays_are_rejected(array):
    with pytest.raises(InputError):
        encode_pfm(array)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"Pf",
        b"P5\n2 2\n255\n1234",
        b"Pf\n-2 2\n-1\n" + bytes(16),
        b"Pf\n0 2\n-1\n",
        b"Pf\n999999999 999999999\n-1\n" + bytes(16),
        b"Pf\n2 2\n0\n" + bytes(16),
        b"Pf\n2 2\n-e\n" + bytes(16),
        b"Pf\n2 2\n-1e999\n" + bytes(16),
        b"Pf\n" + b" " * 1000 + b"2 2\n-1\n" + bytes(16),
    ],
)
def test_invalid_headers_are_rejected(data, peak_below):
    with peak_below(1 << 20), pytest.raises(FileError, match=r"^x\.pfm: "):
        decode_pfm(data, "x.pfm")


@pytest.mark.parametrize("length", range(len(GOOD)))
def test_every_truncation_is_rejected(length):
    with pytest.raises(FileError):
        decode_pfm(GOOD[:length])


HEADERS = {
    "crlf": b"Pf\r\n7 5\r\n-1.0\r\n",
    "comments": b"Pf # grey\n# made by a program\n7 5\n#\n-1.0\n",
    "comment after the scale": b"Pf\n7 5\n-1.0 # little-endian\n",
    "crlf and comments": b"Pf\r\n# size\r\n7 # width\r\n5\r\n-1.0\r\n",
    "spaces": b"Pf 7 5 -1.0 ",
}


@pytest.mark.parametrize("kind", HEADERS)
def test_comments_and_crlf_are_read_and_truncation_is_still_rejected(kind):
    # The first pixels are bytes that could be taken for a line end or a comment.
    pixels = b"\r\n\n#" + GOOD[-136:]
    expected = decode_pfm(b"Pf\n7 5\n-1.0\n" + pixels)
    np.testing.assert_array_equal(decode_pfm(HEADERS[kind] + pixels), expected)
    for wrong in (
        HEADERS[kind] + pixels[:-1],
        HEADERS[kind] + pixels + b"\0",
        HEADERS[kind][:-1] + pixels,
    ):
        with pytest.raises(FileError):
            decode_pfm(wrong)


@given(damaged(GOOD))
def test_damaged_files_are_read_or_rejected(data):
    try:
        array = decode_pfm(data)
    except TwinlensError:
        return
    assert array.nbytes <= len(data)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileError, match=r"nothing\.pfm: no such file"):
        read_pfm(tmp_path / "nothing.pfm")
    with pytest.raises(FileError, match="cannot be read"):
        read_pfm(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="is a file where a folder is needed"):
        write_pfm(tmp_path / "file" / "d.pfm", np.zeros((2, 2)))
