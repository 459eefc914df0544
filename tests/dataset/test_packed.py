"""Packed arrays of records: exact round trip, size, and damage."""

import base64
import json
import zlib

import numpy as np
import pytest

from twinlens.camera import MaskAperture, ThinLens
from twinlens.dataset.record import (
    LENS,
    PACKED_ABOVE,
    encode_json,
    pack,
    plain,
    read,
    unpack,
)
from twinlens.errors import InputError

SIDE = 256


def lens_from_plain(value):
    return read(LENS, value, "sample.json", "lens")


random = np.random.default_rng(4)
MASKS = {
    "binary": random.random((SIDE, SIDE)) < 0.5,
    "grey": random.integers(0, 256, (SIDE, SIDE), np.uint8),
    "fine": random.integers(0, 65536, (SIDE, SIDE), np.uint16),
    "any": random.random((SIDE, SIDE)),
}
# Bytes per cell, times 4/3 for base64; a list of decimals needs 20 bytes per cell.
BYTES_PER_CELL = {"binary": 0.3, "grey": 1.4, "fine": 2.7, "any": 10.7}


@pytest.mark.parametrize("kind", MASKS)
def test_large_masks_read_back_equal_and_are_small(kind):
    lens = ThinLens(0.01, 2.0, MaskAperture(MASKS[kind]))
    text = encode_json({"lens": lens})
    assert len(text) < BYTES_PER_CELL[kind] * SIDE**2 + 500
    back = lens_from_plain(json.loads(text)["lens"])
    assert back == lens
    assert back.aperture.digest == lens.aperture.digest


def test_small_masks_and_whole_numbers_stay_readable():
    assert plain(MaskAperture([[0.0, 0.5], [1.0, 0.25]]))["mask"] == [
        [0.0, 0.5],
        [1.0, 0.25],
    ]
    assert plain(np.arange(PACKED_ABOVE + 1)) == list(range(PACKED_ABOVE + 1))
    assert plain({"user": np.full(PACKED_ABOVE + 1, 0.5)}) == {
        "user": [0.5] * (PACKED_ABOVE + 1)
    }  # not a field
    with pytest.raises(InputError, match="NaN"):
        plain(np.full(PACKED_ABOVE + 1, np.nan))


def test_packed_arrays_follow_the_documented_format():
    kept = pack(MASKS["fine"] / 65535)
    rows = np.frombuffer(
        zlib.decompress(base64.b64decode(kept["zlib"])), "<u2"
    ).reshape(kept["shape"])
    assert np.array_equal(rows, MASKS["fine"])
    assert (kept["type"], kept["levels"]) == ("array", 65535)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": [SIDE, 7]}, r"damaged \(its shape needs 1792 bytes\)"),
        ({"shape": [-1, 2]}, r"shape\[0\]: must be >= 1"),
        ({"shape": [10**9, 10**9]}, "at most 16777216 are allowed"),
        ({"levels": 7}, "levels"),
        ({"zlib": "no base64"}, "damaged"),
        ({"zlib": "AAAA"}, "damaged"),
    ],
)
def test_damaged_arrays_are_rejected(change, message):
    with pytest.raises(InputError, match=message):
        unpack(pack(MASKS["grey"] / 255) | change)


def test_truncated_and_extended_data_and_nan_are_rejected():
    kept = pack(MASKS["grey"] / 255)
    body = base64.b64decode(kept["zlib"])
    for changed in (body[:-2], body + b"more"):
        with pytest.raises(InputError, match="damaged"):
            unpack(kept | {"zlib": base64.b64encode(changed).decode()})
    nan = base64.b64encode(zlib.compress(np.full(2000, np.nan).tobytes())).decode()
    with pytest.raises(InputError, match="NaN"):
        unpack({"type": "array", "shape": [2000], "levels": None, "zlib": nan})


def test_unknown_fields_are_rejected_before_arrays_are_unpacked():
    lens = plain(ThinLens(0.01, 2.0)) | {
        "x": [{"type": "array", "shape": "not looked at"}]
    }
    with pytest.raises(InputError, match="unknown key 'x'"):
        lens_from_plain(lens)
