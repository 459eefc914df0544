"""Equal glass of all cues, the effective baseline of dual pixels, and crossings of known tables."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.studies import STUDIES, Setup, Table, defocus
from twinlens.studies.stage import noise_texture
from twinlens.studies.table import filled_table

STUDY = STUDIES["defocus"]


@pytest.mark.parametrize("diameter", defocus.DIAMETERS)
def test_all_cues_have_equal_glass_and_their_lenses_fit_side_by_side(diameter):
    for cue, baseline, shots in defocus.cues(diameter):
        lenses = {}
        for shot in shots:
            lenses[shot.x] = max(lenses.get(shot.x, 0.0), shot.lens.aperture_diameter)
        assert sum(width**2 for width in lenses.values()) == pytest.approx(
            diameter**2
        ), cue
        if len(lenses) > 1:
            assert max(lenses) - min(lenses) == pytest.approx(baseline)
            assert baseline >= max(lenses.values()) * (1 - 1e-9)


def test_images_share_the_light_equally(monkeypatch):
    """The noise of n flat images has n times the variance of one image with all photons."""
    seen = []
    monkeypatch.setattr(
        defocus,
        "inverse_depth_from_defocus",
        lambda images, *_, **__: seen.extend(images) or images[0],
    )
    for _, _, shots in defocus.cues(0.01):
        samples = [aperture for shot in shots for aperture in shot.apertures()]
        seen.clear()
        flat = np.ones((96, 96)) + 1e-3 * np.eye(96)
        defocus._error_and_bound([flat] * len(samples), flat, samples, 0.5, 3)
        assert np.var(seen) == pytest.approx(len(samples) / defocus.PHOTONS, rel=0.05)


@pytest.mark.parametrize("diameter", defocus.DIAMETERS)
def test_the_bound_of_dual_pixels_in_focus_is_that_of_a_pair_with_the_centroids_baseline(
    diameter,
):
    """Pinholes at the centroids of half disks, 4/(3 pi) of the diameter apart; two apertures are blind."""
    sharp = 1.0 + noise_texture(96, 72, 1.5, 0.5, 0)
    pinholes = [
        tl.ApertureSamples([[side * 2 / (3 * math.pi) * diameter, 0.0]])
        for side in (-1, 1)
    ]
    bounds = {cue: _bound(sharp, [aperture for shot in shots for aperture in shot.apertures()])
              for cue, _, shots in defocus.cues(diameter)}  # fmt: skip
    expected = _bound(sharp, pinholes)
    assert bounds[defocus.HALVES] == pytest.approx(expected, rel=0.01)
    assert bounds[defocus.TOUCHING] == pytest.approx(
        expected * 4 * math.sqrt(2) / (3 * math.pi), rel=0.01
    )
    assert bounds[defocus.APERTURES] > 1e3 * expected


def _bound(sharp, apertures):
    bound = tl.inverse_depth_bound(sharp, apertures, defocus.FX, defocus.FOCUS, 0.05)
    return float(np.median(bound[20:-20, 20:-20]))


def rows(crossing_px=None, halves=1.0):
    """In focus, errors as predicted, times `halves` for dual pixels; elsewhere, pair / stack = blur / crossing."""
    measured = []
    for diameter in defocus.DIAMETERS:
        for blur in (0.0, 2.0, 4.0, 8.0):
            for cue, baseline, _ in defocus.cues(diameter):
                error = 1.0 / baseline if baseline else 1.0
                error *= halves if cue == defocus.HALVES else 1.0
                if crossing_px and cue in (defocus.TOUCHING, defocus.FOCI) and blur:
                    error = (
                        math.exp(blur - crossing_px) if cue == defocus.TOUCHING else 1.0
                    )
                measured.append({"scene": "plane", "seed": 0, "cue": cue, "aperture_mm": 1e3 * diameter, "z_m": 2.0,
                              "baseline_mm": 1e3 * baseline, "blur_px": blur, "depth_error_mm": error,
                              "bound_mm": error, "in_bounds": 1.2})  # fmt: skip
    return filled_table(STUDY.all_columns, measured)


def test_findings_of_known_tables():
    findings = STUDY.conclude(rows(5.0))
    assert [finding.holds for finding in findings] == [True, True, True]
    assert [finding.measured.value for finding in findings] == pytest.approx(
        [1.0, 5.0, 1.2]
    )
    assert not STUDY.conclude(rows(5.0, halves=1.2))[0].holds


def test_curves_that_do_not_cross_have_no_verdict():
    assert not STUDY.conclude(rows(20.0))[1].has_verdict
    empty = Table(STUDY.all_columns, ())
    assert not any(finding.has_verdict for finding in STUDY.conclude(empty))


SETUP = Setup((), (), (0,), width=160, height=120, spp=256)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [200, 201])
def test_dual_pixels_in_focus_are_a_pair_under_new_seeds(seed):
    camera = defocus.centred_camera(160, 120, defocus.FX)
    measured = [
        row
        for k in range(2)
        for row in defocus._rows(SETUP, camera, seed + 10 * k, 0.0)
    ]
    finding = STUDY.conclude(filled_table(STUDY.all_columns, measured))[0]
    assert finding.holds, finding.sentence
    assert (finding.expected, finding.tolerance) == (1.0, 0.15)


@pytest.mark.slow
def test_the_focal_stack_passes_the_pair_where_the_bounds_cross_under_new_seeds(
    monkeypatch,
):
    monkeypatch.setattr(defocus, "DIAMETERS", (0.04,))
    camera = defocus.centred_camera(160, 120, defocus.FX)
    measured = [
        row
        for offset in (-0.2, -0.1, 0.1, 0.2)
        for row in defocus._rows(SETUP, camera, 300, offset)
    ]
    finding = STUDY.conclude(filled_table(STUDY.all_columns, measured))[1]
    assert finding.holds, finding.sentence
    assert finding.tolerance == 0.15
