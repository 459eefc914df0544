"""Projectors, their patterns and rigs with them."""

import numpy as np
import pytest
from scipy import special

from tests.rigs import random_rig, rotation
from twinlens import geometry
from twinlens.camera import (
    Camera,
    GrayCode,
    Misalignment,
    PhaseShift,
    Projector,
    Rig,
    decode,
    layouts,
    misaligned,
    patterns,
)
from twinlens.camera.projector import LUMENS_PER_WATT
from twinlens.dataset.record import RIG, plain
from twinlens.errors import InputError

LENS = Camera(64, 48, 80.0, 70.0, 20.0, 30.0)


def pose(rng):
    return geometry.rigid(rotation(rng, 0.2), rng.uniform(-0.2, 0.2, 3))


def test_patterns_are_fully_lit_and_dark_somewhere():
    """Speckle, which has no largest value, and a white pattern apart."""
    for name in patterns.PATTERNS:
        pattern = patterns.named(name, 37, 23)
        assert pattern.shape == (23, 37)
        assert pattern.dtype == np.float32
        ends = {"white": (1, 1), "speckle": (pattern.min(), pattern.max())}
        low, high = ends.get(name, (0, 1))
        assert 0 <= low == pattern.min()
        assert 1 >= high == pattern.max()


def test_the_density_of_dots_is_exact_and_the_seed_places_them():
    first, second = (
        patterns.dots(60, 40, density=0.15, size=2, seed=seed) for seed in (1, 2)
    )
    assert first.mean() == second.mean() == 0.15
    assert (first != second).any()
    blocks = first.reshape(20, 2, 30, 2)
    assert (blocks == blocks[:, :1, :, :1]).all()


def test_grid_stripes_and_checker_repeat_with_their_period():
    grid, stripes, checker = (
        patterns.named(name, 48, 48) for name in ("dot_grid", "stripes", "checker")
    )
    assert grid.sum() == 36
    for pattern, step in ((grid, 8), (stripes, 16), (checker, 32)):
        assert (pattern[:, step:] == pattern[:, :-step]).all()
    assert (checker[:, 16:] == 1 - checker[:, :-16]).all()
    assert (stripes[:, 8:] == 1 - stripes[:, :-8]).all()


def test_tiled_dots_repeat_and_have_their_density():
    pattern = patterns.dots(60, 40, density=0.2, size=2, tiles=2)
    assert pattern.mean() == np.float32(0.2)
    assert (pattern[:20, :30] == pattern[20:, 30:]).all()
    assert (pattern[:20, :30] == pattern[:20, 30:]).all()


def test_speckle_is_exponential_and_correlated_over_its_grain():
    """Within 4 standard errors of the closed forms; a pattern has about (size / grain)^2 independent grains."""
    grain, shape = 5.0, (400, 600)
    pattern = (
        patterns.speckle(shape[1], shape[0], grain, seed=3).astype(np.float64)
        / patterns.SPECKLE_MEAN
    )
    error = 4 * grain / np.sqrt(shape[0] * shape[1])
    assert pattern.mean() == pytest.approx(1, abs=error)
    for level in (0.1, 0.5, 1.0, 2.0, 4.0):
        assert (pattern > level).mean() == pytest.approx(np.exp(-level), abs=error)
    for r in (1, 2, 3, 5, 6, 8):
        x = np.pi * r / grain
        expected = (2 * special.j1(x) / x) ** 2
        for a, b in ((pattern[:, r:], pattern[:, :-r]), (pattern[r:], pattern[:-r])):
            assert np.mean((a - 1) * (b - 1)) == pytest.approx(expected, abs=2 * error)


@pytest.mark.parametrize("axis", ["u", "v"])
def test_neighbouring_gray_codes_differ_in_one_bit_and_decode_to_their_positions(axis):
    code = GrayCode(53, 41, axis)
    shown = code.patterns
    assert all((a + b == 1).all() for a, b in zip(shown[::2], shown[1::2], strict=True))
    changes = sum(np.abs(np.diff(image, axis="vu".index(axis))) for image in shown[::2])
    assert (changes == 1).all()
    v, u = np.mgrid[:41, :53]
    assert (decode(shown, code).position == (u if axis == "u" else v)).all()


