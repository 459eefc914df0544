"""Errors in metres against reprojected points."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from twinlens.dataset import Calibration
from twinlens.scoring import evaluate

CALIBRATION = Calibration(
    (90.0, 80.0, 5.5, 4.0), (90.0, 80.0, 8.5, 4.0), 0.2, 12, 9, 3.0
)


def reproject(u, v, d):
    """Pixel and disparity to a 3-D point, by OpenCV's Q matrix for these two cameras."""
    fx, fy, cx, cy = CALIBRATION.cam0
    q = np.array(
        [
            [1, 0, 0, -cx],
            [0, fx / fy, 0, -cy * fx / fy],
            [0, 0, 0, fx],
            [0, 0, 1 / 0.2, 3.0 / 0.2],
        ],
        dtype=np.float64,
    )
    x, y, z, w = q @ [u, v, d, 1]
    return np.array([x, y, z]) / w


def random_maps(seed):
    rng = np.random.default_rng(seed)
    gt = rng.uniform(1, 40, (9, 12)).astype(np.float32)
    disp = (gt + rng.normal(0, 3, gt.shape)).astype(np.float32)
    disp[rng.random(gt.shape) < 0.2] = np.inf
    gt[rng.random(gt.shape) < 0.1] = np.inf
    return disp, gt


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_point_errors_are_distances_of_reprojected_points(seed):
    disp, gt = random_maps(seed)
    distances, shares, count = [], [], 0
    for v, u in np.argwhere(np.isfinite(gt)):
        count += 1
        if disp[v, u] + 3.0 > 0 and np.isfinite(disp[v, u]):
            true = reproject(u, v, float(gt[v, u]))
            distances.append(
                float(np.linalg.norm(reproject(u, v, float(disp[v, u])) - true))
            )
            shares.append(distances[-1] / float(np.linalg.norm(true)))
    scores = evaluate(disp, gt, protocol="points", calibration=CALIBRATION).all
    assert scores["coverage"] == pytest.approx(100 * len(distances) / count)
    assert scores["point_avgerr"] == pytest.approx(np.mean(distances), rel=1e-9)
    assert scores["point_rms"] == pytest.approx(
        math.sqrt(np.mean(np.square(distances))), rel=1e-9
    )
    assert scores["point_A90"] == pytest.approx(
        sorted(distances)[len(distances) * 9 // 10], rel=1e-9
    )
    assert scores["point_rel"] == pytest.approx(100 * np.mean(shares), rel=1e-9)


def test_a_point_at_or_behind_infinity_is_no_estimate():
    gt = np.full((1, 4), 5, np.float32)
    disp = np.array([[5, -3, -9, np.inf]], np.float32)
    scores = evaluate(disp, gt, protocol="points", calibration=CALIBRATION).all
    assert (scores["coverage"], scores["point_avgerr"]) == (25, 0)
