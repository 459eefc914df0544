"""The commands and examples of docs/planning.md give what is printed there."""

import doctest
import re
import shlex
from pathlib import Path

import pytest

from twinlens.cli import run

PAGE = Path(__file__).parents[2] / "docs" / "planning.md"
pytestmark = pytest.mark.skipif(
    not PAGE.is_file(), reason="docs/ is not next to tests/"
)


def test_examples_run_as_printed():
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert (failed, tried) == (0, 5)


def test_commands_print_what_is_shown(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(
        r"^\$ twinlens (plan .+)\n((?:.*\n)*?)```", PAGE.read_text(), flags=re.MULTILINE
    )
    assert len(blocks) == 2
    for command, shown in blocks:
        run(shlex.split(command))
        assert shown in capsys.readouterr().out
