"""Imports between rooms run one way, no files import each other, and only `rendering` imports the renderer."""

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

import twinlens

PACKAGE = Path(twinlens.__file__).parent
BASE = {"errors", "machine", "processes", "schema", "seeds", "settings"}
UNDER_SCENES = {*BASE, "geometry", "optics", "camera"}
MAY_IMPORT = {
    "errors": set(),
    "machine": set(),
    "processes": {"errors"},
    "schema": {"errors", "settings"},
    "seeds": set(),
    "settings": {"errors"},
    "geometry": {*BASE},
    "optics": {*BASE, "geometry"},
    "camera": {*BASE, "geometry", "optics"},
    "scenes": UNDER_SCENES,
    "families": {*UNDER_SCENES, "scenes"},
    "rendering": {*UNDER_SCENES, "scenes"},
    "sensor": UNDER_SCENES,
    "dataset": UNDER_SCENES,
    "matching": {
        *BASE,
        "dataset",
    },  # external programs read PNG files, which its codecs write
    "scoring": {*UNDER_SCENES, "sensor", "dataset", "matching"},
    "reconstruction": {*UNDER_SCENES, "dataset"},
    "factory": {*UNDER_SCENES, "scenes", "families", "rendering", "sensor", "dataset"},
}
MAY_IMPORT["studies"] = {*MAY_IMPORT["factory"], "factory", "matching", "scoring"}
MAY_IMPORT["report"] = {*UNDER_SCENES, "dataset", "matching", "scoring", "studies"}
MAY_IMPORT["cli"] = {*MAY_IMPORT} | {"cli"}
RENDERERS = {"mitsuba", "mitsuba_oidn", "drjit"}


def modules():
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent != PACKAGE or path.stem not in ("__init__", "__main__")
    ]


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path):
    """Every dotted name that a module imports, also inside functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            yield node.module or ""
            if node.module == "twinlens":
                yield from (f"twinlens.{alias.name}" for alias in node.names)


@pytest.mark.parametrize(
    "path", modules(), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_imports_run_one_way(path):
    room = room_of(path)
    others = {
        name.split(".")[1] for name in imported(path) if name.startswith("twinlens.")
    } - {room}
    assert others <= MAY_IMPORT[room], (
        f"{room} may not import {others - MAY_IMPORT[room]}"
    )


@pytest.mark.parametrize(
    "path", modules(), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_only_rendering_knows_the_renderer(path):
    used = {name.split(".")[0] for name in imported(path)} & RENDERERS
    assert not used or room_of(path) == "rendering"


def test_no_two_files_import_each_other():
    names = {
        path: ".".join(("twinlens", *path.relative_to(PACKAGE).with_suffix("").parts))
        for path in modules()
    }
    names = {path: name.removesuffix(".__init__") for path, name in names.items()}
    graph = {
        name: set(imported_modules(path, names.values())) - {name}
        for path, name in names.items()
    }
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def imported_modules(path, known):
    """The modules of twinlens that a file imports outside of functions; `from package import module` is that module."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                if inner in known:
                    yield inner
                elif node.module in known:
                    yield node.module


@pytest.mark.parametrize(
    "path", modules(), ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_modules_say_what_they_are_for(path):
    assert ast.get_docstring(ast.parse(path.read_text())), f"{path} has no first lines"


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
