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
from twinlens.matching import StereoMatcher, parse_method
from twinlens.scoring import (
    Board,
    MapFolder,
    Pair,
    board_csv,
    board_file,
    evaluate,
    load_pair,
    read_board,
    run_benchmark,
)
from twinlens.scoring.samples import fingerprint


class Counting:
    """Counts its calls."""

    def __init__(self, name, value, spec="v1"):
        self.name, self.value, self.spec, self.calls = name, value, spec, 0

    def match(self, left, right, *, num_disparities, min_disparity):
        self.calls += 1
        return np.full(left.shape[:2], self.value, np.float32)


def test_the_board_holds_the_scores_of_evaluate():
    sample, method = pair(), Constant("c", 6.5, holes=3)
    entry = run_benchmark([sample], [method], protocol="eth3d").entries[0]
    scores = evaluate(
        method.match(sample.im0, sample.im1, **sample.search),
        sample.disp0,
        sample.mask0_nonocc,
        16,
        protocol="eth3d",
    )
    assert entry.regions == {"all": scores.all, "nonocc": scores.nonocc}
    assert (entry.method, entry.spec, entry.sample, entry.width, entry.height) == (
        "c",
        "constant 6.5 3",
        "a",
        30,
        40,
    )
    assert entry.sample_sha256 == fingerprint(sample)


def test_time_is_normalised_by_pixels_and_by_hypotheses():
    entry = run_benchmark([pair()], [Constant("c", 4)]).entries[0]
    times = replace(entry, seconds=0.6).times()
    assert times["time/MP"] == pytest.approx(0.6 / 0.0012)
    assert times["time/GD"] == pytest.approx(0.6 / (30 * 40 * 16 / 1e9))


def test_one_map_is_scored_by_every_protocol():
    method = Counting("c", 4)
    board = run_benchmark(
        [pair()], [method], protocol=["middlebury-v3", "kitti2015"], warm_up=False
    )
    assert method.calls == 1
    assert board.protocols == ("middlebury-v3", "kitti2015")


def test_a_sample_without_a_mask_has_no_nonocc():
    board = run_benchmark([pair("a"), pair("b", mask=False)], [Constant("c", 4)])
    assert [tuple(e.regions) for e in board.entries] == [("all", "nonocc"), ("all",)]
    assert board.mean("c", "middlebury-v3", "nonocc").counted == 1


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
    methods = [*(Trouble(name) for name in KINDS), Constant("good", 4)]
    board = run_benchmark([pair("a"), pair("b")], methods, warm_up=False)
    assert {(e.method, e.failure.kind) for e in board.entries if e.failure} == set(
        KINDS.items()
    )
    assert [e.regions["all"]["avgerr"] for e in board.entries if e.ok] == [0, 0]
    assert all("\n" not in e.failure.message for e in board.entries if e.failure)


WRONG = """
import numpy as np

def nan(left, right, **search):
    return np.full(left.shape[:2], np.nan)

def minus_inf(left, right, **search):
    return np.full(left.shape[:2], -np.inf)

def wrong_size(left, right, **search):
    return np.zeros((3, 3))

def nothing(left, right, **search):
    return None

def words(left, right, **search):
    return "far away"

def raises(left, right, **search):
    raise RuntimeError
"""


@pytest.mark.parametrize("limit", [None, 30])
def test_a_function_by_name_fails_by_the_same_kinds(tmp_path, monkeypatch, limit):
    (tmp_path / "wrong_answers.py").write_text(WRONG)
    monkeypatch.syspath_prepend(str(tmp_path))
    kinds = {
        name: KINDS[name]
        for name in ("nan", "minus_inf", "wrong_size", "nothing", "raises")
    }
    kinds["words"] = "wrong-type"
    methods = [
        parse_method(f"function:function=wrong_answers:{name}") for name in kinds
    ]
    board = run_benchmark([pair()], methods, warm_up=False, time_limit=limit)
    assert {e.method.rpartition(":")[2]: e.failure.kind for e in board.entries} == kinds


