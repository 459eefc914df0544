"""Rectification: rows agree, rotations and maps equal OpenCV, and impossible pairs raise."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.rigs import random_rig, rotation, seen
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Misalignment, Rig
from twinlens.camera.layouts import grid, line, toed_in
from twinlens.camera.rectification import Rectification, rectify
from twinlens.errors import InputError

CAMERA = Camera(640, 480, 700.0, 690.0, 310.25, 241.0)


@pytest.fixture(scope="module")
def pairs():
    """Pairs of different cameras with similar directions, and a cloud that both see."""
    return [alike(np.random.default_rng(seed)) for seed in range(30)]


def alike(rng):
    rig, _ = random_rig(rng, distorted=True)
    world = geometry.rigid(rotation(rng), rng.uniform(-5, 5, 3))
    poses = [
        geometry.rigid(rotation(rng, 0.15), place)
        for place in ([0, 0, 0], [0.4, *rng.uniform(-0.1, 0.1, 2)])
    ]
    points = geometry.transform_points(
        world, rng.uniform([-0.3, -0.3, 2], [0.5, 0.3, 4], (20, 3))
    )
    return Rig(rig.cameras, [world @ pose for pose in poses]), points


def rectified(result, points, side):
    return result.rectified_pixels(side, seen(result.pair, points, side))


def test_rows_agree_and_disparity_gives_depth(pairs):
    for rig, points in pairs:
        result = rectify(rig)
        assert result.rectified_rig.is_rectified()
        left, right = (rectified(result, points, side) for side in (0, 1))
        assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-6
        new = result.rectified_rig
        depth = geometry.transform_points(
            geometry.inverse(new.world_from_cams[0]), points
        )[:, 2]
        disparity = new.cameras[0].fx * result.baseline / depth - result.doffs
        assert np.allclose(left[:, 0] - right[:, 0], disparity, atol=1e-6)


def test_rectified_cameras_and_pixel_maps_agree(pairs):
    """Projection by `rectified_rig` and the pixel maps agree."""
    for rig, points in pairs:
        result = rectify(rig, misalignment=Misalignment(1.5, 0.1, -0.2, 0.3))
        for side in (0, 1):
            cast = seen(result.rectified_rig, points, side)
            assert np.allclose(cast, rectified(result, points, side), atol=1e-8)
            assert np.allclose(
                result.source_pixels(side, cast), seen(rig, points, side), atol=1e-8
            )


def opencv_rotations(rig):
    right_from_left = rig.b_from_a(0, 1)
    calibration = []
    for camera in rig.cameras:
        model = camera.distortion
        coefficients = np.zeros(5) if model is None else np.array(model.coefficients)
        calibration += [camera.K, coefficients]
    turn, shift = right_from_left[:3, :3], right_from_left[:3, 3:].copy()
    return cv2.stereoRectify(*calibration, (640, 480), turn, shift, alpha=-1)[:2]


def test_rotations_equal_opencv(pairs):
    for rig, _ in pairs:
        models = [camera.distortion for camera in rig.cameras]
        if not any(isinstance(model, KannalaBrandt) for model in models):
            result = rectify(rig)
            for side, rotation_of_side in enumerate(opencv_rotations(rig)):
                assert np.allclose(result.rotation(side), rotation_of_side, atol=1e-6)


def test_maps_equal_opencv():
    camera = CAMERA.replace(distortion=BrownConrady(-0.1, 0.02, 1e-3, -5e-4))
    result = rectify(toed_in(camera, 0.3, 2.0))
    for side in (0, 1):
        new = result.rectified_rig.cameras[side]
        theirs = cv2.initUndistortRectifyMap(
            camera.K,
            np.array(camera.distortion.coefficients),
            result.rotation(side),
            new.K,
            (640, 480),
            cv2.CV_32FC1,
        )
        assert all(
            np.allclose(a, b, atol=1e-3)
            for a, b in zip(result.maps(side), theirs, strict=True)
        )
        inside = [
            (m >= 0) & (m <= n - 1) for m, n in zip(theirs, (640, 480), strict=True)
        ]
        assert (result.valid(side) != (inside[0] & inside[1])).mean() < 1e-4


def test_a_parallel_pair_does_not_change():
    camera = CAMERA.replace(fy=700.0, cx=319.5, cy=239.5)
    result = rectify(line(camera, 2, 0.1))
    assert pytest.approx(camera.K) == result.rectified_rig.cameras[0].K
    assert np.allclose(result.maps(0)[0], np.arange(640), atol=1e-4)
    assert result.valid(1)[1:-1, 1:-1].all()


def test_a_vertical_pair_is_rotated_by_90_degrees():
    result = rectify(grid(CAMERA, 2, 1, 0.1, 0.1), width=480, height=640)
    assert result.rectified_rig.is_rectified()
    assert np.allclose(
        np.abs(result.rotation(0)), [[0, 1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12
    )


def test_without_zero_doffs_each_image_is_centred_on_its_view():
    rig = toed_in(CAMERA, 0.5, 1.5)
    shared, centred = rectify(rig), rectify(rig, zero_doffs=False)
    assert shared.doffs == 0
    assert centred.valid(0).mean() > shared.valid(0).mean() + 0.05
    for side in (0, 1):
        u, _ = centred.rectified_pixels(side, [[0.0, 240.0], [639.0, 240.0]]).T
        assert u.mean() == pytest.approx(319.5, abs=3)


def test_fit_all_shows_every_pixel_and_fit_valid_has_no_empty_ones(pairs):
    for rig, _ in pairs[:5]:
        whole = rectify(rig, fit="all", zero_doffs=False)
        full = rectify(rig, fit="valid", zero_doffs=False)
        for side in (0, 1):
            corners = whole.rectified_pixels(
                side, [[0, 0], [639, 0], [0, 479], [639, 479]]
            )
            assert (corners > -1e-6).all()
            assert (corners < (639 + 1e-6, 479 + 1e-6)).all()
            assert full.valid(side).mean() > 1 - 1e-5
        loose = wider(full.rectified_rig, 0.99)
        looser = Rectification(full.pair, loose, loose)
        assert not (looser.valid(0).all() and looser.valid(1).all())


def wider(rig, factor):
    """The same cameras with `factor` times their focal length and the same centre."""
    middle = np.array([319.5, 239.5])
    shorter = []
    for camera in rig.cameras:
        cx, cy = middle + factor * (np.array([camera.cx, camera.cy]) - middle)
        shorter.append(
            camera.replace(fx=camera.fx * factor, fy=camera.fy * factor, cx=cx, cy=cy)
        )
    return Rig(shorter, rig.world_from_cams)


def test_vertical_misalignment_shifts_rows():
    rig = toed_in(CAMERA, 0.3, 2.0)
    points = np.random.default_rng(0).uniform([-0.3, -0.3, 1.5], [0.3, 0.3, 3], (20, 3))
    off = rectify(rig, misalignment=Misalignment(vertical_px=1.25))
    left, right = (rectified(off, points, side) for side in (0, 1))
    assert np.allclose(right[:, 1] - left[:, 1], 1.25, atol=1e-9)
    assert off.aligned_rig.is_rectified()
    assert not off.rectified_rig.is_rectified()


@pytest.mark.parametrize(
    ("name", "axis"), [("pitch_deg", "x"), ("yaw_deg", "y"), ("roll_deg", "z")]
)
def test_rotational_misalignment_turns_the_rays_of_the_second_camera_only(name, axis):
    rig = line(CAMERA, 2, 0.2)
    pixels = np.array([[100.0, 100.0], [500.0, 300.0]])
    straight, turned = (
        rectify(rig, misalignment=Misalignment(**{name: degrees}))
        for degrees in (0.0, 0.5)
    )
    unturned = straight.rectified_pixels(0, pixels)
    assert np.allclose(turned.rectified_pixels(0, pixels), unturned, atol=1e-12)
    camera = straight.rectified_rig.cameras[1]
    rays = camera.unproject(straight.rectified_pixels(1, pixels))
    moved = Rotation.from_euler(axis, -0.5, degrees=True).apply(rays)
    expected = camera.project(moved)
    assert np.allclose(turned.rectified_pixels(1, pixels), expected, atol=1e-9)


def two(place, turn=(0, 0, 0)):
    return Rig(
        [CAMERA] * 2,
        [np.eye(4), geometry.rigid(cv2.Rodrigues(np.array(turn, float))[0], place)],
    )


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: rectify(two([0, 0, 0])), "centres coincide"),
        (lambda: rectify(two([0.01, 0, 0.5])), "looks along the baseline"),
        (lambda: rectify(two([0.5, 0, 0], (0, -1.5, 0))), "looks along the baseline"),
        (lambda: rectify(two([0.27, 0, 0.5])), "85 degrees"),
        (lambda: rectify(two([-0.5, 0, 0])), "exchange the two cameras"),
        (lambda: rectify(two([0.5, 0, 0]), 0, 2), "from 0 to 1"),
        (lambda: rectify(two([0.5, 0, 0]), fit="al"), "did you mean 'all'"),
        (lambda: rectify(two([0.5, 0, 0]), width=0), "width"),
        (
            lambda: rectify(two([0.1, 0, 0], (0, 0.9, 0)), fit="valid"),
            "zero_doffs=False",
        ),
        (lambda: Misalignment(roll_deg=np.nan), "roll_deg"),
    ],
)
def test_pairs_that_cannot_be_rectified_raise(make, says):
    with pytest.raises(InputError, match=says):
        make()


# Fisheyes of about 195 degrees (as TUM VI), of 180, and one turned by 20; the first sees the other camera.
FISHEYES = [
    (512, 512, 190.97, (-0.013, 0.021, -0.016, 0.004), 1.0),
    (640, 480, 203.0, (0.01, -0.004, 0.001, 0.0), 1.0),
    (640, 400, 160.0, (0.0, 0.0, 0.0, 0.0), 20.0),
]


@pytest.mark.parametrize(("width", "height", "focal", "k", "turn_deg"), FISHEYES)
@pytest.mark.parametrize("fit", ["focal", "valid"])
def test_a_fisheye_is_cropped_around_the_middle_of_its_image(
    width, height, focal, k, turn_deg, fit
):
    camera = Camera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), KannalaBrandt(*k))  # fmt: skip
    turn = Rotation.from_euler("xyz", [0.3, turn_deg, 0.5], degrees=True).as_matrix()
    pair = Rig([camera] * 2, [np.eye(4), geometry.rigid(turn, [0.11, 0.002, -0.001])])
    assert camera.rays([0.0, 0.0])[2] < np.cos(np.radians(80))
    result = rectify(pair, fit=fit)
    assert result.rectified_rig.is_rectified()
    points = np.random.default_rng(3).uniform([-0.5, -0.5, 1.5], [0.6, 0.5, 4], (40, 3))
    left, right = (rectified(result, points, side) for side in (0, 1))
    assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-6
    new = result.rectified_rig
    depth = geometry.transform_points(geometry.inverse(new.world_from_cams[0]), points)
    disparity = new.cameras[0].fx * result.baseline / depth[:, 2]
    assert np.allclose(left[:, 0] - right[:, 0], disparity, atol=1e-6)
    # OpenCV's fisheye model has the same source pixel for every rectified one.
    rows, columns = np.mgrid[:height:40, :width:40]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float)
    rays = new.cameras[0].unproject(pixels) @ result.rotation(0)
    ahead = rays[:, 2] > 0.05
    expected, _ = cv2.fisheye.projectPoints(
        rays[ahead][:, None], np.zeros(3), np.zeros(3), camera.K, np.array(k)
    )
    assert np.allclose(
        result.source_pixels(0, pixels)[ahead], expected[:, 0], atol=1e-6
    )
    if fit == "valid":
        assert min(result.valid(side).mean() for side in (0, 1)) > 1 - 1e-4
    with pytest.raises(InputError, match="'focal' and 'valid' show the part"):
        rectify(pair, fit="all")


@pytest.mark.parametrize("fit", ["valid", "all"])
def test_the_principal_point_of_a_rectified_pair_stays_in_the_middle(fit):
    """Exactly: rotations alone leave rounding errors."""
    pose = geometry.rigid(rotation(np.random.default_rng(0)), (0.3, -0.2, 1.1))
    pair = Rig.stereo(Camera.from_fov(320, 240, fov_x_deg=50), 0.1, pose)
    assert [
        (camera.cx, camera.cy)
        for camera in rectify(pair, fit=fit).rectified_rig.cameras
    ] == [(159.5, 119.5)] * 2
