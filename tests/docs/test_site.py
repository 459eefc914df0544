"""The documentation site lists every page, links lead somewhere, and docstrings become valid reStructuredText."""

import doctest
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike

import twinlens as tl
from twinlens import Rig

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


@pytest.mark.slow
@pytest.mark.parametrize("page", ["index.md", "families.md"])
def test_the_first_example_of_a_page_renders(page):
    code = (
        python_blocks(page)[0].replace("640, 480", "64, 48")
        + "\nassert left.shape == right.shape == (48, 64, 3)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_every_public_name_is_in_the_reference():
    names = REFERENCE.names_page()
    pages = "".join(REFERENCE.room_page(room) for room in REFERENCE.rooms())
    for name in set(tl.__all__) - set(REFERENCE.rooms()):
        assert f"`tl.{name} <twinlens.{name}>`" in names
        assert len(re.findall(rf":: twinlens\.{name}\n", pages)) == 1, name
    assert ":: twinlens.scoring.run_benchmark\n" in pages
    assert "exception:: twinlens.errors.InputError\n" in pages
    assert "check_number" not in pages


def example(
    x: ArrayLike,
    *rigs: "Rig | None",
    how: Literal["Rig"] = "Rig",
    n: Annotated[int, "n"] = 1,
) -> list[Rig]:
    """A function with annotations."""


def test_signatures_are_those_of_the_source():
    def signature(obj, what="function"):
        return REFERENCE.written_signature(None, what, "", obj, None, None, None)

    assert signature(example) == (
        "(x: ArrayLike, *rigs: twinlens.Rig | None, how: Literal['Rig']='Rig', n: int=1)",
        "list[twinlens.Rig]",
    )
    assert signature(tl.Dataset.select, "method") == (
        "(*names: str)",
        "Mapped[dict[str, Any]]",
    )
    assert signature(tl.ThinLens)[0].startswith(
        "(aperture_diameter: float, focus_distance: float"
    )
    assert ", *, " in signature(tl.StereoMatcher)[0]
    assert "Annotated" not in signature(tl.StereoMatcher)[0]
    assert signature(np.add) is None


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["a * b of |x| and `name`, see docs/rigs.md"],
         [r"a \* b of \|x\| and :py:obj:`name`, see :doc:`docs/rigs.md </docs/rigs>`"]),
        (["`c = A fx`s and ``two``"], [r"``c = A fx``\ s and :py:obj:`two`"]),
        (["depth : metres,", "    along z.", "ids : >= 0"], ["- **depth**: metres,", "  along z.", "- **ids**: >= 0"]),
        (["Law:", "", "    z = f b / d", "      * 2"], ["Law:", "", "::", "", "    z = f b / d", "      * 2"]),
        (["Law::", "", "    a_b = 1", "", "Text."], ["Law::", "", "    a_b = 1", "", "Text."]),
        (["- one", "  and more", "", ">>> 2**3", "8"], ["- one", "  and more", "", ">>> 2**3", "8"]),
        (["Sum.", "", "Returns", "-------", "float", "", "Raises E."],
         ["Sum.", "", "Returns", "-------", "float", "", "Notes", "-----", "Raises E."]),
    ],
)  # fmt: skip
def test_docstrings_become_restructured_text(lines, expected):
    REFERENCE.rewrite_docstring(None, "function", "", None, None, lines)
    assert lines == [*expected, ""]


def test_the_tables_of_a_schema(tmp_path):
    path = tmp_path / "toy.json"
    lens = {
        "properties": {
            "kind": {"const": "a"},
            "f": {"type": "number", "exclusiveMinimum": 0},
        },
        "required": ["f"],
    }
    lenses = {
        "type": "array",
        "items": {"$ref": "#/$defs/Lens"},
        "default": [],
        "description": "a | b",
    }
    path.write_text(
        json.dumps({"properties": {"lenses": lenses}, "$defs": {"Lens": lens}})
    )
    page = REFERENCE.schema_page(path)
    assert r"| `lenses` | array of [Lens](#lens) | `[]` | a \| b |" in page
    assert "## Lens\n" in page
    assert '| `kind` | `"a"` |  |  |' in page
    assert "| `f` | number > 0 | required |  |" in page