def test_a_limit_stops_a_hang_and_survives_a_dead_process():
    methods = [
        Trouble("hangs"),
        Constant("good", 4),
        Trouble("dies"),
        Trouble("raises"),
        Constant("better", 5),
    ]
    start = time.monotonic()
    board = run_benchmark([pair()], methods, time_limit=2.0, warm_up=False)
    assert time.monotonic() - start < 600
    kinds = {e.method: e.failure and e.failure.kind for e in board.entries}
    assert kinds == {
        "hangs": "time-limit",
        "good": None,
        "dies": "crash",
        "raises": "crash",
        "better": None,
    }
    assert "SIGABRT" in board.find("dies", "a", "middlebury-v3").failure.message


@pytest.mark.slow
def test_segfault_memory_exhaustion_and_massive_output_are_single_failures(capfd):
    """The limit of 2 GiB is above what the good methods need and below this machine's memory."""
    methods = [
        Trouble("segfaults"),
        Trouble("hoards"),
        Trouble("talks"),
        Constant("good", 4),
    ]
    board = run_benchmark(
        [pair()], methods, memory_limit=2 * 2**30, time_limit=30, warm_up=False
    )
    kinds = {e.method: e.failure and e.failure.kind for e in board.entries}
    assert kinds == {
        "segfaults": "crash",
        "hoards": "memory",
        "talks": None,
        "good": None,
    }
    assert "SIGSEGV" in board.entries[0].failure.message
    assert capfd.readouterr() == ("", "")


def test_a_memory_limit_implies_a_worker_process():
    board = run_benchmark(
        [pair()],
        [Trouble("dies"), Constant("good", 4)],
        memory_limit=2**31,
        warm_up=False,
    )
    assert [e.ok for e in board.entries] == [False, True]


only_linux = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux counts a process's data"
)


@only_linux
@pytest.mark.parametrize("warm_up", [True, False])
def test_a_limit_below_what_a_process_needs_to_start_is_a_lack_of_memory(warm_up):
    board = run_benchmark(
        [pair()], [Constant("small", 4)], memory_limit=2**17, warm_up=warm_up
    )
    failure = board.entries[0].failure
    assert failure.kind == "memory"
    assert "before the first match; the limit is 0.00012 GiB" in failure.message


@pytest.mark.parametrize(
    ("error", "kind"),
    [(MemoryError, "memory"), (ImportError, "memory"), (KeyError, "crash")],
)
def test_out_of_memory_while_loading_is_not_a_crash(error, kind):
    board = run_benchmark(
        [pair()], [Unloadable("u", error)], time_limit=30, warm_up=False
    )
    assert board.entries[0].failure.kind == kind


@only_linux
def test_a_worker_out_of_memory_between_two_matches_is_a_memory_failure():
    """The method lowers its own limit during the warm-up; the images of the next match cannot be received.

    Images of more than 32 MB always need new memory.
    """
    image, truth = (
        np.zeros((3600, 3200, 3), np.uint8),
        np.ones((3600, 3200), np.float32),
    )
    large = Pair("a", image, image, truth, None, 16)
    board = run_benchmark([large], [Starving("s")], time_limit=30, warm_up=True)
    assert board.entries[0].failure.kind == "memory"


@pytest.mark.slow
def test_a_hanging_warm_up_is_stopped_and_not_repeated(tmp_path):
    start = time.monotonic()
    method = Hangs("hangs", tmp_path / "rows")
    board = run_benchmark(
        [pair("a"), pair("b", 1)], [method], time_limit=1.5, warm_up_limit=1.5
    )
    assert [e.failure.kind for e in board.entries] == ["time-limit"] * 2
    assert time.monotonic() - start < method.seconds
    assert method.note.read_text().split() == [
        "32",
        "40",
        "40",
    ]  # a warm-up has 32 rows, the images 40
    says = r"exceeded the time limit of 1\.5 s; the warm-up took [\d.]+ s and was not repeated"
    assert all(re.fullmatch(says, e.failure.message) for e in board.entries)


