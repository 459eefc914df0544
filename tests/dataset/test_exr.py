import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from tests.dataset.dataset_damage import damaged
from twinlens.dataset.codecs.exr import decode_exr, encode_exr, read_exr
from twinlens.errors import FileError, InputError, TwinlensError
from twinlens.rendering.backends import mitsuba

shapes = st.tuples(st.integers(1, 40), st.integers(1, 9))
PLANE = np.arange(40 * 30, dtype=np.float32).reshape(40, 30)
GOOD = encode_exr(
    {"depth": PLANE, "id": PLANE.astype(np.int32)}, {"names": "wall\nball"}
)


@given(hnp.arrays(np.float32, shapes), hnp.arrays(np.uint32, st.just((3, 5))))
def test_channels_read_back_bit_for_bit(floats, integers):
    back = decode_exr(encode_exr({"z": floats}))
    np.testing.assert_array_equal(
        back.channels["z"].view(np.uint32), floats.view(np.uint32)
    )
    ids = decode_exr(
        encode_exr({"position.X": integers.astype(np.float32), "id": integers})
    ).channels["id"]
    assert ids.dtype == np.uint32
    np.testing.assert_array_equal(ids, integers)


def test_strides_byte_order_and_types():
    views = {
        "back": PLANE[::-1, ::-1],
        "big": PLANE.astype(">f4"),
        "double": PLANE.astype(np.float64),
        "broadcast": np.broadcast_to(np.float32(3), PLANE.shape),
        "bool": PLANE > 7,
        "byte": PLANE.astype(np.uint8)[::-1],
        "long": PLANE.astype(np.int64),
    }
    back = decode_exr(encode_exr(views)).channels
    assert list(back) == sorted(views)
    for name, view in views.items():
        assert back[name].dtype == (np.float32 if view.dtype.kind == "f" else np.uint32)
        np.testing.assert_array_equal(back[name], view)


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
    np.testing.assert_array_equal(pixels[..., names.index("depth")], PLANE)
    np.testing.assert_array_equal(pixels[..., names.index("normal.X")], -PLANE)


def test_half_floats_become_float32(tmp_path):
    half = PLANE.astype(np.float16)
    OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION}, {"R": half}).write(
        str(tmp_path / "h.exr")
    )
    back = read_exr(tmp_path / "h.exr").channels["R"]
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, half)


@pytest.mark.parametrize(
    "channels",
    [
        {},
        {"a": PLANE, "b": PLANE[1:]},
        {"a": PLANE[0]},
        {"a": np.zeros((0, 4))},
        {"a": np.array([[-1]])},
        {"a": np.array([[1 << 32]])},
        {"a": np.array([[1e39]])},
        {"a": np.array([["x"]])},
    ],
)
def test_unsupported_channels_are_rejected(channels):
    with pytest.raises(InputError, match="EXR"):
        encode_exr(channels)


@pytest.mark.parametrize("length", range(0, len(GOOD), 7))
def test_every_truncation_is_rejected(length):
    with pytest.raises(FileError, match=r"^t\.exr: "):
        decode_exr(GOOD[:length], "t.exr")


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


@settings(max_examples=200)
@given(damaged(GOOD))
def test_damaged_files_are_read_or_rejected(data):
    try:
        image = decode_exr(data)
    except TwinlensError:
        return
    assert sum(plane.nbytes for plane in image.channels.values()) <= 4 * 1100 * len(
        data
    )


def test_damage_prints_nothing_to_stdout(capfd):
    data = bytearray(GOOD)
    data[-40] ^= 255
    with pytest.raises(FileError):
        decode_exr(bytes(data))
    assert capfd.readouterr().out == ""
