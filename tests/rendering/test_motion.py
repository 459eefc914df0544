"""Truth between cameras and times, of what moves, against closed forms: homographies, spheres, OpenCV, brute force.

Rotations are OpenCV's (`cv2.Rodrigues`), and no pose comes from `twinlens.geometry.motion`.
"""

import itertools

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.rendering.rendering_answers import View
from tests.rendering.rendering_bodies import Ball, Hull, Plate, seen_from
from twinlens.camera import BrownConrady, Camera, Misalignment, Rig, misaligned
from twinlens.camera.rectification import rectify
from twinlens.errors import InputError
from twinlens.geometry.motion import Keyframe, Motion, Turn
from twinlens.scenes import Mesh, Scene, SceneObject

EXACT_PX = 1e-4
WIDTH, HEIGHT = 48, 36
CAMERA = Camera(WIDTH, HEIGHT, 50.0, 52.0, 23.0, 18.5)
SQUARE = Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
SPIN = np.array([20.0, -30.0, 40.0])  # degrees per second
SPEED = np.array([0.3, -0.1, 0.4])  # metres per second


def turned(vector_deg):
    """The rotation (3, 3) of a rotation vector in degrees."""
    return cv2.Rodrigues(np.radians(np.asarray(vector_deg, float)))[0]


def posed(turn, place, scale=1.0):
    pose = np.eye(4)
    pose[:3, :3] = turn * scale
    pose[:3, 3] = place
    return pose


def scene_of(*objects, motion=()):
    """A scene in the axes of a camera at the origin that looks along z."""
    return Scene(
        "moving",
        objects,
        {"grey": {"type": "diffuse"}},
        np.eye(4),
        (1.0, 9.0),
        {"sky": {"type": "constant"}},
        motion=tuple(motion),
    )


def pixels_of(camera):
    """Homogeneous pixels (H, W, 3)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([u, v, np.ones_like(u)], axis=-1).astype(float)


PLANE_TURN = turned([12, 25, 5])
PLANE_PLACE = np.array([0.1, -0.05, 3.0])


@pytest.fixture(scope="module")
def plane():
    """A large square that moves and turns about its own middle."""
    placement = posed(PLANE_TURN, PLANE_PLACE, [9.0, 9.0, 1.0])
    motion = Motion(object="wall", velocity=SPEED, angular_velocity_deg=SPIN)
    return scene_of(SceneObject("wall", SQUARE, "grey", placement), motion=[motion])


def plane_motion(t1, t2):
    """X2 = R X1 + t, and the plane n . X1 = d, of the moving square in the camera's axes."""
    turn = turned((t2 - t1) * SPIN)
    centre1, centre2 = PLANE_PLACE + t1 * SPEED, PLANE_PLACE + t2 * SPEED
    normal = turned(t1 * SPIN) @ PLANE_TURN[:, 2]
    return turn, centre2 - turn @ centre1, normal, normal @ centre1


@pytest.mark.parametrize(
    ("t1", "t2"), [(0.0, 0.4), (0.4, -0.3), (0.25, 0.25), (-0.5, 0.5)]
)
def test_a_moving_plane_is_a_homography(plane, t1, t2):
    """H = K (R + (t - b) n^T / d) K^-1 from one eye to the other at another time, with the baseline b."""
    baseline = np.array([0.1, 0.0, 0.0])
    rig = Rig.stereo(CAMERA, baseline[0])
    answer = tl.correspondence(plane, rig, (0, t1), (1, t2))
    turn, shift, normal, distance = plane_motion(t1, t2)
    to_ray = np.linalg.inv(CAMERA.K)
    homography = (
        CAMERA.K @ (turn + np.outer(shift - baseline, normal) / distance) @ to_ray
    )
    pixels = pixels_of(CAMERA)
    there = pixels @ homography.T
    expected = there[..., :2] / there[..., 2:]
    assert np.abs(answer.pixels - expected).max() < EXACT_PX
    assert np.abs(answer.flow - (expected - pixels[..., :2])).max() < EXACT_PX
    inside = (np.abs(expected - [23.5, 17.5]) < [24.0, 18.0]).all(axis=-1)
    assert np.array_equal(answer.visible, inside)
    rays = pixels @ to_ray.T
    before = rays * (distance / (rays @ normal))[..., None]
    after = before @ turn.T + shift
    assert np.abs(answer.disparity - 5.0 / before[..., 2]).max() < EXACT_PX
    assert np.abs(answer.target_disparity - 5.0 / after[..., 2]).max() < EXACT_PX
    assert np.abs(answer.scene_flow - (after - before)).max() < 5e-6


