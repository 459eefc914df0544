"""Errors in metres against reprojected points, and clouds against brute force."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.scoring import cloud_errors, evaluate, points

CALIBRATION = Calibration((90.0, 80.0, 5.5, 4.0), (90.0, 80.0, 8.5, 4.0), 0.2, 12, 9, 3.0)


def reproject(u, v, d):
    """Pixel and disparity to a 3-D point, by OpenCV's Q matrix for these two cameras."""
    fx, fy, cx, cy = CALIBRATION.cam0
    q = np.array(
        [[1, 0, 0, -cx], [0, fx / fy, 0, -cy * fx / fy], [0, 0, 0, fx], [0, 0, 1 / 0.2, 3.0 / 0.2]], dtype=np.float64
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
    distances, shares, known = [], [], 0
    for v, u in np.argwhere(np.isfinite(gt)):
        known += 1
        if disp[v, u] + 3.0 > 0 and np.isfinite(disp[v, u]):
            true = reproject(u, v, float(gt[v, u]))
            distances.append(float(np.linalg.norm(reproject(u, v, float(disp[v, u])) - true)))
            shares.append(distances[-1] / float(np.linalg.norm(true)))
    scores = evaluate(disp, gt, protocol="points", calibration=CALIBRATION).all
    assert scores["coverage"] == pytest.approx(100 * len(distances) / known)
    assert scores["point_avgerr"] == pytest.approx(np.mean(distances), rel=1e-9)
    assert scores["point_rms"] == pytest.approx(math.sqrt(np.mean(np.square(distances))), rel=1e-9)
    assert scores["point_A90"] == pytest.approx(sorted(distances)[len(distances) * 9 // 10], rel=1e-9)
    assert scores["point_rel"] == pytest.approx(100 * np.mean(shares), rel=1e-9)


def test_the_cloud_holds_every_known_point():
    disp, _ = random_maps(4)
    there = np.argwhere(np.isfinite(disp) & (disp > -3))
    np.testing.assert_allclose(points(disp, CALIBRATION), [reproject(u, v, float(disp[v, u])) for v, u in there])
    half = np.indices(disp.shape)[1] < 6
    assert len(points(disp, CALIBRATION, half)) == (there[:, 1] < 6).sum()


def test_a_point_at_or_behind_infinity_is_no_estimate():
    gt = np.full((1, 4), 5, np.float32)
    disp = np.array([[5, -3, -9, np.inf]], np.float32)
    scores = evaluate(disp, gt, protocol="points", calibration=CALIBRATION).all
    assert (scores["coverage"], scores["point_avgerr"]) == (25, 0)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_cloud_errors_equal_brute_force(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.random((rng.integers(1, 30), 3)), rng.random((rng.integers(1, 30), 3))
    gaps = np.linalg.norm(a[:, None] - b[None], axis=2)
    found = cloud_errors(a, b, 0.2)
    assert found["accuracy"] == pytest.approx(gaps.min(axis=1).mean())
    assert found["completeness"] == pytest.approx(gaps.min(axis=0).mean())
    p, r = 100 * np.mean(gaps.min(axis=1) < 0.2), 100 * np.mean(gaps.min(axis=0) < 0.2)
    assert (found["precision"], found["recall"]) == pytest.approx((p, r))
    assert found["fscore"] == pytest.approx(0 if p + r == 0 else 2 * p * r / (p + r))
    assert cloud_errors(a, a, 1e-9) == {
        "accuracy": 0,
        "completeness": 0,
        "precision": 100,
        "recall": 100,
        "fscore": 100,
    }


def test_an_empty_cloud_has_no_errors_and_a_bad_one_is_refused():
    assert all(math.isnan(v) for v in cloud_errors(np.zeros((0, 3)), [[0, 0, 1]], 1).values())
    with pytest.raises(InputError, match=r"cloud 'true' has shape \(1, 2\)"):
        cloud_errors([[0, 0, 1]], [[0, 0]], 1)
    with pytest.raises(InputError, match="threshold_m is 0"):
        cloud_errors([[0, 0, 1]], [[0, 0, 1]], 0)
