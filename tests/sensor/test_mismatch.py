"""Differences between cameras, measured back from exposed flat fields, steps, points and colours."""

import math

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from tests.sensor.flat_fields import (
    CAMERA,
    QUIET,
    RIG,
    WHITE,
    colours,
    correlation,
    exposure_to,
    shot,
)
from twinlens.camera import (
    BareAperture,
    BrownConrady,
    Camera,
    KannalaBrandt,
    Pinhole,
    Rig,
    ThinLens,
)
from twinlens.errors import InputError
from twinlens.sensor import LEVELS, Exposure, Mismatch, Sensor
from twinlens.sensor.mismatch import SPREADS

PINHOLE = Pinhole()
NOISY = Sensor(output="linear", bits=16)
BRIGHT = 0.5
"""Share of white of a radiance of 1 in the first camera."""


def pair(sensor, image, exposure=BRIGHT, lens=PINHOLE, **mismatch):
    """Linear values of both cameras, of which `exposure` is that of a radiance of 1."""
    photos = sensor.replace(mismatch=Mismatch(**mismatch)).expose_pair(
        image,
        image,
        rig=RIG,
        lens=lens,
        exposure=exposure_to(exposure, sensor, lens=lens),
    )
    left, right = (photo.image.astype(np.float64) / 65535 for photo in photos)
    return left, right


def black_beside_white():
    step = WHITE.copy()
    step[:, :48] = 0
    return step


def test_the_f_number_is_that_of_a_narrower_lens():
    wide = ThinLens(CAMERA.film_distance / 4, 2.0)
    narrow = wide.replace(aperture_diameter=wide.aperture_diameter / 1.2)
    exposure = exposure_to(BRIGHT, QUIET, lens=wide)
    expected = shot(QUIET, lens=narrow, exposure=exposure).image.mean() / 65535
    _, right = pair(QUIET, WHITE, lens=wide, f_number=1.2)
    assert right.mean() == pytest.approx(expected, rel=1e-3)


def test_shading_from_a_noisy_flat_field():
    """A least-squares fit of 1, x, y and r^2, with distances in pixels."""
    shading = {"shading_right": 0.1, "shading_down": -0.05, "shading_corner": 0.2}
    left, right = pair(NOISY, WHITE, **shading)
    v, u = np.mgrid[:64, :96]
    x, y = (u - 47.5).ravel(), (v - 31.5).ravel()
    ratio = right.mean(axis=-1).ravel() / left.mean()
    terms = np.stack([x**0, x, y, x**2 + y**2], axis=1)
    one, across, down, round_ = np.linalg.lstsq(terms, ratio, rcond=None)[0]
    assert one == pytest.approx(1, abs=0.02)
    assert across * 47.5 == pytest.approx(0.1, abs=0.002)
    assert down * 31.5 == pytest.approx(-0.05, abs=0.002)
    assert round_ * (47.5**2 + 31.5**2) == pytest.approx(-0.2, abs=0.01)


def test_veiling_glare_fills_a_black_half_of_the_image():
    left, right = pair(QUIET, black_beside_white(), veiling_glare=0.06)
    assert right[:, :48] == pytest.approx(BRIGHT * 0.03, abs=1e-4)
    assert right[:, 48:] == pytest.approx(BRIGHT * 0.97, abs=1e-4)
    assert right.sum() == pytest.approx(left.sum(), rel=1e-4)


def test_veiling_glare_is_even_on_a_film_with_vignetting():
    lens, spot = ThinLens(CAMERA.film_distance / 1.4, 2.0), np.zeros_like(WHITE)
    spot[24:40, 40:56] = 1
    left, right = pair(QUIET, spot, lens=lens, veiling_glare=0.2)
    assert right[spot == 0] == pytest.approx(0.2 * left.mean(), abs=1e-4)


