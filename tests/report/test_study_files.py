"""Files of a study: reproducible bytes, a self-contained page, escaped names."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from twinlens.report.study_files import write_study
from twinlens.studies import Column, Figure, Measured, Picture, Setup, Study, run_study
from twinlens.studies.findings import Finding
from twinlens.studies.intervals import Interval

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
    findings = [
        Finding("It is {}", nothing, False),
        Finding("So is {}", Interval(1.0, 0.0, 2.0), False, decided=False),
    ]
    page = write_study(
        tmp_path, run_study(replace(STUDY, conclude=lambda table: findings))
    ).read_text()
    html = '<div class="finding"><p>{}.</p><p class=note>No verdict: {}.</p></div>'
    assert html.format("It is <b>(not measured)</b>", "not measured") in page
    assert html.format("So is <b>1 [0, 2]</b>", "not decided") in page
    assert "not hold" not in page


def test_the_protocol_is_complete(folder):
    protocol = json.loads((folder / "study.json").read_text())
    assert protocol["seeds"] == [0, 1]
    assert protocol["note"] == 1.5
    assert protocol["columns"]["x"] == {"unit": "m", "text": "across"}
    assert protocol["findings"][0]["text"] == "The least is 1 m of all"
    assert protocol["findings"][0]["interval"] == [None, None]
    assert protocol["findings"][1]["interval"] == [1, 3]
    assert {"twinlens", "mitsuba", "numpy"} <= set(protocol["versions"])
