"""Damaged environment maps are read or raise a twinlens error of one line, in bounded memory and time."""

import os
import struct
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import strategies as st

from tests.dataset.dataset_damage import damaged
from tests.dataset.test_fuzz import fuzz, in_process  # noqa: F401
from twinlens.errors import FileError
from twinlens.scenes.assets import read_sky

QUICK, CASES = 100, 5_000
PIXELS = np.random.default_rng(0).random((12, 24, 3)).astype(np.float32)


def exr(folder):
    path = folder / "good.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": PIXELS}) as file:
        file.write(str(path))
    return path.read_bytes()


def hdr(folder):
    """Run-length encoded as literal runs; Source: G. Ward, Real Pixels, Graphics Gems II, 1991."""
    rgbe = np.concatenate([PIXELS * 255, np.full((12, 24, 1), 128)], axis=2).astype(
        np.uint8
    )
    lines = (
        b"\x02\x02\x00\x18" + b"".join(b"\x18" + row[:, c].tobytes() for c in range(4))
        for row in rgbe
    )
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 12 +X 24\n" + b"".join(lines)


FORMATS = {".exr": exr, ".hdr": hdr}


def fuzz_sky(suffix, cases):
    with tempfile.TemporaryDirectory() as folder:
        good = FORMATS[suffix](Path(folder))
        path = Path(folder) / f"sky{suffix}"
        path.write_bytes(good)
        assert np.abs(read_sky(path) - PIXELS).max() < 0.01

        def read(data):
            path.write_bytes(data)
            pixels = read_sky(path)
            assert np.isfinite(pixels).all()
            assert (pixels >= 0).all()

        fuzz(read, damaged(good) | st.binary(max_size=80), cases)


@pytest.mark.parametrize("cases", [QUICK, pytest.param(CASES, marks=pytest.mark.slow)])
@pytest.mark.parametrize("suffix", FORMATS)
def test_damaged_skies(in_process, suffix, cases):  # noqa: F811
    in_process(fuzz_sky, suffix, cases)


def test_an_hdr_that_promises_more_pixels_than_it_has_is_refused(tmp_path):
    path = tmp_path / "sky.hdr"
    path.write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\n"
        b"\x02\x02\x40\x00" + bytes(99)
    )
    with pytest.raises(FileError, match="cannot be read"):
        read_sky(path)


def test_an_exr_of_many_large_channels_is_refused_from_its_header(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    flat = {
        name: np.zeros((5, 8), np.float32)
        for name in ("R", "G", "B", *(f"x{i}" for i in range(20)))
    }
    with OpenEXR.File(header, flat) as file:
        file.write(str(tmp_path / "sky.exr"))
    data = (tmp_path / "sky.exr").read_bytes()
    small, large = struct.pack("<4i", 0, 0, 7, 4), struct.pack("<4i", 0, 0, 8191, 8191)
    (tmp_path / "sky.exr").write_bytes(data.replace(small, large))
    with pytest.raises(
        FileError, match="23 channels of 8192x8192 pixels are too many values"
    ):
        read_sky(tmp_path / "sky.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_values_without_a_radiance_are_refused(tmp_path, value):
    pixels = PIXELS.copy()
    pixels[3, 4, 1] = value
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}) as file:
        file.write(str(tmp_path / "sky.exr"))
    with pytest.raises(FileError, match="finite values >= 0"):
        read_sky(tmp_path / "sky.exr")


def test_damaged_pixels_print_nothing(tmp_path, capfd):
    data = exr(tmp_path)
    (tmp_path / "sky.exr").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileError, match="cannot be read"):
        read_sky(tmp_path / "sky.exr")
    os.write(2, b"stderr works again")
    assert capfd.readouterr() == ("", "stderr works again")
