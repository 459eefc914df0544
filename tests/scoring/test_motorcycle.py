import socket

import numpy as np
import pytest

from twinlens.scoring import motorcycle


@pytest.fixture(scope="module")
def pair():
    return motorcycle()


def test_the_pair_needs_no_network(monkeypatch):
    def refuse(*_):
        raise AssertionError("asked for a connection")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    assert motorcycle().name == "motorcycle"


def test_the_pair_has_the_documented_content(pair):
    assert pair.im0.shape == pair.im1.shape == (500, 741, 3)
    assert pair.im0.dtype == np.uint8
    assert pair.disp0.shape == pair.mask0_nonocc.shape == (500, 741)
    finite = np.isfinite(pair.disp0)
    assert not np.isnan(pair.disp0).any()
    assert 0.92 < finite.mean() < 0.93
    np.testing.assert_array_equal(pair.mask0_nonocc == 0, ~finite)


def test_the_calibration_fits_the_data(pair):
    calibration = pair.calibration
    assert (calibration.height, calibration.width) == pair.im0.shape[:2]
    finite = pair.disp0[np.isfinite(pair.disp0)]
    assert finite.min() >= calibration.vmin
    assert finite.max() <= calibration.vmax < pair.ndisp == calibration.ndisp
    # Quarters of the published values.
    assert calibration.fx * 4 == pytest.approx(3979.911, abs=2e-3)
    assert calibration.doffs * 4 == pytest.approx(124.343, abs=2e-3)
    # The published scene fills an indoor room: a motorcycle at two to five metres.
    depth = calibration.depth(pair.disp0)[np.isfinite(pair.disp0)]
    assert 2.0 < depth.min() < depth.max() < 5.1


def test_visible_pixels_match_in_colour(pair):
    here, there = (image.astype(float).mean(axis=-1) for image in (pair.im0, pair.im1))

    def difference(code):
        rows, columns = np.nonzero(pair.mask0_nonocc == code)
        matches = np.rint(columns - pair.disp0[rows, columns]).clip(0, 740).astype(int)
        return np.median(np.abs(here[rows, columns] - there[rows, matches]))

    assert difference(255) < 4
    assert difference(128) > 3 * difference(255)
