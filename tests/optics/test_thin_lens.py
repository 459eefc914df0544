"""Thin-lens formulas against the textbook, rays traced by hand, and each other."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from twinlens import optics
from twinlens.errors import InputError

focal = st.floats(0.005, 0.2)
stops = st.floats(1.0, 32.0)
pixels = st.floats(0.2, 5.0)


@given(focal, stops, st.floats(0.5, 50.0), pixels)
def test_depth_of_field_equals_the_textbook(f, n, s, c_px):
    """Near and far of Ray, Applied Photographic Optics: s (H - f) / (H +- (s - f)...), H = f^2 / (N c) + f.

    The textbook has a lens of fixed power and moves the film to v = f s / (s - f): at that film the two must agree.
    """
    pitch = 5e-6
    v = f * s / (s - f)
    c = c_px * pitch
    hyperfocal = f * f / (n * c) + f
    near, far = optics.depth_of_field(f / n, fx=v / pitch, k=1 / s, circle_px=c_px)
    assert near == pytest.approx(
        s * (hyperfocal - f) / (hyperfocal + s - 2 * f), rel=1e-9
    )
    if s < hyperfocal * (1 - 1e-9):
        assert far == pytest.approx(s * (hyperfocal - f) / (hyperfocal - s), rel=1e-6)
    elif s > hyperfocal * (1 + 1e-9):
        assert far == math.inf


@given(focal, stops, pixels)
def test_hyperfocal_distance_equals_the_textbook(f, n, c_px):
    """f^2 / (N c) + f, for the lens that is focused there."""
    pitch = 5e-6
    hyperfocal = f * f / (n * c_px * pitch) + f
    v = f * hyperfocal / (hyperfocal - f)
    assert optics.hyperfocal_distance(f / n, v / pitch, c_px) == pytest.approx(
        hyperfocal, rel=1e-9
    )


@given(st.floats(1e-4, 0.05), st.floats(100, 5000), st.floats(-20.0, 5.0), pixels)
def test_blur_at_the_limits_is_the_circle(a, fx, k, c_px):
    limits = optics.depth_of_field(a, fx, k, c_px)
    for depth, sign in zip(limits, (1, -1), strict=True):
        if depth < math.inf:
            assert optics.circle_of_confusion_px(depth, a, fx, k) == pytest.approx(
                sign * c_px, rel=1e-6
            )
    assert limits[0] <= limits[1]


@given(
    st.floats(1e-4, 0.05),
    st.floats(100, 5000),
    st.floats(-20.0, 5.0),
    pixels,
    st.floats(1e-3, 1e3),
)
def test_in_focus_is_true_between_the_limits(a, fx, k, c_px, z):
    near, far = optics.depth_of_field(a, fx, k, c_px)
    if min(abs(z / near - 1), abs(z / far - 1)) > 1e-9:
        assert bool(optics.in_focus(z, a, fx, k, c_px)) == (near < z < far)


def test_in_focus_in_limiting_cases():
    """A pinhole, infinite depth, and a bare aperture."""
    depths = np.array([[0.1, 1.0], [100.0, np.inf]])
    assert optics.in_focus(depths, 0.0, 700, 0.5).all()
    assert optics.in_focus(depths, 0.01, 700, 0.0).tolist() == [
        [False, False],
        [True, True],
    ]
    assert not optics.in_focus(depths, 0.01, 700, -20.0).any()


def test_depth_of_field_in_limiting_cases():
    assert optics.depth_of_field(0.0, 700, 0.5) == (0.0, math.inf)
    assert optics.depth_of_field(0.01, 700, k=-20.0) == (
        math.inf,
        math.inf,
    )  # an open box: nothing is sharp
    near, far = optics.depth_of_field(0.01, 700, k=0.0)
    assert (near, far) == (7.0, math.inf)


@pytest.mark.parametrize("f", [math.inf, 0.05], ids=["bare hole", "lens"])
def test_blur_equals_traced_rays(f):
    """Rays through the two edges of the aperture, deflected by -y/f and traced to the film."""
    v, a, z, fx = 0.06, 0.012, 0.8, 1200.0
    landings = [
        y + v * (y / z - y / f) for y in (-a / 2, a / 2)
    ]  # paraxial: slope from the point, then the bend
    spread_px = (landings[1] - landings[0]) * fx / v
    k = optics.vergence(0.0 if f == math.inf else 1 / f, v)
    assert optics.circle_of_confusion_px(z, a, fx, k) == pytest.approx(
        spread_px, rel=1e-12
    )


@given(st.floats(0.05, 100.0), st.floats(0.001, 0.3))
def test_focal_length_obeys_the_thin_lens_equation(s, v):
    assert 1 / optics.focal_length(s, v) == pytest.approx(1 / s + 1 / v)
    assert optics.vergence(1 / optics.focal_length(s, v), v) == pytest.approx(
        1 / s, abs=1e-9 / v
    )
    assert optics.focal_length(math.inf, v) == pytest.approx(v)


def test_the_middle_focus_is_at_the_middle_of_the_disparities():
    middle = optics.middle_focus(0.7, 2.5)
    assert 1 / 0.7 - 1 / middle == pytest.approx(1 / middle - 1 / 2.5)
    assert optics.middle_focus(math.inf, math.inf) == math.inf


NAN, INF = math.nan, math.inf
NOT_POSITIVE = (0.0, -2.0, NAN, "2", None)
LENS = {"aperture_diameter": 0.01, "fx": 700.0, "k": 0.5}
DEPTHS = (0.0, -1.0, NAN, [1.0, NAN], "near", None)
INVALID = {
    "aperture_diameter": (-0.01, NAN, INF, "wide", None),
    "fx": (*NOT_POSITIVE, INF),
    "k": (NAN, INF, None),
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_apertures_raise_in_one_line(name):
    for value in INVALID[name]:
        lens = LENS | {name: value}
        calls = [
            lambda lens=lens: optics.circle_of_confusion_px(1.0, **lens),
            lambda lens=lens: optics.depth_of_field(**lens),
            lambda lens=lens: optics.in_focus([1.0, 2.0], **lens),
        ]
        if name != "k":
            del lens["k"]
            calls = [lambda lens=lens: optics.hyperfocal_distance(**lens)]
        for call in calls:
            with pytest.raises(InputError, match=f"^{name} must be") as refusal:
                call()
            assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("call", "values", "says"),
    [
        (lambda z: optics.circle_of_confusion_px(z, **LENS), DEPTHS, "depth must be"),
        (lambda c: optics.depth_of_field(**LENS, circle_px=c), [*NOT_POSITIVE, True], "circle_px"),
        (lambda c: optics.hyperfocal_distance(0.01, 700, c), NOT_POSITIVE, "circle_px"),
        (lambda c: optics.in_focus(1.0, **LENS, circle_px=c), NOT_POSITIVE, "circle_px"),
        (lambda s: optics.focal_length(s, 0.05), NOT_POSITIVE, "focus_distance"),
        (lambda v: optics.focal_length(2.0, v), NOT_POSITIVE, "film_distance"),
        (lambda v: optics.vergence(20.0, v), NOT_POSITIVE, "film_distance"),
        (lambda power: optics.vergence(power, 0.05), [NAN], "power"),
    ],
)  # fmt: skip
def test_invalid_numbers_raise(call, values, says):
    for value in values:
        with pytest.raises(InputError, match=says):
            call(value)
