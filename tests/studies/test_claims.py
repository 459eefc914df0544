"""Claims of the studies against independent theory, at full size; most tests are slow."""

import math
from dataclasses import replace

import numpy as np
import pytest

from twinlens.camera import BareAperture
from twinlens.studies import STUDIES, depth_error, focus, pinhole
from twinlens.studies.pinhole.film import exposed_rate, film_light
from twinlens.studies.table import filled_table


def findings(study, rows):
    return study.conclude(filled_table(study.all_columns, rows))


def irradiance(diameter, film):
    """E / L on the axis behind a hole: the integral of cos cos' / d^2 over its disk by the midpoint rule."""
    edges = np.linspace(0.0, 0.5 * diameter, 2001)
    radius = 0.5 * (edges[1:] + edges[:-1])
    away = np.hypot(radius, film)
    cosine = film / away
    return float(
        (cosine * cosine / away**2 * 2 * np.pi * radius * np.diff(edges)).sum()
    )


def test_sensor_radiometry_equals_the_integral_over_the_hole():
    camera = pinhole.edge_camera()
    unit = exposed_rate(camera, BareAperture(1e-3, pinhole.FILM), 0)
    for k, millimetres in enumerate((0.07, 0.35, 2.0, pinhole.BOX_MM)):
        hole = BareAperture(1e-3 * millimetres, pinhole.FILM)
        expected = irradiance(hole.diameter, pinhole.FILM) / irradiance(
            1e-3, pinhole.FILM
        )
        assert exposed_rate(camera, hole, k + 1) / unit == pytest.approx(
            expected, rel=2e-3
        )


@pytest.mark.parametrize(("diameter", "spp"), [(0.1, 64), (0.02, 512)])
def test_path_traced_light_equals_the_integral_over_the_hole(diameter, spp):
    """A binomial share of 2304 spp paths passes the hole; the tolerance is four standard deviations."""
    expected = irradiance(diameter, 0.05) / np.pi
    assert film_light(diameter, 0.05, spp, 1) == pytest.approx(
        expected, rel=4 / math.sqrt(2304 * spp * expected)
    )


@pytest.mark.slow
def test_blur_over_disparity_has_slope_aperture_over_baseline():
    rows = filled_table(
        STUDIES["focus"].all_columns,
        [row for seed in (0, 1) for row in focus._line(seed)],
    )
    finding = focus.conclude(rows)[0]
    assert finding.holds, finding.sentence
    assert finding.tolerance == 0.01


@pytest.mark.slow
def test_depth_error_grows_as_the_square_of_depth():
    setup = replace(STUDIES["baseline"].defaults, methods=("sad", "census"), seeds=(0,))
    rows = [
        row
        for base in (0.06, 0.24)
        for row in depth_error.plane_rows(setup, 0, base, 50.0)
    ]
    for finding in depth_error.BY_BASELINE.conclude(
        filled_table(STUDIES["baseline"].all_columns, rows)
    )[:2]:
        assert finding.holds, finding.sentence
        assert finding.tolerance == 0.05


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::twinlens.optics.diffraction.FresnelWarning")
def test_the_best_hole_agrees_with_wave_optics():
    conclusions = findings(STUDIES["pinhole"], pinhole._edges(3))
    for finding in conclusions[:2]:
        assert finding.holds, finding.sentence
        assert finding.tolerance == 0.02
    decided = [finding for finding in conclusions if finding.has_verdict]
    assert len(decided) >= 4
    assert all(np.isfinite(finding.measured.value) for finding in decided)