@pytest.mark.slow
def test_a_method_that_is_always_slow_is_warmed_up_once(tmp_path):
    """Its warm-up ends after the time limit, so repeating it in a new worker would not help."""
    method = Hangs("slow", tmp_path / "rows", seconds=2.5)
    samples = [pair(name, seed) for seed, name in enumerate("abc")]
    board = run_benchmark(
        samples, [method, Constant("good", 4)], time_limit=1.5, warm_up_limit=100
    )
    assert method.note.read_text().split() == ["32", "40", "40", "40"]
    failures = [e.failure for e in board.entries if e.method == "slow"]
    assert [f.kind for f in failures] == ["time-limit"] * 3
    first, *later = [f.message for f in failures]
    assert re.fullmatch(
        r"exceeded the time limit of 1\.5 s; the warm-up took [\d.]+ s", first
    )
    for message in later:
        assert re.fullmatch(
            r".* limit of 1\.5 s; the warm-up took [\d.]+ s and was not repeated",
            message,
        )
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


def has_ended(pid):
    """Whether that process ends, or becomes a zombie, soon after its SIGKILL: long before it would by itself."""
    for _ in range(2000):
        try:
            if (
                Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
                == "Z"
            ):
                return True
        except FileNotFoundError:
            return True
        time.sleep(0.01)
    return False


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to see other processes"
)
@pytest.mark.parametrize(
    ("deaf", "session"), [(False, False), (False, True), (True, False)]
)
def test_a_limit_ends_what_the_method_started(tmp_path, deaf, session):
    method = Starts("starts", tmp_path / "pid", deaf, session)
    board = run_benchmark([pair()], [method], time_limit=2.0, warm_up=False)
    assert board.entries[0].failure.kind == "time-limit"
    assert has_ended(int(method.note.read_text()))
    left = [path.name for path in tmp_path.iterdir()]
    assert deaf or left == ["pid"]


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to see other processes"
)
def test_an_interrupt_keeps_finished_entries_and_ends_what_the_method_started(tmp_path):
    method = Starts("starts", tmp_path / "pid")

    def interrupt():
        while not (method.note.exists() and method.note.read_text()):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(
            [pair()],
            [Constant("c", 4), method],
            time_limit=50,
            warm_up=False,
            save=tmp_path / "board.json",
        )
    thread.join()
    assert has_ended(int(method.note.read_text()))
    assert [(e.method, e.ok) for e in read_board(tmp_path / "board.json").entries] == [
        ("c", True)
    ]


def test_a_program_by_name_ends_with_the_limit(tmp_path):
    """Programs run in their own sessions, which killing the worker's process group does not reach."""
    script = tmp_path / "prog.sh"
    script.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/pid\nexec sleep 1000\n")
    script.chmod(0o755)
    method = parse_method(f"program:command='{script} {{left}} {{right}} {{out}}'")
    board = run_benchmark([pair()], [method], time_limit=2.0, warm_up=False)
    assert board.entries[0].failure.kind == "time-limit"
    assert has_ended(int((tmp_path / "pid").read_text()))


def negative(name="n"):
    """A pair with the truth -5 everywhere, as of a rig whose principal points differ."""
    plain = pair(name, truth=-5.0)
    return replace(plain, min_disparity=-8, ndisp=16)


def test_a_perfect_answer_to_a_negative_truth_is_perfect():
    sample = negative()
    entry = run_benchmark([sample], [Signed("s", -5.0)]).entries[0]
    assert entry.regions["all"]["totbad2.0"] == 0
    assert (entry.min_disparity, entry.ndisp) == (-8, 16)
    assert fingerprint(sample) != fingerprint(replace(sample, min_disparity=0))


@pytest.mark.parametrize("limit", [None, 20.0])
def test_methods_receive_a_negative_min_disparity(limit):
    corners = []
    run_benchmark(
        [negative(), pair("p")],
        [Signed("s", -5.0)],
        on_map=lambda method, sample, disp: corners.append(tuple(disp[0, :2])),
        time_limit=limit,
    )
    assert corners == [(16, -8), (16, 0)]


def test_a_method_without_negative_disparities_fails_on_such_pairs_only():
    board = run_benchmark([negative(), pair("p")], [Constant("c", 4)])
    assert [e.ok for e in board.entries] == [False, True]
    assert "min_disparity" in board.entries[0].failure.message


