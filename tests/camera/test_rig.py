"""Rigs: closed forms of the rectified pair, and the test of other pairs."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from tests.rigs import px_from_world
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, Rig

CAMERA = Camera(640, 480, 700.0, 690.0, 310.25, 241.0)
turns = arrays(np.float64, 3, elements=st.floats(-3, 3))
shifts = arrays(np.float64, 3, elements=st.floats(-20, 20))
poses = st.builds(
    lambda turn, shift: geometry.rigid(cv2.Rodrigues(turn)[0], shift), turns, shifts
)
baselines = st.floats(1e-3, 3)


@given(
    poses,
    baselines,
    st.floats(-40, 40),
    st.floats(-2, 2),
    st.floats(-2, 2),
    st.floats(0.5, 20),
)
def test_a_rectified_pair_has_equal_rows_and_disparity_fx_b_over_z(
    pose, baseline, doffs, x, y, z
):
    rig = Rig.stereo(CAMERA, baseline, pose, right=CAMERA.replace(cx=CAMERA.cx + doffs))
    world = geometry.transform_points(pose, [x, y, z])
    left, right = (
        geometry.dehomogeneous(px_from_world(rig, i) @ [*world, 1]) for i in (0, 1)
    )
    assert left[1] == pytest.approx(right[1], abs=1e-8)
    assert left[0] - right[0] == pytest.approx(
        CAMERA.fx * baseline / z - doffs, abs=1e-7
    )
    assert rig.doffs() == pytest.approx(doffs, abs=1e-12)
    assert rig.baseline() == pytest.approx(baseline, rel=1e-12, abs=1e-13)
    assert rig.is_rectified()
    assert not rig.is_rectified(1, 0)


@given(poses, baselines)
def test_a_pose_with_seven_digits_gives_a_rectified_pair(pose, baseline):
    typed = np.round(pose, 7)
    assert Rig.stereo(CAMERA, baseline, typed).is_rectified()


@given(poses, poses, poses)
def test_relative_poses_compose(a, b, c):
    rig = Rig([CAMERA] * 3, [a, b, c])
    assert np.allclose(
        rig.b_from_a(1, 2) @ rig.b_from_a(0, 1), rig.b_from_a(0, 2), atol=1e-9
    )
    assert np.allclose(rig.b_from_a(0, 1) @ rig.b_from_a(1, 0), np.eye(4), atol=1e-10)
    assert np.allclose(a @ rig.b_from_a(1, 0), b, atol=1e-9)


def shifted(x=0.1, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0)):
    return geometry.rigid(cv2.Rodrigues(np.array(turn))[0], [x, y, z])


@pytest.mark.parametrize(
    ("right", "pose"),
    [
        (CAMERA, shifted(y=1e-6)),
        (CAMERA, shifted(z=1e-6)),
        (CAMERA, shifted(x=-0.1)),
        (CAMERA, shifted(turn=(0, 1e-6, 0))),
        (CAMERA, shifted(turn=(math.pi, 0, 0))),
        (CAMERA.replace(fx=701.0), shifted()),
        (CAMERA.replace(fy=691.0), shifted()),
        (CAMERA.replace(cy=240.0), shifted()),
        (CAMERA.replace(height=479), shifted()),
        (CAMERA.replace(distortion=BrownConrady(k1=-0.1)), shifted()),
    ],
)
def test_nearly_rectified_pairs_are_not_rectified(right, pose):
    assert not Rig([CAMERA, right], [np.eye(4), pose]).is_rectified()


def test_a_rectified_pair_may_differ_in_width_and_cx():
    assert Rig.stereo(
        CAMERA, 0.1, right=CAMERA.replace(cx=300.0, width=500)
    ).is_rectified()


@pytest.mark.parametrize(
    ("count", "partners"), [(1, [None]), (2, [1, 0]), (3, [1, 0, 1]), (4, [1, 0, 3, 2])]
)
def test_partner_of_each_camera(count, partners):
    rig = Rig([CAMERA] * count, [shifted(0.1 * i) for i in range(count)])
    assert len(rig) == count
    assert [rig.partner(i) for i in range(count)] == partners


def test_a_rig_copies_its_poses():
    pose = np.eye(4)
    rig = Rig.stereo(CAMERA, 0.1, pose)
    other = Rig([CAMERA], [pose])
    pose[0, 3] = 5
    assert rig.world_from_cams[0][0, 3] == 0
    assert other.world_from_cams[0][0, 3] == 0
