"""The plan of the house, held by reading imports: they run one way, and only one room knows the renderer."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import twinlens

PACKAGE = Path(twinlens.__file__).parent
MAY_IMPORT = {
    "errors": set(),
    "geometry": {"errors"},
    "optics": {"errors"},
    "camera": {"errors", "geometry", "optics"},
    "truth": {"errors", "geometry", "optics", "camera"},
    "diffraction": {"errors", "geometry", "optics", "camera"},
    "epipolar": {"errors", "geometry", "camera"},
    "epipolar_picture": {"errors", "geometry", "camera", "epipolar"},
    "hartley_sturm": {"errors", "geometry"},
    "triangulation": {"errors", "geometry", "camera", "epipolar", "hartley_sturm"},
    "rectification": {"errors", "geometry", "camera", "epipolar"},
    "poses": {"errors", "geometry", "camera", "dataset"},
    "scenes": {"errors", "geometry", "optics", "camera"},
    "rendering": {"errors", "geometry", "optics", "camera", "truth", "scenes"},
    "sensor": {"errors", "geometry", "optics", "camera", "diffraction"},
    "dataset": {"errors", "geometry", "optics", "camera", "truth"},
    "matching": {"errors"},
    "scoring": {"errors", "geometry", "optics", "camera", "truth", "dataset", "matching"},
    "reconstruction": {
        "errors",
        "geometry",
        "optics",
        "camera",
        "truth",
        "epipolar",
        "triangulation",
        "rectification",
        "dataset",
    },
    "factory": {
        "errors",
        "geometry",
        "optics",
        "camera",
        "truth",
        "diffraction",
        "scenes",
        "rendering",
        "sensor",
        "epipolar",
        "rectification",
        "dataset",
    },
}
MAY_IMPORT["studies"] = {*MAY_IMPORT["factory"], "factory", "matching", "scoring"}
MAY_IMPORT["report"] = {"errors", "dataset", "matching", "scoring", "studies"}
MAY_IMPORT["cli"] = {*MAY_IMPORT} | {"cli"}
RENDERERS = {"mitsuba", "drjit"}


def modules():
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent != PACKAGE or path.stem not in ("__init__", "__main__")
    ]


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path):
    """Every dotted name that a module imports, wherever in it the import stands."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            yield node.module or ""
            if node.module == "twinlens":
                yield from (f"twinlens.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_one_way(path):
    room = room_of(path)
    others = {name.split(".")[1] for name in imported(path) if name.startswith("twinlens.")} - {room}
    assert others <= MAY_IMPORT[room], f"{room} may not import {others - MAY_IMPORT[room]}"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_only_rendering_knows_the_renderer(path):
    used = {name.split(".")[0] for name in imported(path)} & RENDERERS
    assert not used or room_of(path) == "rendering"


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_modules_are_short_and_say_what_they_are_for(path):
    assert len(path.read_text().splitlines()) <= 300
    assert ast.get_docstring(ast.parse(path.read_text())), f"{path} has no first lines"


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_importing_twinlens_is_light():
    heavy = "('mitsuba', 'drjit', 'numba', 'numpy', 'trimesh', 'skimage')"
    assert run(f"import sys, twinlens; print([m for m in {heavy} if m in sys.modules])") == "[]"


def test_matching_dataset_and_scoring_live_without_mitsuba():
    rooms = ("matching", "dataset", "scoring", "report", "sensor", "scenes")
    imports = "; ".join(f"import twinlens.{room}" for room in rooms)
    assert (
        run(f"import sys; sys.modules['mitsuba'] = sys.modules['drjit'] = None; {imports}; print('alive')") == "alive"
    )
