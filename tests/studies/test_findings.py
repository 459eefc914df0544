"""Findings: wording for either outcome, verdicts, and claims without measurements."""

import math

import numpy as np
import pytest

from twinlens.scoring.intervals import Interval, bootstrap, mean
from twinlens.studies import (
    FAILS,
    HOLDS,
    OPEN,
    STUDIES,
    Needs,
    SeedSupport,
    depth_error,
    focus,
    pinhole,
    radiometric,
    window,
)
from twinlens.studies.findings import (
    SHARES,
    Finding,
    bounded,
    compared,
    fewer_wrong,
    predicted,
    shortages,
    units_to_decide,
)
from twinlens.studies.table import filled_table

NAN = math.nan
NOTHING = Interval(NAN, NAN, NAN)


def rows_of(study, rows, scenes="abc"):
    """The rows repeated in each scene, with `totbad2` increasing by one from scene to scene."""
    return filled_table(STUDIES[study].all_columns, [
        {"seed": 0.0, "scene": scene, **row, **({"totbad2": row["totbad2"] + k} if "totbad2" in row else {})}
        for k, scene in enumerate(scenes) for row in rows
    ])  # fmt: skip


def test_a_finding_without_a_measurement_has_no_verdict():
    finding = Finding("Census has {} fewer", NOTHING, holds=True, unit="%")
    assert not finding.has_verdict
    assert finding.sentence == "Census has (not measured) fewer"
    assert SeedSupport(finding, 0, 1).verdict == "not decided: not measured"


def test_the_verdict_names_the_prediction_and_the_seeds():
    finding = Finding(
        "p = {}", Interval(2.0, NAN, NAN), True, expected=2.0, tolerance=0.05
    )
    assert (
        SeedSupport(finding, 1, 3).verdict
        == "holds; expected 2 within 5 %; 1 of 3 seeds support it"
    )
    open_one = Finding("p = {}", Interval(2.0, NAN, NAN), False, decided=False)
    assert SeedSupport(open_one, 0, 3).state == OPEN


@pytest.mark.parametrize(
    ("difference", "result", "state"),
    [
        (Interval(2, 1, 3, 9), "2 s [1, 3] fewer than b", HOLDS),
        (Interval(-2, -3, -1, 9), "2 s [1, 3] more than b", FAILS),
        (Interval(2, -1, 5, 9), "2 s [-1, 5] fewer than b", OPEN),
        (Interval(-2, -5, 1, 9), "2 s [-1, 5] more than b", OPEN),
        (Interval(0, 0, 0, 9), "0 s [0, 0] fewer than b", FAILS),
        (NOTHING, "(not measured) fewer than b", OPEN),
    ],
)
def test_a_difference_is_worded_by_its_sign(difference, result, state):
    finding = compared(
        "a is fewer than b", difference, "fewer", "more", "than b", unit="s"
    )
    assert finding.sentence == f"a is fewer than b. Measured: {result}"
    assert SeedSupport(finding, 1, 1).state == state


@pytest.mark.parametrize(
    ("value", "low", "high", "state"),
    [
        (2.05, 2.0, 2.1, HOLDS),
        (2.05, 1.9, 2.3, OPEN),  # within the tolerance, but the interval is not
        (2.3, 2.25, 2.35, FAILS),
        (2.3, 1.0, 3.5, OPEN),
        (1.7, 1.6, 1.75, FAILS),
    ],
)
def test_a_prediction_is_refuted_only_by_an_interval_outside_its_tolerance(
    value, low, high, state
):
    finding = predicted("p = {}", Interval(value, low, high, 9), 2.0, 0.1)
    assert SeedSupport(finding, 1, 1).state == state


@pytest.mark.parametrize(
    ("value", "low", "high", "state"),
    [(4, 3, 4.5, HOLDS), (6, 5.5, 7, FAILS), (4, 3, 5.5, OPEN), (-1, -2, -0.5, FAILS)],
)
def test_a_bounded_value_is_judged_by_its_interval(value, low, high, state):
    finding = bounded("It is {}", Interval(value, low, high, 9), 0.0, 5.0)
    assert SeedSupport(finding, 1, 1).state == state