def test_the_record_has_the_f_number_of_each_camera():
    sensor = QUIET.replace(mismatch=Mismatch(f_number=1.2))
    photos = sensor.expose_pair(WHITE, WHITE, rig=RIG, lens=PINHOLE)
    left, right = (photo.record for photo in photos)
    assert right["working_f_number"] == pytest.approx(1.2 * left["working_f_number"])
    assert right["ev"] == pytest.approx(left["ev"] + 2 * math.log2(1.2))
    ratio = right["mean_electrons"] / left["mean_electrons"]
    rates = right["electrons_per_radiance"], left["electrons_per_radiance"]
    assert np.divide(*rates) == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("degrees", "bright"),
    [(0, (32, 95)), (90, (63, 48)), (180, (32, 0)), (225, (0, 0))],
)
def test_stray_light_grows_towards_its_direction(degrees, bright):
    black = WHITE.copy()
    black[20:40, 20:40] = 0
    left, right = pair(QUIET, black, stray_light=0.1, stray_direction_deg=degrees)
    added = (right - left).mean(axis=-1) / left.mean()
    assert added.mean() == pytest.approx(0.1, rel=1e-3)
    assert added[bright] == pytest.approx(0.2, rel=0.02)
    assert added[63 - bright[0], 95 - bright[1]] == pytest.approx(0, abs=0.01)


def test_blur_has_its_standard_deviation_and_conserves_light():
    for row, column in ((30, 50), (0, 0)):
        point = np.zeros((64, 96, 3))
        point[row, column] = 1
        left, right = pair(QUIET, point, exposure=0.9, blur_px=1.5)
        assert right.sum() == pytest.approx(left.sum(), rel=1e-3)
        if (row, column) != (0, 0):
            light = right[..., 1] / right[..., 1].sum()
            v, u = np.mgrid[:64, :96]
            assert (light * (u - 50) ** 2).sum() == pytest.approx(1.5**2, rel=0.02)
            assert (light * (v - 30) ** 2).sum() == pytest.approx(1.5**2, rel=0.02)


def test_an_edge_is_blurred_as_the_normal_distribution():
    _, right = pair(QUIET, black_beside_white(), exposure=0.9, blur_px=4.0)
    distance = np.arange(20, 76) - 47.5
    expected = 0.9 * ndtr(distance / 4.0)
    assert right[32, 20:76, 1] == pytest.approx(expected, abs=0.004)


def test_blur_comes_before_the_noise():
    _, right = pair(NOISY, WHITE, blur_px=2.0)
    noise = right[..., 1] - right[..., 1].mean()
    bound = 5 / math.sqrt(noise.size)
    assert abs(correlation(noise[:, 1:], noise[:, :-1])) < bound


@pytest.mark.parametrize(
    ("shift", "colour", "expected"),
    [
        (0.1, [1, 0, 0], [1, 0.1, 0]), (0.1, [0, 1, 0], [0, 0.9, 0.1]), (0.1, [0, 0, 1], [0, 0, 0.9]),
        (-0.1, [1, 0, 0], [0.9, 0, 0]), (-0.1, [0, 1, 0], [0.1, 0.9, 0]), (-0.1, [0, 0, 1], [0, 0.1, 1]),
        (0.3, [1, 1, 1], [1, 1, 1]),
    ],
)  # fmt: skip
def test_shifted_filters_mix_neighbouring_bands(shift, colour, expected):
    left, right = pair(QUIET, WHITE * colour, filter_shift=shift)
    assert left[0, 0] == pytest.approx(BRIGHT * np.array(colour), abs=1e-4)
    assert right[0, 0] == pytest.approx(BRIGHT * np.array(expected), abs=1e-4)


@pytest.mark.parametrize("filters", ["rgb", "RGGB"])
def test_white_balance_scales_the_developed_channels(filters):
    balance = {"white_balance_red": 1.1, "white_balance_blue": 0.8}
    left, right = pair(QUIET.replace(filters=filters), WHITE, **balance)
    ratio = (right / left)[8:-8, 8:-8].reshape(-1, 3)
    assert np.abs(ratio - [1.1, 1, 0.8]).max() < 1e-3


def test_the_tone_exponent_is_the_slope_of_the_logarithms():
    ramp = WHITE * np.geomspace(0.05, 1, 96)[:, None]
    left, right = pair(QUIET, ramp, exposure=0.9, tone_exponent=1.08)
    slope, at_white = np.polyfit(np.log(left[0, :, 1]), np.log(right[0, :, 1]), 1)
    assert slope == pytest.approx(1.08, abs=0.001)
    assert at_white == pytest.approx(0, abs=0.002)


def test_raw_and_mono_output_has_no_white_balance():
    changed = {"white_balance_red": 1.3, "tone_exponent": 1.2}
    left, right = pair(QUIET.replace(output="raw"), WHITE, **changed)
    assert np.array_equal(left, right)
    mono = QUIET.replace(filters="mono")
    left, right = pair(mono, WHITE, exposure=0.2, white_balance_red=1.3)
    assert np.array_equal(left, right)


