"""Programs on a board: names, no shell, limits, failures."""

import json
import os
import re
import sys
import time
from pathlib import Path

import pytest

from twinlens.cli.benchmark import DEFAULT_METHODS
from twinlens.matching import parse_program, split_methods
from twinlens.scoring import PROTOCOLS, REGIONS
from twinlens.scoring.runners import WARM_UP_LIMIT_S

FLAT = """
import struct, sys
left, out, value = sys.argv[1], sys.argv[2], float(sys.argv[3].split(",")[-1])
width, height = struct.unpack(">II", open(left, "rb").read(24)[16:])
open(out, "wb").write(b"Pf\\n%d %d\\n-1.0\\n" % (width, height) + struct.pack("<f", value) * (width * height))
"""
FAULTS = {
    "dies": ("import sys; sys.exit('no weights')", "crash", "no weights"),
    "nan": ("", "not-a-number", "returned nan"),
    "silent": ("pass", "crash", "wrote no file"),
    "cut": (
        "import sys; open(sys.argv[2], 'wb').write(b'Pf\\n1 1\\n-1.0\\nabcd')",
        "wrong-shape",
        "shape (1, 1)",
    ),
    "hangs": ("import time; time.sleep(60)", "time-limit", "longer than 1 s"),
}


@pytest.fixture
def program(tmp_path):
    """A command line that runs Python code with {left}, {out} and one more argument."""

    def make(code, value="4", name="matcher"):
        path = tmp_path / f"{name}.py"
        path.write_text(code)
        return f"{sys.executable} {path} {{left}} {{out}} {value} {{right}}"

    return make


def entries(out):
    return {entry["method"]: entry for entry in json.loads(out)["entries"]}


def test_a_program_is_listed_under_its_name(twinlens, dataset, tmp_path, program):
    code, out, err = twinlens(
        "benchmark", dataset, "--command", f"flat={program(FLAT)}", "--methods", "sad:block_size=5",
        "-o", tmp_path / "board", "--json",
    )  # fmt: skip
    assert code == 0, err
    board = entries(out)
    assert set(board) == {"flat", "sad:block_size=5"}
    assert all(entry["failure"] is None for entry in board.values())
    assert " program:command=" in board["flat"]["spec"]


@pytest.mark.parametrize("limit", [(), ("--time-limit", "1")])
def test_what_a_program_does_wrong_it_does_alone(
    twinlens, dataset, tmp_path, program, limit
):
    commands = [("flat", program(FLAT)), ("nan", program(FLAT, "nan", "nan"))]
    commands += [
        (name, program(fault[0], name=name))
        for name, fault in FAULTS.items()
        if name != "nan"
    ]
    if not limit:
        commands = [(name, command) for name, command in commands if name != "hangs"]
    options = [
        word
        for name, command in commands
        for word in ("--command", f"{name}={command}")
    ]
    code, out, err = twinlens(
        "benchmark", dataset, *options, *limit, "-o", tmp_path / "board", "--json"
    )
    assert code == 0, err
    board = entries(out)
    assert board["flat"]["failure"] is None
    for name, _ in commands[1:]:
        _, kind, words = FAULTS[name]
        assert board[name]["failure"]["kind"] == kind
        assert words in board[name]["failure"]["message"]


def test_a_program_is_ended_with_all_that_it_started(
    twinlens, dataset, tmp_path, program
):
    pid = tmp_path / "pid"
    code = (
        "import subprocess, sys, time\n"
        f"child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'])\n"
        f"open({str(pid)!r}, 'w').write(str(child.pid)); time.sleep(300)"
    )
    started = time.monotonic()
    status, _, err = twinlens(
        "match", dataset / "cards/im0.png", dataset / "cards/im1.png", "--command", program(code), "--time-limit", "3",
        "-o", tmp_path / "d.pfm",
    )  # fmt: skip
    assert status == 1
    assert "longer than 3 s" in err
    assert time.monotonic() - started < 60
    assert not (tmp_path / "d.pfm").exists()
    state = Path(f"/proc/{pid.read_text()}/stat")
    deadline = time.monotonic() + 5
    while (
        state.exists()
        and state.read_text().split()[2] != "Z"
        and time.monotonic() < deadline
    ):
        time.sleep(0.05)
    assert not state.exists() or state.read_text().split()[2] == "Z"


