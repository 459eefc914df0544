"""Differences between cameras, measured back from exposed flat fields, steps, points and colours."""

import math

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from twinlens.camera import BareAperture, Camera, Pinhole, Rig, ThinLens
from twinlens.errors import InputError
from twinlens.sensor import LEVELS, Exposure, Mismatch, Sensor
from twinlens.sensor.mismatch import SPREADS

CAMERA = Camera(96, 64, 100.0, 100.0, 47.5, 31.5)
RIG = Rig.stereo(CAMERA, 0.1)
QUIET = Sensor.preset("ideal", shot_noise=False, output="linear", bits=16)
WHITE = np.ones((64, 96, 3))

PINHOLE = Pinhole()


def pair(
    sensor: Sensor, image, exposure: float = 0.5, lens=PINHOLE, **mismatch
) -> tuple[np.ndarray, np.ndarray]:
    """Linear values of both cameras, of which `exposure` is that of a radiance of 1."""
    rate = sensor.level_rate(WHITE, camera=CAMERA, lens=lens).max()
    photos = sensor.replace(mismatch=Mismatch(**mismatch)).expose_pair(
        image, image, rig=RIG, lens=lens, exposure=Exposure(exposure / rate)
    )
    left, right = (photo.image.astype(np.float64) / 65535 for photo in photos)
    return left, right


def test_gain_from_a_noisy_flat_field():
    sensor = Sensor(output="linear", bits=16)
    left, right = pair(sensor, WHITE, gain=1.07)
    assert right.mean() / left.mean() == pytest.approx(1.07, rel=0.01)


def test_the_f_number_is_that_of_a_narrower_lens():
    wide = ThinLens(CAMERA.film_distance / 4, 2.0)
    narrow = wide.replace(aperture_diameter=wide.aperture_diameter / 1.2)
    exposure = Exposure(0.5 / QUIET.level_rate(WHITE, camera=CAMERA, lens=wide).max())
    expected = QUIET.expose(
        WHITE, camera=CAMERA, lens=narrow, exposure=exposure
    ).image.mean()
    _, right = pair(QUIET, WHITE, lens=wide, f_number=1.2)
    assert right.mean() * 65535 == pytest.approx(expected, rel=1e-3)


def test_shading_from_a_noisy_flat_field():
    """A least-squares fit of 1, x, y and r^2, with distances in pixels."""
    left, right = pair(
        Sensor(output="linear", bits=16),
        WHITE,
        shading_right=0.1,
        shading_down=-0.05,
        shading_corner=0.2,
    )
    v, u = np.mgrid[:64, :96]
    x, y = (u - 47.5).ravel(), (v - 31.5).ravel()
    ratio = right.mean(axis=-1).ravel() / left.mean()
    one, across, down, round_ = np.linalg.lstsq(
        np.stack([x**0, x, y, x**2 + y**2], 1), ratio, rcond=None
    )[0]
    assert one == pytest.approx(1, abs=0.02)
    assert across * 47.5 == pytest.approx(0.1, abs=0.002)
    assert down * 31.5 == pytest.approx(-0.05, abs=0.002)
    assert round_ * (47.5**2 + 31.5**2) == pytest.approx(-0.2, abs=0.01)


def test_veiling_glare_fills_a_black_half_of_the_image():
    step = WHITE.copy()
    step[:, :48] = 0
    left, right = pair(QUIET, step, veiling_glare=0.06)
    assert right[:, :48] == pytest.approx(0.5 * 0.03, abs=1e-4)
    assert right[:, 48:] == pytest.approx(0.5 * 0.97, abs=1e-4)
    assert right.sum() == pytest.approx(left.sum(), rel=1e-4)


def test_veiling_glare_is_even_on_a_film_with_vignetting():
    lens, spot = ThinLens(CAMERA.film_distance / 1.4, 2.0), np.zeros_like(WHITE)
    spot[24:40, 40:56] = 1
    left, right = pair(QUIET, spot, lens=lens, veiling_glare=0.2)
    assert right[spot == 0] == pytest.approx(0.2 * left.mean(), abs=1e-4)


