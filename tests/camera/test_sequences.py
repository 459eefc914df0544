"""Sequences of patterns: what a projector shows in each frame, how they are decoded, and where the points are."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import twinlens as tl
from twinlens import geometry
from twinlens.camera import (
    BrownConrady,
    Camera,
    GrayCode,
    PhaseShift,
    Projector,
    Rig,
    Still,
    decode_sequence,
    patterns,
)
from twinlens.camera.light_planes import light_plane_points
from twinlens.dataset.record import RIG, plain, read
from twinlens.errors import InputError

LENS = Camera(64, 48, 80.0, 70.0, 20.0, 30.0)
CODES = ["white", GrayCode(64, 48), PhaseShift(64, 48, 16, 3, "v")]
TURN = Rotation.from_euler("xyz", [3, -16, 10], degrees=True).as_matrix()
POSE = geometry.rigid(TURN, [0.25, 0.02, -0.01])
ABOVE = geometry.rigid(
    Rotation.from_euler("xyz", [-16, 3, 10], degrees=True).as_matrix(),
    [0.02, -0.25, -0.01],
)


def test_each_frame_shows_one_pattern_after_another():
    projector = Projector(None, LENS, sequence=CODES)
    assert projector.num_frames == 1 + 12 + 3
    assert (projector.pattern == 1).all()
    expected = [patterns.white(64, 48), *CODES[1].patterns, *CODES[2].patterns]
    assert np.array_equal(projector.patterns, expected)
    shown = projector.at_frame(13)
    assert shown.sequence == ()
    assert np.array_equal(shown.pattern, CODES[2].patterns[0])
    for frame in (-1, 16, 1.5):
        with pytest.raises(
            InputError, match="frame must be a whole number from 0 to 15"
        ):
            projector.at_frame(frame)
    still = Projector(None, LENS, "dots")
    assert still.num_frames == 1
    assert still.with_sequence(CODES).with_pattern("dots").agrees_with(still)


def test_a_rig_has_the_frames_of_its_projectors_and_its_record_keeps_them():
    moving, still = Projector(POSE, LENS, sequence=CODES), Projector(None, LENS, "dots")
    rig = tl.Rig.stereo(LENS.replace(band="nir"), 0.1).with_projectors([moving, still])
    assert rig.num_frames == 16
    frame = rig.at_frame(3)
    assert np.array_equal(frame.projectors[0].pattern, moving.patterns[3])
    assert np.array_equal(frame.projectors[1].pattern, still.pattern)
    record = plain(rig)
    assert record["projectors"][0]["sequence"][1]["type"] == "GrayCode"
    assert "sequence" not in record["projectors"][1]
    copy = read(RIG, record, "sample.json")
    assert copy.projectors[0].agrees_with(moving)
    assert copy.projectors[0].sequence[1:] == moving.sequence[1:]
    with pytest.raises(InputError, match=r"equally many patterns, got \[16, 1\]"):
        rig.with_projectors([moving, still.with_sequence(["dots"])])


@pytest.mark.parametrize(
    ("sequence", "problem"),
    [
        ("white", "must be a list of codes and patterns"),
        ([GrayCode(48, 64)], "must have the size 64 x 48"),
        ([np.ones((4, 4))], r"must have the shape \(48, 64\)"),
        (["wihte"], "did you mean 'white'"),
        ([np.full((48, 64), 2.0)], "values from 0 to 1"),
        (["white"] * 1001, "may have at most 1000 patterns, got 1001"),
        (7, "must be a list of codes and patterns, got 7"),
    ],
)
def test_wrong_sequences_are_refused(sequence, problem):
    with pytest.raises(InputError, match=problem):
        Projector(None, LENS, sequence=sequence)


def test_a_pattern_and_another_sequence_exclude_each_other():
    with pytest.raises(InputError, match="not both"):
        Projector(None, LENS, "dots", sequence=CODES)


def own_gray_positions(images):
    """The columns of a Gray code: a bit is 1 where an image is brighter than its inverse; g xor g/2 xor g/4 ..."""
    gray = np.zeros(images[0].shape, dtype=int)
    for lit, inverse in zip(images[0::2], images[1::2], strict=True):
        gray = gray * 2 + (lit > inverse)
    binary = gray.copy()
    while (gray := gray >> 1).any():
        binary ^= gray
    return binary


def test_a_sequence_decodes_to_the_positions_that_were_seen():
    """Images are the patterns looked up at known positions, darker by an albedo, with ambient light and noise."""
    rng = np.random.default_rng(1)
    u, v = rng.uniform(1, 62, (30, 40)), rng.uniform(1, 46, (30, 40))
    codes = [
        Still(patterns.white(64, 48)),
        PhaseShift(64, 48, 8, 4, "u"),
        GrayCode(64, 48, "v"),
        PhaseShift(64, 48, 80, 5, "u"),
    ]
    albedo = rng.uniform(0.2, 1, u.shape)
    shown = [pattern for code in codes for pattern in map(code.pattern, range(code.num_patterns))]  # fmt: skip
    images = []
    for pattern in shown:
        seen = cv2.remap(pattern, np.float32(u), np.float32(v), cv2.INTER_LINEAR)
        images.append(albedo * seen + 0.1 + rng.normal(0, 1e-3, u.shape))
    decoded = decode_sequence(images, codes)
    assert decoded.keys() == {"u", "v"}
    assert np.abs(decoded["u"].position - u).max() < 0.2  # of linear interpolation
    assert np.abs(decoded["v"].position - v).max() < 0.05
    nearest = np.rint(v)
    assert (own_gray_positions(images[5:17]) == nearest).mean() > 0.97
    assert (np.rint(decoded["v"].position) == nearest).mean() > 0.97


@pytest.mark.parametrize(
    ("codes", "problem"),
    [
        ([PhaseShift(64, 48, 16)], "repeats across 64: add a Gray code"),
        ([PhaseShift(64, 48, 16, 3), GrayCode(64, 48, "v")], "repeats across 64"),
        ([Still(np.ones((48, 64)))], "needs a Gray code or a phase shift"),
    ],
)
def test_sequences_that_cannot_be_decoded_say_what_they_lack(codes, problem):
    count = sum(code.num_patterns for code in codes)
    with pytest.raises(InputError, match=problem):
        decode_sequence([np.ones((4, 5))] * count, codes)
    with pytest.raises(InputError, match=f"has {count} patterns, got {count + 1}"):
        decode_sequence([np.ones((4, 5))] * (count + 1), codes)


@pytest.mark.parametrize("axis", ["u", "v"])
@pytest.mark.parametrize("distortion", [None, (-0.2, 0.05, 1e-3, -1e-3)])
def test_points_in_planes_of_light_are_those_that_opencv_projects(axis, distortion):
    rng = np.random.default_rng(2)
    camera = Camera(40, 30, 35.0, 36.0, 19.0, 14.0, BrownConrady(0.1, -0.02))
    lens = LENS.replace(distortion=distortion and BrownConrady(*distortion))
    depth = rng.uniform(1.0, 2.0, (30, 40))
    rays = camera.unproject(camera.pixel_grid()).reshape(-1, 3)
    in_camera = depth.reshape(-1, 1) * rays
    # Rows give depth where the projector is above or below the camera.
    pose = POSE if axis == "u" else ABOVE
    turn, shift = pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]
    seen, _ = cv2.projectPoints(
        in_camera, cv2.Rodrigues(turn)[0], shift, lens.K, np.array(distortion or [0.0] * 4)
    )  # fmt: skip
    position = seen[:, 0, "uv".index(axis)].reshape(30, 40)
    world_from_camera = geometry.rigid(TURN.T, [3.0, -2.0, 1.0])
    rig = Rig([camera], [world_from_camera], projectors=[Projector(pose, lens)])
    position[0, 0] = np.inf
    points = light_plane_points(rig, 0, 0, position, axis)
    expected = geometry.transform_points(world_from_camera, in_camera)
    assert np.isinf(points[0, 0]).all()
    error = np.linalg.norm(points.reshape(-1, 3)[1:] - expected[1:], axis=1)
    assert error.max() < 1e-6


def test_points_behind_a_device_are_unknown():
    camera = Camera.from_fov(8, 6, 40)
    lens = Camera.from_fov(64, 48, 50)
    rig = Rig([camera], [np.eye(4)], projectors=[Projector(geometry.rigid(np.eye(3), [0.2, 0, 0]), lens)])  # fmt: skip
    right_of_ray = np.full((6, 8), 200.0)  # its plane meets the rays behind the camera
    assert np.isinf(light_plane_points(rig, 0, 0, right_of_ray)).all()
    with pytest.raises(InputError, match=r"\(H, W\) = \(6, 8\)"):
        light_plane_points(rig, 0, 0, np.ones((8, 6)))
