"""The page compares groups of samples by recorded values, and says doubts about maps."""

import html
import re
from dataclasses import replace

import pytest

from tests.report.test_page import browse, document_of, needs_chromium
from tests.scoring.test_grouping import METRIC, PROTOCOL, two_lenses
from twinlens.report.page import page_html
from twinlens.scoring import CONSISTENCY, compare_groups, groups_by

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
    comparison = compare_groups(board, PROTOCOL, "all", groups_by(board, "lens"))
    interval = comparison.differences["f/4"]["m"].interval
    gaps = second["gaps"][PROTOCOL]["all"]
    value, low, high, scenes, basis = gaps["methods"]["m"]
    assert (value, low, high) == (interval.value, interval.low, interval.high)
    assert (scenes, basis, gaps["basis"]) == (6, "paired, 6 scenes", "paired, 6 scenes")
    mean = second["means"][PROTOCOL]["all"]["m"]["v"][METRIC]
    assert mean == pytest.approx(sum(FIRST) / 6 - 1.5, rel=1e-5)


def test_the_reader_chooses_the_groups_shown_first():
    assert document_of(doubted_board(), by="scene")["by"] == "scene"
    assert document_of(replace(doubted_board(), recorded={}))["by"] == ""


def test_differences_are_of_lenses_and_of_the_value_asked_for():
    board = doubted_board()
    recorded = {
        name: {**board.recorded[name], "family": str(k % 2), "split": str(k % 3)}
        for k, name in enumerate(board.samples)
    }
    document = document_of(replace(board, recorded=recorded), by="split")
    with_gaps = [
        grouping["by"]
        for grouping in document["groupings"]
        if any(group["gaps"] for group in grouping["groups"])
    ]
    assert with_gaps == ["lens", "split"]


def without_truth_at_f_1_4():
    """f/1.4 of the scene has entries of the protocol for pairs without truth only, f/2 and f/4 of both."""
    board = two_lenses(FIRST, [score - 1.5 for score in FIRST])
    thirds = [
        replace(entry, sample=entry.sample.replace("f/4", "f/2"))
        for entry in board.entries
        if "f/4" in entry.sample
    ]
    checks = [replace(entry, protocol=CONSISTENCY) for entry in board.entries]
    scored = [entry for entry in board.entries if "f/1.4" not in entry.sample]
    entries = (*checks, *scored, *thirds)
    samples = {entry.sample for entry in entries}
    return replace(
        board,
        entries=entries,
        scenes={name: name.split()[0] for name in samples},
        recorded={name: {"lens": name.split()[-1]} for name in samples},
    )


def test_each_protocol_has_the_first_group_that_it_scores_as_reference():
    document = document_of(without_truth_at_f_1_4())
    groups = {group["name"]: group for group in document["groupings"][0]["groups"]}
    assert [*groups] == ["f/1.4", "f/4", "f/2"]
    protocols = {name: [*(group["gaps"] or {})] for name, group in groups.items()}
    assert protocols == {"f/1.4": [], "f/4": [CONSISTENCY], "f/2": [PROTOCOL]}
    assert groups["f/1.4"]["means"][PROTOCOL]["all"]["m"]["n"] == 0


def groups_shown(path, board):
    """The table of groups as HTML."""
    dom = browse(path, page_html(board))
    assert 'data-ready="1"' in dom
    return re.search(r'<table id="groups">(.*?)</table>', dom, re.S)[1]


@needs_chromium
def test_few_scenes_have_a_range_without_colour(tmp_path):
    """Both of two scenes are worse: without an effect this happens in every other board."""
    table = groups_shown(tmp_path / "page.html", two_lenses([10.0, 20.0], [11.0, 25.0]))
    assert "(range of 2: +1.00 to +5.00)" in table
    assert "gain" not in table
    assert "loss" not in table


@needs_chromium
def test_a_group_without_scores_by_the_protocol_is_not_shown(tmp_path):
    board = without_truth_at_f_1_4()
    entries = sorted(board.entries, key=lambda entry: entry.protocol == CONSISTENCY)
    table = groups_shown(tmp_path / "page.html", replace(board, entries=tuple(entries)))
    assert "f/2 − f/4" in table
    assert "f/1.4" not in table


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
