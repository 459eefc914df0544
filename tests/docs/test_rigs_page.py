"""The rig of docs/rigs.md can be read."""

import tomllib
from pathlib import Path

import pytest

import twinlens as tl
from twinlens.scenes import rig_from_table

DOCS = Path(__file__).parents[2] / "docs"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="docs/ is not next to tests/")


def test_the_rig_of_the_page_is_one():
    table = (DOCS / "rigs.md").read_text().split("```toml\n")[1].split("```")[0]
    rig = rig_from_table(tomllib.loads(table), tl.load_scene("cards"), 64, 48)
    assert rig.cameras[1].fy == 705
    assert rig.calibrated is not None