@pytest.mark.parametrize("level", LEVELS[1:])
def test_the_first_camera_stays_as_it_is(level):
    def exposed(name):
        sensor = Sensor(mismatch=Mismatch.draw(name, 3))
        image = colours()
        return sensor.expose_pair(image, image, rig=RIG, lens=PINHOLE, seed=1)

    plain, drawn, again = exposed("none"), exposed(level), exposed(level)
    assert np.array_equal(plain[0].image, drawn[0].image)
    assert not np.array_equal(plain[1].image, drawn[1].image)
    assert np.array_equal(again[1].image, drawn[1].image)
    assert drawn[1].record["sensor"]["mismatch"]["level"] == level


@pytest.mark.parametrize("level", LEVELS[1:])
def test_draws_have_the_spreads_of_the_table(level):
    drawn = [vars(Mismatch.draw(level, seed)) for seed in range(600)]
    neutral = vars(Mismatch())
    for name, spreads in SPREADS.items():
        off = np.array([values[name] for values in drawn]) - neutral[name]
        spread = spreads[LEVELS.index(level) - 1]
        assert np.sqrt((off**2).mean()) == pytest.approx(spread, rel=0.12), name
        assert np.abs(off).max() <= 2.5 * spread + 1e-12
        is_one_sided = name in ("veiling_glare", "stray_light", "blur_px")
        assert (off >= 0).all() if is_one_sided else abs(off.mean()) <= 0.2 * spread
    directions = [values["stray_direction_deg"] for values in drawn]
    assert np.abs(np.histogram(directions, 6, (0, 360))[0] - 100).max() < 45


def test_a_seed_gives_the_same_pair_at_every_level():
    typical, consumer = (vars(Mismatch.draw(name, 8)) for name in LEVELS[2:])
    neutral = vars(Mismatch())
    for name, (_, low, high) in SPREADS.items():
        large, small = consumer[name] - neutral[name], typical[name] - neutral[name]
        assert large * low == pytest.approx(small * high), name


def test_the_center_and_the_corners_move_by_the_given_pixels():
    """Points far away, projected by the rig that takes the images and by the calibrated one."""
    rig = Rig.stereo(Camera(700, 500, 800.0, 800.0, 349.5, 249.5), 0.1)
    corner, half = np.array([350.0, 250.0]), np.array([175.0, 125.0])
    middle = np.array([349.5, 249.5])
    pixels = [
        middle,
        middle + np.array([350, 0]),
        middle + corner,
        middle - corner,
        middle + half,
    ]
    points = rig.unproject(1, np.array(pixels), np.full(5, 3.0))

    def moved(**mismatch: float) -> np.ndarray:
        off = Mismatch(**mismatch).misalign(rig)
        assert off.nominal is rig
        assert np.array_equal(off.project(0, points), rig.project(0, points))
        return off.project(1, points) - rig.project(1, points)

    assert moved(pitch_px=0.3)[0] == pytest.approx([0, 0.3], abs=1e-6)
    assert moved(yaw_px=0.3)[0] == pytest.approx([0.3, 0], abs=1e-6)
    assert moved(roll_px=0.3)[1] == pytest.approx([0, 0.3], abs=1e-3)
    out = 0.3 * corner / math.hypot(*corner)
    for name, share in (("scale_px", 0.5), ("distortion_px", 0.125)):
        expected = np.array([out, -out, share * out])
        assert moved(**{name: 0.3})[2:] == pytest.approx(expected, abs=1e-6)


OBLONG = Camera(320, 240, 170.0, 165.0, 159.5, 119.5)


@pytest.mark.parametrize(
    "camera",
    [
        OBLONG,
        OBLONG.replace(fx=300.0, fy=400.0),
        OBLONG.replace(cx=150.0, cy=130.0),
        OBLONG.replace(fx=240.0, distortion=BrownConrady(k1=-0.2, k2=0.04, k4=0.01)),
        OBLONG.replace(distortion=KannalaBrandt(k1=-0.02, k2=0.003)),
    ],
)
def test_pixels_that_are_not_square_move_by_the_given_pixels(camera):
    """OpenCV projects points that are seen half an image right of the principal point, and half a diagonal from it."""
    half = 0.5 * np.array([camera.width, camera.height])
    pixels = (camera.cx, camera.cy) + half * [[1, 0], [1, 1], [-0.9, -0.9]]
    rig = Rig.stereo(camera, 0.1)
    points = rig.unproject(1, pixels, np.full(3, 2.0)) - [0.1, 0, 0]

    def moved(**values):
        off = Mismatch(**values).misalign(rig)
        return projected_by_opencv(off.cameras[1], off.world_from_cams[1], points)

    def outwards(change):
        return change @ half / np.linalg.norm(half)

    still = moved()
    assert still == pytest.approx(pixels, abs=1e-3)
    assert (moved(roll_px=0.3) - still)[0, 1] == pytest.approx(0.3, abs=1e-4)
    if camera.distortion is None:
        assert (moved(roll_px=9.0) - still)[0, 1] == pytest.approx(9.0, abs=1e-4)
    for name, value in (("scale_px", 0.4), ("distortion_px", -0.4)):
        assert outwards((moved(**{name: value}) - still)[1]) == pytest.approx(
            value, abs=1e-4
        )


