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
from twinlens.scoring.board import Failure
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
    )


def board(*entries):
    return Board(
        "t", entries, {"numpy": "2"}, {entry.sample: "hall" for entry in entries}
    )


def test_a_mean_is_plain_unless_weighted():
    b = board(entry("m", "s", 10), entry("m", "t", 40))
    assert b.mean("m", "middlebury-v3", "all").metrics["totbad2.0"] == 25
    assert b.mean("m", "middlebury-v3", "all", {"t": 0.5}).metrics["totbad2.0"] == 20
    assert b.mean("m", "middlebury-v3", "all", {"t": 0}).metrics["totbad2.0"] == 10
    assert b.mean("m", "middlebury-v3", "all").metrics["time/MP"] == pytest.approx(
        0.5 / 12e-6
    )


def test_a_failure_leaves_no_mean_and_comes_last():
    b = board(
        *(entry("m", "s", 10), entry("m", "t", 0, failure=Failure("crash", "x"))),
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
    console = Console(width=200, file=io.StringIO(), color_system=None)
    console.print(leaderboard_table(b, "middlebury-v3"))
    assert "1 of 2" in console.file.getvalue()


def test_a_region_not_scored_is_missing_only_where_another_has_it():
    b = board(
        entry("m", "s", 1),
        entry("m", "t", 1, region="near"),
        entry("n", "s", 2),
        entry("n", "t", 3),
    )
    assert b.mean("m", "middlebury-v3", "all").missing == ("t",)
    assert b.mean("n", "middlebury-v3", "all").metrics["totbad2.0"] == 2.5
    b = board(entry("m", "s", 1), entry("m", "t", 1, region="near"), entry("n", "s", 2))
    assert (
        b.mean("m", "middlebury-v3", "all").total
        == b.mean("n", "middlebury-v3", "all").total
        == 1
    )


def test_a_sample_without_the_region_is_not_counted():
    b = board(
        entry("m", "s", 10),
        entry("m", "t", 30, region="near"),
        entry("m", "u", 50, evaluated=0),
    )
    mean = b.mean("m", "middlebury-v3", "all")
    assert (mean.metrics["totbad2.0"], mean.counted) == (10, 1)


def test_standings_sort_each_metric_its_own_way():
    b = board(entry("m", "s", 10), entry("n", "s", 5), entry("o", "s", NAN))
    assert [m.method for m in standings(b, "middlebury-v3")] == ["n", "m", "o"]
    assert [m.method for m in standings(b, "middlebury-v3", sort="coverage")] == [
        "n",
        "m",
        "o",
    ]
    b = board(entry("m", "s", 10), entry("n", "s", 5))
    assert standings(b, "middlebury-v3", sort="coverage")[0].metrics["coverage"] == 95


def test_two_entries_of_one_key_are_refused():
    with pytest.raises(InputError, match="two entries for m / s / middlebury-v3"):
        board(entry("m", "s", 10), entry("m", "s", 11))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda b: standings(b, "eth3d"), "unknown protocol on this board 'eth3d'"),
        (
            lambda b: standings(b, "middlebury-v3", "near"),
            "unknown region on this board 'near'",
        ),
        (lambda b: standings(b, "middlebury-v3", sort="bad2"), "did you mean 'bad2.0'"),
        (lambda b: standings(b, "middlebury-v3", sort="D1"), "unknown metric 'D1'"),
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
            method, sample, bad, failure=Failure("crash", message) if failed else None
        )
    )
    text = board_to_json(b)
    json.loads(text, parse_constant=pytest.fail)
    again = board_from_json(text)
    assert board_to_json(again) == text
    assert (again.title, again.meta, again.methods, again.samples) == (
        b.title,
        b.meta,
        b.methods,
        b.samples,
    )
    assert again.scenes == b.scenes
    if not failed:
        np.testing.assert_equal(again.entries[0].value("all", "totbad2.0"), bad)


WRONG_VALUES = [
    ("format", "x", "not a twinlens-board file"),
    ("version", 2, "reads version 1"),
    ("titel", "x", "did you mean 'title'"),
    ("title", None, "missing key 'title'"),
    ("meta.a", 3, "meta.a: must be a string, got 3"),
    ("entries.0", 3, r"entries\[0\]: must be a table"),
    ("entries.0.width", True, "width: must be a whole number, got True"),
    ("entries.0.width", 0, "width: must be >= 1, got 0"),
    ("entries.0.ndisp", 0, "ndisp: must be >= 1"),
    ("entries.0.min_disparity", 0.5, "must be a whole number, got 0.5"),
    ("entries.0.seconds", -1, "seconds: must be >= 0"),
    ("entries.0.seconds", 10**400, "seconds: must be a number, got 1000"),
    ("entries.0.seconds", 1e300, "seconds: must be < 1e280, got 1e\\+300"),
    ("entries.0.regions.all.metrics.rms", 1e308, "rms: must be < 1e280"),
    ("entries.0.regions.all.metrics.rms", "3", "rms: must be a number, got '3'"),
    ("entries.0.regions.all.metrics.bad2", 3, "did you mean 'bad2.0'"),
    ("entries.0.protocol", "eth", "did you mean 'eth3d'"),
    ("entries.1.failure.kind", "bad luck", "unknown failure 'bad luck'"),
    ("entries.1.method", "m", "two entries"),
]
"""Places in a board's file, values there that are wrong, and a part of the message."""


