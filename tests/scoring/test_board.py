"""The board as data, file and text."""

import contextlib
import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from rich.console import Console

from tests.scoring.scoring_methods import Constant, Trouble, pair
from twinlens.dataset import Calibration
from twinlens.errors import FileError, InputError, OutputError, TwinlensError
from twinlens.scoring import (
    PROTOCOLS,
    Board,
    Entry,
    board_csv,
    board_file,
    board_latex,
    board_to_json,
    caption,
    failures,
    leaderboard_table,
    read_board,
    run_benchmark,
    standings,
)
from twinlens.scoring.board import MatchFailure
from twinlens.scoring.board_file import board_from_json, write_board
from twinlens.scoring.evaluate import RegionScores

NAN = math.nan


def entry(method, sample, bad, *, evaluated=10, failure=None, region="all"):
    metrics = dict.fromkeys(PROTOCOLS["middlebury-v3"].metrics, 1.0) | {
        "totbad2.0": bad,
        "coverage": abs(100 - bad),
    }
    regions = {} if failure else {region: RegionScores(12, evaluated, 9, metrics)}
    return Entry(
        method,
        method,
        sample,
        "0" * 64,
        "middlebury-v3",
        4,
        3,
        8,
        0.5,
        failure,
        regions,
        min_disparity=-7,
    )


def board(*entries):
    return Board(
        "t", entries, {"numpy": "2"}, {entry.sample: "hall" for entry in entries}
    )


def test_a_mean_is_plain_unless_weighted():
    b = board(entry("m", "s", 10), entry("m", "t", 40))
    assert b.mean("m", "middlebury-v3", "all").metrics["totbad2.0"] == 25
    assert b.mean("m", "middlebury-v3", "all", {"t": 0.5}).metrics["totbad2.0"] == 20
    assert b.mean("m", "middlebury-v3", "all").metrics["time/MP"] == pytest.approx(
        0.5 / 12e-6
    )


def test_a_failure_leaves_no_mean_and_comes_last():
    b = board(
        *(entry("m", "s", 10), entry("m", "t", 0, failure=MatchFailure("crash", "x"))),
        *(entry("n", "s", 90), entry("n", "t", 90)),
    )
    assert math.isnan(b.mean("m", "middlebury-v3", "all").metrics["totbad2.0"])
    assert [(m.method, m.failed) for m in standings(b, "middlebury-v3")] == [
        ("n", ()),
        ("m", ("t",)),
    ]


def test_a_pair_that_was_not_run_is_missing_and_leaves_no_mean():
    """A method run on the easy sample only must not rank above one run on both."""
    b = board(entry("easy", "s", 1), entry("both", "s", 10), entry("both", "t", 90))
    ranked = standings(b, "middlebury-v3")
    assert [(m.method, m.counted, m.missing, m.total) for m in ranked] == [
        ("both", 2, (), 2),
        ("easy", 1, ("t",), 2),
    ]
    assert math.isnan(ranked[1].metrics["totbad2.0"])
    assert math.isnan(ranked[1].metrics["time"])


def test_a_region_not_scored_is_missing_only_where_another_has_it():
    b = board(
        entry("m", "s", 1),
        entry("m", "t", 1, region="near"),
        entry("n", "s", 2),
        entry("n", "t", 3),
    )
    assert b.mean("m", "middlebury-v3", "all").missing == ("t",)
    assert b.mean("n", "middlebury-v3", "all").metrics["totbad2.0"] == 2.5
    # Neither a region that no method has on a sample, nor one without a pixel, is counted.
    b = board(
        entry("m", "s", 1),
        entry("m", "t", 9, region="near"),
        entry("m", "u", 9, evaluated=0),
    )
    mean = b.mean("m", "middlebury-v3", "all")
    assert (mean.metrics["totbad2.0"], mean.counted) == (1, 1)


def test_standings_sort_each_metric_its_own_way():
    b = board(entry("m", "s", 10), entry("n", "s", 5), entry("o", "s", NAN))
    assert [m.method for m in standings(b, "middlebury-v3")] == ["n", "m", "o"]
    assert [m.method for m in standings(b, "middlebury-v3", sort="coverage")] == [
        "n",
        "m",
        "o",
    ]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda b: standings(b, "eth3d"), "unknown protocol on this board 'eth3d'"),
        (lambda b: standings(b, "middlebury-v3", sort="bad2"), "did you mean 'bad2.0'"),
        (
            lambda b: leaderboard_table(b, "middlebury-v3", columns=["D1"]),
            "unknown metric 'D1'",
        ),
        (lambda b: b.mean("m", "middlebury-v3", "all", {"x": 1}), "unknown sample 'x'"),
        (
            lambda b: b.mean("m", "middlebury-v3", "all", {"s": -1}),
            "weight of 's' is -1",
        ),
    ],
)
def test_unknown_names_are_refused(call, says):
    with pytest.raises(InputError, match=says):
        call(board(entry("m", "s", 10)))


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
numbers = st.one_of(st.floats(0, 1e9), st.just(math.inf), st.just(NAN))


@given(method=texts, sample=texts, bad=numbers, message=texts, failed=st.booleans())
@settings(max_examples=60, deadline=None)
def test_json_round_trip(method, sample, bad, message, failed):
    b = board(
        entry(
            method,
            sample,
            bad,
            failure=MatchFailure("crash", message) if failed else None,
        )
    )
    text = board_to_json(b)
    json.loads(text, parse_constant=pytest.fail)
    again = board_from_json(text)
    assert board_to_json(again) == text
    assert (again.methods, again.samples) == (b.methods, b.samples)
    if not failed:
        np.testing.assert_equal(again.entries[0].value("all", "totbad2.0"), bad)


