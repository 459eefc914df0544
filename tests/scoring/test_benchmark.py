"""`run_benchmark`: isolated failures, resume, time and memory limits."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.scoring.scoring_methods import (
    Constant,
    Counting,
    DiesBetween,
    Hangs,
    Signed,
    Slow,
    Starts,
    Starving,
    Trouble,
    Unloadable,
    pair,
)
from twinlens.dataset import Calibration
from twinlens.errors import FileError, InputError
from twinlens.matching import StereoMatcher
from twinlens.scoring import (
    MapFolder,
    Pair,
    board_file,
    evaluate,
    load_pair,
    read_board,
    run_benchmark,
)
from twinlens.scoring.samples import fingerprint

CALIBRATION = Calibration((9.0, 9.0, 1.0, 1.0), (9.0, 9.0, 1.0, 1.0), 0.1, 30, 40, 0.0)


def run_cold(*arguments, **options):
    """A run without warm-ups."""
    return run_benchmark(*arguments, warm_up=False, **options)


def kinds_of(board):
    """Method -> the kind of its failure, or None."""
    return {e.method: e.failure and e.failure.kind for e in board.entries}


def test_the_board_holds_the_scores_of_evaluate():
    sample, method = pair(), Constant("c", 6.5, holes=3)
    before = fingerprint(sample)
    board = run_benchmark([sample], [Trouble("scribbles"), method], protocol="eth3d")
    assert fingerprint(sample) == before
    entry = board.entries[1]
    disparity = method.match(sample.im0, sample.im1, **sample.search)
    truth = sample.disp0, sample.mask0_nonocc
    scores = evaluate(disparity, *truth, 16, protocol="eth3d")
    assert entry.regions == {"all": scores.all, "nonocc": scores.nonocc}
    names = entry.method, entry.spec, entry.sample
    assert names == ("c", "constant 6.5 3", "a")
    assert (entry.width, entry.height) == (30, 40)
    assert entry.sample_sha256 == before
    times = replace(entry, seconds=0.6).times()
    assert times["time/MP"] == pytest.approx(0.6 / 0.0012)
    assert times["time/GD"] == pytest.approx(0.6 / (30 * 40 * 16 / 1e9))


@pytest.mark.parametrize(
    ("warm_up", "calls"),
    [
        (True, [(32, 16), (40, 16), (40, 16), (32, 20), (40, 20)]),
        (False, [(40, 16), (40, 16), (40, 20)]),
    ],
)
def test_a_method_is_warmed_up_once_for_each_range(warm_up, calls):
    method = Counting("c", 4)
    samples = [pair("a"), pair("b"), replace(pair("c"), ndisp=20)]
    run_benchmark(samples, [method], warm_up=warm_up)
    assert method.rows_and_ranges == calls


KINDS = {
    "raises": "crash",
    "exits": "crash",
    "asks_for_too_much": "memory",
    "wrong_size": "wrong-shape",
    "integers": "wrong-type",
    "nothing": "wrong-type",
    "nan": "not-a-number",
    "minus_inf": "not-a-number",
}


def test_a_failure_does_not_affect_other_pairs():
    methods = [*map(Trouble, KINDS), Constant("good", 4)]
    board = run_cold([pair("a"), pair("b")], methods)
    assert kinds_of(board) == KINDS | {"good": None}
    assert [e.regions["all"]["avgerr"] for e in board.entries if e.ok] == [0, 0]
    assert all("\n" not in e.failure.message for e in board.entries if e.failure)


def test_failures_in_a_worker_are_single_ones():
    """One run: a hang, a dead process, exceptions, and methods that cannot be sent or loaded."""
    local = Counting("local", 4)
    local.secret = lambda: None
    methods = [
        Trouble("hangs"),
        Constant("good", 4),
        Trouble("dies"),
        Trouble("raises"),
        *(Unloadable(e.__name__, e) for e in (MemoryError, ImportError, KeyError)),
        local,
        Constant("better", 5),
    ]
    board = run_cold([pair()], methods, time_limit=2.0)
    assert kinds_of(board) == {
        "hangs": "time-limit",
        "good": None,
        "dies": "crash",
        "raises": "crash",
        "MemoryError": "memory",
        "ImportError": "memory",
        "KeyError": "crash",
        "local": "crash",
        "better": None,
    }
    raised = board.find("raises", "a", "middlebury-v3").failure
    assert re.fullmatch(r".*\.py:\d+ in raises: raise .*", raised.frames[-1])
    assert board_file.board_from_json(board_file.board_to_json(board)) == board
    died = board.find("dies", "a", "middlebury-v3").failure
    unsent = board.find("local", "a", "middlebury-v3").failure
    assert "SIGABRT" in died.message
    assert "without a time limit" in unsent.message


@pytest.mark.slow
def test_segfault_memory_exhaustion_and_massive_output_are_single_failures(capfd):
    """The limit of 2 GiB is above what the good methods need and below this machine's memory."""
    kinds = {"segfaults": "crash", "hoards": "memory", "talks": None}
    methods = [*map(Trouble, kinds), Constant("good", 4)]
    board = run_cold([pair()], methods, memory_limit=2 * 2**30, time_limit=30)
    assert kinds_of(board) == kinds | {"good": None}
    assert "SIGSEGV" in board.entries[0].failure.message
    assert capfd.readouterr() == ("", "")


