"""The epipolar picture: curves pass through the matches, other pixels do not change, epipoles are marked."""

import numpy as np
import pytest

from twinlens.camera import BrownConrady, Camera, Rig
from twinlens.camera.layouts import line, toed_in
from twinlens.geometry import rigid
from twinlens.report.epipolar_picture import epipolar_picture, spread_points

CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
GREY = np.full((120, 160, 3), 128, np.uint8)
GAP = 12


def drawn(rig, here, there=None):
    """Where each half of the picture differs from its grey image."""
    picture = epipolar_picture((GREY, GREY), rig, here, there)
    changed = np.abs(picture.astype(int) - 128).max(axis=2) > 30
    return changed[:, :160], changed[:, 160 + GAP :]


def test_lines_of_a_rectified_pair_are_rows():
    left, right = drawn(line(CAMERA, 2, 0.1), [[120.0, 40.0]])
    assert not left[:20].any()
    assert set(np.flatnonzero(right.any(axis=1))) <= {39, 40, 41}
    assert right[40, :118].all()  # from the left edge to the point at infinity
    assert not right[40, 123:].any()


@pytest.mark.parametrize("distortion", [None, BrownConrady(-0.2, 0.05)])
def test_the_curve_of_each_point_passes_through_its_match(distortion):
    rig = toed_in(CAMERA.replace(distortion=distortion), 0.4, 1.5)
    points = np.array([[-0.2, -0.25, 1.4], [0.0, 0.1, 1.6], [0.25, 0.3, 1.3]])
    here, there = (rig.project(i, points) for i in (0, 1))
    _, right = drawn(rig, here)
    for u, v in np.rint(there).astype(int):
        assert right[v, u]
        assert not right[v - 5 : v - 2, u].any()


def test_the_epipole_is_the_image_of_the_other_camera():
    rig = Rig([CAMERA] * 2, [np.eye(4), rigid(np.eye(3), [0.1, 0.0, 1.0])])
    left, right = drawn(rig, np.empty((0, 2)))
    for half, (u, v) in (
        (left, rig.project(0, [0.1, 0.0, 1.0])),
        (right, (79.5 + 15.0, 59.5)),
    ):
        rows, columns = np.nonzero(half)
        assert columns.mean() == pytest.approx(u, abs=0.6)
        assert rows.mean() == pytest.approx(v, abs=0.6)
    assert not np.any(drawn(line(CAMERA, 2, 0.1), np.empty((0, 2))))


def test_images_may_be_grey_16_bit_and_of_different_sizes():
    rig = Rig(
        [CAMERA, CAMERA.replace(width=100, height=140)],
        line(CAMERA, 2, 0.1).world_from_cams,
    )
    grey, deep = (
        np.full((120, 160), 77, np.uint8),
        np.full((140, 100, 3), 55 << 8, np.uint16),
    )
    picture = epipolar_picture((grey, deep), rig, np.empty((0, 2)))
    assert picture.shape == (140, 160 + GAP + 100, 3)
    assert (picture[:120, :160] == 77).all()
    assert (picture[:, -100:] == 55).all()


def test_points_are_allowed_and_spread_evenly():
    allowed = np.random.default_rng(0).random((90, 120)) < 0.3
    points = spread_points(allowed, 12)
    assert len(points) == 12
    assert allowed[points[:, 1], points[:, 0]].all()
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)[
        ~np.eye(12, dtype=bool)
    ]
    assert apart.min() > 12
    assert len(spread_points(np.zeros((4, 5), bool), 3)) == 0
    assert spread_points(np.eye(3, dtype=bool)[:1], 5).tolist() == [[0, 0]]