def changed(path, value):
    """A board's file with another value at a place; None: without it."""
    failed = entry("n", "s", 0, failure=Failure("crash", "x"))
    document = json.loads(board_to_json(board(entry("m", "s", 10), failed)))
    *parents, last = (int(key) if key.isdigit() else key for key in path.split("."))
    place = document
    for key in parents:
        place = place[key]
    place[last] = value
    if value is None:
        del place[last]
    return json.dumps(document)


TEXTS = [
    ("[]", "not a twinlens-board file"),
    ("{", "not valid JSON"),
    ("[" * 100_000, "not valid JSON"),
    ('{"format": NaN}', "NaN is not JSON"),
]
TEXTS += [(changed(path, value), message) for path, value, message in WRONG_VALUES]


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


def test_min_disparity_is_stored_and_0_in_older_files():
    text = board_to_json(board(replace(entry("m", "s", 10), min_disparity=-7)))
    assert board_from_json(text).entries[0].min_disparity == -7
    older = json.loads(text)
    del older["entries"][0]["min_disparity"]
    assert board_from_json(json.dumps(older)).entries[0].min_disparity == 0


def test_writing_is_atomic(tmp_path):
    path = tmp_path / "b.json"
    write_board(board(entry("m", "s", 10)), path)
    before = path.read_text()
    with pytest.raises(OutputError):
        write_board(board(), path / "b.json")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError):
        write_board(board(), tmp_path / "folder")
    assert path.read_text() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.json", "folder"]


def test_a_missing_or_binary_board_is_refused(tmp_path):
    with pytest.raises(FileError, match="no such file; a board is a folder that"):
        read_board(tmp_path / "none.json")
    (tmp_path / "x").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="not valid JSON"):
        read_board(tmp_path / "x")


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


def test_the_terminal_shows_order_numbers_and_protocol():
    console = Console(width=200, file=io.StringIO(), color_system=None)
    console.print(leaderboard_table(real_board(), "middlebury-v3", "nonocc"))
    text = console.file.getvalue()
    assert (
        text.index("=exact") < text.index("[red]off[/] & 50%_#") < text.index("raises")
    )
    assert "2 failed" in text
    for line in caption(real_board(), "middlebury-v3", "nonocc").splitlines():
        assert line in text


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
    words = [
        line.partition(": ") for line in caption(b, protocol, "nonocc").splitlines()
    ]
    assert tuple(name for name, _, text in words if text.strip()) == NAMED
    console = Console(width=160, file=io.StringIO(), color_system=None)
    console.print(leaderboard_table(b, protocol, "nonocc"))
    latex, shown = (
        board_latex(b, protocol, "nonocc"),
        " ".join(console.file.getvalue().split()),
    )
    for name, _, text in words:
        assert f"{name}: {' '.join(text.split())}" in shown
        assert f"{name}: " in latex
    stored = json.loads(board_to_json(b))["protocols"][protocol]
    assert all(stored[name] for name in NAMED if name not in ("region", "mean"))


def test_a_table_of_weighted_means_says_so():
    b, console = real_board(), Console(width=200, file=io.StringIO(), color_system=None)
    console.print(leaderboard_table(b, "eth3d", "all", weights={"s": 2.0}))
    assert "weighted mean over samples" in console.file.getvalue()
    assert "weighted mean over samples" in board_latex(
        b, "eth3d", "all", weights={"s": 2.0}
    )


def test_csv_keeps_every_number_and_escapes_formulas():
    b = real_board()
    rows = list(csv.DictReader(io.StringIO(board_csv(b))))
    assert len(rows) == 3 * 2 * 2 * 3 + 2 * 3
    off = next(
        r
        for r in rows
        if r["method"].startswith("[red]")
        and r["region"] == "all"
        and r["sample"] == "s"
    )
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
    assert failures(real_board()) == [
        "raises on s and 1 more: crash (RuntimeError: out of luck)"
    ]
    assert failures(real_board().subset("s")) == [
        "raises on s: crash (RuntimeError: out of luck)"
    ]
    late = [
        entry("m", name, 1, failure=Failure("time-limit", "late")) for name in "abc"
    ]
    died = entry("m", "d", 1, failure=Failure("crash", "signal 11"))
    assert failures(board(*late, died)) == [
        "m on a and 2 more: time-limit (late)",
        "m on d: crash (signal 11)",
    ]
    assert failures(board(died), ["other"]) == []
