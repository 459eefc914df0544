"""Encodings of the page round-trip; the colormaps equal the published ones."""

import base64
import io
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from twinlens.dataset.pictures import NO_TRUTH
from twinlens.report.page import COLORMAPS, NO_ESTIMATE, UNKNOWN, image_uri, pack

disparities = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=9),
    elements=st.one_of(st.floats(-300, 3000, width=32), st.just(np.inf)),
)


def unpack(packed):
    """Decode as the page's script does: (H, W) pixels, +inf unknown."""
    planes = np.frombuffer(
        zlib.decompress(base64.b64decode(packed["data"])), np.uint8
    ).astype(np.uint16)
    low, high = planes.reshape(2, packed["h"], packed["w"])
    codes = np.cumsum(low | (high << 8), axis=1, dtype=np.uint16)
    return np.where(codes == UNKNOWN, np.inf, packed["offset"] + codes * packed["step"])


@given(disp=disparities, stride=st.integers(1, 3))
def test_a_map_round_trips_within_half_a_step(disp, stride):
    packed = pack(disp, stride)
    wanted = disp[::stride, ::stride]
    unpacked = unpack(packed)
    assert unpacked.shape == wanted.shape == (packed["h"], packed["w"])
    np.testing.assert_array_equal(np.isfinite(unpacked), np.isfinite(wanted))
    finite = np.isfinite(wanted)
    assert (
        np.abs(unpacked[finite] - wanted[finite]).max(initial=0) <= packed["step"] / 2
    )


@pytest.mark.parametrize("shape", [(12, 20), (12, 20, 3)])
def test_an_image_round_trips_approximately(shape):
    image = np.full(shape, 90, np.uint8)
    for stride, size in ((1, (20, 12)), (2, (10, 6))):
        kind, data = image_uri(image, stride).split(",")
        assert kind == "data:image/webp;base64"
        back = Image.open(io.BytesIO(base64.b64decode(data)))
        assert back.size == size
        assert np.abs(np.asarray(back, int) - 90).max() <= 3


@pytest.mark.parametrize(
    ("name", "code"), [("viridis", cv2.COLORMAP_VIRIDIS), ("magma", cv2.COLORMAP_MAGMA)]
)
def test_the_tables_are_the_published_ones(name, code):
    ramp = np.arange(256, dtype=np.uint8)[None]
    published = cv2.applyColorMap(ramp, code)[0, :, ::-1].astype(int)
    assert np.abs(published - COLORMAPS[name]).max() <= 8


def luminance(rgb):
    linear = (np.asarray(rgb) / 255.0) ** 2.2
    return linear @ [0.2126, 0.7152, 0.0722]


def test_lightness_of_berlin_rises_from_its_middle():
    # Every eighth step: between neighbours the rounding to 8 bits is as large as the step.
    berlin = luminance(COLORMAPS["berlin"])
    assert berlin[127:129].max() < 0.01
    assert (np.diff(berlin[128::8]) > 0).all()
    assert (np.diff(berlin[127::-8]) > 0).all()


def test_unknown_is_unlike_every_colour_of_a_map():
    for table in COLORMAPS.values():
        for flat in (NO_TRUTH, NO_ESTIMATE):
            assert np.abs(table.astype(int) - flat).sum(axis=1).min() > 40
