"""Ctrl-C: what is kept is said where something is; and whoever is in a hurry is let go at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from twinlens import cli, factory
from twinlens.cli import generate, interrupts

PATIENCE_S = 60
SLEEPER = """
import os, sys, time
print("program", os.getpid(), file=open(sys.argv[1], "w"))
time.sleep(300)
"""


def started(*arguments):
    command = [sys.executable, "-m", "twinlens", *(str(argument) for argument in arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path):
    end = time.monotonic() + PATIENCE_S
    while not (path.exists() and path.read_text().endswith("\n")) and time.monotonic() < end:
        time.sleep(0.02)
    return path.read_text()


def is_alive(process):
    with Path(f"/proc/{process}/stat").open() as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux tells who started whom")
@pytest.mark.parametrize("limit", [(), ("--time-limit", "200")])
def test_three_interrupts_end_at_once_with_all_that_runs(dataset, tmp_path, limit):
    """Here a program, also one that a process between starts: it would sleep for minutes."""
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    program = f"{sys.executable} {tmp_path / 'sleeper.py'} {tmp_path / 'pid'} {{left}} {{right}} {{out}}"
    process = started("benchmark", dataset, "--command", f"mine={program}", *limit, "-o", tmp_path / "board")
    sleeper = int(wait_for(tmp_path / "pid").split()[1])
    for _ in range(3):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    said = [line for line in err.splitlines() if line]
    assert said[-1] in ("twinlens: interrupted", "twinlens: interrupted again; ended at once")
    end = time.monotonic() + 5
    while Path(f"/proc/{sleeper}").exists() and is_alive(sleeper) and time.monotonic() < end:
        time.sleep(0.02)
    assert not Path(f"/proc/{sleeper}").exists() or not is_alive(sleeper)


def test_one_interrupt_before_anything_is_finished_says_no_more(dataset, tmp_path):
    (tmp_path / "sleeper.py").write_text(SLEEPER)
    program = f"{sys.executable} {tmp_path / 'sleeper.py'} {tmp_path / 'pid'} {{left}} {{right}} {{out}}"
    process = started("benchmark", dataset, "--command", f"mine={program}", "-o", tmp_path / "board")
    wait_for(tmp_path / "pid")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, err.strip()) == (130, "twinlens: interrupted")
    assert not (tmp_path / "board").exists(), "made for nothing"


def test_render_says_what_is_kept_only_where_something_is(twinlens, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(factory, "make_sample", interrupted)
    code, _, err = twinlens("render", "cards", "-o", tmp_path / "out")
    assert (code, err.strip()) == (130, "twinlens: interrupted")


def test_the_first_interrupt_is_python_s_and_the_second_is_the_end(monkeypatch):
    ended = []
    monkeypatch.setattr(interrupts, "end", lambda: ended.append(True))
    ender = interrupts.Ender()
    for times in (0, 1, 2):
        with pytest.raises(KeyboardInterrupt):
            ender(signal.SIGINT, None)
        assert len(ended) == times
    with pytest.raises(KeyboardInterrupt):
        interrupts.once_more(signal.default_int_handler)
    assert len(ended) == 2


def test_importing_or_running_the_command_line_changes_no_handler(twinlens):
    before = signal.getsignal(signal.SIGINT)
    assert twinlens("--version")[0] == 0
    assert signal.getsignal(signal.SIGINT) is before


def test_descendants_are_found_in_sessions_of_their_own():
    code = (
        "import subprocess, sys; p = subprocess.Popen(['sleep', '60'], start_new_session=True); print(p.pid); p.wait()"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        grandchild = int(process.stdout.readline())
        assert {process.pid, grandchild} <= set(interrupts._descendants(os.getpid()))
    finally:
        os.kill(grandchild, signal.SIGKILL)
        process.communicate(timeout=PATIENCE_S)


def test_who_was_started_deaf_to_interrupts_stays_so(monkeypatch):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        interrupts.take_over()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_way_out_of_an_interrupt_is_the_short_one(monkeypatch):
    """On the long one, Python's, a third interrupt would find no handler any more, and end it by its signal."""
    ended = []
    monkeypatch.setattr(cli, "run", lambda **_: 130)
    monkeypatch.setattr(cli, "end", ended.append)
    monkeypatch.setattr(cli, "take_over", interrupts.Ender)
    with pytest.raises(SystemExit):
        cli.console()
    assert ended == [""]


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
def test_an_interrupt_when_all_is_said_changes_neither_the_code_nor_what_was_said(code):
    process = subprocess.run([sys.executable, "-c", LATE.format(code=code)], capture_output=True, timeout=PATIENCE_S)
    assert (process.returncode, process.stderr) == (code, b"")


def test_generate_hears_no_interrupt_where_the_process_was_started_deaf_to_them():
    """As a script's in the background; what batch systems send is heard all the same."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with generate._stop_on_signal() as stop:
            signal.raise_signal(signal.SIGINT)
            assert not stop.is_set()
            signal.raise_signal(signal.SIGTERM)
            assert stop.is_set()
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


class Left(BaseException):
    """In the place of the process's end."""


@pytest.mark.parametrize("step", ["_descendants", "os.isatty", "signal.signal"])
def test_the_end_comes_whatever_fails_on_the_way(monkeypatch, step):
    def fails(*_):
        raise RuntimeError(step)

    def leave(code):
        raise Left(code)

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(interrupts, "_descendants", lambda _: [])
    monkeypatch.setattr(f"twinlens.cli.interrupts.{step}", fails)
    monkeypatch.setattr(os, "_exit", leave)
    with pytest.raises(Left) as left:
        interrupts.end("-")
    assert left.value.args == (130,)


def test_a_process_that_ends_while_it_is_listed_hides_no_other(monkeypatch, tmp_path):
    (tmp_path / "children").write_text("123456789 ")

    def vanishing(self, _):
        if "123456789" not in str(self):
            yield tmp_path / "children"
        raise FileNotFoundError(self)

    monkeypatch.setattr(Path, "glob", vanishing)
    assert interrupts._descendants(1) == [123456789]
