"""Every shell block and every Python block of the README runs, in order, in one empty folder.

Of the shell blocks only the `make` lines are left out: they install, and run these tests. The blocks run with images of
80x60 pixels of 4 samples in this process and, as slow tests, as printed in processes of their own. Blocks of which no
other block needs the results, and whose commands have tests of their own, are slow tests alone.
"""

import re
from pathlib import Path

import pytest

from tests.docs.pages import blocks, run_block, run_block_here

README = Path(__file__).parents[2] / "README.md"
BLOCKS = blocks(README, "sh", "python")
SIZES = {
    r"--size \d+x\d+": "--size 80x60",
    r"width = \d+\nheight = \d+": "width = 80\nheight = 60",
    r"from_fov\(\d+, \d+": "from_fov(80, 60",
    r"(twinlens render .*)--spp \d+": r"\1--spp 4 --no-denoise",
    r"--spp \d+": "--spp 4",
    r"\bspp = \d+": "spp = 4",
    r"\bspp=\d+": "spp=4",
}


def small(text):
    for pattern, size in SIZES.items():
        text = re.sub(pattern, size, text)
    return text


def is_needed(text):
    return "twinlens generate" not in text and "twinlens study" not in text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


@pytest.mark.parametrize(
    ("kind", "text"), [block for block in BLOCKS if is_needed(block[1])]
)
def test_a_small_block_works(folder, kind, text):
    run_block_here(kind, small(text), folder)


@pytest.mark.slow
def test_the_blocks_work_as_printed(tmp_path):
    for kind, text in BLOCKS:
        printed = run_block(kind, text, tmp_path)
        assert "no lens on the market" not in printed, "examples use realistic lenses"