def rows_of_scenes(scenes, seeds):
    return filled_table(STUDIES["window"].all_columns, [
        {"scene": scene, "seed": float(seed), "method": method, "block_size": NAN, "region": "nonocc",
         "totbad2": wrong + seed, "totbad1": NAN, "avgerr": NAN, "pixels": 1e6}
        for scene in scenes for seed in range(seeds) for method, wrong in (("sad", 9.0), ("census", 4.0))
    ])  # fmt: skip


def lacking_of(scenes, seeds, pixels=320 * 240, **more):
    table = rows_of_scenes(scenes, seeds)
    finding = fewer_wrong("a", table, "census", "sad", "than SAD", **more)
    return [shortage.text for shortage in shortages(finding, pixels)]


def test_scenes_are_the_units_of_a_claim_or_the_seeds_of_a_single_scene():
    assert lacking_of("abc", 1) == []
    assert lacking_of("a", 3) == []
    assert lacking_of("ab", 9) == ["3 scenes (has 2)"]
    assert lacking_of("a", 2) == ["3 seeds (has 2)"]
    assert lacking_of("a", 1) == ["3 seeds (has 1)"]


def test_a_share_needs_an_image_and_a_mean_over_a_region_its_pixels():
    """400 blocks of 9x9 pixels: the standard error of a share is at most sqrt(0.25 / 400) = 2.5 %."""
    assert SHARES.pixels == round(0.25 / 0.025**2) * 81
    assert lacking_of("abc", 1, 160 * 120) == ["images of 32400 pixels (has 19200)"]
    assert lacking_of("abc", 1, 240 * 180) == []
    few = {"needs": Needs(region_pixels=2430), "region_pixels": 1200.0}
    (text,) = lacking_of("abc", 1, 160 * 120, **few)
    assert text == "2430 pixels in its smallest region (has 1200)"


def test_a_claim_that_lacks_its_sample_is_not_decided_however_clear_it_looks():
    table = rows_of_scenes("ab", 1)
    finding = fewer_wrong("a", table, "census", "sad", "than SAD")
    assert finding.measured.low == 5.0
    support = SeedSupport(finding, 1, 1, shortages(finding, 10**6))
    assert support.verdict == "not decided: needs 3 scenes (has 2)"


def test_three_units_without_an_effect_decide_by_chance_in_a_quarter_of_the_runs():
    """All three signs are equal with a probability of 2 / 2^3; the bound is four standard errors."""
    runs, rng = 1000, np.random.default_rng(5)
    states = [
        SeedSupport(compared("a", bootstrap(mean, units), "", "", ""), 1, 1).state
        for units in rng.standard_normal((runs, 3, 1))
    ]
    for state in (HOLDS, FAILS):
        share = states.count(state) / runs
        assert abs(share - 1 / 8) < 4 * math.sqrt(1 / 8 * 7 / 8 / runs)


def test_the_number_of_units_that_would_decide():
    """Half an interval of 4 units is 3; of 10 units 3 sqrt(4 / 10) = 1.9, which is less than the distance 2."""
    finding = compared("a", Interval(2, -1, 5, 4), "more", "fewer", "")
    assert units_to_decide(finding) == 10
    assert "about 10 scenes would decide it" in SeedSupport(finding, 1, 1).verdict
    hopeless = compared("a", Interval(0.1, -3, 3, 4), "more", "fewer", "")
    assert units_to_decide(hopeless) is None
    assert "over 100 scenes would decide it" in SeedSupport(hopeless, 1, 1).verdict


def test_a_verdict_of_one_scene_of_many_names_it():
    finding = Finding("a", Interval(1.0, 0.5, 1.5, 3, "cards"), True)
    support = SeedSupport(finding, 1, 1, place="cards")
    assert support.verdict == "holds on cards; 1 of 1 seed supports it"


def test_the_size_of_a_difference_swaps_the_ends_of_its_interval():
    finding = compared("a", Interval(-2.0, -5.0, 1.0, 7), "fewer", "more", "than b")
    assert finding.measured == Interval(2.0, -1.0, 5.0, 7)