def test_the_search_range_of_a_stored_sample():
    """min_disparity from the calibration's vmin, or else from the truth; ndisp counts from there."""
    plain = pair(truth=-4.5)
    fields = ("name", "im0", "im1", "disp0", "mask0_nonocc", "ndisp")
    stored = SimpleNamespace(**{name: getattr(plain, name) for name in fields})
    assert load_pair(stored).search == {"num_disparities": 21, "min_disparity": -5}
    stored.calibration = Calibration(
        (9.0, 9.0, 1.0, 1.0), (9.0, 9.0, 1.0, 1.0), 0.1, 30, 40, 0.0, vmin=-7.0
    )
    assert load_pair(stored).search == {"num_disparities": 23, "min_disparity": -7}
    stored.calibration = stored.calibration.replace(vmin=3.0)
    assert load_pair(stored).search == {"num_disparities": 16, "min_disparity": 0}
    stored.calibration = stored.calibration.replace(vmin=-1e9)
    assert load_pair(stored).search == {
        "num_disparities": 16 + 30,
        "min_disparity": -30,
    }


def test_a_method_that_cannot_be_pickled_fails_with_a_reason():
    method = Counting("c", 4)
    method.secret = lambda: None
    entry = run_benchmark(
        [pair()], [method, Constant("good", 4)], time_limit=5, warm_up=False
    )
    assert "without a time limit" in entry.entries[0].failure.message
    assert entry.entries[1].ok


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
        {"blur0": first.disp0},
        {"material_kind0": flipped},
        {
            "calibration": Calibration(
                (9.0, 9.0, 1.0, 1.0), (9.0, 9.0, 1.0, 1.0), 0.1, 30, 40, 0.0
            )
        },
    ]
    prints = [fingerprint(replace(first, **change)) for change in changes]
    assert len({fingerprint(first), *prints}) == len(changes) + 1
    assert fingerprint(replace(first, name="other")) == fingerprint(first)


def test_a_method_cannot_change_the_sample_for_the_next():
    sample = pair()
    before = fingerprint(sample)
    run_benchmark([sample], [Trouble("scribbles"), Constant("c", 4)])
    assert fingerprint(sample) == before


def test_resume_runs_only_what_is_new(tmp_path):
    save, a, b = tmp_path / "board.json", Counting("a", 4), Counting("b", 5)
    first = run_benchmark([pair("s")], [a], save=save, warm_up=False)
    second = run_benchmark(
        [pair("s"), pair("t", seed=1)], [a, b], save=save, warm_up=False
    )
    assert (a.calls, b.calls) == (2, 2)
    assert second.entries[0] == first.entries[0]
    assert read_board(save).entries == second.entries
    skipped = []
    run_benchmark(
        [pair("s")],
        [a],
        save=save,
        warm_up=False,
        progress=lambda step: skipped.append(step.skipped),
    )
    assert skipped == [True]
    assert a.calls == 2


def test_a_resumed_board_of_an_earlier_version_gets_the_scenes():
    samples = [replace(pair("s"), scene="hall"), pair("t", seed=1)]
    board = run_benchmark(samples, [Constant("a", 4)])
    assert board.scenes == {"s": "hall", "t": "t"}
    assert (
        run_benchmark(samples, [Constant("a", 4)], board=replace(board, scenes={}))
        == board
    )


def test_a_resumed_board_describes_all_machines():
    first = run_benchmark([pair("s")], [Constant("a", 4)])
    assert "mixed" not in first.meta
    elsewhere = replace(
        first, meta=dict(first.meta) | {"twinlens": "0.0.1", "processors": "96"}
    )
    untouched = run_benchmark([pair("s")], [Constant("a", 4)], board=elsewhere)
    assert untouched.meta == elsewhere.meta
    both = run_benchmark(
        [pair("s")], [Constant("a", 4), Constant("b", 4)], board=elsewhere
    )
    assert both.meta["twinlens"] == f"0.0.1; {first.meta['twinlens']}"
    assert "several machines or versions" in both.meta["mixed"]
    again = run_benchmark(
        [pair("t", 1)], [Constant("a", 4), Constant("b", 4)], board=both
    )
    assert again.meta == both.meta
    replaced = run_benchmark([pair("s")], [Constant("a", 5)], board=elsewhere)
    assert replaced.meta == first.meta


@pytest.mark.parametrize(
    ("interval", "sizes"), [(1e9, [1, 5]), (0, [1, 2, 3, 4, 5, 5])]
)
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
    samples = [pair(str(i), i) for i in range(5)]
    run_benchmark(samples, [Constant("a", 4)], save=tmp_path / "b.json", warm_up=False)
    assert written == sizes


