"""Poses of moving bodies against matrices written by hand, and what is refused."""

import cv2
import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.geometry import rigid
from twinlens.geometry.motion import Keyframe, Motion, Trajectory, Turn

QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # about z, from x to y
HALF = np.diag([-1.0, -1, 1])
UPRIGHT = [0.0, 0, 0, 1]
ROOT = np.sqrt(0.5)


def placement():
    """Turned, scaled, and off the world's origin."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array([0.3, -0.5, 0.2]))[0] * [0.5, 0.7, 0.9]
    pose[:3, 3] = [2.0, -1.0, 0.5]
    return pose


def test_velocities_turn_about_the_own_origin_along_the_axes_of_the_world():
    motion = Motion(velocity=(0.5, 0, -1), angular_velocity_deg=(0, 0, 90))
    for time, turn in (
        (0.0, np.eye(3)),
        (1.0, QUARTER),
        (-1.0, QUARTER.T),
        (2.0, HALF),
    ):
        expected = np.eye(4)
        expected[:3, :3] = turn @ placement()[:3, :3]
        expected[:3, 3] = placement()[:3, 3] + time * np.array([0.5, 0, -1])
        got = motion.pose_at(time, placement())
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14)


def test_rotations_about_a_point_carry_the_origin_around_it():
    """A door of which (2, 0, 0.5) is on the hinge: its origin, 1 m away along -y, goes to +x of the hinge."""
    motion = Motion(angular_velocity_deg=(0, 0, 90), about=(2, 0, 0.5))
    got = motion.pose_at(1.0, placement())
    np.testing.assert_allclose(got[:3, 3], [3.0, 0.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(got[:3, :3], QUARTER @ placement()[:3, :3], atol=1e-14)


def test_keyframes_are_displacements_from_the_placement():
    keyframes = (
        Keyframe(1.0),
        Keyframe(2.0, (1, 2, 3), Turn((0, 0, 2), 90)),
        Keyframe(4.0, (1, 2, 5), Turn((0, 0, -1), -179)),
    )
    motion = Motion(object="ball", keyframes=keyframes)
    cases = {
        1.0: (0.0, [0, 0, 0]),
        1.5: (45.0, [0.5, 1, 1.5]),
        2.0: (90.0, [1, 2, 3]),
        3.0: (134.5, [1, 2, 4]),
        4.0: (179.0, [1, 2, 5]),
    }
    for time, (deg, shift) in cases.items():
        turn = cv2.Rodrigues(np.array([0, 0, np.radians(deg)]))[0]
        got = motion.pose_at(time, placement())
        np.testing.assert_allclose(got[:3, 3], placement()[:3, 3] + shift, atol=1e-12)
        np.testing.assert_allclose(
            got[:3, :3], turn @ placement()[:3, :3], rtol=0, atol=1e-12
        )


def test_a_trajectory_moves_the_axes_of_the_placement():
    path = Trajectory([10, 12], [[0, 0, 1], [4, 0, 1]], [UPRIGHT, [0, 0, ROOT, ROOT]])
    motion = Motion(trajectory=path)
    eighth = cv2.Rodrigues(np.array([0, 0, np.pi / 4]))[0]
    ends = (
        (10, np.eye(3), [0, 0, 1]),
        (11, eighth, [2, 0, 1]),
        (12, QUARTER, [4, 0, 1]),
    )
    for time, turn, shift in ends:
        expected = rigid(turn, shift) @ placement()
        got = motion.pose_at(time, placement())
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14)


def test_the_nearest_samples_decide_on_a_long_path():
    times = np.arange(6.0)
    path = Trajectory(times, np.outer(times**2, [1, 0, 0]), [UPRIGHT] * 6)
    for time, x in ((0.5, 0.5), (1.0, 1.0), (3.5, 12.5), (4.25, 18.25), (5.0, 25.0)):
        np.testing.assert_allclose(path.at(time)[:3, 3], [x, 0, 0], atol=1e-12)


def test_rounded_times_count_as_the_ends_of_a_path():
    path = Trajectory([0, 0.3], [[0, 0, 0], [1, 0, 0]], [UPRIGHT] * 2)
    np.testing.assert_allclose(path.at(0.1 + 0.2)[:3, 3], [1, 0, 0])


def test_quaternions_of_few_digits_are_scaled_to_unit_length():
    path = Trajectory([0, 1], np.zeros((2, 3)), [UPRIGHT, [0, 0, 0.7071, 0.7071]])
    np.testing.assert_allclose(path.at(1)[:3, :3], QUARTER, atol=1e-14)


TWO = (Keyframe(0), Keyframe(1))
PATH = Trajectory([0, 1], np.zeros((2, 3)), [UPRIGHT] * 2)
REFUSED_MOTIONS = [
    (
        {
            "keyframes": (
                Keyframe(0, rotate=Turn((0.2, 0.3, 1), 30)),
                Keyframe(1, rotate=Turn((0.2, 0.3, 1), 290)),
            )
        },
        "keyframes 0 and 1 are 260 degrees apart",
    ),
    ({}, "needs velocity, angular_velocity_deg, keyframes or a trajectory"),
    ({"velocity": (0, 0, 0), "keyframes": TWO}, "'velocity' and 'keyframes' exclude"),
    ({"trajectory": PATH, "keyframes": TWO}, "'keyframes' and 'trajectory' exclude"),
    ({"trajectory": PATH, "about": (0, 0, 0)}, "'trajectory' and 'about' exclude"),
    ({"object": "a", "light": "b", "velocity": (0, 0, 0)}, "'object' and 'light' excl"),
    (
        {"velocity": (np.nan, 0, 0)},
        "motion velocity must be three numbers of metres per",
    ),
    (
        {"velocity": (np.inf, 0, 0)},
        "motion velocity must be three numbers of metres per",
    ),
    ({"velocity": (1, 0)}, "motion velocity must be three numbers"),
    ({"velocity": 1.0}, "motion velocity must be three numbers"),
    (
        {"angular_velocity_deg": (0, 0, "a")},
        "motion angular_velocity_deg must be three",
    ),
    ({"keyframes": TWO[:1]}, "keyframes: needs two or more, got 1"),
    (
        {"keyframes": TWO[::-1]},
        r"the time 1 \(from 0\), 0 s, is before the one before, 1 s",
    ),
    (
        {"keyframes": TWO + TWO[1:]},
        r"the time 2 \(from 0\), 1 s, repeats the one before",
    ),
    ({"keyframes": (0, 1)}, "motion keyframes must be a tuple of Keyframe"),
    ({"trajectory": "path.tum"}, "motion trajectory must be a Trajectory"),
    (
        {"keyframes": (Keyframe(0), Keyframe(1, rotate=Turn((1, 1, 0), 270)))},
        "keyframes 0 and 1 are 270 degrees apart, .* add a keyframe between",
    ),
    (
        {"keyframes": (Keyframe(0), Keyframe(1, rotate=Turn((1, 0, 0), -180)))},
        "keyframes 0 and 1 are 180 degrees apart",
    ),
]


@pytest.mark.parametrize(("fields", "message"), REFUSED_MOTIONS)
def test_motions_that_are_none_are_refused(fields, message):
    with pytest.raises(InputError, match=message) as error:
        Motion(**fields)
    assert "\n" not in str(error.value)


REFUSED_PATHS = [
    ([0, 0], None, None, r"the time 1 \(from 0\), 0 s, repeats the one before"),
    ([1, 0.5], None, None, "0.5 s, is before the one before, 1 s"),
    ([0, np.nan], None, None, "a time must be a finite number of seconds, got nan"),
    ([0], None, None, "needs two times or more"),
    (
        None,
        [[0, 0, 0], [0, np.inf, 0]],
        None,
        "positions of a trajectory .* row 1 is not",
    ),
    (
        None,
        [[0, 0, 0]],
        None,
        r"positions .* must have the shape \(2, 3\), got \(1, 3\)",
    ),
    (None, None, [UPRIGHT, [0, 0, 0, 1.1]], r"at 1 s must have the length 1, .* \+0.1"),
    (None, None, [[0, 0, 0, 0], UPRIGHT], "at 0 s must have the length 1, .* -1"),
    (None, None, [UPRIGHT, [0, 0, 0, np.nan]], "quaternions .* row 1 is not"),
]


@pytest.mark.parametrize(
    ("times", "positions", "quaternions", "message"), REFUSED_PATHS
)
def test_paths_that_are_none_are_refused(times, positions, quaternions, message):
    with pytest.raises(InputError, match=message) as error:
        Trajectory(
            times or [0, 1], positions or np.zeros((2, 3)), quaternions or [UPRIGHT] * 2
        )
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("time", [-0.5, 1.01, 1e9])
def test_times_outside_of_a_path_are_refused_with_its_range(time):
    for fields in ({"keyframes": TWO}, {"trajectory": PATH}):
        motion = Motion(object="ball", **fields)
        with pytest.raises(
            InputError, match="of object 'ball': covers 0 s to 1 s, but"
        ):
            motion.pose_at(time, np.eye(4))


@pytest.mark.parametrize("time", [np.nan, np.inf, "1", None])
def test_times_are_finite_numbers(time):
    with pytest.raises(InputError, match="a time must be a finite number of seconds"):
        Motion(velocity=(1, 0, 0)).pose_at(time, np.eye(4))


@pytest.mark.parametrize("axis", [(0, 0, 0), (1, 0), (np.nan, 0, 1)])
def test_an_axis_has_a_direction(axis):
    with pytest.raises(InputError, match="rotation axis must"):
        Turn(axis, 90)
