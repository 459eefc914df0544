import numpy as np
import OpenEXR
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from twinlens.dataset.codecs.exr import decode_exr, encode_exr, read_exr
from twinlens.errors import FileError, InputError
from twinlens.rendering.backends import mitsuba

shapes = st.tuples(st.integers(1, 40), st.integers(1, 9))
PLANE = np.arange(40 * 30, dtype=np.float32).reshape(40, 30)
GOOD = encode_exr(
    {"depth": PLANE, "id": PLANE.astype(np.int32)}, {"names": "wall\nball"}
)


@given(hnp.arrays(np.float32, shapes), hnp.arrays(np.uint32, st.just((3, 5))))
def test_channels_read_back_bit_for_bit(floats, integers):
    back = decode_exr(encode_exr({"z": floats}))
    assert_array_equal(back.channels["z"].view(np.uint32), floats.view(np.uint32))
    ids = decode_exr(
        encode_exr({"position.X": integers.astype(np.float32), "id": integers})
    ).channels["id"]
    assert ids.dtype == np.uint32
    assert_array_equal(ids, integers)


def test_types():
    views = {
        "double": PLANE.astype(np.float64),
        "bool": PLANE > 7,
        "byte": PLANE.astype(np.uint8)[::-1],
        "long": PLANE.astype(np.int64),
    }
    back = decode_exr(encode_exr(views)).channels
    assert list(back) == sorted(views)
    for name, view in views.items():
        assert back[name].dtype == (np.float32 if view.dtype.kind == "f" else np.uint32)
        assert_array_equal(back[name], view)


def test_text_round_trip_and_equal_bytes():
    assert decode_exr(GOOD).text == {"names": "wall\nball"}
    again = {"depth": np.asfortranarray(PLANE), "id": PLANE.astype(np.uint32)}
    assert encode_exr(again, {"names": "wall\nball"}) == GOOD


def test_mitsuba_reads_it(tmp_path):
    pytest.importorskip("mitsuba")
    mi = mitsuba()
    (tmp_path / "t.exr").write_bytes(encode_exr({"depth": PLANE, "normal.X": -PLANE}))
    bitmap = mi.Bitmap(str(tmp_path / "t.exr"))
    names, pixels = [field.name for field in bitmap.struct_()], np.array(bitmap)
    assert_array_equal(pixels[..., names.index("depth")], PLANE)
    assert_array_equal(pixels[..., names.index("normal.X")], -PLANE)


def test_half_floats_become_float32(tmp_path):
    half = PLANE.astype(np.float16)
    OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION}, {"R": half}).write(
        str(tmp_path / "h.exr")
    )
    back = read_exr(tmp_path / "h.exr").channels["R"]
    assert back.dtype == np.float32
    assert_array_equal(back, half)


def test_unsupported_channels_are_rejected():
    for channels in (
        {},
        {"a": PLANE, "b": PLANE[1:]},
        {"a": np.array([["x"]])},
    ):
        with pytest.raises(InputError, match="EXR"):
            encode_exr(channels)


def test_a_small_file_with_a_large_header_allocates_no_memory(peak_below):
    place = GOOD.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    for corner in (1_000_000, 2_000_000_000, -5):
        huge = (
            GOOD[:place]
            + np.array([0, 0, corner, corner], "<i4").tobytes()
            + GOOD[place + 16 :]
        )
        with peak_below(1 << 22), pytest.raises(FileError):
            decode_exr(huge)


def test_damage_prints_nothing_to_stdout(capfd):
    data = bytearray(GOOD)
    data[-40] ^= 255
    with pytest.raises(FileError):
        decode_exr(bytes(data))
    assert capfd.readouterr().out == ""