only_linux = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux counts a process's data"
)


@only_linux
def test_a_limit_below_what_a_process_needs_to_start_is_a_lack_of_memory():
    board = run_benchmark([pair()], [Constant("small", 4)], memory_limit=2**17)
    failure = board.entries[0].failure
    assert failure.kind == "memory"
    assert "before the first match; the limit is 0.00012 GiB" in failure.message


@only_linux
def test_a_worker_out_of_memory_between_two_matches_is_a_memory_failure():
    """The method lowers its own limit during the warm-up; the images of the next match cannot be received.

    Images of more than 32 MB always need new memory.
    """
    image = np.zeros((3600, 3200, 3), np.uint8)
    large = Pair("a", image, image, np.ones((3600, 3200), np.float32), None, 16)
    board = run_benchmark([large], [Starving("s")], time_limit=30)
    assert kinds_of(board) == {"s": "memory"}


def test_a_signal_between_two_matches_is_no_lack_of_memory():
    image = np.zeros((3000, 3000, 3), np.uint8)
    large = Pair("a", image, image, np.ones((3000, 3000), np.float32), None, 16)
    board = run_benchmark([large], [DiesBetween()], time_limit=30)
    failure = board.entries[0].failure
    assert failure.kind == "crash"
    assert "SIGSEGV" in failure.message


LATE = r"exceeded the time limit of 1\.5 s; the warm-up took [\d.]+ s"
NOT_REPEATED = LATE + " and was not repeated"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seconds", "warm_up_limit", "first"),
    [(1000, 1.5, NOT_REPEATED), (2.5, 100, LATE)],
)
def test_a_warm_up_that_does_not_help_is_not_repeated(
    tmp_path, seconds, warm_up_limit, first
):
    """One that hangs is stopped; one that ends after the time limit would not help a new worker."""
    method = Hangs("slow", tmp_path / "rows", seconds)
    board = run_benchmark(
        [pair(name, seed) for seed, name in enumerate("abc")],
        [method, Constant("good", 4)],
        time_limit=1.5,
        warm_up_limit=warm_up_limit,
    )
    # A warm-up has 32 rows, the images 40.
    assert method.note.read_text().split() == ["32", "40", "40", "40"]
    failures = [e.failure for e in board.entries if e.method == "slow"]
    assert [failure.kind for failure in failures] == ["time-limit"] * 3
    for expected, failure in zip(
        [first, NOT_REPEATED, NOT_REPEATED], failures, strict=True
    ):
        assert re.fullmatch(expected, failure.message)
    assert all(e.ok for e in board.entries if e.method == "good")


@pytest.mark.slow
def test_a_new_worker_is_warmed_up_again():
    """Compilation exceeds the time limit: without a new warm-up, the method would fail or appear slow."""
    methods = [Slow("slow", 3.0), Trouble("dies")]
    board = run_benchmark(
        [pair("a"), pair("b", 1)], methods, time_limit=2.0, warm_up_limit=100
    )
    assert [e.failure and e.failure.kind for e in board.entries] == [None, "crash"] * 2
    assert all(e.seconds < 2.0 for e in board.entries if e.ok)


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to see other processes"
)


