"""`read_image`: formats, bit depths, and files that are rejected."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import EpsImagePlugin, Image

from twinlens.dataset import read_image
from twinlens.errors import FileError

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n0 0 moveto\nshowpage\n%%EOF\n"


@pytest.fixture
def read_back(tmp_path):
    """What `read_image` returns of pixels that Pillow has written."""

    def read(name, pixels):
        Image.fromarray(pixels).save(tmp_path / name)
        return read_image(tmp_path / name)

    return read


def test_lossless_formats_keep_every_pixel(read_back):
    color = np.random.default_rng(3).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    grey = np.arange(35, dtype=np.uint8).reshape(7, 5)
    deep = (np.arange(35) * 1800).astype(np.uint16).reshape(7, 5)
    for names, pixels in (
        (("a.bmp", "a.tif", "a.ppm", "a.png"), color),
        (("a.pgm", "a.png"), grey),
        (("a.tif", "a.pgm", "a.png"), deep),
    ):
        for name in names:
            back = read_back(name, pixels)
            assert back.dtype == pixels.dtype
            assert_array_equal(back, pixels)


def test_lossy_formats_are_read(read_back):
    pixels = np.full((8, 16, 3), (200, 100, 50), np.uint8)
    for name in ("a.jpg", "a.webp"):
        back = read_back(name, pixels)
        assert back.shape == pixels.shape
        assert_allclose(back, pixels.astype(int), atol=6)


def test_postscript_is_never_interpreted(tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *given, **_: started.append(given)
    )
    for name in ("a.jpg", "a.png", "a.eps", "a.bmp"):
        (tmp_path / name).write_bytes(POSTSCRIPT)
        with pytest.raises(FileError, match=name) as error:
            read_image(tmp_path / name)
        assert "object at 0x" not in str(error.value)
    assert started == []


def test_alpha_and_floats_are_rejected(read_back):
    message = r"a\.tif: image mode .* is not supported; save it as"
    for pixels in (np.zeros((4, 4, 4), np.uint8), np.ones((4, 4), np.float32)):
        with pytest.raises(FileError, match=message):
            read_back("a.tif", pixels)
