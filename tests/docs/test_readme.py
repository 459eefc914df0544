"""Every shell block and every Python block of the README runs, in order, in one empty folder.

Of the shell blocks only the `make` lines are left out: they install, and run these tests. The blocks run with images of
80x60 pixels of 4 samples and, as slow tests, as printed. Blocks of which no other block needs the results, and whose
commands have tests of their own, are slow tests too.
"""

import re
from pathlib import Path

import pytest

from tests.docs.pages import blocks, run_block

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


@pytest.fixture(
    scope="module", params=["small", pytest.param("as printed", marks=pytest.mark.slow)]
)
def edit(request):
    """The function that is applied to the text of a block."""
    return small if request.param == "small" else str


@pytest.fixture(scope="module")
def folder(edit, tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


def case(number):
    kind, text = BLOCKS[number]
    by_itself = "twinlens generate" in text or "twinlens study" in text
    marks = pytest.mark.slow if by_itself else ()
    return pytest.param(number, id=f"{number}-{kind}", marks=marks)


@pytest.mark.parametrize("number", [case(number) for number in range(len(BLOCKS))])
def test_block_works(folder, edit, number):
    kind, text = BLOCKS[number]
    assert "no lens on the market" not in run_block(kind, edit(text), folder), (
        "examples use realistic lenses"
    )