def test_finished_entries_are_kept_when_a_run_is_interrupted(tmp_path):
    def broken():
        yield from (pair(str(i), i) for i in range(5))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(broken(), [Constant("a", 4)], save=tmp_path / "b.json")
    assert len(read_board(tmp_path / "b.json").entries) == 5


def test_a_map_is_dropped_when_its_method_fails_or_changes(tmp_path):
    maps = MapFolder(tmp_path)
    options = {"warm_up": False, "on_map": maps.keep, "on_drop": maps.drop}
    board = run_benchmark(
        [pair("s"), pair("t")], [Counting("raises", 4, spec="v1")], **options
    )
    assert maps.get(("raises", "s")) is not None
    board = run_benchmark([pair("s")], [Trouble("raises")], board=board, **options)
    assert not board.entries[0].ok
    assert [maps.get(("raises", name)) for name in "st"] == [None, None]
    run_benchmark(
        [pair("s")],
        [Counting("raises", 4, spec="raises")],
        board=board,
        retry_failed=True,
        **options,
    )
    assert maps.get(("raises", "s")) is not None


@pytest.mark.parametrize("change", ["spec", "protocol", "region"])
def test_resume_runs_again_what_disagrees(change):
    board = run_benchmark([pair()], [Counting("a", 4)], regions=["all"], warm_up=False)
    method = Counting("a", 6, spec="v2" if change == "spec" else "v1")
    again = run_benchmark(
        [pair()],
        [method],
        protocol="eth3d" if change == "protocol" else "middlebury-v3",
        regions=["all", "far"] if change == "region" else ["all"],
        board=board,
        warm_up=False,
    )
    assert method.calls == 1
    assert len(again.entries) == (2 if change == "protocol" else 1)
    assert again.entries[-1].regions["all"]["avgerr"] == 2


def test_a_changed_sample_is_refused(tmp_path):
    save = tmp_path / "board.json"
    run_benchmark([pair("s")], [Constant("a", 4)], save=save)
    before = save.read_bytes()
    for method in (Constant("a", 4), Constant("b", 4)):
        with pytest.raises(
            InputError, match="sample 's' is not the one that the board scores"
        ):
            run_benchmark([pair("s", seed=1)], [method], save=save)
    assert save.read_bytes() == before


def test_a_failure_is_kept_unless_retry_failed():
    board = run_benchmark([pair()], [Trouble("raises")])
    method = Counting("raises", 4, spec="raises")
    assert (
        not run_benchmark([pair()], [method], board=board, warm_up=False).entries[0].ok
    )
    assert (
        run_benchmark([pair()], [method], board=board, retry_failed=True, warm_up=False)
        .entries[0]
        .ok
    )


def test_progress_and_on_map_are_called():
    steps, maps = [], {}
    run_benchmark(
        (p for p in [pair("s"), pair("t")]),
        [Constant("a", 4), Trouble("raises")],
        progress=steps.append,
        on_map=lambda method, sample, disp: maps.update({(method, sample): disp}),
    )
    assert [(s.done, s.total, s.method, s.sample) for s in steps][-1] == (
        4,
        None,
        "raises",
        "t",
    )
    assert set(maps) == {("a", "s"), ("a", "t")}


def test_a_file_that_is_not_a_board_is_not_overwritten(tmp_path):
    save = tmp_path / "board.json"
    save.write_text("my thesis")
    with pytest.raises(FileError, match="not valid JSON"):
        run_benchmark([pair()], [Constant("a", 4)], save=save)
    assert save.read_text() == "my thesis"