def test_the_record_has_the_f_number_of_each_camera():
    sensor = QUIET.replace(mismatch=Mismatch(f_number=1.2))
    left, right = (
        photo.record
        for photo in sensor.expose_pair(WHITE, WHITE, rig=RIG, lens=Pinhole())
    )
    assert right["working_f_number"] == pytest.approx(1.2 * left["working_f_number"])
    assert right["ev"] == pytest.approx(left["ev"] + 2 * math.log2(1.2))
    ratio = right["mean_electrons"] / left["mean_electrons"]
    assert np.divide(
        right["electrons_per_radiance"], left["electrons_per_radiance"]
    ) == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("degrees", "bright"),
    [(0, (32, 95)), (90, (63, 48)), (180, (32, 0)), (225, (0, 0))],
)
def test_stray_light_grows_towards_its_direction(degrees, bright):
    black = WHITE.copy()
    black[20:40, 20:40] = 0
    left, right = pair(QUIET, black, stray_light=0.1, stray_direction_deg=degrees)
    added = (right - left).mean(axis=-1)
    light = left.mean()
    assert added.mean() == pytest.approx(0.1 * light, rel=1e-3)
    assert added[bright] == pytest.approx(0.2 * light, rel=0.02)
    assert added[63 - bright[0], 95 - bright[1]] == pytest.approx(0, abs=0.01 * light)


def test_blur_has_its_standard_deviation_and_conserves_light():
    point = np.zeros((64, 96, 3))
    point[30, 50] = 1
    left, right = pair(QUIET, point, exposure=0.9, blur_px=1.5)
    v, u = np.mgrid[:64, :96]
    light = right[..., 1]
    assert light.sum() == pytest.approx(left[..., 1].sum(), rel=1e-3)
    assert (light * (u - 50) ** 2).sum() / light.sum() == pytest.approx(
        1.5**2, rel=0.02
    )
    assert (light * (v - 30) ** 2).sum() / light.sum() == pytest.approx(
        1.5**2, rel=0.02
    )
    corner = np.zeros((64, 96, 3))
    corner[0, 0] = 1
    left, right = pair(QUIET, corner, exposure=0.9, blur_px=1.5)
    assert right.sum() == pytest.approx(left.sum(), rel=1e-3)


def test_blur_comes_before_the_noise():
    _, right = pair(Sensor(output="linear", bits=16), WHITE, blur_px=2.0)
    noise = right[..., 1] - right[..., 1].mean()
    assert abs(
        np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]
    ) < 5 / math.sqrt(noise.size)


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
    assert left[0, 0] == pytest.approx(0.5 * np.array(colour), abs=1e-4)
    assert right[0, 0] == pytest.approx(0.5 * np.array(expected), abs=1e-4)


@pytest.mark.parametrize("filters", ["rgb", "RGGB"])
def test_white_balance_scales_the_developed_channels(filters):
    left, right = pair(
        QUIET.replace(filters=filters),
        WHITE,
        white_balance_red=1.1,
        white_balance_blue=0.8,
    )
    assert (right / left)[8:-8, 8:-8] == pytest.approx(
        np.broadcast_to([1.1, 1, 0.8], (48, 80, 3)), abs=1e-3
    )


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
    left, right = pair(
        QUIET.replace(filters="mono"), WHITE, exposure=0.2, white_balance_red=1.3
    )
    assert np.array_equal(left, right)


@pytest.mark.parametrize("level", LEVELS[1:])
def test_the_first_camera_stays_as_it_is(level):
    v, u = np.mgrid[:64, :96]
    image = np.stack([1 + np.sin(u / 7), 1 + np.cos(v / 5), 0.2 + u / 96], axis=-1)
    plain, drawn = (
        Sensor(mismatch=Mismatch.draw(name, 3)).expose_pair(
            image, image, rig=RIG, lens=Pinhole(), seed=1
        )
        for name in ("none", level)
    )
    assert plain[0].image.tobytes() == drawn[0].image.tobytes()
    assert plain[1].image.tobytes() != drawn[1].image.tobytes()
    again = Sensor(mismatch=Mismatch.draw(level, 3)).expose_pair(
        image, image, rig=RIG, lens=Pinhole(), seed=1
    )
    assert again[1].image.tobytes() == drawn[1].image.tobytes()
    assert drawn[1].record["sensor"]["mismatch"]["level"] == level


