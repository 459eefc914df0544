"""Ctrl-C ends a command with exit code 130 and one line, and ends all that it started."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from twinlens.cli import render

PATIENCE_S = 60
SLEEPER = """
import os, sys, time
print("program", os.getpid(), file=open(sys.argv[1], "w"))
time.sleep(300)
"""


def started(*arguments):
    command = [
        sys.executable,
        "-m",
        "twinlens",
        *(str(argument) for argument in arguments),
    ]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def wait_for(path):
    end = time.monotonic() + PATIENCE_S
    while (
        not (path.exists() and path.read_text().endswith("\n"))
        and time.monotonic() < end
    ):
        time.sleep(0.02)
    return path.read_text()


def is_alive(process):
    with Path(f"/proc/{process}/stat").open() as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(
    not Path("/proc/self/task").exists(),
    reason="only Linux lists the children of a process",
)
@pytest.mark.parametrize("limit", [(), ("--time-limit", "200")])
def test_three_interrupts_end_the_command_and_the_programs_it_started(
    dataset, tmp_path, limit
):
    """Also a program that a subprocess of the command started."""
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    program = f"{sys.executable} {tmp_path / 'sleeper.py'} {tmp_path / 'pid'} {{left}} {{right}} {{out}}"
    process = started(
        "benchmark",
        dataset,
        "--command",
        f"mine={program}",
        *limit,
        "-o",
        tmp_path / "board",
    )
    sleeper = int(wait_for(tmp_path / "pid").split()[1])
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert err.split("\n")[-2] == "twinlens: interrupted"
    end = time.monotonic() + 5
    while (
        Path(f"/proc/{sleeper}").exists()
        and is_alive(sleeper)
        and time.monotonic() < end
    ):
        time.sleep(0.02)
    assert not Path(f"/proc/{sleeper}").exists() or not is_alive(sleeper)


def test_an_interrupt_before_anything_is_finished_is_one_word(dataset, tmp_path):
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    program = f"{sys.executable} {tmp_path / 'sleeper.py'} {tmp_path / 'pid'} {{left}} {{right}} {{out}}"
    process = started(
        "benchmark", dataset, "--command", f"mine={program}", "-o", tmp_path / "board"
    )
    wait_for(tmp_path / "pid")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err.strip()) == (130, "twinlens: interrupted")
    assert not (tmp_path / "board").exists(), "made for nothing"


def test_an_interrupted_render_that_kept_nothing_says_nothing_more(
    twinlens, tmp_path, monkeypatch
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(render, "make_sample", interrupted)
    code, _, err = twinlens("render", "cards", "-o", tmp_path / "out")
    assert (code, err.strip()) == (130, "twinlens: interrupted")


def test_running_the_command_line_in_a_process_changes_no_handler(twinlens):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    assert twinlens("--version")[0] == 0
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


LATE = """
import atexit, os, signal
from twinlens import cli
def run(**_):
    atexit.register(os.kill, os.getpid(), signal.SIGINT)
    return {code}
cli.run = run
cli.console()
"""


@pytest.mark.parametrize("code", [0, 1])
def test_an_interrupt_at_exit_changes_neither_the_exit_code_nor_the_output(code):
    process = subprocess.run(
        [sys.executable, "-c", LATE.format(code=code)],
        capture_output=True,
        timeout=PATIENCE_S,
    )
    assert (process.returncode, process.stderr) == (code, b"")


BACKGROUND = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGTERM, signal.SIG_IGN)
from twinlens import cli
def run():
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)
    return 0
cli.run = run
cli.console()
"""


def test_signals_that_the_parent_ignores_stay_ignored():
    """As in a background job of a script."""
    process = subprocess.run(
        [sys.executable, "-c", BACKGROUND], capture_output=True, timeout=PATIENCE_S
    )
    assert (process.returncode, process.stderr) == (0, b"")


EARLY = """
import os, runpy, signal, sys
class Interrupting:
    def find_spec(self, name, *_):
        try:
            name == "{module}" and os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt as error:
            if name.startswith("twinlens.matching"):
                raise RuntimeError("an import may hide it, as __set_name__ does") from error
            raise
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting())
sys.argv = ["twinlens", "methods"]
runpy.run_module("twinlens", run_name="__main__")
"""


@pytest.mark.parametrize(
    "module", ["twinlens.cli", "click.core", "twinlens.matching.costs"]
)
def test_an_interrupt_while_modules_are_imported_ends_the_command_in_one_line(module):
    script = EARLY.format(module=module)
    process = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert (process.returncode, process.stdout, process.stderr.strip()) == (
        130,
        "",
        "twinlens: interrupted",
    )


def test_the_help_of_a_command_line_imports_no_numpy():
    """So that there is little time to interrupt before errors are handled."""
    script = "import sys; from twinlens.cli import run; run(['--help']); assert 'numpy' not in sys.modules"
    assert (
        subprocess.run(
            [sys.executable, "-c", script],
            stdout=subprocess.DEVNULL,
            timeout=PATIENCE_S,
        ).returncode
        == 0
    )
