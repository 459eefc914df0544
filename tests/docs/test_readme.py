"""Every shell block and every Python block of the README runs, in order, in one empty folder.

Of the shell blocks only the `make` lines are left out: they install, and run these tests.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
BLOCKS = re.findall(r"```(sh|python)\n(.*?)```", README.read_text(), flags=re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


def test_the_readme_shows_all_three_uses():
    shell = "".join(text for kind, text in BLOCKS if kind == "sh")
    assert all(f"twinlens {command} " in shell for command in ("render", "benchmark", "score", "match", "verify"))
    assert "make demo" in shell
    assert "make test" in shell


@pytest.mark.parametrize("number", range(len(BLOCKS)), ids=lambda number: f"{number}-{BLOCKS[number][0]}")
def test_block_works_as_printed(folder, number):
    kind, text = BLOCKS[number]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    lines = "\n".join(line for line in text.splitlines() if not line.startswith("make "))
    command = ["bash", "-euc", lines] if kind == "sh" else [sys.executable, "-W", "error", "-c", text]
    child = subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=300
    )
    assert child.returncode == 0, child.stderr
    assert "no lens on the market" not in child.stdout, "examples use realistic lenses"


def test_every_linked_file_exists():
    links = re.findall(r"\]\((?!https://)([^)#]+)\)", README.read_text())
    assert links
    assert all((README.parent / link).exists() for link in links)
