"""Distortion against OpenCV, against its inverse, and at the fold."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from twinlens.camera import BrownConrady, Camera, KannalaBrandt, undistort_maps
from twinlens.errors import InputError
from twinlens.geometry import look_at


def small(bound: float):
    return st.floats(-bound, bound, allow_subnormal=False)


# Coefficients as calibrations give them: bent, not folded within a field of 53 degrees to each side.
brown = st.builds(
    BrownConrady,
    small(0.08),
    small(0.02),
    small(0.004),
    small(0.004),
    small(0.005),
    small(0.05),
    small(0.02),
    small(0.004),
)
fisheye = st.builds(KannalaBrandt, small(0.05), small(0.02), small(0.005), small(0.001))


def rays(seed: int, count: int = 200, reach: float = 1.0) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-reach, reach, (count, 2))
    return np.column_stack([xy, np.ones(count)])


def camera(distortion, fx: float = 700.0, fy: float = 650.0) -> Camera:
    return Camera(640, 480, fx, fy, 330.25, 211.5, distortion)


def opencv_projection(model, points: np.ndarray) -> np.ndarray:
    cam = camera(model)
    if isinstance(model, BrownConrady):
        px, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), cam.K, np.array(model.coefficients)
        )
    else:
        px = cv2.fisheye.distortPoints(
            points[None, :, :2] / points[None, :, 2:],
            cam.K,
            np.array(model.coefficients),
        )
    return px.reshape(-1, 2)


@settings(max_examples=60, deadline=None)
@given(st.one_of(brown, fisheye), st.integers(0, 2**31))
def test_projection_equals_opencv(model, seed):
    points = rays(seed, reach=0.6) * np.random.default_rng(seed).uniform(
        0.1, 50, (200, 1)
    )
    mine = camera(model).project(points)
    assert np.abs(mine - opencv_projection(model, points)).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(st.one_of(brown, fisheye), st.integers(0, 2**31))
def test_undistort_inverts_distort(model, seed):
    xy = rays(seed)[:, :2]
    xy = xy[model.valid(xy)]
    back = model.undistort(model.distort(xy))
    # the inverse of a nearly singular map loses digits: away from the fold it keeps twelve
    steep = np.array([np.linalg.norm(numeric_jacobian(model, p), -2) for p in xy]) < 0.1
    assert np.abs(back - xy)[~steep].max() < 1e-10
    assert np.abs(model.distort(back) - model.distort(xy)).max() < 1e-11


def numeric_jacobian(model, point: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Central differences, (2, 2)."""
    ends = [
        (model.distort(point + d) - model.distort(point - d)) / (2 * step)
        for d in step * np.eye(2)
    ]
    return np.stack(ends, axis=1)


def test_a_point_beyond_the_fold_has_no_pixel():
    """r (1 - 0.3 r^2) has its maximum at r = 1/sqrt(0.9): farther points would be projected into the image again."""
    model = BrownConrady(k1=-0.3)
    fold = 1 / math.sqrt(0.9)
    cam = Camera(200, 200, 300.0, 300.0, 99.5, 99.5, model)
    assert np.isfinite(cam.project([[0.99 * fold, 0, 1]])).all()
    assert np.isnan(cam.project([[1.01 * fold, 0, 1], [1.9, 0, 1]])).all()
    assert np.isfinite(model.distort([1.9, 0])).all()
    assert np.isnan(model.undistort([0.75, 0.0])).all()
    assert np.isnan(cam.project([[0, 0, -1.0], [1e9, 0, 1e-9]])).all()


@pytest.mark.parametrize("edge", [0.999, 1.001])
def test_the_image_may_reach_up_to_the_fold(edge):
    """The fold at the radius 1/sqrt(0.9) has 2/3 of it as its image: an image that ends before it is accepted."""
    fx = 100 / (edge * 2 / 3 / math.sqrt(0.9))

    def make() -> Camera:
        return Camera(200, 2, fx, fx, 99.5, 0.5, BrownConrady(k1=-0.3))

    if edge < 1:
        assert np.isfinite(make().unproject(make().pixel_grid())).all()
    else:
        with pytest.raises(InputError, match="folds the image over itself"):
            make()


@pytest.mark.parametrize(
    "model",
    [
        BrownConrady(k1=-0.9),
        BrownConrady(k1=-2.0, k2=1.5),
        BrownConrady(k4=-4.0),
        BrownConrady(p1=0.6),
        BrownConrady(p2=-2.0),
        KannalaBrandt(k1=-0.9),
    ],
    ids=str,
)
def test_folding_distortion_raises_in_one_line(model):
    with pytest.raises(
        InputError, match=r"folds the image over itself before pixel \("
    ) as refusal:
        Camera.from_fov(640, 480, fov_x_deg=90).replace(distortion=model)
    assert "\n" not in str(refusal.value)


