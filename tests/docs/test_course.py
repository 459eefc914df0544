"""The scripts of docs/course have numbers, a title, a formula and a figure, and use public names only."""

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from latex2mathml.converter import convert

import twinlens as tl

COURSE = Path(__file__).parents[2] / "docs" / "course"
SCRIPTS = sorted(COURSE.glob("*.py"))
ALLOWED = {"matplotlib", "numpy", "twinlens", *sys.stdlib_module_names}
pytestmark = pytest.mark.skipif(
    not COURSE.is_dir(), reason="docs/ is not next to tests/"
)
each_script = pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)


@each_script
def test_a_script_uses_public_names_only(script):
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.Import):
            assert {name.name.split(".")[0] for name in node.names} <= ALLOWED
            assert not [
                name for name in node.names if name.name.startswith("twinlens.")
            ]
        elif isinstance(node, ast.ImportFrom):
            package, _, rest = node.module.partition(".")
            assert package in ALLOWED
            if package == "twinlens":
                assert rest.split(".")[0] in tl.__all__
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names)
            assert not [name for name in node.names if name.name.startswith("_")]
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "tl"
        ):
            assert node.attr in tl.__all__


def test_the_first_pages_name_the_course_and_the_number_of_its_lessons():
    lessons = f"{len(SCRIPTS)} (?:short )?lessons"
    for page in (COURSE.parents[1] / "README.md", COURSE.parent / "index.md"):
        text = " ".join(page.read_text().split())
        assert re.search(rf"course[^.]* {lessons}", text), page.name


@each_script
def test_the_formulas_of_a_script_are_typeset(script):
    """They become MathML without an error and without a command that was not understood."""
    text = ast.get_docstring(ast.parse(script.read_text()))
    blocks = re.findall(r"^\.\. math::\n\n((?: {4}.*\n|\n)+)", text, re.MULTILINE)
    assert blocks
    for formula in "\n\n".join(blocks).split("\n\n"):
        if not formula.strip():
            continue
        mathml = ElementTree.fromstring(convert(formula, display="block"))
        tags = {element.tag.rpartition("}")[2] for element in mathml.iter()}
        assert "merror" not in tags
        assert "\\" not in "".join(mathml.itertext())
        assert tags & {"mfrac", "msub", "msqrt", "mtext", "mo"}


@pytest.mark.slow
@each_script
def test_a_script_makes_one_figure(script):
    text = script.read_text()
    code = text.replace(
        "plt.show()\n", "plt.gcf().canvas.draw()\nassert plt.get_fignums() == [1]\n"
    )
    env = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        check=True,
        env=env,
        cwd=script.parent,
    )
