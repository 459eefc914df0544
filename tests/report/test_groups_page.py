"""The page compares groups of samples by recorded values, and says doubts about maps."""

import html
import re
from dataclasses import replace

import pytest

from tests.report.test_page import browse, document_of, needs_chromium
from tests.scoring.test_grouping import METRIC, PROTOCOL, two_lenses
from twinlens.report.page import page_html
from twinlens.scoring import compared, groups_by

FIRST = [10.0, 80.0, 30.0, 55.0, 5.0, 61.0]


def doubted_board():
    """Every score of f/4 is lower by 1.5; the method's maps look scaled by 16."""
    board = two_lenses(FIRST, [score - 1.5 for score in FIRST])
    entries = (replace(entry, doubt="values look <16>") for entry in board.entries)
    return replace(board, entries=tuple(entries))


def test_the_page_has_the_differences_of_the_board():
    board = doubted_board()
    document = document_of(board)
    assert [grouping["by"] for grouping in document["groupings"]] == ["lens", "scene"]
    assert document["by"] == "lens"
    first, second = document["groupings"][0]["groups"]
    assert (first["name"], first["gaps"]) == ("f/1.4", None)
    comparison = compared(board, PROTOCOL, "all", groups_by(board, "lens"))
    interval = comparison.differences["f/4"]["m"].interval
    value, low, high, basis = second["gaps"][PROTOCOL]["all"]["m"]
    assert (value, low, high) == (interval.value, interval.low, interval.high)
    assert basis == "paired, 6 scenes"
    mean = second["means"][PROTOCOL]["all"]["m"]["v"][METRIC]
    assert mean == pytest.approx(sum(FIRST) / 6 - 1.5, rel=1e-5)


def test_the_reader_chooses_the_groups_shown_first():
    assert document_of(doubted_board(), by="scene")["by"] == "scene"
    assert document_of(replace(doubted_board(), recorded={}))["by"] == ""


@needs_chromium
def test_groups_and_doubts_are_shown(tmp_path):
    dom = browse(tmp_path / "page.html", page_html(doubted_board()))
    assert 'data-ready="1"' in dom
    table = re.search(r'<table id="groups">(.*?)</table>', dom, re.S)[1]
    text = html.unescape(re.sub(r"<[^>]+>", " ", table))
    assert "f/4 − f/1.4" in text
    assert "−1.50" in text
    assert "paired, 6 scenes" in text
    assert 'class="gain"' in table
    doubts = re.search(r'<div id="doubts">(.*?)</div>', dom, re.S)[1]
    assert "m, 12 of 12 maps: values look &lt;16&gt;" in doubts
