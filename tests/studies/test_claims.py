"""What the studies claim of theory, at full size: slow, but for the law of light."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twinlens.camera import BareAperture
from twinlens.studies import STUDIES, Table, baseline, film_levels, focus, pinhole
from twinlens.studies.plate import film_light
from twinlens.studies.range_error import plane_rows


def findings(study, rows):
    """What a study's own rows say; columns that the rows lack are filled."""
    return study.conclude(Table(study.all_columns, tuple(rows)))


def irradiance(diameter, film):
    """E / L on the axis behind a hole: the integral of cos cos' / d^2 over its disk, by rings' midpoints."""
    edges = np.linspace(0.0, 0.5 * diameter, 2001)
    radius = 0.5 * (edges[1:] + edges[:-1])
    away = np.hypot(radius, film)
    cosine = film / away
    return float((cosine * cosine / away**2 * 2 * np.pi * radius * np.diff(edges)).sum())


def test_the_sensors_light_is_the_integral_over_the_hole_until_the_box_is_open():
    camera = pinhole.edge_camera()
    unit = film_levels.light_of(camera, BareAperture(1e-3, pinhole.FILM), 0, 0)
    for k, millimetres in enumerate((0.07, 0.35, 2.0, pinhole.BOX_MM)):
        hole = BareAperture(1e-3 * millimetres, pinhole.FILM)
        expected = irradiance(hole.diameter, pinhole.FILM) / irradiance(1e-3, pinhole.FILM)
        assert film_levels.light_of(camera, hole, 0, k + 1) / unit == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("diameter", "spp"), [(0.1, 64), (0.02, 512)])
def test_light_paths_through_a_real_plate_are_the_integral_over_its_hole(diameter, spp):
    """Of n = 2304 spp paths a share of the value finds the hole: four deviations of their number."""
    expected = irradiance(diameter, 0.05) / np.pi
    assert film_light(diameter, 0.05, spp, 1) == pytest.approx(expected, rel=4 / math.sqrt(2304 * spp * expected))


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
        assert finding.tolerance == 0.02
    asked = [finding for finding in found if finding.has_verdict]
    assert len(asked) >= 4
    assert all(np.isfinite(finding.measured.value) for finding in asked)
