import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from twinlens.dataset.codecs.pfm import decode_pfm, encode_pfm, read_pfm, write_pfm
from twinlens.errors import FileError, InputError, OutputError

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
    assert_array_equal(back.view(np.uint32), array.view(np.uint32))


@pytest.mark.parametrize("color", [False, True])
def test_round_trip_with_opencv(tmp_path, color):
    rng = np.random.default_rng(0)
    array = rng.normal(size=(5, 8, 3) if color else (5, 8)).astype(np.float32)
    write_pfm(tmp_path / "ours.pfm", array)
    theirs = cv2.imread(str(tmp_path / "ours.pfm"), cv2.IMREAD_UNCHANGED)
    assert_array_equal(theirs[..., ::-1] if color else theirs, array)
    cv2.imwrite(str(tmp_path / "theirs.pfm"), array[..., ::-1] if color else array)
    assert_array_equal(read_pfm(tmp_path / "theirs.pfm"), array)


def test_both_byte_orders_are_read_bottom_up():
    rows = np.array([[1, 2, 3], [4, 5, np.inf]], np.float32)
    for order, scale in (("<f4", b"-1.0"), (">f4", b"1"), ("<f4", b"-0.003922")):
        data = b"Pf\n3 2\n" + scale + b"\n" + rows[::-1].astype(order).tobytes()
        assert_array_equal(decode_pfm(data), rows)


def test_nan_and_minus_infinity_are_rejected_in_both_directions():
    for bad in (np.nan, -np.inf):
        array = np.array([[1, bad]], np.float32)
        with pytest.raises(InputError, match="NaN or -inf"):
            encode_pfm(array)
        with pytest.raises(FileError, match=r"^a\.pfm: contains NaN or -inf"):
            decode_pfm(b"Pf\n2 1\n-1.0\n" + array.tobytes(), "a.pfm")


def test_invalid_headers_are_rejected(peak_below):
    for data in (
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
    ):
        with peak_below(1 << 20), pytest.raises(FileError, match=r"^x\.pfm: "):
            decode_pfm(data, "x.pfm")


HEADERS = (
    b"Pf\r\n7 5\r\n-1.0\r\n",
    b"Pf # grey\n# made by a program\n7 5\n#\n-1.0\n",
    b"Pf\n7 5\n-1.0 # little-endian\n",
    b"Pf\r\n# size\r\n7 # width\r\n5\r\n-1.0\r\n",
    b"Pf 7 5 -1.0 ",
)


def test_comments_and_crlf_are_read_and_truncation_is_still_rejected():
    # The first pixels are bytes that could be taken for a line end or a comment.
    pixels = b"\r\n\n#" + GOOD[-136:]
    expected = decode_pfm(b"Pf\n7 5\n-1.0\n" + pixels)
    for header in HEADERS:
        assert_array_equal(decode_pfm(header + pixels), expected)
        for wrong in (
            header + pixels[:-1],
            header + pixels + b"\0",
            header[:-1] + pixels,
        ):
            with pytest.raises(FileError):
                decode_pfm(wrong)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileError, match=r"nothing\.pfm: no such file"):
        read_pfm(tmp_path / "nothing.pfm")
    with pytest.raises(FileError, match="cannot be read"):
        read_pfm(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="is a file where a folder is needed"):
        write_pfm(tmp_path / "file" / "d.pfm", np.zeros((2, 2)))
