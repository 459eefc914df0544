"""docs/studies.md: the example study runs as printed, and links work."""

import json
import re
from pathlib import Path

import pytest

from tests.docs.pages import blocks
from twinlens.cli import run
from twinlens.studies import STUDIES

PAGE = Path(__file__).parents[2] / "docs" / "studies.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not available")


def test_the_example_study_is_short_and_runs(tmp_path):
    text = next(
        block for _, block in blocks(PAGE, "python") if "STUDY = Study(" in block
    )
    assert len(text.splitlines()) < 90
    path = tmp_path / "low_light.py"
    path.write_text(text)
    out = tmp_path / "out"
    assert (
        run(
            [
                "study",
                str(path),
                "--seeds",
                "1",
                "--size",
                "64x48",
                "--spp",
                "2",
                "-o",
                str(out),
            ]
        )
        == 0
    )
    assert len(json.loads((out / "study.json").read_text())["findings"]) == 2
    assert (out / "figures" / "light.svg").exists()


def test_every_study_has_its_section():
    text = PAGE.with_name("study_results.md").read_text()
    titles = " ".join(re.findall(r"^## (.*)$", text, flags=re.MULTILINE))
    assert all(name in titles for name in STUDIES)
