"""The depth camera of the study `active`: its light, its holes, and the findings of known tables."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.studies import STUDIES, Setup, active
from twinlens.studies.table import filled_table

STUDY = STUDIES["active"]
SMALL = Setup((), ("zncc",), (0,), width=212, height=120, spp=16)


@pytest.fixture(scope="module")
def wall():
    return active._wall(SMALL, 1.0, 0.0, 0)


def test_the_light_of_the_dots_on_the_wall_is_the_power_over_the_lit_area(wall):
    """1 W over 86 x 57 degrees, at 1 m, on a matte surface that reflects half of it."""
    lit_area = 4 * math.tan(math.radians(43)) * math.tan(math.radians(28.5))
    radiance = active.GREY / (3 * math.pi) / lit_area
    inner = wall.dots[0][12:-12, 24:-24]
    assert inner.mean() == pytest.approx(radiance, rel=0.03)  # 4,000 dots: 1.6 %
    assert wall.ambient[0].mean() == pytest.approx(
        active.GREY / (3 * math.pi), rel=1e-3
    )


def test_the_depth_camera_leaves_a_wall_without_dots_unknown_and_finds_it_with_them(
    wall,
):
    for power, least, most in ((0.0, 0.0, 0.4), (active.POWER_W, 0.8, 1.0)):
        pair = wall.pictures(active.OFFICE_KLUX, power, active.SENSOR, 0)
        disparity = tl.match(*pair, method="depth_camera", num_disparities=32)[:, 32:]
        is_known = np.isfinite(disparity)
        assert least <= is_known.mean() <= most
        assert (
            np.abs(disparity[is_known] - wall.truth[0, 0]) > 2
        ).mean() < 0.02 or not power


def _rows(active_wrong):
    for klux, wrong in ((active.OFFICE_KLUX, active_wrong), (active.SUN_KLUX, 80.0)):
        for light, method, bad in (
            ("passive", "zncc", 90.0),
            ("active", "depth_camera", wrong),
        ):
            yield {"scene": "wall", "seed": 0, "swept": "ambient", "daylight_klux": klux, "light": light,
                   "method": method, "bad2": bad, "unknown_or_wrong": bad}  # fmt: skip


@pytest.mark.parametrize(
    ("wrong", "holds"), [(1.0, [True, True, True]), (3.0, [True, False, True])]
)
def test_findings_follow_from_the_table(wrong, holds):
    findings = STUDY.conclude(filled_table(STUDY.all_columns, list(_rows(wrong))))
    assert [finding.holds for finding in findings] == holds