def projected_by_opencv(camera, world_from_cam, points):
    turn, _ = cv2.Rodrigues(world_from_cam[:3, :3].T)
    to_origin = -world_from_cam[:3, :3].T @ (world_from_cam[:3, 3] - [0.1, 0, 0])
    coefficients = np.zeros(5)
    project = cv2.projectPoints
    if camera.distortion is not None:
        coefficients = np.array(camera.distortion.coefficients)
    if isinstance(camera.distortion, KannalaBrandt):
        project = cv2.fisheye.projectPoints
    points = points.reshape(-1, 1, 3)
    return project(points, turn, to_origin, camera.K, coefficients)[0].reshape(-1, 2)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"scale_px": -80}, "scale_px=-80"),
        ({"scale_px": 3, "distortion_px": -50}, "scale_px=3 and distortion_px=-50"),
        ({"roll_px": 60}, "roll_px=60"),
    ],
)
def test_a_lens_that_no_camera_has_is_named_by_its_fields(values, text):
    corner = math.hypot(CAMERA.width, CAMERA.height) / 2
    message = (
        rf"^mismatch {text}: too large .* are {corner:.3g} px from the centre; use"
    )
    with pytest.raises(InputError, match=message):
        Mismatch(**values).misalign(RIG)


def test_a_camera_moves_along_its_own_axes():
    """A point at a depth Z moves by -f t/Z pixels; a camera that is turned by a quarter moves along its turned axes."""
    turned = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    rig = Rig([CAMERA, CAMERA], [np.eye(4), turned])
    off = Mismatch(right_mm=2.0, down_mm=-3.0, forward_mm=5.0).misalign(rig)
    assert off.nominal is rig
    assert off.world_from_cams[1][:3, 3] == pytest.approx([0.003, 0.002, 0.005])
    pixel = off.project(1, rig.unproject(1, [47.5, 31.5], 2.0))
    assert pixel == pytest.approx([47.5 - 0.2 / 1.995, 31.5 + 0.3 / 1.995])


SIZE = (700, 500)
K = np.array([[800, 0, 349.5], [0, 800, 249.5], [0, 0, 1.0]])
BOARD = np.zeros((54, 3), np.float32)
BOARD[:, :2] = 0.03 * (np.mgrid[:9, :6].T.reshape(-1, 2) - [4, 2.5])


def chessboards(rng, count):
    """Corners of a board (2, count, 54, 2) that two cameras 0.1 m apart see whole."""
    views = []
    while len(views) < count:
        turn = rng.uniform(-0.5, 0.5, 3)
        place = rng.uniform([-0.15, -0.15, 0.5], [0.25, 0.15, 1.0])
        corners = np.array(
            [
                cv2.projectPoints(BOARD, turn, place - [x, 0, 0], K, None)[0][:, 0]
                for x in (0.0, 0.1)
            ]
        )
        if ((corners > 5) & (corners < np.subtract(SIZE, 5))).all():
            views.append(corners)
    return np.swapaxes(views, 0, 1)


def calibrated_shift(views):
    """The place of the second camera by OpenCV's calibration, from the true one."""
    left, right = views.astype(np.float32)
    undistorted = np.zeros(5)
    result = cv2.stereoCalibrate(
        [BOARD] * len(left), list(left), list(right), K, undistorted, K, undistorted, SIZE,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )  # fmt: skip
    rotation, translation = result[5], result[6].ravel()
    return -rotation.T @ translation - [0.1, 0, 0]


