"""A student's first study: too small, it decides nothing and says what would; run as it says, it decides."""

import json
import re

import pytest

from twinlens.studies import stage

RUN = ("study", "window", "--scene", "cards", "--methods", "zncc,census")


FEW = ("--seeds", 1, "--size", "64x48", "--spp", 2)
ENOUGH = re.compile(r"enough: (--seeds 3 --size \d+x\d+) \(about \d+ (s|min)\)\.")


@pytest.fixture
def _raw_images(monkeypatch):
    """Fewer kernels; test_the_printed_options_decide and tests/studies denoise."""
    photograph = stage.render

    def raw(*arguments, denoise):
        return photograph(*arguments, denoise=False)

    monkeypatch.setattr(stage, "render", raw)


@pytest.mark.usefixtures("_raw_images")
def test_a_study_that_is_too_small_decides_nothing_and_says_what_would(
    twinlens, tmp_path
):
    code, out, _ = twinlens("study", "list")
    assert code == 0
    assert re.search(r"^window +How large should the block be", out, re.MULTILINE)

    code, out, err = twinlens(*RUN, *FEW, "-o", tmp_path / "window")
    assert code == 0, err
    assert "does not hold" not in out
    assert out.count("not decided: needs 3 seeds (has 1)") == 6
    assert ENOUGH.search(out)
    record = json.loads((tmp_path / "window" / "study.json").read_text())
    assert [finding["holds"] for finding in record["findings"]] == [None] * 6
    check_page((tmp_path / "window" / "index.html").read_text())


def check_page(page):
    """The law, the legend and the lesson; no finding is red."""
    assert 'class="finding bad"' not in page
    assert page.count('class="finding open"') == 6
    assert "<h2>The law</h2><p>A matcher compares blocks" in page
    assert "docs/course/12_matchers" in page
    assert "Rings: the least of each line." in page
    assert "1 seed (0)" in page
    assert "seeds 0" not in page


@pytest.mark.slow
def test_the_printed_options_decide(twinlens, tmp_path):
    """The scene has over 30 blocks at discontinuities at 240x180, and sgm fewer errors than a fixed block there."""
    _, out, _ = twinlens(*RUN, *FEW, "-o", tmp_path / "small")
    options = ENOUGH.search(out)[1].split()
    folder = tmp_path / "enough"
    code, out, err = twinlens(*RUN, *options, "-o", folder)
    assert code == 0, err
    assert "needs" not in out
    assert "holds on cards; 3 of 3 seeds support it" in out
    findings = json.loads((folder / "study.json").read_text())["findings"]
    for finding in findings:
        if finding["holds"] is None:
            assert "the interval contains the limit" in finding["verdict"]
    assert findings[-1]["holds"] is True


def test_at_two_scenes_a_third_is_asked_for(twinlens, tmp_path):
    """Without renders: a study file of fixed numbers, whose claim is true in each of two scenes."""
    study = tmp_path / "mine.py"
    study.write_text("""
from twinlens.studies import Column, Measured, Setup, Study, compared, paired_difference

def measure(setup):
    return Measured([{"scene": scene, "seed": seed, "side": side, "y": y}
                     for scene in setup.scenes for seed in setup.seeds for side, y in (("a", 3.0), ("b", 1.0))])

def conclude(table):
    return [compared("a is above b", paired_difference(table, "y", "side", "a", "b"), "more", "less", "", unit="m")]

STUDY = Study("mine", "Is a above b?", (Column("side", "", "side"), Column("y", "m", "y")), measure, conclude, (),
              Setup(("cards", "fence", "room"), (), (0,)))
""")
    two = ("study", study, "--scene", "cards", "--scene", "fence")
    code, out, err = twinlens(*two, "-o", tmp_path / "two")
    assert code == 0, err
    assert "not decided: needs 3 scenes (has 2)" in out
    assert "enough: --scene cards --scene fence --scene room (about" in out
    code, out, err = twinlens("study", study, "-o", tmp_path / "three")
    assert code == 0, err
    assert "holds; 1 of 1 seed supports it" in out
