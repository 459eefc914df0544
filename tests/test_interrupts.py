"""Ctrl-C while Mitsuba sets itself up: the set-up ends first, and then the interrupt is heard."""

import importlib
import os
import signal
import subprocess
import sys
import threading

import pytest

from twinlens.processes import deferred_interrupts

backends = importlib.import_module(
    "twinlens.rendering.backends"
)  # the room's `backend` is the function
LLVM = backends.Backend("llvm", "llvm_ad_rgb", "a test asks for it")
SLOW_MITSUBA = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(0.01)
LogLevel = type("LogLevel", (), {"Error": 0})
steps = ["imported"]
chosen = None


def variant():
    return chosen


def set_variant(name):
    global chosen
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)
    chosen = name
    steps.append("variant")


def set_log_level(level):
    steps.append("log level")
"""


@pytest.fixture(autouse=True)
def pythons_own_handler():
    """pytest may have been started deaf, as a script's child in the background is."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def slow_mitsuba(monkeypatch, tmp_path):
    """A module of that name which is interrupted while it is imported, and again while its variant is set."""
    (tmp_path / "mitsuba.py").write_text(SLOW_MITSUBA)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mitsuba", raising=False)
    monkeypatch.setattr(backends, "_activated", {})
    yield
    sys.modules.pop("mitsuba", None)


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_is_raised_after_the_set_up(slow_mitsuba):
    with pytest.raises(KeyboardInterrupt):
        backends._activate(LLVM)
    assert sys.modules["mitsuba"].steps == ["imported", "variant", "log level"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_backend_after_an_interrupt_keeps_its_reason(slow_mitsuba):
    with pytest.raises(KeyboardInterrupt):
        backends._activate(LLVM)
    assert backends._already_set() is LLVM


def test_an_interrupt_is_raised_once_to_the_previous_handler():
    heard = []
    signal.signal(signal.SIGINT, lambda *_: heard.append("interrupt"))
    with deferred_interrupts():
        interrupt()
        interrupt()
        assert heard == []
    assert heard == ["interrupt"]
    interrupt()
    assert heard == ["interrupt"] * 2


def test_without_an_interrupt_the_handler_is_restored():
    with deferred_interrupts():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_propagates_and_the_handler_is_restored():
    with pytest.raises(ZeroDivisionError), deferred_interrupts():
        1 / 0  # noqa: B018
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("kind", [signal.SIG_IGN, signal.SIG_DFL])
def test_handlers_outside_python_are_kept(kind):
    signal.signal(signal.SIGINT, kind)
    with deferred_interrupts():
        assert signal.getsignal(signal.SIGINT) is kind
    assert signal.getsignal(signal.SIGINT) is kind


def test_other_threads_defer_nothing():
    seen = []

    def work():
        with deferred_interrupts():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_mitsuba_works_after_an_interrupt_during_import():
    """A child, interrupted where Python imports Mitsuba's own library, which would abort it; then it renders."""
    script = (
        "import importlib, os, signal, sys\n"
        "b = importlib.import_module('twinlens.rendering.backends')\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, *_):\n"
        "        name == 'mitsuba.mitsuba_ext' and os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "try: b.backend()\n"
        "except KeyboardInterrupt: print('interrupted')\n"
        "sys.meta_path.pop(0)\n"
        "mi = b.mitsuba(); mi.render(mi.load_dict(mi.cornell_box()), spp=1)\n"
        "print(b.backend().name)"
    )
    environment = {**os.environ, "TWINLENS_BACKEND": "llvm"}
    child = subprocess.run(
        [sys.executable, "-c", script],
        env=environment,
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert child.returncode == 0, child.stderr
    assert child.stdout.splitlines() == ["interrupted", "llvm"]