@pytest.mark.parametrize("level", LEVELS[1:])
def test_draws_have_the_spreads_of_the_table(level):
    drawn = [vars(Mismatch.draw(level, seed)) for seed in range(600)]
    neutral = vars(Mismatch())
    for name, spreads in SPREADS.items():
        off = np.array([each[name] for each in drawn]) - neutral[name]
        spread = spreads[LEVELS.index(level) - 1]
        assert np.sqrt((off**2).mean()) == pytest.approx(spread, rel=0.12), name
        assert np.abs(off).max() <= 2.5 * spread + 1e-12
        limited = name in ("veiling_glare", "stray_light", "blur_px")
        assert (off >= 0).all() if limited else abs(off.mean()) <= 0.2 * spread, name
    directions = np.array([each["stray_direction_deg"] for each in drawn])
    assert np.abs(np.histogram(directions, 6, (0, 360))[0] - 100).max() < 45


def test_a_seed_gives_the_same_pair_at_every_level():
    typical, consumer = (
        vars(Mismatch.draw(level, 8)) for level in ("typical", "consumer")
    )
    for name, (_, low, high) in SPREADS.items():
        neutral = getattr(Mismatch(), name)
        assert (consumer[name] - neutral) * low == pytest.approx(
            (typical[name] - neutral) * high
        ), name


def test_the_center_and_the_corners_move_by_the_given_pixels():
    """Points far away, projected by the rig that takes the images and by the calibrated one."""
    rig = Rig.stereo(Camera(700, 500, 800.0, 800.0, 349.5, 249.5), 0.1)
    pixels = np.array(
        [[349.5, 249.5], [699.5, 249.5], [699.5, 499.5], [-0.5, -0.5], [524.5, 374.5]]
    )
    points = rig.unproject(1, pixels, np.full(5, 3.0))

    def moved(**mismatch: float) -> np.ndarray:
        off = Mismatch(**mismatch).misalign(rig)
        assert off.nominal is rig
        assert np.array_equal(off.project(0, points), rig.project(0, points))
        return off.project(1, points) - rig.project(1, points)

    assert moved(pitch_px=0.3)[0] == pytest.approx([0, 0.3], abs=1e-6)
    assert moved(yaw_px=0.3)[0] == pytest.approx([0.3, 0], abs=1e-6)
    assert moved(roll_px=0.3)[1] == pytest.approx([0, 0.3], abs=1e-3)
    out = np.array([350.0, 250.0]) / math.hypot(350, 250)
    for name, half in (("scale_px", 0.5), ("distortion_px", 0.125)):
        found = moved(**{name: 0.3})
        assert found[2:] == pytest.approx(
            np.array([0.3 * out, -0.3 * out, half * 0.3 * out]), abs=1e-6
        )


@pytest.mark.parametrize(
    ("mismatch", "given"),
    [
        (Mismatch(scale_px=-80), "scale_px=-80"),
        (Mismatch(distortion_px=-50), "distortion_px=-50"),
        (Mismatch(scale_px=3, distortion_px=-50), "scale_px=3 and distortion_px=-50"),
    ],
)
def test_a_lens_that_no_camera_has_is_named_by_its_fields(mismatch, given):
    rig = Rig.stereo(CAMERA, 0.1)
    corner = math.hypot(CAMERA.width, CAMERA.height) / 2
    with pytest.raises(
        InputError,
        match=rf"^mismatch {given}: too large .* are {corner:.3g} px from the centre; use",
    ):
        mismatch.misalign(rig)


