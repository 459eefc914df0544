"""docs/studies.md: the example study runs as printed, links work, tables match their scripts."""

import json
import re
from pathlib import Path

import pytest

from tests.docs.pages import blocks, check_links
from twinlens.cli import run
from twinlens.studies import STUDIES

PAGE = Path(__file__).parents[2] / "docs" / "studies.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not available")


def test_the_example_study_is_short_and_runs(tmp_path):
    text = next(block for _, block in blocks(PAGE, "python") if "STUDY = Study(" in block)
    assert len(text.splitlines()) < 60
    path = tmp_path / "low_light.py"
    path.write_text(text)
    out = tmp_path / "out"
    assert run(["study", str(path), "--seeds", "1", "--size", "96x72", "--spp", "2", "-o", str(out)]) == 0
    assert len(json.loads((out / "study.json").read_text())["findings"]) == 2
    assert (out / "figures" / "light.svg").exists()


def test_every_study_has_its_section():
    titles = " ".join(re.findall(r"^### (.*)$", PAGE.read_text(), flags=re.MULTILINE))
    assert all(name in titles for name in STUDIES)


def test_the_table_of_samples_matches_its_script(monkeypatch):
    """Every scene and f-number of the script has a row, and the script finds the table to replace."""
    monkeypatch.syspath_prepend(PAGE.parents[1] / "benchmarks")
    import bench_samples as script

    page = PAGE.read_text()
    assert "`python benchmarks/bench_samples.py --seeds 2 --write` makes this table" in page
    lines = page[page.index(script.HEAD) :].partition("\n\n")[0].splitlines()
    names = [line.split(" | ")[0].removeprefix("| ") for line in lines[2:]]
    assert names == [f"{scene}, f/{number:g}" for scene in script.SCENES for number in script.F_NUMBERS]
    assert script.replace_table(page, lines) == page
    renewed = script.replace_table(page, [*lines[:2], "| one row |"])
    assert renewed.count("\n") == page.count("\n") - len(names) + 1
    assert lines[2] not in renewed


@pytest.mark.slow
def test_the_script_of_samples_runs(monkeypatch):
    monkeypatch.syspath_prepend(PAGE.parents[1] / "benchmarks")
    import bench_samples as script

    monkeypatch.setattr(script, "SCENES", ("cards",))
    monkeypatch.setattr(script, "F_NUMBERS", (2.0, 4.0))
    found = dict(script.rows((96, 72), [0], (1, 64)))
    assert list(found) == ["cards, f/2", "cards, f/4"]
    for few, many, expected in found.values():
        assert 100 >= few[0] > many[0] > 0
        assert 0 < expected[0] < few[0]
    assert script.cell([2.04, 2.0]) == "2 %"
    assert script.cell([1.0, 2.0]) == "1.5 % (1 to 2)"


def test_links_exist():
    check_links(PAGE)