def test_a_fisheye_image_beyond_360_degrees_raises():
    assert Camera(400, 400, 100.0, 100.0, 199.5, 199.5, KannalaBrandt()).is_wide
    with pytest.raises(
        InputError, match=r"-0.5\), which is more than 180 degrees from"
    ):
        Camera(400, 400, 80.0, 80.0, 199.5, 199.5, KannalaBrandt())


FISHEYES = {
    # Calibrations of TUM VI (Kalibr), Intel T265, OpenCV's tests, and of equidistant lenses of 190 and 220 degrees.
    "tum": (512, 512, 190.978, 190.973, 254.932, 256.897, (0.0034823894, 0.0007150348, -0.0020532361, 0.0002029367)),
    "t265": (848, 800, 286.18, 286.32, 421.37, 398.8, (-0.00666, 0.0448, -0.0420, 0.00787)),
    "opencv": (1280, 800, 558.478, 620.459, 638.18, 381.94, (-0.00146133, -0.00329861, 0.00605760, -0.00374209)),
    "190": (1000, 1000, 301.5, 301.5, 499.5, 499.5, (0.0, 0.0, 0.0, 0.0)),
    "220": (1280, 960, 275.0, 275.0, 639.5, 479.5, (-0.005, 0.0, 0.0, 0.0)),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", FISHEYES)
def test_calibrations_of_wide_fisheyes_are_used_up_to_their_corners(name):
    *intrinsics, coefficients = FISHEYES[name]
    cam = Camera(*intrinsics, distortion=KannalaBrandt(*coefficients))
    corner = np.array([-0.5, -0.5])
    film = (corner - cam.K[:2, 2]) / (cam.fx, cam.fy)
    # The angle of the corner by a search on a fine grid, on which theta_d rises.
    theta = np.linspace(0, math.pi, 2_000_001)
    k1, k2, k3, k4 = coefficients
    theta_d = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9
    angle = theta[np.searchsorted(theta_d, np.linalg.norm(film))]
    x, y, z = cam.rays(corner)
    assert math.atan2(math.hypot(x, y), z) == pytest.approx(angle, abs=3e-6)
    assert cam.project([x, y, z]) == pytest.approx(corner, abs=1e-6)


@pytest.mark.parametrize(
    ("fx", "k1", "angle"), [(200.0, -0.05, "147.9"), (150.0, -0.1, "104.6"), (190.0, -0.3, "60.4")]
)  # fmt: skip
def test_a_fisheye_that_folds_is_refused_with_the_angle(fx, k1, angle):
    """theta + k1 theta^3 has its maximum at sqrt(-1 / (3 k1))."""
    assert float(angle) == pytest.approx(
        math.degrees(math.sqrt(-1 / (3 * k1))), rel=1e-3
    )
    with pytest.raises(InputError, match=f"theta_d falls beyond {angle} degrees"):
        Camera(640, 480, fx, fx, 319.5, 239.5, KannalaBrandt(k1))


@pytest.mark.parametrize("turned", [False, True])
def test_undistort_maps_equal_opencv(turned):
    rotation = (
        look_at([0, 0, 0], [0.05, 0.02, 1.0], up=[0, -1, 0])[:3, :3]
        if turned
        else np.eye(3)
    )
    model = BrownConrady(-0.25, 0.08, 1e-3, -5e-4, 0.01)
    source, target = camera(model), Camera(320, 240, 300.0, 310.0, 150.0, 121.0)
    mine = undistort_maps(source, target, to_from_camera=rotation)
    theirs = cv2.initUndistortRectifyMap(
        source.K,
        np.array(model.coefficients),
        rotation,
        target.K,
        (320, 240),
        cv2.CV_32FC1,
    )
    assert all(m.dtype == np.float32 and m.shape == (240, 320) for m in mine)
    assert max(np.abs(m - t).max() for m, t in zip(mine, theirs, strict=True)) < 1e-3


def test_unseen_pixels_map_outside():
    cam = camera(None)
    map_x, map_y = undistort_maps(cam, cam, to_from_camera=np.diag([-1.0, 1.0, -1.0]))
    assert (map_x < -100).all()
    assert (map_y < -100).all()


def test_a_matrix_that_is_not_a_rotation_raises():
    with pytest.raises(InputError, match="rotation"):
        undistort_maps(camera(None), camera(None), to_from_camera=2 * np.eye(3))
    with pytest.raises(InputError, match="mirror image"):
        undistort_maps(
            camera(None), camera(None), to_from_camera=np.diag([-1.0, 1.0, 1.0])
        )