def test_flow_of_one_eye_has_the_disparities_of_its_pair(plane):
    """KITTI's two disparity maps: both on the grid of the first image."""
    rig = Rig.stereo(CAMERA, 0.1)
    left, right = (tl.correspondence(plane, rig, (i, 0.1), (i, 0.5)) for i in (0, 1))
    cross = tl.correspondence(plane, rig, (0, 0.1), (1, 0.5))
    for name in ("disparity", "target_disparity"):
        assert np.array_equal(getattr(left, name), getattr(cross, name))
    difference = left.pixels[..., 0] - cross.pixels[..., 0]
    assert np.abs(left.target_disparity - difference).max() < EXACT_PX
    assert np.isfinite(right.target_disparity).all()


BALL_PLACE = np.array([-0.1, 0.2, 2.5])
RADIUS = 0.8


def ball_hits(rays):
    """Where rays from the origin (N, 3) meet the ball at its placement; NaN where they do not."""
    a = (rays * rays).sum(-1)
    b = rays @ BALL_PLACE
    c = BALL_PLACE @ BALL_PLACE - RADIUS**2
    with np.errstate(invalid="ignore"):
        return rays * ((b - np.sqrt(b * b - a * c)) / a)[..., None]


@pytest.mark.parametrize("shape", ["sphere", "copies"])
def test_a_rotating_sphere_carries_its_surface(shape):
    """Its outline stands still; its points turn about its middle."""
    if shape == "sphere":
        ball = SceneObject(
            "ball", {"type": "sphere"}, "grey", posed(np.eye(3), BALL_PLACE, RADIUS)
        )
        name = "ball"
    else:
        copies = (posed(np.eye(3), BALL_PLACE), posed(np.eye(3), [0, 0, 50.0]))
        ball = SceneObject(
            "ball",
            {"type": "sphere"},
            "grey",
            posed(np.eye(3), [0, 0, 0], RADIUS),
            instances=copies,
        )
        name = "ball[0]"
    spin = Motion(object=name, angular_velocity_deg=SPIN)
    answer = tl.correspondence(
        scene_of(ball, motion=[spin]), Rig.stereo(CAMERA, 0.1), (0, 0.0), (0, 0.5)
    )
    hits = ball_hits(pixels_of(CAMERA) @ np.linalg.inv(CAMERA.K).T)
    on_ball = np.isfinite(hits[..., 0])
    assert on_ball.sum() > 300
    moved = (hits[on_ball] - BALL_PLACE) @ turned(0.5 * SPIN).T + BALL_PLACE
    there = moved @ CAMERA.K.T
    error = np.abs(answer.pixels[on_ball] - there[:, :2] / there[:, 2:])
    # The renderer's sphere has a float32 pose, 1e-7 off, and a ray at a small angle a meets it 1e-7 / a off.
    normal = (hits[on_ball] - BALL_PLACE) / RADIUS
    steep = np.einsum("nc,nc->n", normal, -hits[on_ball]) > 0.1
    assert steep.mean() > 0.95
    assert error[steep].max() < EXACT_PX
    flow_error = answer.scene_flow[on_ball] - (moved - hits[on_ball])
    assert np.abs(flow_error[steep]).max() < 5e-6
    turns_to_us = np.einsum("nc,nc->n", moved - BALL_PLACE, -moved)
    sure = np.abs(turns_to_us) > 0.01
    u, v = (there[:, :2] / there[:, 2:]).T
    inside = (np.abs(u - 23.5) < 24) & (np.abs(v - 17.5) < 18)
    expected = (turns_to_us > 0) & inside
    assert np.array_equal(answer.visible[on_ball][sure], expected[sure])


