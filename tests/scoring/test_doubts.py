"""Maps that are right but written wrongly raise a doubt; bad maps and honest ones raise none."""

import cv2
import numpy as np
import pytest

from twinlens.matching import parse_method
from twinlens.scoring import evaluate, motorcycle
from twinlens.scoring.doubts import mistake_of

LAST = 69
LOOKS = {
    "scaled by 16": lambda d: 16 * d,
    "scaled by -16": lambda d: np.where(np.isfinite(d), -16 * d, np.inf),
    "divide by 256": lambda d: 256 * d,
    "multiply by 16": lambda d: d / 16,
    "multiply by 256": lambda d: d / 256,
    "multiply by 2": lambda d: d / 2,
    "multiply by 4": lambda d: d / 4,
    "divide by 2": lambda d: 2 * d,
    "wrong sign": lambda d: np.where(np.isfinite(d), -d, np.inf),
    "proportional": lambda d: d / 741,
    "look like depth": lambda d: 994.978 * 193.001 / (d + 31.086),
    "shifted by doffs": lambda d: d + 31.086,
    "mirrored": lambda d: d[:, ::-1],
    "upside down": lambda d: d[::-1],
    "rotated by 180": lambda d: d[::-1, ::-1],
    "no estimate": lambda d: np.full_like(d, np.inf),
    "many values are -1": lambda d: np.where(np.arange(d.shape[1]) < 60, -1, d),
    "values are 4095.94": lambda d: np.where(np.arange(d.shape[1]) < 60, 4095.9375, d),
}


@pytest.fixture(scope="module")
def real():
    return motorcycle()


def matched(real, method):
    return parse_method(method).match(real.im0, real.im1, **real.search)


@pytest.fixture(scope="module")
def honest(real):
    return matched(real, "opencv_sgbm")


def doubt(real, disparity):
    scores = evaluate(
        np.asarray(disparity, np.float32), real.disp0, real.mask0_nonocc, real.ndisp,
        calibration=real.calibration,
    )  # fmt: skip
    return scores.doubt


@pytest.mark.parametrize("text", LOOKS)
def test_what_is_wrong_is_said(real, honest, text):
    assert text in doubt(real, LOOKS[text](honest))


def test_the_map_of_the_right_view_is_recognized(real):
    mirrored = [np.ascontiguousarray(i[:, ::-1]) for i in (real.im1, real.im0)]
    of_right = parse_method("opencv_sgbm").match(*mirrored, **real.search)[:, ::-1]
    assert "right view" in doubt(real, of_right)


def test_a_transposed_square_map_is_recognized():
    rows, columns = np.mgrid[:200, :200].astype(np.float32)
    truth = 10 + 30 * np.sin(rows / 30) ** 2 + columns / 20
    mask = np.ones(truth.shape, bool)
    assert "transposed" in mistake_of(truth.T, truth, mask, 0, 60)
    assert mistake_of(truth, truth, mask, 0, 60) == ""


@pytest.mark.parametrize(
    "method",
    ["sad:block_size=3", "sad:block_size=41", "zncc", "census", "sgm", "opencv_bm"],
)
def test_honest_maps_raise_no_doubt(real, method):
    assert doubt(real, matched(real, method)) == ""


def bad_maps(truth):
    """Maps of methods that work badly or not at all."""
    random = np.random.default_rng(0)
    filled = np.where(np.isfinite(truth), truth, 30)
    shape = truth.shape
    ramp = np.linspace(0, LAST, shape[1])
    return {
        "noise": random.uniform(0, LAST, shape),
        "zero": np.zeros(shape),
        "one": np.ones(shape),
        "median": np.full(shape, np.median(filled)),
        "double": np.full(shape, 2 * np.median(filled)),
        "ramp": np.broadcast_to(ramp, shape),
        "steep": np.broadcast_to(16 * ramp, shape),
        "blurred": cv2.GaussianBlur(filled, (0, 0), 40),
        "noisy": filled + random.normal(0, 6, shape),
        "clipped": np.minimum(filled, 25),
        "sparse": np.where(random.random(shape) < 1e-4, filled, np.inf),
    }


@pytest.mark.parametrize("name", bad_maps(np.full((4, 5), 3.0)))
def test_bad_maps_raise_no_doubt(real, name):
    assert doubt(real, bad_maps(real.disp0)[name]) == ""


def test_flat_scenes_and_constant_maps_raise_no_doubt():
    truth = np.full((40, 50), 4, np.float32)
    for value in (0, 1, 2, 8, 64, 1024):
        assert mistake_of(np.full_like(truth, value), truth, None, 0, 15) == ""
    values = truth + np.linspace(-3, 3, 50, dtype=np.float32)
    assert mistake_of(values, truth, None, 0, 15) == ""


def steps(*disparities):
    """A map of vertical stripes."""
    return np.repeat(np.float32([disparities]), 40, axis=0).repeat(25, axis=1)


@pytest.mark.parametrize(
    ("truth", "low"),
    [
        (steps(-6, -3, 2, 5), 0),
        (steps(-40, -3, 2, 5), -8),
        (steps(2, 5, 130, 9), 0),
        (steps(-1, 4, 8), 0),
    ],
)
def test_a_right_map_with_values_beyond_the_search_raises_no_doubt(truth, low):
    assert mistake_of(truth, truth, None, low, 60) == ""
    assert mistake_of(np.rint(truth - 0.4), truth - 0.4, None, low, 60) == ""
    assert evaluate(truth, truth, None, 64, min_disparity=low).doubt == ""


@pytest.mark.parametrize("fill", [-1, -17, 999])
def test_a_fill_value_of_a_truth_with_negative_disparities_is_said(fill):
    truth = steps(6, 3, 2, 5) if fill == -1 else steps(-6, -3, 2, 5)
    values = truth.copy()
    values[:, 40:60] = fill
    expected = f"many values are {fill}, which no pixel can have"
    assert expected in mistake_of(values, truth, None, -8 if fill != -1 else 0, 60)