def test_a_camera_moves_along_its_own_axes():
    """A point at a depth Z moves by -f t/Z pixels; a camera that is turned by a quarter moves along its turned axes."""
    turned = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    rig = Rig([CAMERA, CAMERA], [np.eye(4), turned])
    off = Mismatch(right_mm=2.0, down_mm=-3.0, forward_mm=5.0).misalign(rig)
    assert off.nominal is rig
    assert off.world_from_cams[1][:3, 3] == pytest.approx([0.003, 0.002, 0.005])
    found = off.project(1, rig.unproject(1, [47.5, 31.5], 2.0))
    assert found == pytest.approx([47.5 - 0.2 / 1.995, 31.5 + 0.3 / 1.995])


def test_translations_are_as_large_as_those_of_calibrations():
    """Chessboard calibrations by OpenCV from 20 views, with 0.03, 0.1 and 0.3 px of noise in the corners."""
    rng = np.random.default_rng(0)
    size, k = (700, 500), np.array([[800, 0, 349.5], [0, 800, 249.5], [0, 0, 1.0]])
    board = np.zeros((54, 3), np.float32)
    board[:, :2] = 0.03 * (np.mgrid[:9, :6].T.reshape(-1, 2) - [4, 2.5])

    def seen(turn: np.ndarray, place: np.ndarray, x: float) -> np.ndarray:
        return cv2.projectPoints(board, turn, place - [x, 0, 0], k, None)[0][:, 0]

    views = []
    while len(views) < 20:
        turn, place = (
            rng.uniform(-0.5, 0.5, 3),
            rng.uniform([-0.15, -0.15, 0.5], [0.25, 0.15, 1.0]),
        )
        pair = [seen(turn, place, x) for x in (0.0, 0.1)]
        if all(
            (points > 5).all() and (points < np.subtract(size, 5)).all()
            for points in pair
        ):
            views.append(pair)
    for level, noise in enumerate((0.03, 0.1, 0.3)):
        found = []
        for _ in range(12):
            noisy = [
                [
                    (view[i] + rng.normal(0, noise, view[i].shape)).astype(np.float32)
                    for view in views
                ]
                for i in (0, 1)
            ]
            result = cv2.stereoCalibrate(
                [board] * 20,
                *noisy,
                k,
                np.zeros(5),
                k,
                np.zeros(5),
                size,
                flags=cv2.CALIB_FIX_INTRINSIC,
            )
            found.append(-result[5].T @ result[6].ravel() - [0.1, 0, 0])
        spread = 1e3 * np.sqrt(np.square(found).mean())
        for name in ("right_mm", "down_mm", "forward_mm"):
            assert SPREADS[name][level] == pytest.approx(spread, rel=0.35)


def test_lenses_of_displaced_films():
    """Gauss's lens equation: the distances of object and displaced film belong to the same focal length."""
    camera = CAMERA.replace(pixel_pitch_um=80.0)  # film distance 8 mm
    nominal = ThinLens(0.002, 1.5)
    focal = 1 / (1 / 1.5 + 1 / 0.008)
    for focus_um in (20.0, -20.0):
        lens = Mismatch(focus_um=focus_um, f_number=1.25).lens(nominal, camera)
        film = 0.008 + 1e-6 * focus_um
        assert 1 / lens.vergence == pytest.approx(
            focal * film / (film - focal), rel=1e-9
        )
        assert lens.aperture_diameter == pytest.approx(0.002 / 1.25)
    beyond = Mismatch(focus_um=-5.0).lens(ThinLens(0.002, math.inf), camera)
    assert beyond.vergence < 0
    hole = BareAperture(0.001, 0.05)
    assert Mismatch(focus_um=5.0, f_number=1.25).lens(hole, camera) == BareAperture(
        0.0008, 0.05
    )
    assert Mismatch(focus_um=5.0, f_number=1.25).lens(Pinhole(), camera) == Pinhole()
    assert Mismatch(gain=1.1).lens(nominal, camera) is nominal
    with pytest.raises(
        InputError, match="focus_um=-8000 moves the film to the lens, 8000 um away"
    ):
        Mismatch(focus_um=-8000.0).lens(nominal, camera)