@pytest.mark.parametrize("kind", ["velocity", "keyframes"])
def test_a_moving_distorted_camera_projects_as_opencv(kind):
    """The rig turns about its first camera, and the second one has OpenCV's distortion of five coefficients."""
    rates = {"velocity": SPEED, "angular_velocity_deg": 0.2 * SPIN}
    end = Keyframe(1.0, tuple(SPEED), Turn(tuple(SPIN), 0.2 * np.linalg.norm(SPIN)))
    motion = (
        Motion(**rates) if kind == "velocity" else Motion(keyframes=(Keyframe(0), end))
    )
    distortion = BrownConrady(-0.2, 0.05, 1e-3, -2e-3, 0.01)
    second = Camera(60, 50, 55.0, 54.0, 30.5, 24.0, distortion)
    first_pose = posed(turned([3, -4, 6]), [0.2, 0.1, -0.3])
    first_from_second = posed(turned([-2, 3, 5]), [0.15, -0.02, 0.01])
    rig = Rig([CAMERA, second], [first_pose, first_pose @ first_from_second]).moving(
        motion
    )
    wall = SceneObject(
        "wall", SQUARE, "grey", posed(PLANE_TURN, PLANE_PLACE, [9.0, 9.0, 1.0])
    )
    t1, t2 = 0.3, 0.8
    answer = tl.correspondence(scene_of(wall), rig, (0, t1), (1, t2))

    def first_at(time):
        return turned(time * 0.2 * SPIN) @ first_pose[:3, :3], first_pose[
            :3, 3
        ] + time * SPEED

    turn, centre = first_at(t1)
    rays = pixels_of(CAMERA).reshape(-1, 3) @ np.linalg.inv(CAMERA.K).T @ turn.T
    normal = PLANE_TURN[:, 2]
    points = (
        centre + rays * ((normal @ (PLANE_PLACE - centre)) / (rays @ normal))[:, None]
    )
    turn, centre = first_at(t2)
    second_turn = turn @ first_from_second[:3, :3]
    second_centre = centre + turn @ first_from_second[:3, 3]
    expected, _ = cv2.projectPoints(
        points,
        cv2.Rodrigues(second_turn.T)[0],
        -second_turn.T @ second_centre,
        second.K,
        np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    )
    error = answer.pixels.reshape(-1, 2) - expected.reshape(-1, 2)
    assert np.abs(error).max() < EXACT_PX
    assert np.array_equal(answer.scene_flow, np.zeros((HEIGHT, WIDTH, 3)))


CRATE_TURN = turned([20, 30, 10])
CRATE_SIZE = np.array([0.35, 0.25, 0.3])
CRATE_PLACE = np.array([0.6, 0.1, 2.2])
CRATE_SPEED = np.array([-0.9, 0.2, 0.1])
BALL_SPEED = np.array([0.5, -0.4, -0.2])


def crowd(motion=True):
    """A wall, and a ball and a crate that pass each other before it."""
    objects = (
        SceneObject(
            "wall", SQUARE, "grey", posed(PLANE_TURN, [0, 0, 4.0], [6.0, 6.0, 1.0])
        ),
        SceneObject(
            "ball", {"type": "sphere"}, "grey", posed(np.eye(3), BALL_PLACE, 0.4)
        ),
        SceneObject(
            "crate",
            {"type": "cube"},
            "grey",
            posed(CRATE_TURN, CRATE_PLACE, CRATE_SIZE),
        ),
    )
    motions = (
        Motion(object="ball", velocity=BALL_SPEED, angular_velocity_deg=(10, 50, 0)),
        Motion(object="crate", velocity=CRATE_SPEED, angular_velocity_deg=tuple(SPIN)),
    )
    return scene_of(*objects, motion=motions if motion else ())


def bodies_at(time):
    """The closed forms of `crowd`."""
    wall = Plate(np.array([0, 0, 4.0]), 6 * PLANE_TURN[:, 0], 6 * PLANE_TURN[:, 1])
    ball = Ball(BALL_PLACE + time * BALL_SPEED, 0.4)
    normals = (turned(time * SPIN) @ CRATE_TURN).T
    normals = np.concatenate([normals, -normals])
    centre = CRATE_PLACE + time * CRATE_SPEED
    return [wall, ball, Hull(normals, normals @ centre + np.tile(CRATE_SIZE, 2))]


RIG_SPEED = np.array([0.2, 0.05, 0.1])


def moved_by_hand(points, body, t1, t2):
    moved = points.copy()
    for number, place, speed, spin in (
        (1, BALL_PLACE, BALL_SPEED, np.array([10.0, 50.0, 0.0])),
        (2, CRATE_PLACE, CRATE_SPEED, SPIN),
    ):
        rows = body == number
        turn = turned((t2 - t1) * spin)
        moved[rows] = (points[rows] - place - t1 * speed) @ turn.T + place + t2 * speed
    return moved