def test_a_gray_code_interpolated_between_pixels_decodes_to_positions_between_them():
    code, u = GrayCode(53, 1), np.linspace(0, 52, 401)
    images = [
        0.1 + 3.0 * np.interp(u, np.arange(53), image[0])[None]
        for image in code.patterns
    ]
    assert np.abs(decode(images, code).position - u).max() < 1e-9


def test_gray_codes_that_no_column_has_are_not_valid():
    code = GrayCode(5, 1)
    longer = [image[:, :8] for image in GrayCode(8, 1).patterns]
    assert decode(longer, code).valid.tolist() == [[True] * 5 + [False] * 3]


@pytest.mark.parametrize("steps", [3, 4, 7])
def test_phase_shift_decodes_under_gain_and_ambient_light(steps):
    code = PhaseShift(70, 5, 12.5, steps)
    images = [0.3 + 2.0 * image for image in code.patterns]
    u = np.mgrid[:5, :70][1]
    assert np.abs((decode(images, code).position - u + 6.25) % 12.5 - 6.25).max() < 1e-5
    decoded = decode(images, code, coarse=u + 5.0)
    assert np.abs(decoded.position - u).max() < 1e-5
    assert np.abs(decoded.modulation - 2.0).max() < 1e-5


def test_pixels_without_modulation_are_not_valid():
    code = GrayCode(16, 8)
    images = [image.copy() for image in code.patterns]
    for image in images:
        image[2, 3] = 0.5
    assert np.argwhere(~decode(images, code).valid).tolist() == [[2, 3]]


def test_projectors_move_with_the_first_camera():
    rng = np.random.default_rng(4)
    rig, _ = random_rig(rng, 3)
    projector = Projector(pose(rng), LENS, "dots", 2.0, "rgb")
    rig = rig.with_projectors([projector])
    world = geometry.rigid(rotation(rng), rng.uniform(-3, 3, 3))
    moved = Rig(
        rig.cameras,
        [world @ pose for pose in rig.world_from_cams],
        projectors=rig.projectors,
    )
    assert np.allclose(
        moved.world_from_projectors[0], world @ rig.world_from_projectors[0]
    )
    still = (rig.pair(2, 0), misaligned(rig, [Misalignment(yaw_deg=3.0)] * 3))
    for other in still:
        assert np.allclose(other.world_from_projectors[0], rig.world_from_projectors[0])


def test_a_rig_with_projectors_is_stored_and_read():
    rng = np.random.default_rng(6)
    rig, _ = random_rig(rng, 2)
    pattern = rng.random((48, 64)).astype(np.float32)
    rig = rig.with_projectors(
        [Projector(pose(rng), LENS, pattern, 2.5, "rgb", "nearest", 0.01, 1.5)]
    )
    assert "projectors" not in plain(rig.with_projectors([]))
    again = RIG.validate_python(plain(rig)).projectors[0]
    for name, value in vars(rig.projectors[0]).items():
        assert np.array_equal(getattr(again, name), value), name
    assert again.with_pattern("white").focus_distance == 1.5


def test_the_calibrated_rig_has_the_projectors_at_the_same_places():
    rng = np.random.default_rng(7)
    rig = misaligned(
        random_rig(rng, 2)[0], [Misalignment(yaw_deg=3.0), Misalignment(pitch_deg=1.0)]
    )
    lit = rig.with_projectors([Projector(pose(rng), LENS, "dots", 2.0, "rgb")])
    assert np.allclose(
        lit.nominal.world_from_projectors[0], lit.world_from_projectors[0]
    )
    assert len(lit.pair(1, 0).nominal.projectors) == 1
    table = plain(lit)
    table["projectors"][0]["power"] = 3.0
    with pytest.raises(
        ValueError, match="must have the same projectors, at the same places"
    ):
        RIG.validate_python(table)
    with pytest.raises(InputError, match="must have the same projectors"):
        Rig(rig.cameras, rig.world_from_cams, rig.calibrated, lit.projectors)


def test_lux_at_a_distance():
    near, far = (
        Projector(None, LENS, band="rgb").with_lux(100.0, distance)
        for distance in (1.0, 2.0)
    )
    assert far.power == pytest.approx(4 * near.power)
    assert near.power / (64 * 48) * 80 * 70 * LUMENS_PER_WATT == pytest.approx(100.0)


