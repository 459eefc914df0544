"""Files of a study: reproducible bytes, a self-contained page, escaped names."""

import html
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twinlens
from twinlens.report.study_files import write_study
from twinlens.scoring.intervals import Interval
from twinlens.studies import (
    STUDIES,
    Column,
    Figure,
    Measured,
    Needs,
    Picture,
    Setup,
    Study,
    bounded,
    run_study,
)
from twinlens.studies.findings import Finding

ROOT = Path(twinlens.__file__).parents[2]
EVIL = "<script>alert('a')</script>"


def measure(setup):
    rows = [
        {"scene": EVIL, "seed": seed, "x": x, "y": x * x + seed}
        for seed in setup.seeds
        for x in (1.0, 2.0)
    ]
    picture = Picture(
        "shown",
        EVIL,
        (np.zeros((20, 30), np.uint8),) * 3,
        ("one", "two", EVIL),
        columns=2,
    )
    return Measured(rows, (picture,), {"note": 1.5}, {"remark": EVIL})


def conclude(table):
    least = float(table.numbers("y").min())
    return [
        Finding(
            "The least is {} of all",
            Interval(least, math.nan, math.nan),
            least < 1.5,
            "m",
            1.0,
            0.05,
        ),
        Finding(f"{EVIL} is {{}}", Interval(2.0, 1.0, 3.0), False),
    ]


STUDY = Study(
    EVIL, f"Is {EVIL} shown?", (Column("x", "m", "across"), Column("y", "", "up")), measure, conclude,
    (Figure("plot", EVIL, "x", "y"),), Setup((), (), (0, 1)),
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("study")
    write_study(where, run_study(STUDY))
    return where


def test_the_same_result_gives_the_same_files(folder, tmp_path):
    write_study(tmp_path, run_study(STUDY))
    for path in folder.rglob("*"):
        if path.is_file():
            assert (
                tmp_path / path.relative_to(folder)
            ).read_bytes() == path.read_bytes()


def test_names_are_escaped(folder):
    page = (folder / "index.html").read_text()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 6


def test_the_page_is_self_contained(folder):
    page = (folder / "index.html").read_text()
    assert "default-src 'none'" in page
    assert all(
        link.startswith("data:image/png;base64,")
        for link in re.findall(r'src="([^"]*)"', page)
    )
    links = re.findall(r'href="([^"]*)"', page)
    assert sorted(set(links)) == [
        "figures/plot.png", "figures/plot.svg", "pictures/shown.png", "study.json", "table.csv",
    ]  # fmt: skip
    assert all((folder / link).exists() for link in links)


def test_the_page_gives_the_reason_for_no_verdict(tmp_path):
    """Grey: neither confirmed nor refuted."""
    nothing = Interval(math.nan, math.nan, math.nan)
    wide = Interval(1.0, 0.0, 4.0, 2)
    findings = [
        Finding("It is {}", nothing, False),
        bounded("So is {}", wide, 2.0, 9.0, needs=Needs(units=0)),
        bounded("That is {}", wide, 2.0, 9.0, needs=Needs(5, 10**6)),
    ]
    page = write_study(
        tmp_path, run_study(replace(STUDY, conclude=lambda table: findings))
    ).read_text()
    finding = '<div class="finding open"><p>{}.</p><p class=note><b>Not decided</b>: {}.</p></div>'
    assert finding.format("It is <b>(not measured)</b>", "not measured") in page
    number = "<b>1 (range of 2: 0 to 4)</b>"
    limit = "the interval contains the limit 2; about 19 scenes would decide it"
    assert finding.format(f"So is {number}", limit) in page
    lacks = "needs 5 scenes (has 2) and images of 1000000 pixels (has 76800)"
    assert finding.format(f"That is {number}", lacks) in page
    assert "<span class=open>not decided: 3</span>" in page
    assert "enough: 5 scenes --size 1156x868." in page
    assert "not hold" not in page


def test_the_page_has_the_law_the_legends_and_the_documentation(tmp_path):
    taught = replace(
        STUDY,
        law="y = x²",
        lesson="docs/course/08_triangulation.py",
        docs="docs/studies.md#intervals",
    )
    page = write_study(tmp_path, run_study(taught)).read_text()
    assert "<h2>The law</h2><p>y = x²</p>" in page
    for name in ("docs/course/08_triangulation.py", "docs/studies.md#intervals"):
        assert f"<code>{name}</code>" in page
    assert "Lines: means over scenes and seeds. Bands or bars: 95 % intervals" in page
    assert "2 seeds (0, 1)" in page


def test_a_page_names_the_pages_of_any_study_and_no_folder_of_this_machine(tmp_path):
    changed = replace(STUDY, lesson="my <lesson>.py", docs="notes.md#results")
    taught = next(iter(STUDIES.values()))
    shared = replace(STUDY, lesson=taught.lesson, docs=taught.docs)
    for study in (changed, shared):
        page = write_study(tmp_path, run_study(study)).read_text()
        for name in (study.lesson, study.docs):
            assert f"<code>{html.escape(name)}</code>" in page
        assert "file:" not in page
        assert str(ROOT) not in page


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_explains_its_law_and_links_to_pages_that_exist(name):
    study = STUDIES[name]
    assert len(study.law) > 200
    for page in (study.lesson, study.docs):
        file, _, anchor = page.partition("#")
        text = (ROOT / file).read_text()
        headings = [line for line in text.splitlines() if line.startswith("## ")]
        anchors = [line[3:].strip().lower().replace(" ", "-") for line in headings]
        assert not anchor or anchor in anchors


def test_the_protocol_is_complete(folder):
    protocol = json.loads((folder / "study.json").read_text())
    assert protocol["seeds"] == [0, 1]
    assert protocol["note"] == 1.5
    assert protocol["columns"]["x"] == {"unit": "m", "text": "across"}
    assert protocol["findings"][0]["text"] == "The least is 1 m of all"
    assert protocol["findings"][0]["interval"] == [None, None]
    assert protocol["findings"][1]["interval"] == [1, 3]
    assert {"twinlens", "mitsuba", "numpy"} <= set(protocol["versions"])