def test_translations_are_as_large_as_those_of_calibrations():
    """Chessboard calibrations by OpenCV from 20 views, with 0.03, 0.1 and 0.3 px of noise in the corners."""
    rng = np.random.default_rng(0)
    views = chessboards(rng, 20)
    for level, noise in enumerate((0.03, 0.1, 0.3)):
        shifts = [
            calibrated_shift(views + rng.normal(0, noise, views.shape))
            for _ in range(12)
        ]
        spread = 1e3 * np.sqrt(np.square(shifts).mean())
        for name in ("right_mm", "down_mm", "forward_mm"):
            assert SPREADS[name][level] == pytest.approx(spread, rel=0.35)


@pytest.mark.parametrize("focus_um", [20.0, -20.0])
def test_lenses_of_displaced_films(focus_um):
    """Gauss's lens equation: the distances of object and displaced film belong to the same focal length."""
    camera = CAMERA.replace(pixel_pitch_um=80.0)  # film distance 8 mm
    nominal = ThinLens(0.002, 1.5)
    focal = 1 / (1 / 1.5 + 1 / 0.008)
    lens = Mismatch(focus_um=focus_um, f_number=1.25).lens(nominal, camera)
    film = 0.008 + 1e-6 * focus_um
    assert 1 / lens.vergence == pytest.approx(focal * film / (film - focal), rel=1e-9)
    assert lens.aperture_diameter == pytest.approx(0.002 / 1.25)


def test_lenses_without_a_focus_and_without_a_mismatch():
    both = Mismatch(focus_um=5.0, f_number=1.25)
    hole, lens = BareAperture(0.001, 0.05), ThinLens(1e-4, math.inf)
    assert both.lens(hole, CAMERA) == hole.replace(diameter=0.0008)
    assert both.lens(PINHOLE, CAMERA) == PINHOLE
    assert Mismatch(gain=1.1).lens(lens, CAMERA) is lens
    assert Mismatch(focus_um=-5.0).lens(lens, CAMERA).vergence < 0
    film_um = 1e6 * CAMERA.film_distance
    message = f"moves the film to the lens, {film_um:g} um away"
    with pytest.raises(InputError, match=message):
        Mismatch(focus_um=-film_um).lens(lens, CAMERA)


@pytest.mark.parametrize(("f_number", "blur_um"), [(2.0, 2.5), (1.0, 5.0), (0.1, 5.0)])
def test_impossible_f_numbers_have_the_blur_of_one(f_number, blur_um):
    """What is in nominal focus has a blur circle of dv / N on the film: 5 um at f/1, and no more below."""
    camera = Camera.from_fov(640, 480, fov_x_deg=60)
    nominal = ThinLens(camera.film_distance / f_number, 2.0)
    lens = Mismatch(focus_um=5.0).lens(nominal, camera)
    blur_px = -lens.blur_px(nominal.focus_distance, camera.fx)
    assert blur_px * camera.pixel_pitch_um == pytest.approx(blur_um, rel=0.003)


def test_lenses_of_a_rig_are_those_of_its_mismatches():
    """Of the calibrated cameras, whose film distance does not change with the scale of the image."""
    lens = ThinLens(0.001, 2.0)
    sensor = Sensor(mismatch=Mismatch(focus_um=1.0, scale_px=3.0))
    first, second = sensor.lenses(sensor.misalign(RIG), lens)
    assert first is lens
    assert second == sensor.mismatch.lens(lens, CAMERA)
    assert Sensor().lenses(RIG, lens) == (lens, lens)


def test_records_have_all_fields_and_those_of_earlier_versions_are_read():
    sensor = Sensor(mismatch=(Mismatch(gain=1.1), Mismatch(focus_um=2.0)), nir=Sensor())
    record = sensor.record()
    for mismatch in record["mismatch"]:
        assert mismatch.keys() == vars(Mismatch()).keys()
    assert Sensor.from_record(record) == sensor
    for mismatch in record["mismatch"]:
        del mismatch["down_mm"]
    assert Sensor.from_record(record) == sensor


THREE = Rig([CAMERA] * 3, [np.eye(4)] * 3)


def test_a_rig_without_errors_of_alignment_is_returned():
    assert Mismatch(gain=1.1).misalign(RIG) is RIG
    off = Mismatch(pitch_px=1.0).misalign(THREE)
    assert np.array_equal(off.world_from_cams[1], off.world_from_cams[2])
    assert Mismatch(yaw_px=1.0).misalign(off).nominal is THREE