CODE, SHIFTS = GrayCode(8, 8), PhaseShift(8, 8, 4)
FRAMES = [np.zeros((2, 2))] * 4
ALONE = Rig([LENS], [np.eye(4)])
REFUSALS = [  # what the message says, the call, and its arguments; None is the projector's pose in the rig
    ("power must be a number of watts", Projector, (None, LENS, "white", -1)),
    ("power must be a number of watts", Projector, (None, LENS, "white", np.nan)),
    (r"pattern must have the shape \(48, 64\)", Projector, (None, LENS, np.ones((48, 63)))),
    ("values from 0 to 1", Projector, (None, LENS, np.full((48, 64), 1.5))),
    ("values from 0 to 1", Projector, (None, LENS, np.full((48, 64), np.nan))),
    ("pattern must be an array of real", Projector, (None, LENS, np.full((48, 64), 1j))),
    ("pattern must be an array of numbers", Projector, (None, LENS, {"type": "dots"})),
    ("did you mean 'dots'", Projector, (None, LENS, "dot")),
    ("band of a projector", Projector, (None, LENS, "white", 1.0, "uv")),
    ("filter of a projector", Projector, (None, LENS, "white", 1.0, "rgb", "cubic")),
    ("aperture_diameter must be", Projector, (None, LENS, "white", 1.0, "rgb", "nearest", -1)),
    ("focus_distance must be", Projector, (None, LENS, "white", 1.0, "rgb", "nearest", 0.01, 0)),
    ("a projector's pose", Projector, (2 * np.eye(4), LENS)),
    ("band='rgb', or give the power", Projector(None, LENS).with_lux, (100.0,)),
    ("list of Projectors, got None", ALONE.with_projectors, (None,)),
    ("list of Projectors, got Projector", ALONE.with_projectors, (Projector(None, LENS),)),
    ("list of Projectors", ALONE.with_projectors, ([LENS],)),
    ("density of dots", patterns.dots, (8, 8, 2)),
    ("from 2 to 24, got 25", patterns.speckle, (64, 48, 25.0)),
    ("grain of speckle", patterns.speckle, (8, 8, 1.0)),
    ("frame of a Gray code", patterns.gray_code, (8, 8, 6)),
    ("unknown axis", GrayCode, (8, 8, "x")),
    ("period of a phase shift", PhaseShift, (8, 8, 2)),
    ("6 patterns, got 4 images", decode, (CODE.patterns[:4], CODE)),
    ("coarse positions", decode, (FRAMES, SHIFTS, np.zeros(3))),
    ("coarse positions must be an array", decode, (FRAMES, SHIFTS, "x")),
    ("a Gray code has none to unwrap", decode, (CODE.patterns, CODE, np.zeros((8, 8)))),
    ("a list of images, got None", decode, (None, CODE)),
    (r"images\[0\] must be an array of numbers", decode, (["x"] * 6, CODE)),
    (r"images\[0\] must be an array of real numbers", decode, ([np.ones((2, 2)) * 1j] * 6, CODE)),
    (r"of one shape, got \(0, 2\)", decode, ([np.ones((0, 2))] * 6, CODE)),
    (r"got \(2, 2\) and \(3, 2\)", decode, ([np.ones((2, 2)), *[np.ones((3, 2))] * 5], CODE)),
    ("power must be a number of watts", layouts.depth_camera, (640, 480, None, 0)),
    ("camera width in pixels must be", layouts.depth_camera, (0, 480)),
]  # fmt: skip


@pytest.mark.parametrize(("message", "call", "arguments"), REFUSALS)
def test_refusals_are_one_line(message, call, arguments):
    with pytest.raises(InputError, match=message) as refusal:
        call(*arguments)
    assert "\n" not in str(refusal.value)


def test_settings_of_a_pattern_are_named():
    for settings, message in (
        ({"dens": 1}, "dens"),
        ({"width": 3}, "'width'"),
        ({"tiles": 9}, "tiles of dots"),
    ):
        with pytest.raises(InputError, match=message):
            patterns.named("dots", 8, 8, **settings)
