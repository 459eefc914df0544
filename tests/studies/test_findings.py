"""Findings: wording for either outcome, verdicts, and claims without measurements."""

import math

import pytest

from twinlens.studies import (
    STUDIES,
    SeedSupport,
    depth_error,
    focus,
    pinhole,
    radiometric,
    window,
)
from twinlens.studies.findings import Finding, compared
from twinlens.studies.intervals import Interval
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
    assert SeedSupport(finding, 0, 1).verdict == "no verdict: not measured"


@pytest.mark.parametrize(
    ("text", "measured"),
    [("All is well", NOTHING), ("Least is {}", Interval(1.0, NAN, NAN))],
)
def test_neither_a_number_nor_an_interval_is_required(text, measured):
    finding = Finding(text, measured, holds=True)
    assert finding.has_verdict
    assert finding.holds


def test_the_verdict_names_the_prediction_and_the_seeds():
    finding = Finding(
        "p = {}", Interval(2.0, NAN, NAN), True, expected=2.0, tolerance=0.05
    )
    assert (
        SeedSupport(finding, 1, 3).verdict
        == "holds; expected 2 within 5 %; 1 of 3 seeds support it"
    )
    open_one = Finding("p = {}", Interval(2.0, NAN, NAN), False, decided=False)
    assert SeedSupport(open_one, 0, 3).verdict == "no verdict: not decided"


@pytest.mark.parametrize(
    ("difference", "result", "holds"),
    [
        (Interval(2, 1, 3, 9), "2 s [1, 3] fewer than b", True),
        (Interval(-2, -3, -1, 9), "2 s [1, 3] more than b", False),
        (Interval(2, -1, 5, 9), "2 s [-1, 5] fewer than b", False),
        (NOTHING, "(not measured) fewer than b", False),
    ],
)
def test_a_difference_is_worded_by_its_sign(difference, result, holds):
    finding = compared(
        "a is fewer than b", difference, "fewer", "more", "than b", unit="s"
    )
    assert finding.sentence == f"a is fewer than b. Measured: {result}"
    assert finding.holds is holds


def test_the_size_of_a_difference_swaps_the_ends_of_its_interval():
    finding = compared("a", Interval(-2.0, -5.0, 1.0, 7), "fewer", "more", "than b")
    assert finding.measured == Interval(2.0, -1.0, 5.0, 7)
    assert finding.result == "{} more than b"
    assert compared("a", NOTHING, "fewer", "more", "").measured == NOTHING


@pytest.mark.parametrize(
    ("census", "way", "holds"), [(5.0, "fewer", True), (11.0, "more", False)]
)
def test_census_against_the_best_other_cost(census, way, holds):
    wrong = {"census": census, "sad": 8.0, "rank": 20.0}
    rows = [
        {"change": "gain", "amount": 2.0, "method": method, "totbad2": value}
        for method, value in wrong.items()
    ]
    finding = radiometric.conclude(rows_of("radiometric", rows))[-1]
    assert finding.sentence.endswith(
        f"Measured: 3 percentage points (range of 3: 3 to 3) {way} than sad"
    )
    assert finding.holds is holds


@pytest.mark.parametrize(
    ("different", "way", "holds"), [(30.0, "more", True), (10.0, "fewer", False)]
)
def test_cameras_with_different_focus(different, way, holds):
    wrong = {"both far": 18.0, "both near": 22.0, "far and near": different}
    line = [
        {"part": "line", "method": "", "defocus_px": d, "blur_px": d, "predicted_px": d}
        for d in (1.0, 2.0)
    ]
    maps = [{"part": "map", "method": "sad", "aperture_px": focus.BLURS_PX[-1], "focus": place,
             "totbad2": 10 * abs(place - 0.5)} for place in focus.FOCI]  # fmt: skip
    eyes = [
        {"part": "eyes", "method": "sad", "eyes": focus_of, "totbad2": value}
        for focus_of, value in wrong.items()
    ]
    findings = focus.conclude(rows_of("focus", line + maps + eyes))
    assert (
        "Measured: 5 percentage points (range of 3: 5 to 5) fewer at the best focus, 50 %"
        in findings[1].sentence
    )
    assert findings[2].sentence.startswith(
        "sad: cameras with different focus give more wrong pixels"
    )
    assert findings[2].sentence.endswith(
        f"10 percentage points (range of 3: 10 to 10) {way} with different focus"
    )
    assert findings[2].holds is holds


