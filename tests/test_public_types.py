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


def mypy(folder):
    return ["mypy", "--strict", f"--cache-dir={folder}", "--config-file="]


def pyright(folder):
    available = subprocess.run(
        [sys.executable, "-m", "pyright", "--version"], capture_output=True, text=True
    )
    if available.returncode != 0 and os.environ.get("TWINLENS_REQUIRE_PYRIGHT") != "1":
        pytest.skip(
            f"pyright does not run here: {available.stderr.strip().splitlines()[-1:]}"
        )
    return ["pyright", "--pythonpath", sys.executable]


@pytest.mark.parametrize("checker", [mypy, pyright])
def test_a_correct_program_passes_and_every_mistake_is_reported(
    checker, tmp_path, pytestconfig
):
    """Both programs at once. The lines of errors by their files. mypy keeps what it read of NumPy for the next run."""
    kept = getattr(pytestconfig, "cache", None)
    notes = kept.mkdir("mypy") if kept else tmp_path
    programs = [PROGRAMS / "right_calls.py", PROGRAMS / "wrong_calls.py"]
    command = [sys.executable, "-m", *checker(notes), *map(str, programs)]
    environment = {**os.environ, "PYTHONPATH": str(STUB.parents[1])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    errors = re.findall(r"(\w+)\.py:(\d+)(?::\d+)?[: -]+error", done.stdout)
    assert done.returncode == 1
    assert {(file, int(line)) for file, line in errors} == {
        ("wrong_calls", line) for line in range(5, 10)
    }


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