def has_ended(pid):
    """Whether that process ends, or becomes a zombie, soon after its SIGKILL: long before it would by itself."""
    for _ in range(2000):
        try:
            status = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if status == "Z":
            return True
        time.sleep(0.01)
    return False


@needs_proc
@pytest.mark.parametrize(
    "habit", ["session", pytest.param("deaf", marks=pytest.mark.slow)]
)
def test_a_limit_ends_what_the_methods_started(tmp_path, habit):
    """In a session of its own, which killing a process group does not reach, and with SIGTERM blocked."""
    method = Starts("starts", tmp_path / "pid", **{habit: True})
    board = run_cold([pair()], [method], time_limit=2.0)
    assert kinds_of(board) == {"starts": "time-limit"}
    assert has_ended(int(method.note.read_text()))
    if habit == "session":
        # A method that receives SIGTERM removes its temporary folder.
        assert {path.name for path in tmp_path.iterdir()} == {"pid"}


@needs_proc
def test_an_interrupt_keeps_finished_entries_and_ends_what_the_method_started(tmp_path):
    method = Starts("starts", tmp_path / "pid")

    def interrupt():
        while not (method.note.exists() and method.note.read_text()):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    save = tmp_path / "board.json"
    with pytest.raises(KeyboardInterrupt):
        run_cold([pair()], [Constant("c", 4), method], time_limit=50, save=save)
    thread.join()
    assert has_ended(int(method.note.read_text()))
    assert kinds_of(read_board(save)) == {"c": None}


def negative(name="n"):
    """A pair with the truth -5 everywhere, as of a rig whose principal points differ."""
    return replace(pair(name, truth=-5.0), min_disparity=-8, ndisp=16)


def test_the_fingerprint_covers_every_part_of_a_sample():
    first = pair()
    flipped = first.mask0_nonocc[::-1].copy()
    changes = [
        {"im0": first.im1[::-1].copy()},
        {"im1": first.im1[::-1].copy()},
        {"disp0": first.disp0 + 1},
        {"disp0": first.disp0.astype(np.float64)},
        {"mask0_nonocc": flipped},
        {"mask0_nonocc": None},
        {"ndisp": 17},
        {"min_disparity": -1},
        {"blur0": first.disp0},
        {"material_kind0": flipped},
        {"calibration": CALIBRATION},
    ]
    prints = [fingerprint(replace(first, **change)) for change in changes]
    assert len({fingerprint(first), *prints}) == len(changes) + 1
    assert fingerprint(replace(first, name="other")) == fingerprint(first)


def test_resume_runs_only_what_is_new(tmp_path):
    save, a, b = tmp_path / "board.json", Counting("a", 4), Counting("b", 5)
    first = run_cold([pair("s")], [a], save=save)
    samples = [pair("s"), pair("t", seed=1)]
    second = run_cold(samples, [a, b], save=save)
    assert (a.calls, b.calls) == (2, 2)
    assert second.entries[0] == first.entries[0]
    assert read_board(save).entries == second.entries


@pytest.mark.parametrize(("interval", "sizes"), [(1e9, [1, 3]), (0, [1, 2, 3, 3])])
def test_the_file_is_written_periodically_and_at_the_end(
    tmp_path, monkeypatch, interval, sizes
):
    written = []
    monkeypatch.setattr(board_file, "WRITE_EVERY_S", interval)
    monkeypatch.setattr(
        board_file,
        "write_board",
        lambda board, path: written.append(len(board.entries)),
    )
    samples = [pair(name) for name in "abc"]
    run_benchmark(samples, [Constant("a", 4)], save=tmp_path / "b.json", warm_up=False)
    assert written == sizes


def test_a_file_that_is_not_a_board_is_not_overwritten(tmp_path):
    save = tmp_path / "board.json"
    save.write_text("my thesis")
    with pytest.raises(FileError, match="not valid JSON"):
        run_benchmark([pair()], [Constant("a", 4)], save=save)
    assert save.read_text() == "my thesis"


