"""A difference the other way round than a sentence claims is said with the other word, and without a sign."""

import pytest

from twinlens.studies import STUDIES, Interval, Table, focus, pinhole, radiometric
from twinlens.studies.bootstrap import unsigned

NAN = float("nan")


def table(study, rows):
    empty = dict.fromkeys((column.name for column in STUDIES[study].all_columns), NAN)
    return Table(STUDIES[study].all_columns, tuple({**empty, "seed": 0.0, **row} for row in rows))


def scenes(rows):
    """The same rows of three scenes, `totbad2` a little off in each."""
    return [{**row, "scene": scene, "totbad2": row["totbad2"] + k} for k, scene in enumerate("abc") for row in rows]


@pytest.mark.parametrize(("census", "way", "holds"), [(5.0, "fewer", True), (11.0, "more", False)])
def test_census_beside_its_nearest_rival(census, way, holds):
    wrong = {"census": census, "sad": 8.0, "rank": 20.0}
    rows = [{"change": "gain", "amount": 2.0, "method": method, "totbad2": value} for method, value in wrong.items()]
    same_in_all = [{**row, "scene": scene} for scene in "abc" for row in rows]
    finding = radiometric.conclude(table("radiometric", same_in_all))[-1]
    assert finding.sentence.endswith(f": 3 percent points (range of 3: 3 to 3) {way} than sad")
    assert finding.holds is holds


@pytest.mark.parametrize(("unlike", "way", "holds"), [(30.0, "more", True), (10.0, "fewer", False)])
def test_eyes_focused_unlike(unlike, way, holds):
    wrong = {"both far": 18.0, "both near": 22.0, "far and near": unlike}
    line = [{"scene": "lamps", "part": "line", "method": "", "defocus_px": d, "blur_px": d, "predicted_px": d}
            for d in (1.0, 2.0)]  # fmt: skip
    maps = [{"part": "map", "method": "sad", "aperture_px": focus.BLURS_PX[-1], "focus": place,
             "totbad2": 10 * abs(place - 0.5)} for place in focus.FOCI]  # fmt: skip
    eyes = [{"part": "eyes", "method": "sad", "eyes": each, "totbad2": value} for each, value in wrong.items()]
    findings = focus.conclude(table("focus", line + scenes(maps + eyes)))
    assert "the best focus lies 50 %" in findings[1].sentence
    assert findings[2].sentence.startswith("sad: eyes focused unlike have 10 percent points (range of 3: 10 to 10) ")
    assert f") {way} wrong pixels than eyes focused alike" in findings[2].sentence
    assert findings[2].holds is holds


@pytest.mark.parametrize(("far_field", "way"), [(6.0, "low"), (9.0, "high")])
def test_the_far_field_pattern_beside_the_true_one(far_field, way):
    rows = [{"scene": "edge", "diameter_mm": pinhole._NEAR_BEST_MM, "model": model, "mtf50": frequency}
            for model, frequency in zip(pinhole._MODELS, (far_field, 7.5), strict=True)]  # fmt: skip
    finding = pinhole._far_from_true(table("pinhole", rows))
    assert finding.sentence.endswith(f"which is 1.5 cycles/mm too {way}")
    assert finding.holds is (way == "low")


def test_an_interval_is_turned_round_end_for_end_and_keeps_what_it_was_drawn_of():
    difference = Interval(-2.0, -5.0, 1.0, 7)
    assert unsigned(difference, "fewer", "more") == (Interval(2.0, -1.0, 5.0, 7), "more")
    assert unsigned(unsigned(difference, "", "")[0], "fewer", "more")[1] == "fewer"
    none = Interval(NAN, NAN, NAN)
    assert unsigned(none, "fewer", "more") == (none, "fewer")