def test_no_shell_reads_the_command(twinlens, dataset, tmp_path, program):
    trap = tmp_path / "trap"
    command = program(
        "import sys; sys.exit(' '.join(sys.argv[3:]))",
        value=f"$HOME `touch {trap}` ; touch {trap} | *",
    )
    images = dataset / "cards/im0.png", dataset / "cards/im1.png"
    _, _, err = twinlens(
        "match", *images, "--command", command, "-o", tmp_path / "d.pfm"
    )
    assert not trap.exists()
    assert "$HOME `touch" in err
    assert os.environ["HOME"] not in err.split("status 1:")[1].split("`")[0]


def test_match_by_a_program(twinlens, dataset, tmp_path, program):
    images = dataset / "cards/im0.png", dataset / "cards/im1.png"
    code, out, err = twinlens(
        "match", *images, "--command", program(FLAT), "-o", tmp_path / "d.pfm", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["known_fraction"] == 1
    for options, words in (
        (
            ("--method", "sad", "--command", "prog {left} {right} {out}"),
            "use one of them",
        ),
        (("--time-limit", "3"), "applies to programs only"),
        (("--command", "prog {left} {right}"), "needs {out}"),
        (
            ("--command", "prog {left} {right} {out}", "--time-limit", "0"),
            "--time-limit must be a finite number > 0 and",
        ),
        (
            ("--command", "prog {left} {right} {out}", "--time-limit", "-1"),
            "> 0 and <= 1000000, got -1.0",
        ),
    ):
        code, _, err = twinlens("match", *images, *options, "-o", tmp_path / "none.pfm")
        assert code == 2
        assert words in err


@pytest.mark.parametrize(
    "command", ["", "prog {left} {out}", "x=prog", "'prog {left} {right} {out}"]
)
def test_invalid_commands_are_refused(twinlens, dataset, tmp_path, command):
    code, _, err = twinlens(
        "benchmark", dataset, "--command", command, "-o", tmp_path / "board"
    )
    assert code == 2
    assert err.startswith("twinlens: command ")
    assert not (tmp_path / "board").exists()


def test_names_of_programs():
    texts = ["mine=./a {left} {right} {out}", "bin/b --x=1 {left} {right} {out}"]
    named = [parse_program(text, 7.0) for text in texts]
    assert [(m.name, m.options["timeout_s"]) for m in named] == [
        ("mine", 7.0),
        ("b", 7.0),
    ]
    assert named[0].options["command"] == "./a {left} {right} {out}"


def test_default_methods(twinlens, dataset, tmp_path):
    code, out, _ = twinlens("benchmark", dataset, "-o", tmp_path / "b", "--json")
    assert code == 0
    assert {entry["method"] for entry in json.loads(out)["entries"]} == {
        *DEFAULT_METHODS.split(",")
    }


def test_commas_in_a_quoted_command_do_not_separate_methods(
    twinlens, dataset, tmp_path, program
):
    command = f"program:command='{program(FLAT, '3,4')}'"
    assert split_methods([f"sad,{command},zncc:block_size=5,lr_check=1"]) == [
        "sad", command, "zncc:block_size=5,lr_check=1",
    ]  # fmt: skip
    code, out, err = twinlens(
        "benchmark",
        dataset,
        "--methods",
        f"sad,{command}",
        "-o",
        tmp_path / "b",
        "--json",
    )
    assert code == 0, err
    assert {name: entry["failure"] for name, entry in entries(out).items()} == {
        "sad": None,
        command: None,
    }


def test_help_lists_every_protocol_and_region(twinlens):
    _, out, _ = twinlens("benchmark", "--help")
    words = " ".join(out.split())
    assert ", ".join(PROTOCOLS) in words
    assert ", ".join(REGIONS) in words


FUNCTIONS = """
import ctypes
import time
import numpy as np

def good(left, right, num_disparities, min_disparity):
    print("hello, I am no JSON")
    return np.full(left.shape[:2], 4, np.float32)

def segfaults(left, right, num_disparities, min_disparity):
    ctypes.string_at(0)

def sleeps(left, right, num_disparities, min_disparity):
    time.sleep(60)

def hoards(left, right, num_disparities, min_disparity):
    kept = []
    while True:
        kept.append(np.ones(2**24))
"""


def test_a_crashing_function_does_not_end_the_run(
    twinlens, dataset, tmp_path, monkeypatch
):
    """By default, functions and networks run in a worker process."""
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(str(tmp_path))
    names = ",".join(
        f"function:function=functions:{name}" for name in ("good", "segfaults")
    )
    code, out, err = twinlens(
        "benchmark", dataset, "--methods", names, "-o", tmp_path / "c", "--json"
    )
    assert code == 0, err
    assert [e["failure"] is None for e in json.loads(out)["entries"]] == [
        True,
        False,
    ] * 2


@pytest.mark.slow
def test_functions_that_crash_and_exhaust_memory_fail_by_their_kinds(
    twinlens, dataset, tmp_path, monkeypatch
):
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(str(tmp_path))
    names = ",".join(
        f"function:function=functions:{name}"
        for name in ("good", "segfaults", "hoards")
    )
    limit = ("--memory-limit", "2")
    code, out, err = twinlens(
        "benchmark", dataset, "--methods", names, *limit, "-o", tmp_path / "b", "--json"
    )
    assert code == 0, err
    kinds = {
        e["method"].rpartition(":")[2]: e["failure"] and e["failure"]["kind"]
        for e in json.loads(out)["entries"]
    }
    assert kinds == {"good": None, "segfaults": "crash", "hoards": "memory"}


@pytest.mark.parametrize("gib", ["0", "-1", "nan", "1e9"])
def test_an_invalid_memory_limit_is_refused(twinlens, dataset, tmp_path, gib):
    code, out, err = twinlens(
        "benchmark", dataset, "--memory-limit", gib, "-o", tmp_path / "b"
    )
    assert (code, out) == (2, "")
    assert (
        f"--memory-limit must be a finite number > 0 and <= 1048576, got {float(gib)}"
        in err
    )


def test_matchers_output_does_not_mix_with_json(
    twinlens, dataset, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        "twinlens.matching.matcher.StereoMatcher.compute",
        lambda self, left, right: print("hello"),
    )
    code, out, err = twinlens(
        "benchmark", dataset, "--methods", "sad", "-o", tmp_path / "b", "--json"
    )
    assert code == 1
    assert "hello" in err
    assert json.loads(out)["entries"][0]["failure"]["kind"] == "wrong-type"


def test_duplicate_sample_names_are_refused_before_matching(
    twinlens, dataset, tmp_path
):
    code, out, err = twinlens(
        "benchmark",
        dataset,
        "motorcycle",
        dataset,
        "--methods",
        "sad",
        "-o",
        tmp_path / "b",
    )
    assert (code, out) == (2, "")
    assert "two samples are named" in err
    assert not (tmp_path / "b").exists()


def test_earlier_failures_are_reported_and_rerun_on_request(
    twinlens, dataset, tmp_path, program
):
    """The program fails because a folder that it names is missing; folders are not part of its spec."""
    weights = tmp_path / "weights"
    code = f"import os, sys\nif not os.path.exists({str(weights)!r}): sys.exit('no weights')\n{FLAT}"
    arguments = (
        "benchmark",
        dataset,
        "-o",
        tmp_path / "b",
        "--command",
        f"mine={program(code)}",
    )
    assert twinlens(*arguments)[0] == 1
    weights.mkdir()
    status, out, err = twinlens(*arguments)
    assert status == 1
    assert "failed: mine on cards · pinhole and 1 more: crash (" in out
    assert err == "earlier failures kept: 2; use --retry-failed to rerun them\n"
    status, out, err = twinlens(
        "benchmark", dataset, "-o", tmp_path / "b", "--methods", "sad"
    )
    assert (status, err) == (0, "")
    assert "failed: " not in out
    status, out, err = twinlens(*arguments, "--retry-failed")
    assert (status, err) == (0, "")
    assert "failed: " not in out


def test_a_hanging_function_is_stopped_at_its_limits(
    twinlens, dataset, tmp_path, monkeypatch
):
    (tmp_path / "sleepers.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(str(tmp_path))
    started = time.monotonic()
    code, out, err = twinlens(
        "benchmark", dataset, "--methods", "function:function=sleepers:sleeps", "-o", tmp_path / "b", "--json",
        "--time-limit", "1", "--warm-up-limit", "2",
    )  # fmt: skip
    assert code == 1, err
    assert time.monotonic() - started < 30
    messages = [e["failure"]["message"] for e in json.loads(out)["entries"]]
    assert len(messages) == 2
    note = r"exceeded the time limit of 1 s; the warm-up took \d+(\.\d+)? s and was not repeated"
    assert all(re.fullmatch(note, message) for message in messages)


def test_help_has_the_scoring_room_s_warm_up_limit(twinlens):
    assert f"[default: {WARM_UP_LIMIT_S}" in " ".join(
        twinlens("benchmark", "--help")[1].split()
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--methods", "sad,function:function=nomodule:f"],
            "function 'nomodule:f' cannot be imported: No module",
        ),
        (
            ["--methods", "function:function=math:nothing"],
            "math has no function 'nothing'",
        ),
        (["--methods", "function:function=math:pi"], "cannot be called"),
        (["--methods", "sad,onnx:model=none.onnx"], "none.onnx: No such file"),
        (
            ["--methods", "program:command='./none {left} {right} {out}'"],
            "'./none' cannot be started: no such program",
        ),
        (
            ["--command", "x=README {left} {right} {out}", "--methods", "sad"],
            "'README' cannot be started: no such",
        ),
        (
            ["--command", "x=none {left} {right} {out}", "--time-limit", "9"],
            "'none' cannot be started: no such",
        ),
    ],
)
def test_missing_requirements_are_reported_before_anything_runs(
    twinlens, dataset, tmp_path, options, words
):
    code, out, err = twinlens("benchmark", dataset, *options, "-o", tmp_path / "b")
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "b").exists()


def test_a_missing_program_does_not_change_the_board(
    twinlens, dataset, tmp_path, program
):
    """Changed content means another method and drops its scores, but a missing file does not."""
    path = tmp_path / "prog.sh"
    command = program(FLAT).split(" ", 1)[1]
    arguments = (
        "benchmark",
        dataset,
        "--command",
        f"mine={path} {command}",
        "-o",
        tmp_path / "b",
    )
    path.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    path.chmod(0o755)
    assert twinlens(*arguments)[0] == 0
    board = (tmp_path / "b" / "board.json").read_bytes()
    path.chmod(0o644)
    code, _, err = twinlens(*arguments)
    assert code == 2
    assert "cannot be started: it is not executable" in err
    assert (tmp_path / "b" / "board.json").read_bytes() == board


def test_options_belong_to_the_method_before_them():
    assert split_methods(["sad:block_size=5,lr_check=1,zncc", "ssd"]) == [
        "sad:block_size=5,lr_check=1",
        "zncc",
        "ssd",
    ]
