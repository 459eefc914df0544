"""Every shell block and every Python block of the README runs, in order, in one empty folder.

Of the shell blocks only the `make` lines are left out: they install, and run these tests.
"""

from pathlib import Path

import pytest

from tests.docs.pages import blocks, check_links, run_block

README = Path(__file__).parents[2] / "README.md"
BLOCKS = blocks(README, "sh", "python")


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
    assert "no lens on the market" not in run_block(*BLOCKS[number], folder), "examples use realistic lenses"


def test_every_linked_file_exists():
    check_links(README)