def focus_rows(different):
    """Wrong pixels least half way between the foci; two equal foci at 20 %, different ones as given."""
    line = [
        {"part": "line", "method": "", "defocus_px": d, "blur_px": d, "predicted_px": d}
        for d in (1.0, 2.0)
    ]
    place = {"part": "map", "method": "sad", "aperture_px": focus.BLURS_PX[-1]}
    maps = [{**place, "focus": at, "totbad2": 10 * abs(at - 0.5)} for at in focus.FOCI]
    wrong = {"both far": 18.0, "both near": 22.0, "far and near": different}
    eyes = [
        {"part": "eyes", "method": "sad", "eyes": pair, "totbad2": value}
        for pair, value in wrong.items()
    ]
    return rows_of("focus", line + maps + eyes)


def cameras_with_different_focus(different):
    return focus.conclude(focus_rows(different))[2]


def best_focus(nearest):
    """Wrong pixels of a focus at the near end of the range: 2 % at its middle, 4 % elsewhere."""
    place = {"part": "map", "method": "sad", "aperture_px": focus.BLURS_PX[-1]}
    wrong = {0.0: nearest, 0.5: 2.0}
    rows = [{**place, "focus": at, "totbad2": wrong.get(at, 4.0)} for at in focus.FOCI]
    return focus._best_focus(rows_of("focus", rows), "sad")


def census(wrong):
    """The best of the other costs has 8 % of wrong pixels."""
    shares = {"census": wrong, "sad": 8.0, "rank": 20.0}
    rows = [
        {"change": "gain", "amount": 2.0, "method": method, "totbad2": share}
        for method, share in shares.items()
    ]
    return radiometric.conclude(rows_of("radiometric", rows))[-1]


def far_field_pattern(mtf50):
    near_best = {"diameter_mm": pinhole._NEAR_BEST_MM}
    far_field, fresnel = pinhole.MODELS
    rows = [
        {**near_best, "model": far_field, "mtf50": mtf50},
        {**near_best, "model": fresnel, "mtf50": 7.5},
    ]
    return pinhole.far_field_error(rows_of("pinhole", rows, scenes=["edge"]))


def adaptive_windows(wrong):
    """SSD with a large fixed block has 20 % of wrong pixels."""
    of_method = dict(zip(window.COMPARED, (20.0, wrong, 12.0), strict=True))
    rows = [
        {"method": method, "block_size": NAN, "region": "discontinuity", "totbad2": bad}
        for method, bad in of_method.items()
    ]
    return window.conclude(rows_of("window", rows))[-2]


def best_block_without_texture(size):
    """The best block at discontinuities has a width of 15."""
    rows = [
        {
            "method": "sad",
            "block_size": float(s),
            "region": region,
            "totbad2": abs(s - best),
        }
        for region, best in (("textureless", size), ("discontinuity", 15))
        for s in (9, 15, 21)
    ]
    return window._larger(
        rows_of("window", rows), "sad", "textureless", "without texture"
    )


def growth_of_occlusion(power):
    rows = [
        {"part": depth_error.SCENES, "baseline_mm": b, "occluded": b**power}
        for b in (1.0, 2.0, 4.0)
    ]
    return depth_error.occlusion(rows_of("baseline", rows))


@pytest.mark.parametrize(
    ("finding_of", "value", "measured", "holds"),
    [
        (cameras_with_different_focus, 30.0, 10, True),
        (cameras_with_different_focus, 10.0, 10, False),
        (census, 5.0, 3, True),
        (census, 11.0, 3, False),
        (best_focus, 5.0, 2, True),
        (best_focus, 0.0, 0, False),
        (far_field_pattern, 6.0, 1.5, True),
        (far_field_pattern, 9.0, 1.5, False),
        (adaptive_windows, 14.0, 6, True),
        (adaptive_windows, 46.0, 26, False),
        (best_block_without_texture, 21, 1.4, True),
        (best_block_without_texture, 9, 0.6, False),
        (growth_of_occlusion, 0.9, 0.9, True),
        (growth_of_occlusion, 1.2, 1.2, False),
        (growth_of_occlusion, -0.2, -0.2, False),
    ],
)
def test_both_outcomes_of_a_finding(finding_of, value, measured, holds):
    finding = finding_of(value)
    assert finding.measured.value == pytest.approx(measured)
    assert SeedSupport(finding, 1, 1).state == (HOLDS if holds else FAILS)