def test_a_bad_sample_is_refused_by_name():
    image, truth = np.zeros((4, 5), np.uint8), np.ones((4, 5), np.float32)
    with pytest.raises(InputError, match=r"sample 'x': im1 is uint8 \(4, 4\)"):
        Pair("x", image, image[:, :4], truth, None, 8)
    with pytest.raises(InputError, match="sample 'x': disp0 holds NaN"):
        Pair("x", image, image, truth * np.nan, None, 8)


def test_scoring_and_its_page_need_no_renderer():
    """In a new process where importing mitsuba, drjit or numba fails."""
    script = """
import sys
for name in ("mitsuba", "drjit", "numba"):
    sys.modules[name] = None
import twinlens as tl
from twinlens.report.page import page_html
from twinlens.scoring import Board
assert tl.evaluate([[1.0]], [[2.0]]).all["avgerr"] == 1
assert page_html(Board(title="none"))
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=600)


def test_methods_search_negative_disparities():
    sample = negative()
    (entry,) = run_benchmark([sample], [Signed("s", -5.0)]).entries
    assert entry.regions["nonocc"]["totbad2.0"] == 0
    assert (entry.min_disparity, entry.ndisp) == (-8, 16)
    board = run_cold([sample, pair("p")], [Constant("c", 4)])
    assert [e.ok for e in board.entries] == [False, True]
    assert "min_disparity" in board.entries[0].failure.message


@pytest.mark.filterwarnings("ignore::twinlens.scoring.benchmark.MapWarning")
def test_a_memory_limit_implies_a_worker_process():
    corners = []
    board = run_cold(
        [negative(), pair("p")],
        [Trouble("dies"), Signed("s", -5.0)],
        memory_limit=2**31,
        on_map=lambda *result: corners.append(tuple(result[2][0, :2])),
    )
    assert kinds_of(board) == {"dies": "crash", "s": None}
    assert corners == [(16, -8), (16, 0)]


def test_the_search_range_of_a_stored_sample():
    """min_disparity from the calibration's vmin, or else from the truth; ndisp counts from there."""
    plain = pair(truth=-4.5)
    fields = ("name", "im0", "im1", "disp0", "mask0_nonocc", "ndisp")
    stored = SimpleNamespace(**{name: getattr(plain, name) for name in fields})
    assert load_pair(stored).search == {"num_disparities": 21, "min_disparity": -5}
    for vmin, count, first in ((-7.0, 23, -7), (3.0, 16, 0), (-1e9, 16 + 30, -30)):
        stored.calibration = CALIBRATION.replace(vmin=vmin)
        expected = {"num_disparities": count, "min_disparity": first}
        assert load_pair(stored).search == expected


def test_a_resumed_board_describes_all_machines():
    samples, a, b = [pair("s")], Constant("a", 4), Constant("b", 4)
    first = run_benchmark(samples, [a])
    meta = dict(first.meta) | {"twinlens": "0.0.1", "processors": "96"}
    elsewhere = replace(first, meta=meta)
    assert run_benchmark(samples, [a], board=elsewhere).meta == meta
    both = run_benchmark(samples, [a, b], board=elsewhere)
    assert both.meta["twinlens"] == f"0.0.1; {first.meta['twinlens']}"
    assert "several machines or versions" in both.meta["mixed"]
    assert run_benchmark([pair("t", 1)], [a, b], board=both).meta == both.meta
    replaced = run_benchmark(samples, [Constant("a", 5)], board=elsewhere)
    assert replaced.meta == first.meta


def test_a_resumed_board_without_scenes_gets_them():
    samples = [replace(pair("s"), scene="hall"), pair("t", seed=1)]
    board = run_cold(samples, [Constant("a", 4)])
    assert board.scenes == {"s": "hall", "t": "t"}
    earlier = replace(board, scenes={})
    assert run_cold(samples, [Constant("a", 4)], board=earlier) == board