def test_each_camera_of_a_rig_may_have_its_own_mismatch():
    mismatches = Mismatch(gain=1.1, pitch_px=1.0), Mismatch(gain=0.8)
    sensor = QUIET.replace(mismatch=mismatches)
    exposure = exposure_to(BRIGHT, QUIET, lens=PINHOLE)
    photos = sensor.expose_rig([WHITE] * 3, rig=THREE, lens=PINHOLE, exposure=exposure)
    first, second, third = (photo.image.mean() for photo in photos)
    assert [second / first, third / first] == pytest.approx([1.1, 0.8], rel=1e-3)
    off = sensor.misalign(THREE)
    assert off.project(1, [0, 0, 1]) == pytest.approx([47.5, 32.5])
    assert np.array_equal(off.world_from_cams[2], np.eye(4))


@pytest.mark.parametrize(
    "use",
    [
        lambda sensor: sensor.misalign(RIG),
        lambda sensor: sensor.lenses(RIG, PINHOLE),
        lambda sensor: sensor.expose_pair(WHITE, WHITE, rig=RIG, lens=PINHOLE),
    ],
)
def test_another_number_of_mismatches_than_of_cameras_is_refused(use):
    sensor = Sensor(mismatch=(Mismatch(), Mismatch()))
    needed = "must be 1, one for each camera after the first, got 2"
    with pytest.raises(InputError, match=needed):
        use(sensor)
    with pytest.raises(InputError, match="those of 2 cameras after the first, not 3"):
        shot(sensor, eye=3)


SIGMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 2.0)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_a_point_has_the_variance_of_the_blur(sigma):
    point = np.zeros((64, 65, 3))
    point[30, 32] = 1.0
    # Once as light that a sensor can measure, and once as a lamp far beyond its white.
    for white in (None, np.full(3, 1e-3)):
        spread = Mismatch(blur_px=sigma).light(point, white)
        assert spread.sum() == pytest.approx(3)
        for axis, place in ((0, 32), (1, 30)):
            profile = spread[..., 1].sum(axis=axis)
            variance = profile @ np.square(np.arange(len(profile)) - place)
            assert variance**0.5 == pytest.approx(sigma, rel=2e-3)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_gratings_lose_the_contrast_of_a_gaussian(sigma):
    """exp(-2 pi^2 s^2 f^2) at f cycles per pixel, in both directions and slanted."""
    frequency = np.array([3, 16, 40, 60]) / 128
    # A whole number of half periods, with a crest at each border.
    waves = np.cos(2 * np.pi * frequency[:, None] * (np.arange(64) + 0.5))
    lost = np.exp(-2 * (np.pi * sigma * frequency) ** 2)
    for wave, contrast in zip(waves, lost, strict=True):
        for grating, expected in (
            (wave[:, None] * np.ones(64), contrast),
            (wave * np.ones((64, 1)), contrast),
            (wave[:, None] * wave, contrast**2),
        ):
            light = (1 + 0.5 * grating)[..., None] * [1.0, 2.0, 0.5]
            blurred = Mismatch(blur_px=sigma).light(light)
            wanted = (1 + 0.5 * expected * grating)[..., None] * [1.0, 2.0, 0.5]
            np.testing.assert_allclose(blurred, wanted, atol=1e-12)


@pytest.mark.parametrize("sigma", SIGMAS)
def test_no_black_surrounds_a_lamp_and_edges_hardly_ring(sigma):
    """A lamp, 1000 times white, before a dark wall; and a step from black to white."""
    mismatch, white = Mismatch(blur_px=sigma), np.ones(3)
    lamp = np.full((48, 64, 3), 0.1)
    lamp[20:24, 30:33] = 1000.0
    assert mismatch.light(lamp, white).min() > 0.08
    step = np.zeros((48, 64, 3))
    step[:, 32:] = 1.0
    blurred = mismatch.light(step, white)
    assert blurred.min() > -0.015
    assert blurred.max() < 1.015
    far = np.abs(np.arange(64) - 31.5) > 6 + 5 * sigma
    assert np.abs(blurred - step)[:, far].max() < 0.002


def test_a_lamp_in_a_photo_has_no_dark_ring():
    wall = 0.1 * WHITE
    wall[30:33, 40:43] = 500.0
    for gain in (1.0, 8.0):
        sensor = QUIET.replace(mismatch=Mismatch(blur_px=0.4))
        exposure = exposure_to(0.5 / gain, sensor)
        exposure = Exposure(exposure.time, gain)
        photo = shot(sensor, wall, exposure=exposure, eye=1).image
        assert photo.min() > 0.8 * np.median(photo)
