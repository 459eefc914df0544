"""The documentation site lists every page, links lead somewhere, and docstrings become valid reStructuredText."""

import doctest
import importlib.util
import os
import re
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    page
    for pattern in (
        "*.md",
        "docs/*.md",
        "docs/decisions/*.md",
        "benchmarks/**/*.md",
        "examples/*.md",
    )
    for page in ROOT.glob(pattern)
)
SPEC = importlib.util.spec_from_file_location(
    "sphinx_reference", DOCS / "sphinx_reference.py"
)
REFERENCE = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(REFERENCE)


def toctree():
    blocks = re.findall(
        r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text(), re.S
    )
    rows = [
        row
        for block in blocks
        for row in block.splitlines()
        if row and not row.startswith(":")
    ]
    return [row.partition("<")[2].rstrip(">") or row for row in rows]


def test_the_site_lists_every_page_once():
    listed = toctree()
    assert len(listed) == len(set(listed))
    written = [
        name for name in listed if not name.startswith(("gallery/", "reference/"))
    ]
    paths = {Path(os.path.normpath(DOCS / f"{name}.md")) for name in written}
    children = {
        *DOCS.glob("decisions/*.md"),
        *ROOT.glob("benchmarks/*.md"),
    }  # listed below their README
    unlisted = {DOCS / "index.md", *ROOT.glob("benchmarks/*/about.md")}
    assert paths | children | unlisted == set(PAGES)


def anchors(page):
    """The anchors that GitHub gives to the headings of a page."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
    headings = [
        re.sub(r"\]\([^)]*\)|[`*\[]", "", title)
        for title in re.findall(r"^#+ (.*)$", text, re.M)
    ]
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in headings
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page):
    text = re.sub(r"^```.*?^```|`[^`\n]+`", "", page.read_text(), flags=re.S | re.M)
    for link in re.findall(r"\]\((?!https?://|mailto:)([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if ">>> " in page.read_text()],
    ids=lambda page: page.stem,
)
def test_examples_with_results_run_as_printed(page):
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert tried
    assert failed == 0


def python_blocks(page):
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.S)
    return [block for block in blocks if not block.startswith(">>>")]


def test_the_examples_of_the_camera_page_run():
    camera = tl.Camera.from_fov(64, 48, fov_x_deg=50).replace(
        pixel_pitch_um=500
    )  # so that v/A is above 1
    image = np.random.default_rng(0).uniform(0, 1, (48, 64, 3)).astype(np.float32)
    names = {
        "radiance": image,
        "im0": image,
        "im1": image,
        "rig": tl.Rig.stereo(camera, 0.1),
    }
    for block in python_blocks("camera.md"):
        exec(block, names)
        names |= {"camera": camera, "lens": tl.ThinLens(0.01, focus_distance=2.0)}
    assert names["photo"].image.shape == names["blurred"].shape == (48, 64, 3)
    assert names["left"].image.shape == (48, 64)


@pytest.mark.slow
def test_the_examples_on_light_fields_run():
    names = {}
    for block in python_blocks("light_fields.md"):
        exec(block, names)
    assert (
        names["far"].shape
        == names["small"].shape
        == names["sharp"].shape
        == (72, 96, 3)
    )
    assert names["truth"].disparity.shape == names["index"].shape == (72, 96)


def test_every_public_name_is_in_the_reference():
    names = REFERENCE.names_page()
    pages = "".join(REFERENCE.room_page(room) for room in REFERENCE.rooms())
    for name in set(tl.__all__) - set(REFERENCE.rooms()):
        assert f"`tl.{name} <twinlens.{name}>`" in names
        assert len(re.findall(rf":: twinlens\.{name}\n", pages)) == 1, name
    assert ":: twinlens.scoring.run_benchmark\n" in pages
    assert "exception:: twinlens.errors.InputError\n" in pages
    assert "check_number" not in pages
