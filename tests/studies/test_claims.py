"""What the studies claim of theory, at full size: slow, but for the law of light."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twinlens.camera import BareAperture
from twinlens.studies import STUDIES, Table, baseline, focus, pinhole
from twinlens.studies.range_error import plane_rows


def findings(study, rows):
    """What a study's own rows say; columns that the rows lack are filled."""
    return study.conclude(Table(study.all_columns, tuple(rows)))


def test_light_grows_as_the_square_of_the_hole_until_the_box_is_open():
    """The film under a disk of light of half-angle t gets pi L sin^2 t: half the square law's where t is 45 degrees."""
    camera = pinhole.edge_camera()
    unit = pinhole._light(camera, BareAperture(1e-3, pinhole.FILM), 0, 0)
    for k, millimetres in enumerate((0.07, 0.35, 2.0, pinhole.BOX_MM)):
        hole = BareAperture(1e-3 * millimetres, pinhole.FILM)
        half_angle = math.atan(0.5 * hole.diameter / pinhole.FILM)
        expected = (math.sin(half_angle) / math.sin(math.atan(0.5e-3 / pinhole.FILM))) ** 2
        assert pinhole._light(camera, hole, 0, k + 1) / unit == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_blur_over_disparity_has_the_slope_of_aperture_over_base():
    rows = Table(STUDIES["focus"].all_columns, tuple(row for seed in (0, 1) for row in focus._line(seed)))
    finding = focus._slope(rows)
    assert finding.holds, finding.sentence
    assert finding.tolerance == 0.01


@pytest.mark.slow
def test_depth_error_grows_as_the_square_of_depth():
    setup = replace(STUDIES["baseline"].defaults, methods=("sad", "census"), seeds=(0,))
    rows = [row for base in (0.06, 0.24) for row in plane_rows(setup, 0, base, 50.0)]
    table = Table(STUDIES["baseline"].all_columns, tuple(rows))
    for finding in baseline.square_law(table, ["sad", "census"]):
        assert finding.holds, finding.sentence
        assert finding.tolerance == 0.05


@pytest.mark.slow
def test_the_best_hole_is_where_wave_optics_has_it():
    found = findings(STUDIES["pinhole"], pinhole._edges(3))
    for finding in found[:2]:
        assert finding.holds, finding.sentence
        assert finding.tolerance == 0.05
    assert all(np.isfinite(finding.measured.value) for finding in found)
