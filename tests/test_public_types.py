"""The public names have types: mypy --strict and pyright accept a correct user program and reject a wrong one."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import twinlens

PROGRAMS = Path(__file__).parent / "user_program"
STUB = Path(twinlens.__file__).with_suffix(".pyi")


def mypy(program, tmp_path):
    command = [sys.executable, "-m", "mypy", "--strict", f"--cache-dir={tmp_path}", "--config-file=", str(program)]
    return check(command, tmp_path)


def pyright(program, tmp_path):
    available = subprocess.run([sys.executable, "-m", "pyright", "--version"], capture_output=True, text=True)
    if available.returncode != 0 and os.environ.get("TWINLENS_REQUIRE_PYRIGHT") != "1":
        pytest.skip(f"pyright does not run here: {available.stderr.strip().splitlines()[-1:]}")
    return check([sys.executable, "-m", "pyright", "--pythonpath", sys.executable, str(program)], tmp_path)


def check(command, folder):
    """(exit code, the lines of the program that an error names)."""
    environment = {**os.environ, "PYTHONPATH": str(STUB.parents[1])}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, sorted({int(line) for line in re.findall(r"\.py:(\d+)(?::\d+)?[: -]+error", done.stdout)})


@pytest.mark.parametrize("checker", [mypy, pyright])
def test_a_correct_program_passes(checker, tmp_path):
    assert checker(PROGRAMS / "right_calls.py", tmp_path) == (0, [])


@pytest.mark.parametrize("checker", [mypy, pyright])
def test_every_mistake_is_reported(checker, tmp_path):
    assert checker(PROGRAMS / "wrong_calls.py", tmp_path) == (1, [5, 6, 7, 8, 9])


def test_every_public_name_exists():
    listed = re.findall(r"\b(\w+) as \1\b", STUB.read_text())
    assert sorted(listed) == sorted(twinlens.__all__)
    for name in listed:
        assert getattr(twinlens, name) is not None


def test_rooms_are_attributes():
    assert twinlens.scoring is importlib.import_module("twinlens.scoring")


def test_a_misspelt_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="mtach"):
        _ = twinlens.mtach
