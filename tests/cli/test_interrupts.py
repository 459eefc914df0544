"""Ctrl-C ends a command with exit code 130 and one line, and ends all that it started."""

import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from twinlens.cli.progress import interrupt_note
from twinlens.dataset import write_png

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
    while time.monotonic() < end:
        if path.exists() and path.read_text().endswith("\n"):
            return path.read_text()
        time.sleep(0.02)
    raise TimeoutError(path)


def is_gone(process):
    """Whether a process ends within five seconds; a zombie has ended."""
    try:
        psutil.wait_procs([psutil.Process(process)], timeout=5)
        return psutil.Process(process).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize(
    ("interrupts", "limit"), [(1, ()), (3, ("--time-limit", "200"))]
)
def test_interrupts_end_the_command_and_the_programs_it_started(
    dataset, tmp_path, interrupts, limit
):
    """Also a program that a subprocess of the command started; a board without matches is not made."""
    pid, board = tmp_path / "pid", tmp_path / "board"
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    program = (
        f"{sys.executable} {tmp_path / 'sleeper.py'} {pid} {{left}} {{right}} {{out}}"
    )
    line = ("benchmark", dataset, "--command", f"mine={program}", *limit, "-o", board)
    process = started(*line)
    sleeper = int(wait_for(pid).split()[1])
    for _ in range(interrupts):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err.strip()) == (130, "twinlens: interrupted")
    assert is_gone(sleeper)
    assert not board.exists()


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
    command = [sys.executable, "-c", script]
    subprocess.run(command, stdout=subprocess.DEVNULL, timeout=PATIENCE_S, check=True)


def test_an_interrupt_inside_a_loop_of_the_renderer_is_one():
    """Dr.Jit turns it into a RuntimeError, once for each loop around it."""
    dr = pytest.importorskip("drjit")
    from drjit.llvm.ad import UInt

    def interrupted(_):
        raise KeyboardInterrupt

    def inner(i):
        dr.while_loop((i,), lambda j: j < 9, interrupted)
        return (i + 1,)

    with pytest.raises(KeyboardInterrupt, match="kept"), interrupt_note(lambda: "kept"):
        dr.while_loop((UInt(0),), lambda i: i < 3, inner)
    with pytest.raises(RuntimeError), interrupt_note(lambda: "kept"):
        raise RuntimeError from ValueError()


def test_a_crash_in_native_code_names_the_line_that_led_to_it(tmp_path):
    """A segmentation fault of a user's matcher in the process itself."""
    image = np.zeros((30, 40), np.uint8)
    for name in ("l.png", "r.png"):
        write_png(tmp_path / name, image)
    (tmp_path / "own.py").write_text(
        "import ctypes\n\ndef crash(left, right, **_):\n    return ctypes.string_at(0)\n"
    )
    line = (
        "match",
        "l.png",
        "r.png",
        "--method",
        "function:own.py:crash",
        "-o",
        "d.pfm",
    )
    ended = subprocess.run(
        [sys.executable, "-m", "twinlens", *line],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == -signal.SIGSEGV
    assert 'own.py", line 4 in crash' in ended.stderr
    assert not (tmp_path / "d.pfm").exists()