@pytest.mark.parametrize(
    ("wrong", "best", "holds"), [((0.0, 5.0), 0, False), ((5.0, 9.0), 50, True)]
)
def test_the_best_focus_can_be_an_end_of_the_range(wrong, best, holds):
    maps = [{"part": "map", "method": "sad", "aperture_px": focus.BLURS_PX[-1], "focus": place,
             "totbad2": {0.0: wrong[0], 1.0: wrong[1], 0.5: 2.0}.get(place, 4.0)} for place in focus.FOCI]  # fmt: skip
    finding = focus._best_focus(rows_of("focus", maps), "sad")
    assert f"at the best focus, {best} % of the way" in finding.sentence
    assert finding.holds is holds


@pytest.mark.parametrize(("far_field", "way"), [(6.0, "low"), (9.0, "high")])
def test_the_far_field_pattern_against_fresnels(far_field, way):
    rows = [{"diameter_mm": pinhole._NEAR_BEST_MM, "model": model, "mtf50": frequency}
            for model, frequency in zip(pinhole.MODELS, (far_field, 7.5), strict=True)]  # fmt: skip
    finding = pinhole.far_field_error(rows_of("pinhole", rows, scenes=["edge"]))
    assert finding.sentence.endswith(f"Measured: 1.5 cycles/mm too {way}")
    assert finding.holds is (way == "low")


@pytest.mark.parametrize(
    ("adaptive", "result", "holds"),
    [
        (14.0, "5 percentage points (range of 3: 4 to 6) fewer", True),
        (46.8, "27.8 percentage points (range of 3: 26.8 to 28.8) more", False),
    ],
)
def test_adaptive_windows_at_discontinuities(adaptive, result, holds):
    """SSD with a large fixed block has 20 % of wrong pixels in all scenes."""
    wrong = dict(zip(window.COMPARED, (20.0, adaptive, 12.0), strict=True))
    rows = [
        {"scene": scene, "seed": 0.0, "method": method, "block_size": NAN, "region": "discontinuity",
         "totbad2": value + (k if method == "adaptive" else 0.0)}
        for k, scene in enumerate("abc")
        for method, value in wrong.items()
    ]  # fmt: skip
    finding = window.conclude(filled_table(STUDIES["window"].all_columns, rows))[-2]
    assert (
        finding.text
        == "At discontinuities, an adaptive window has fewer wrong pixels than SSD with a fixed 21x21 block"
    )
    assert finding.sentence.endswith(f"Measured: {result} with an adaptive window")
    assert "-" not in finding.sentence
    assert finding.holds is holds


@pytest.mark.parametrize(
    ("sizes", "times", "holds"), [((9, 21), "0.429", False), ((21, 9), "2.33", True)]
)
def test_the_best_block_of_a_region_against_discontinuities(sizes, times, holds):
    rows = [
        {
            "method": "sad",
            "block_size": float(size),
            "region": region,
            "totbad2": abs(size - best),
        }
        for region, best in zip(("textureless", "discontinuity"), sizes, strict=True)
        for size in (9, 21)
    ]
    finding = window._larger(
        rows_of("window", rows), "sad", "textureless", "without texture"
    )
    assert finding.sentence.endswith(
        f"Measured: {times} (range of 3: {times} to {times}) times its width"
    )
    assert finding.holds is holds


@pytest.mark.parametrize(("power", "holds"), [(0.9, True), (1.2, False), (-0.2, False)])
def test_the_growth_of_occlusion_has_two_limits(power, holds):
    rows = [
        {"part": depth_error.SCENES, "baseline_mm": b, "occluded": b**power}
        for b in (1.0, 2.0, 4.0)
    ]
    finding = depth_error.occlusion(rows_of("baseline", rows))
    assert finding.holds is holds
    assert f"Measured: p = {power:g}" in finding.sentence