@pytest.mark.parametrize(("t1", "t2"), [(0.0, 0.5), (0.7, 0.1)])
@pytest.mark.parametrize("target", [0, 1])
def test_visibility_is_that_of_brute_force(t1, t2, target):
    """None wrong outside 0.05 px of an edge."""
    rig = Rig.stereo(CAMERA, 0.2).moving(Motion(velocity=RIG_SPEED))
    answer = tl.correspondence(crowd(), rig, (0, t1), (target, t2))
    pose = posed(np.eye(3), t1 * RIG_SPEED)
    view = View(bodies_at(t1), Rig([CAMERA] * 2, [pose] * 2), 0)
    target_centre = t2 * RIG_SPEED + [0.2 * target, 0, 0]

    def visible(pixels):
        depth, body, _ = view.hits(pixels)
        points = moved_by_hand(view.points(pixels, depth), body, t1, t2)
        x, y, z = (points - target_centre).T
        u, v = 50 * x / z + 23.0, 52 * y / z + 18.5
        inside = (np.abs(u - 23.5) < 24) & (np.abs(v - 17.5) < 18) & (z > 0)
        return inside & seen_from(bodies_at(t2), target_centre, points)

    pixels = view.pixels()
    expected = visible(pixels)
    assert 0.2 < expected.mean() < 1
    wrong = answer.visible.ravel() != expected
    here = pixels[wrong]
    at_edge = view.near_edge(visible, here, 0.05) | view.near_edge(
        view.label, here, 0.05
    )
    assert at_edge.all()


def looking_at(pixel, rig):
    """The rig with a camera of one pixel that looks where the first camera has `pixel`, before the first camera."""
    u, v = pixel
    one = Camera(1, 1, CAMERA.fx, CAMERA.fy, CAMERA.cx - u, CAMERA.cy - v)
    pose = rig.world_from_cams[0]
    return Rig([one, CAMERA], [pose, pose]).moving(rig.motion)


def step(scene, rig, pixel, t1, t2):
    """Where the first camera sees at t2 what it has at `pixel` (not whole) at t1, and whether it does."""
    answer = tl.correspondence(scene, looking_at(pixel, rig), (0, t1), (1, t2))
    return answer.pixels[0, 0], bool(answer.visible[0, 0])


@pytest.fixture(scope="module")
def moving_rig():
    motion = Motion(velocity=RIG_SPEED, angular_velocity_deg=(2, -3, 4))
    return Rig.stereo(CAMERA, 0.2).moving(motion)


def test_many_steps_compose_to_one(moving_rig):
    """t1 to t9, through every frame between, where the point is visible in all of them."""
    scene = crowd()
    times = np.linspace(0.0, 0.4, 9).tolist()
    direct = tl.correspondence(scene, moving_rig, (0, times[0]), (0, times[-1]))
    followed = 0
    for u, v in [(10, 8), (15, 22), (20, 24), (24, 20), (33, 18), (36, 21), (40, 30)]:
        pixel, seen = np.array([u, v], float), True
        for t1, t2 in itertools.pairwise(times):
            if seen:
                pixel, seen = step(scene, moving_rig, pixel, t1, t2)
        if seen:
            followed += 1
            assert np.abs(pixel - direct.pixels[v, u]).max() < EXACT_PX
    assert followed >= 4


def test_forward_and_backward_are_inverse(moving_rig):
    scene = crowd()
    t1, t2 = 0.1, 0.45
    forward = tl.correspondence(scene, moving_rig, (0, t1), (0, t2))
    checked = 0
    for v in range(2, HEIGHT, 8):
        for u in range(3, WIDTH, 8):
            if forward.visible[v, u]:
                back, seen = step(scene, moving_rig, forward.pixels[v, u], t2, t1)
                assert seen
                assert np.abs(back - [u, v]).max() < EXACT_PX
                checked += 1
    assert checked > 12


