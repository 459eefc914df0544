"""`read_image`: formats, bit depths, and files that are rejected."""

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from twinlens.dataset import read_image
from twinlens.errors import FileError

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n0 0 moveto\nshowpage\n%%EOF\n"


@pytest.mark.parametrize("name", ["a.bmp", "a.tif", "a.ppm", "a.png"])
def test_lossless_formats_keep_every_pixel(tmp_path, name):
    pixels = np.random.default_rng(3).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / name)
    np.testing.assert_array_equal(read_image(tmp_path / name), pixels)


def test_grey_stays_grey(tmp_path):
    pixels = np.arange(35, dtype=np.uint8).reshape(7, 5)
    Image.fromarray(pixels).save(tmp_path / "a.pgm")
    np.testing.assert_array_equal(read_image(tmp_path / "a.pgm"), pixels)


@pytest.mark.parametrize("name", ["a.jpg", "a.webp"])
def test_lossy_formats_are_read(tmp_path, name):
    Image.new("RGB", (16, 8), (200, 100, 50)).save(tmp_path / name)
    read = read_image(tmp_path / name)
    assert read.shape == (8, 16, 3)
    np.testing.assert_allclose(
        read, np.broadcast_to([200, 100, 50], read.shape), atol=6
    )


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.eps", "a.bmp"])
def test_postscript_is_never_interpreted(tmp_path, monkeypatch, name):
    started = []
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *given, **_: started.append(given)
    )
    (tmp_path / name).write_bytes(POSTSCRIPT)
    with pytest.raises(FileError, match=name) as error:
        read_image(tmp_path / name)
    assert "object at 0x" not in str(error.value)
    assert started == []


@pytest.mark.parametrize("name", ["a.tif", "a.pgm", "a.png"])
def test_sixteen_bits_stay_sixteen(tmp_path, name):
    pixels = (np.arange(35) * 1800).astype(np.uint16).reshape(7, 5)
    Image.fromarray(pixels).save(tmp_path / name)
    read = read_image(tmp_path / name)
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, pixels)


@pytest.mark.parametrize(
    "pixels", [np.zeros((4, 4, 4), np.uint8), np.ones((4, 4), np.float32)]
)
def test_alpha_and_floats_are_rejected(tmp_path, pixels):
    Image.fromarray(pixels).save(tmp_path / "a.tif")
    with pytest.raises(
        FileError, match=r"a\.tif: image mode .* is not supported; save it as"
    ):
        read_image(tmp_path / "a.tif")
