"""Imports between rooms run one way, no files import each other, and only `rendering` imports the renderer."""

import ast
import functools
import graphlib
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import twinlens

PACKAGE = Path(twinlens.__file__).parent
BASE = {"errors", "machine", "pictures", "processes", "schema", "seeds", "settings"}
UNDER_SCENES = {*BASE, "geometry", "optics", "camera"}
MAY_IMPORT = {
    "errors": set(),
    "machine": set(),
    "pictures": set(),
    "processes": {"errors"},
    "schema": {"errors", "settings"},
    "seeds": set(),
    "settings": {"errors"},
    "geometry": {*BASE},
    "optics": {*BASE, "geometry"},
    "camera": {*BASE, "geometry", "optics"},
    "calibrations": {*BASE, "geometry", "camera"},
    "scenes": {*UNDER_SCENES, "calibrations"},
    "families": {*UNDER_SCENES, "scenes"},
    "rendering": {*UNDER_SCENES, "scenes"},
    "sensor": UNDER_SCENES,
    "dataset": {*UNDER_SCENES, "calibrations"},
    "matching": {
        *BASE,
        "dataset",
    },  # external programs read PNG files, which its codecs write
    "scoring": {*UNDER_SCENES, "sensor", "dataset", "matching"},
    "reconstruction": {*UNDER_SCENES, "sensor", "dataset"},
    "factory": {
        *UNDER_SCENES,
        *("calibrations", "scenes", "families", "rendering", "sensor", "dataset"),
    },
}
MAY_IMPORT["studies"] = {*MAY_IMPORT["factory"], "factory", "matching", "scoring"}
MAY_IMPORT["report"] = {*UNDER_SCENES, "dataset", "matching", "scoring", "studies"}
MAY_IMPORT["cli"] = {*MAY_IMPORT} | {"cli"}
RENDERERS = {"mitsuba", "mitsuba_oidn", "drjit"}


@functools.cache
def modules():
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent != PACKAGE or path.stem not in ("__init__", "__main__")
    ]


@functools.cache
def parsed(path):
    return ast.parse(path.read_text())


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path):
    """Every dotted name that a module imports, also inside functions."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            yield node.module or ""
            if node.module == "twinlens":
                yield from (f"twinlens.{alias.name}" for alias in node.names)


def test_imports_run_one_way():
    wrong = {}
    for path in modules():
        room = room_of(path)
        others = {
            name.split(".")[1]
            for name in imported(path)
            if name.startswith("twinlens.")
        }
        forbidden = others - {room} - MAY_IMPORT[room]
        if forbidden:
            wrong[str(path.relative_to(PACKAGE))] = forbidden
    assert not wrong


def test_only_rendering_knows_the_renderer():
    wrong = [
        str(path.relative_to(PACKAGE))
        for path in modules()
        if room_of(path) != "rendering"
        and RENDERERS.intersection(name.split(".")[0] for name in imported(path))
    ]
    assert not wrong


def test_no_files_import_each_other():
    """Nor over others, also inside functions and for annotations."""
    graph = {}
    for path in modules():
        graph[module_name(path)] = set(imported_modules(path)) - {module_name(path)}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def module_name(path):
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(("twinlens", *parts)).removesuffix(".__init__")


def imported_modules(path):
    """The modules of twinlens that a file imports; `from package import module` is that module."""
    ours = {module_name(path) for path in modules()}
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in ours)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in ours else node.module


def test_modules_say_what_they_are_for():
    """In a first sentence of some words that ends in a full stop or a colon and says more than the file's name."""
    wrong = {}
    for path in modules():
        first = (ast.get_docstring(parsed(path)) or "").split("\n\n")[0]
        words = set(re.findall(r"[a-z]{3,}", first.lower())) - set(path.stem.split("_"))
        if len(words) < 3 or not first.rstrip().endswith((".", ":")):
            wrong[str(path.relative_to(PACKAGE))] = first
    assert not wrong


def run(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_importing_twinlens_is_light():
    heavy = "('mitsuba', 'drjit', 'numba', 'numpy', 'trimesh', 'skimage')"
    assert (
        run(f"import sys, twinlens; print([m for m in {heavy} if m in sys.modules])")
        == "[]"
    )


def test_matching_dataset_and_scoring_live_without_mitsuba():
    rooms = ("matching", "dataset", "scoring", "report", "sensor", "scenes")
    imports = "; ".join(f"import twinlens.{room}" for room in rooms)
    assert (
        run(
            f"import sys; sys.modules['mitsuba'] = sys.modules['drjit'] = None; {imports}; print('alive')"
        )
        == "alive"
    )


SCRIPTS = sorted(
    script
    for folder in ("benchmarks", "docs")
    for script in (PACKAGE.parents[1] / folder).rglob("*.py")
)


def names_from_twinlens(script):
    """(module, name) of what a script imports from the package."""
    for node in ast.walk(ast.parse(script.read_text())):
        module = getattr(node, "module", None) or ""
        if isinstance(node, ast.ImportFrom) and module.startswith("twinlens"):
            yield from ((module, alias.name) for alias in node.names)


def test_scripts_import_names_that_exist():
    """Benchmarks run for minutes and longer, so that no other test runs all of them."""
    imported = {pair for script in SCRIPTS for pair in names_from_twinlens(script)}
    assert len(imported) > 100
    for module_name, name in sorted(imported):
        module = importlib.import_module(module_name)
        if not hasattr(module, name):
            importlib.import_module(f"{module_name}.{name}")
