"""Programs on a board: names, no shell, limits, failures."""

import json
import os
import sys
import time
from pathlib import Path

import pytest

from twinlens.matching import split_methods

FLAT = """
import struct, sys
left, out, value = sys.argv[1], sys.argv[2], float(sys.argv[3].split(",")[-1])
width, height = struct.unpack(">II", open(left, "rb").read(24)[16:])
open(out, "wb").write(b"Pf\\n%d %d\\n-1.0\\n" % (width, height) + struct.pack("<f", value) * (width * height))
"""
FAULTS = {
    "dies": ("import sys; sys.exit('no weights')", "crash", "no weights"),
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


def test_what_a_program_does_wrong_it_does_alone(twinlens, dataset, tmp_path, program):
    options = ["--command", f"flat={program(FLAT)}"]
    options += ["--command", f"nan={program(FLAT, 'nan', 'nan')}"]
    for name, (text, _, _) in FAULTS.items():
        options += ["--command", f"{name}={program(text, name=name)}"]
    line = ("benchmark", dataset, *options, "--time-limit", "1")
    code, out, err = twinlens(*line, "-o", tmp_path / "board", "--json")
    assert code == 0, err
    failures = {name: entry["failure"] for name, entry in entries(out).items()}
    assert failures.pop("flat") is None
    assert failures["nan"]["kind"] == "not-a-number"
    for name, (_, kind, words) in FAULTS.items():
        assert failures[name]["kind"] == kind
        assert words in failures[name]["message"]


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


def test_methods_are_separated_by_commas_outside_quotes_and_options():
    command = "program:command='./prog {left} {right} {out} 3,4'"
    texts = [f"sad,{command},zncc:block_size=5,lr_check=1,ssd", "census"]
    assert split_methods(texts) == [
        "sad",
        command,
        "zncc:block_size=5,lr_check=1",
        "ssd",
        "census",
    ]


def test_earlier_failures_are_reported_and_rerun_on_request(
    twinlens, dataset, tmp_path, program
):
    """The program fails because a folder that it names is missing; folders are not part of its spec."""
    weights = tmp_path / "weights"
    check = f"import os, sys\nif not os.path.exists({str(weights)!r}): sys.exit('no weights')\n"
    line = ("benchmark", dataset, "-o", tmp_path / "b")
    command = ("--command", f"mine={program(check + FLAT)}")
    assert twinlens(*line, *command)[0] == 1
    weights.mkdir()
    status, out, err = twinlens(*line, *command)
    assert status == 1
    assert "failed: mine on cards · pinhole and 1 more: crash (" in out
    assert err == "earlier failures kept: 2; use --retry-failed to rerun them\n"
    for rest in (("--methods", "sad"), (*command, "--retry-failed")):
        status, out, err = twinlens(*line, *rest)
        assert (status, err) == (0, "")
        assert "failed: " not in out