def test_impossible_f_numbers_have_the_blur_of_one():
    """What is in nominal focus has a blur circle of dv / N on the film: 5 um at f/1, and no more below."""
    camera = Camera.from_fov(640, 480, fov_x_deg=60)
    for f_number, blur_um in ((2.0, 2.5), (1.0, 5.0), (0.1, 5.0)):
        nominal = ThinLens(camera.film_distance / f_number, 2.0)
        lens = Mismatch(focus_um=5.0).lens(nominal, camera)
        blur_px = (
            camera.fx * lens.aperture_diameter * (lens.vergence - nominal.vergence)
        )
        assert blur_px * camera.pixel_pitch_um == pytest.approx(blur_um, rel=0.003)


def test_lenses_of_a_rig_are_those_of_its_mismatches():
    """Of the calibrated cameras, whose film distance does not change with the scale of the image."""
    lens = ThinLens(0.001, 2.0)
    own = Sensor(mismatch=Mismatch(focus_um=1.0, scale_px=3.0))
    first, second = own.lenses(own.misalign(RIG), lens)
    assert first is lens
    assert second == own.mismatch.lens(lens, CAMERA)
    assert Sensor().lenses(RIG, lens) == (lens, lens)
    with pytest.raises(
        InputError, match="must be 1, one for each camera after the first, got 2"
    ):
        own.replace(mismatch=(Mismatch(), Mismatch())).lenses(RIG, lens)


def test_records_have_all_fields_and_those_of_earlier_versions_are_read():
    sensor = Sensor(mismatch=(Mismatch(gain=1.1), Mismatch(focus_um=2.0)), nir=Sensor())
    record = sensor.record()
    assert [each.keys() for each in record["mismatch"]] == [vars(Mismatch()).keys()] * 2
    assert Sensor.from_record(record) == sensor
    for each in record["mismatch"]:
        del each["down_mm"]
    assert Sensor.from_record(record) == sensor


def test_a_rig_without_errors_of_alignment_is_returned():
    assert Mismatch(gain=1.1).misalign(RIG) is RIG
    three = Rig([CAMERA] * 3, [np.eye(4)] * 3)
    off = Mismatch(pitch_px=1.0).misalign(three)
    assert np.array_equal(off.world_from_cams[1], off.world_from_cams[2])
    twice = Mismatch(yaw_px=1.0).misalign(off)
    assert twice.nominal is three


def test_an_edge_is_blurred_as_the_normal_distribution():
    edge = WHITE.copy()
    edge[:, :48] = 0
    _, right = pair(QUIET, edge, exposure=0.9, blur_px=4.0)
    distance = np.arange(96) - 47.5
    assert right[32, 20:76, 1] == pytest.approx(
        0.9 * ndtr(distance[20:76] / 4.0), abs=0.004
    )


def test_each_camera_of_a_rig_may_have_its_own_mismatch():
    rig = Rig([CAMERA] * 3, [np.eye(4)] * 3)
    own = QUIET.replace(mismatch=(Mismatch(gain=1.1, pitch_px=1.0), Mismatch(gain=0.8)))
    exposure = Exposure(
        0.5 / QUIET.level_rate(WHITE, camera=CAMERA, lens=Pinhole()).max()
    )
    first, second, third = (
        photo.image.mean()
        for photo in own.expose_rig(
            [WHITE] * 3, rig=rig, lens=Pinhole(), exposure=exposure
        )
    )
    assert [second / first, third / first] == pytest.approx([1.1, 0.8], rel=1e-3)
    off = own.misalign(rig)
    assert off.project(1, [0, 0, 1]) == pytest.approx([47.5, 32.5])
    assert np.array_equal(off.world_from_cams[2], np.eye(4))
    for call in (
        lambda: own.misalign(RIG),
        lambda: own.expose_pair(WHITE, WHITE, rig=RIG, lens=Pinhole()),
    ):
        with pytest.raises(
            InputError, match="must be 1, one for each camera after the first, got 2"
        ):
            call()
    with pytest.raises(InputError, match="those of 2 cameras after the first, not 3"):
        own.expose(WHITE, camera=CAMERA, lens=Pinhole(), eye=3)
    with pytest.raises(InputError, match="must be a Mismatch or a tuple"):
        Sensor(mismatch=(Mismatch(), 3))