@pytest.mark.parametrize(
    ("args", "options", "says"),
    [
        (
            ([pair()], [Constant("a", 4), Constant("a", 5)]),
            {},
            "two methods are named 'a'",
        ),
        (([pair("s"), pair("s")], [Constant("a", 4)]), {}, "two samples are named 's'"),
        (([pair()], []), {}, "no method"),
        (([pair()], "zncx"), {}, "unknown method 'zncx'; did you mean 'zncc'"),
        (
            ([pair()], [StereoMatcher("zncc")]),
            {},
            "^StereoMatcher has no name for the board: give it one, or",
        ),
        (([pair()], [Constant("a", 4)]), {"protocol": "eth"}, "did you mean 'eth3d'"),
        (
            ([pair()], [Constant("a", 4)]),
            {"regions": ["nonoc"]},
            "did you mean 'nonocc'",
        ),
        (([pair()], [Constant("a", 4)]), {"regions": []}, "nothing to score"),
        (([pair()], [Constant("a", 4)]), {"time_limit": 0}, "time limits are 0"),
        (
            ([pair()], [Constant("a", 4)]),
            {"time_limit": np.inf},
            "time limits are inf .* at most 1e",
        ),
        (([pair()], [Constant("a", 4)]), {"time_limit": 1e300}, "at most 1e"),
        (([pair()], [Constant("a", 4)]), {"memory_limit": 0}, "memory_limit is 0"),
    ],
)
def test_bad_arguments_are_refused(args, options, says):
    with pytest.raises(InputError, match=says):
        run_benchmark(*args, **options)


def test_methods_are_given_as_text():
    methods = ["wide=sad:block_size=5,num_disparities=4", Constant("a", 4), "sad,zncc"]
    assert run_benchmark([pair()], methods, warm_up=False).methods == (
        "wide",
        "a",
        "sad",
        "zncc",
    )
    assert run_benchmark([pair()], "sad,zncc", warm_up=False).methods == ("sad", "zncc")


def test_a_bad_sample_is_refused_by_name():
    image, truth = np.zeros((4, 5), np.uint8), np.ones((4, 5), np.float32)
    with pytest.raises(InputError, match=r"sample 'x': im1 is uint8 \(4, 4\)"):
        Pair("x", image, image[:, :4], truth, None, 8)
    with pytest.raises(InputError, match="sample 'x': disp0 holds NaN"):
        Pair("x", image, image, truth * np.nan, None, 8)
    with pytest.raises(InputError, match="ndisp is 0"):
        Pair("x", image, image, truth, None, 0)


def test_an_empty_board_is_returned_for_no_samples():
    assert run_benchmark([], [Constant("a", 4)]) == Board(
        meta=run_benchmark([], [Constant("a", 4)]).meta
    )


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


class Confident(Constant):
    """Returns a confidence beside the map."""

    def match(self, left, right, *, num_disparities, min_disparity):
        disp = super().match(
            left, right, num_disparities=num_disparities, min_disparity=min_disparity
        )
        return disp, np.random.default_rng(0).random(disp.shape, np.float32)


@pytest.mark.parametrize("limit", [None, 60.0])
def test_a_confidence_is_scored_and_kept_in_the_file(tmp_path, limit):
    save, sample = tmp_path / "board.json", pair()
    methods = [
        Confident("confident", 7.0),
        Constant("plain", 7.0),
        "sad:confidence=curvature",
    ]
    board = run_benchmark([sample], methods, save=save, time_limit=limit, warm_up=False)
    confident, plain, named = (
        board.find(m, sample.name, "middlebury-v3").regions["all"]
        for m in board.methods
    )
    assert len(confident.sparsification) == len(named.sparsification) == 20
    assert confident.sparsification[-1] == pytest.approx(confident["bad2.0"])
    assert confident["auc2.0_opt"] <= confident["auc2.0"]
    assert {name: plain[name] for name in plain} == {
        name: confident[name] for name in plain
    }
    assert read_board(save).entries == board.entries
    assert save.read_text().count('"sparsification"') == 4, (
        "of two methods in two regions"
    )
    table = board_csv(board).splitlines()
    assert table[0].count("auc2.0") == 2


@pytest.mark.parametrize(
    ("kind", "side", "dtype", "words"),
    [
        ("wrong-shape", 3, np.float32, "confidence of shape (3, 3)"),
        ("wrong-type", None, np.int64, "returned an array of int64: expected float32"),
    ],
)
def test_a_wrong_pair_of_maps_is_a_failure(kind, side, dtype, words):
    def answer(left, right, **_):
        shape = left.shape[:2]
        return np.zeros(shape, dtype), np.zeros((side, side) if side else shape)

    board = run_benchmark(
        [pair()], [SimpleNamespace(name="wrong", match=answer)], warm_up=False
    )
    assert board.entries[0].failure.kind == kind
    assert words in board.entries[0].failure.message