def test_a_map_is_dropped_when_its_method_fails_or_changes(tmp_path):
    maps = MapFolder(tmp_path)
    options = {"on_map": maps.keep, "on_drop": maps.drop}
    samples = [pair("s"), pair("t")]

    def stored():
        return [name for name in "st" if maps.get(("raises", name)) is not None]

    board = run_cold(samples, [Counting("raises", 4, spec="v1")], **options)
    assert stored() == ["s", "t"]
    board = run_cold(samples[:1], [Trouble("raises")], board=board, **options)
    assert kinds_of(board) == {"raises": "crash"}
    assert stored() == []
    # The failure is kept, unless it is to be tried again.
    repaired = Counting("raises", 4, spec="raises")
    board = run_cold(samples[:1], [repaired], board=board, **options)
    assert kinds_of(board) == {"raises": "crash"}
    options["retry_failed"] = True
    board = run_cold(samples[:1], [repaired], board=board, **options)
    assert kinds_of(board) == {"raises": None}
    assert stored() == ["s"]


@pytest.mark.parametrize("change", ["spec", "protocol", "regions"])
def test_resume_runs_again_what_disagrees(change):
    options = {"protocol": "middlebury-v3", "regions": ["all"]}
    board = run_cold([pair()], [Counting("a", 4)], **options)
    method = Counting("a", 6, spec="v2" if change == "spec" else "v1")
    changes = {"protocol": "eth3d", "regions": ["all", "far"]}
    if change != "spec":
        options[change] = changes[change]
    again = run_cold([pair()], [method], board=board, **options)
    assert method.calls == 1
    assert len(again.entries) == (2 if change == "protocol" else 1)
    assert again.entries[-1].regions["all"]["avgerr"] == 2


def test_methods_are_given_as_text_and_progress_is_reported():
    steps, maps = [], []
    board = run_cold(
        (sample for sample in [pair("s"), pair("t")]),
        ["wide=sad:block_size=5,num_disparities=4", Trouble("raises"), "sad,zncc"],
        progress=steps.append,
        on_map=lambda method, sample, _disparity: maps.append((method, sample)),
    )
    assert board.methods == ("wide", "raises", "sad", "zncc")
    last = steps[-1]
    assert (last.done, last.total, last.method, last.sample) == (8, None, "zncc", "t")
    assert [step.failure is None for step in steps] == [True, False, True, True] * 2
    assert maps == [(m, s) for s in "st" for m in ("wide", "sad", "zncc")]


ONE = Constant("a", 4)


@pytest.mark.parametrize(
    ("samples", "methods", "options", "message"),
    [
        ([pair()], [ONE, Constant("a", 5)], {}, "two methods are named 'a'"),
        ([pair("s"), pair("s")], [ONE], {}, "two samples are named 's'"),
        ([pair()], [StereoMatcher("zncc")], {}, "^StereoMatcher has no name"),
        ([pair()], [ONE], {"protocol": "eth"}, "did you mean 'eth3d'"),
        ([pair()], [ONE], {"regions": ["nonoc"]}, "did you mean 'nonocc'"),
        ([pair()], [ONE], {"regions": []}, "nothing to score"),
        ([pair()], [ONE], {"time_limit": 0}, "time limits are 0"),
        ([pair()], [ONE], {"time_limit": np.inf}, "time limits are inf .* most 1e"),
        ([pair()], [ONE], {"memory_limit": 0}, "memory_limit is 0"),
    ],
)
def test_bad_arguments_are_refused(samples, methods, options, message):
    with pytest.raises(InputError, match=message):
        run_benchmark(samples, methods, **options)


class Confident(Constant):
    """Returns a confidence beside the map."""

    def match(self, left, right, **search):
        disparity = super().match(left, right, **search)
        return disparity, np.random.default_rng(0).random(disparity.shape, np.float32)


@pytest.mark.parametrize("limit", [None, 60.0])
def test_a_confidence_is_scored_and_kept_in_the_file(tmp_path, limit):
    save = tmp_path / "board.json"
    methods = [
        Confident("confident", 7),
        Constant("plain", 7),
        "sad:confidence=curvature",
    ]
    board = run_cold([pair()], methods, save=save, time_limit=limit)
    confident, plain, named = (entry.regions["all"] for entry in board.entries)
    assert len(confident.sparsification) == len(named.sparsification) == 20
    assert plain.items() <= confident.items()
    assert read_board(save).entries == board.entries