def test_a_time_of_a_still_scene_and_rig_changes_nothing():
    scene, rig = crowd(motion=False), Rig.stereo(CAMERA, 0.2)
    still = tl.correspondence(scene, rig)
    timed = tl.correspondence(scene, rig, (0, 3.0), (1, 3.5))
    for name in ("pixels", "visible", "disparity", "scene_flow"):
        assert np.array_equal(getattr(still, name), getattr(timed, name))
    flow = tl.correspondence(scene, rig, (0, 0.0), (0, 1.0))
    assert np.abs(flow.flow).max() < 1e-9
    assert flow.visible.all()


def test_the_truth_at_a_time_is_that_of_the_still_scene(moving_rig):
    """And the moving scene is built once, whatever the order of times."""
    scene = crowd()
    for time in (0.4, 0.0, 0.4):
        answer = tl.correspondence(scene, moving_rig, (0, time), (1, time))
        truth = tl.ground_truth(scene.at(time), moving_rig.at(time), objects=False)[0]
        assert np.abs(answer.disparity - truth.disparity).max() < EXACT_PX
        assert (answer.visible != truth.visible).mean() < 0.005


def test_far_from_the_origin_of_the_world(moving_rig):
    """UTM coordinates: nothing is lost but what float64 has there."""
    far = np.array([432100.0, 5_400_000.0, 200.0])
    scene = crowd()
    shift = posed(np.eye(3), far)
    poses = {item.name: shift @ item.world_from_object for item in scene.objects}
    there = scene.with_poses(poses).at(shift)
    cameras = [shift @ pose for pose in moving_rig.world_from_cams]
    rig = Rig(moving_rig.cameras, cameras).moving(
        Motion(velocity=RIG_SPEED, angular_velocity_deg=(2, -3, 4))
    )
    near = tl.correspondence(scene, moving_rig, (0, 0.1), (1, 0.4))
    answer = tl.correspondence(there, rig, (0, 0.1), (1, 0.4))
    error = np.abs(answer.pixels - near.pixels)
    at_edges = np.abs(answer.disparity - near.disparity) > 0.01
    assert at_edges.mean() < 0.01
    assert error[~at_edges].max() < EXACT_PX


WRONG = [
    (
        (0, 0.0),
        (0, 0.0),
        r"a pair needs two different cameras .* or one camera at two times",
    ),
    (0, (2, 0.1), "the target camera must be a whole number from 0 to 1, got 2"),
    ((0.5, 0.1), 1, "the source camera must be a whole number"),
    ((0, np.nan), 1, "source: a time must be a finite number of seconds, got nan"),
    ((0, "now"), 1, "source: a time must be a finite number of seconds, got 'now'"),
    ((0, 1.0, 2.0), 1, r"source must be a camera, or \(camera, seconds\)"),
    (
        (0, 0.5),
        (1, 2.5),
        "keyframes of object 'ball': covers 0 s to 2 s, but is asked for 2.5 s",
    ),
]


@pytest.mark.parametrize(("source", "target", "message"), WRONG)
def test_what_is_no_camera_and_time_is_refused(source, target, message):
    motion = Motion(object="ball", keyframes=(Keyframe(0), Keyframe(2)))
    scene = crowd(motion=False).moving(motion)
    with pytest.raises(InputError, match=message) as error:
        tl.correspondence(scene, Rig.stereo(CAMERA, 0.2), source, target)
    assert "\n" not in str(error.value)


def test_functions_of_one_time_refuse_what_moves(moving_rig):
    still = Rig.stereo(CAMERA, 0.2)
    for call in (tl.ground_truth, tl.render):
        with pytest.raises(
            InputError, match=r"the scene 'moving' moves, .* use scene.at\(seconds\)"
        ):
            call(crowd(), still)
        with pytest.raises(
            InputError, match=r"the rig moves, .* use rig.at\(seconds\)"
        ):
            call(crowd(motion=False), moving_rig)


def test_the_nominal_and_the_rectified_rig_move_along():
    camera = tl.Camera.from_fov(64, 48, 60)
    errors = [Misalignment(), Misalignment(yaw_deg=0.1)]
    rig = misaligned(tl.Rig.stereo(camera, 0.1), errors)
    moved = rig.moving(tl.Motion(velocity=(1, 0, 0)))
    for still in (moved.nominal.at(2.0), moved.at(2.0).nominal):
        np.testing.assert_allclose(still.world_from_cams[0][:3, 3], [2, 0, 0])
    rectified = rectify(moved).rectified_rig.at(2.0)
    np.testing.assert_allclose(rectified.world_from_cams[0][:3, 3], [2, 0, 0])