VALID = board_to_json(
    board(entry("m", "s", 10), entry("n", "s", 0, failure=MatchFailure("crash", "x")))
)
TEXTS = [
    ("[]", "not a twinlens-board file"),
    ("{", "not valid JSON"),
    ("[" * 100_000, "not valid JSON"),
    ('{"format": NaN}', "NaN is not JSON"),
    (VALID.replace('"version": 1', '"version": 2'), "reads version 1"),
    (VALID.replace('"title"', '"titel"'), "did you mean 'title'"),
    (VALID.replace('"width": 4', '"width": 0'), "width: must be >= 1, got 0"),
    (VALID.replace('"seconds": 0.5', '"seconds": 1e300'), "must be < 1e280"),
    (VALID.replace('"bad2.0": 1.0', '"bad2": 1.0'), "did you mean 'bad2.0'"),
    (VALID.replace("middlebury-v3", "eth"), "did you mean 'eth3d'"),
    (VALID.replace('"crash"', '"bad luck"'), "unknown failure 'bad luck'"),
    (VALID.replace('"method": "n"', '"method": "m"'), "two entries for m / s"),
]


@pytest.mark.parametrize(
    ("text", "message"), TEXTS, ids=[message for _, message in TEXTS]
)
def test_the_reader_is_strict(text, message, tmp_path):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(FileError, match=message) as error:
        read_board(path)
    assert str(error.value).startswith(str(path))
    assert len(str(error.value)) < 600


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_a_damaged_board_is_read_or_refused(data):
    text = board_to_json(board(entry("m", "s", 10)))
    start = data.draw(st.integers(0, len(text) - 1))
    stop = start + data.draw(st.integers(0, 8))
    damaged = text[:start] + data.draw(st.text(max_size=3)) + text[stop:]
    with contextlib.suppress(TwinlensError):
        assert isinstance(board_from_json(damaged), Board)


def test_a_board_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    write_board(board(), tmp_path / "b.json")
    read_board(tmp_path / "b.json")
    monkeypatch.setattr(board_file, "MAX_BYTES", 2**6)
    with pytest.raises(
        FileError, match=r"b\.json: larger than .* MiB, the limit for a board$"
    ):
        read_board(tmp_path / "b.json")


def test_writing_is_atomic(tmp_path):
    path = tmp_path / "b.json"
    write_board(board(entry("m", "s", 10)), path)
    before = path.read_text()
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError):
        write_board(board(), tmp_path / "folder")
    assert path.read_text() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.json", "folder"]


def real_board():
    methods = [
        Constant("[red]off[/] & 50%_#", 6.5, 3),
        Constant("=exact", 4),
        Trouble("raises"),
    ]
    protocols = ["middlebury-v3", "eth3d", "kitti2015"]
    return run_benchmark(
        [pair("s"), pair("t", 1)],
        methods,
        protocol=protocols,
        regions=["all", "nonocc", "far"],
    )


NAMED = ("protocol", "region", "denominator", "invalid", "clip", "resolution", "mean")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_table_names_the_rules_of_its_numbers(protocol):
    """In the terminal, in LaTeX and in the board's file, for every protocol."""
    calibration = Calibration(
        (9.0, 9.0, 1.0, 1.0), (9.0, 9.0, 1.0, 1.0), 0.1, 30, 40, 0.0
    )
    b = run_benchmark(
        [replace(pair("s"), calibration=calibration)],
        [Constant("c", 4)],
        protocol=protocol,
    )
    lines = caption(b, protocol, "nonocc", {"s": 2.0}).splitlines()
    assert tuple(line.partition(": ")[0] for line in lines) == NAMED
    assert "weighted mean over samples" in lines[-1]
    console = Console(width=160, file=io.StringIO(), color_system=None)
    console.print(leaderboard_table(b, protocol, "nonocc", weights={"s": 2.0}))
    latex = board_latex(b, protocol, "nonocc", weights={"s": 2.0})
    shown = " ".join(console.file.getvalue().split())
    for line in lines:
        assert " ".join(line.split()) in shown
        assert line.partition(": ")[0] in latex
    stored = json.loads(board_to_json(b))["protocols"][protocol]
    assert all(stored[name] for name in NAMED if name not in ("region", "mean"))


def test_csv_keeps_every_number_and_escapes_formulas():
    b = real_board()
    rows = list(csv.DictReader(io.StringIO(board_csv(b))))
    assert len(rows) == 3 * 2 * 2 * 3 + 2 * 3
    off = rows[0]
    assert (off["sample"], off["region"]) == ("s", "all")
    assert float(off["avgerr"]) == b.entries[0].value("all", "avgerr") == 2.5
    assert {r["method"] for r in rows} == {"'=exact", "[red]off[/] & 50%_#", "raises"}
    assert {r["status"] for r in rows} == {"ok", "crash"}


def test_latex_escapes_names_and_marks_the_best():
    text = board_latex(real_board(), "eth3d", "all", columns=["bad2.0", "avgerr"])
    assert r"[red]off[/] \& 50\%\_\# & 100.00 & 2.50 \\" in text
    assert r"=exact & \textbf{0.00} & \textbf{0.00} \\" in text
    assert r"raises & -- & -- \\" in text
    assert text.count("{") == text.count("}")


def test_failures_are_listed_once_per_method_and_kind():
    late = [
        entry("m", name, 1, failure=MatchFailure("time-limit", "late"))
        for name in "abc"
    ]
    raised = MatchFailure("crash", "ValueError: no", ("mine.py:3 in match: raise",))
    died = entry("m", "d", 1, failure=raised)
    assert failures(board(*late, died)) == [
        "m on a and 2 more: time-limit (late)",
        "m on d: crash (ValueError: no)",
        "    mine.py:3 in match: raise",
    ]
    assert failures(board(died), ["other"]) == []
