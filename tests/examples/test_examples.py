"""The examples, with small images."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="the examples are not installed"
)


def example(name):
    spec = importlib.util.spec_from_file_location(
        f"example_{name}", FOLDER / f"{name}.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_an_object_is_captured_from_all_sides():
    capture = example("capture")
    made = capture.capture(count=12, width=128, spp=8, cell=0.015)
    assert made.found.accuracy_mean_mm < 8
    assert made.found.completeness_mean_mm < 8
    assert next(s for s in made.found.shares if s.tolerance_mm == 20).f_score > 0.85
    size = made.surface.vertices.max(axis=0) - made.surface.vertices.min(axis=0)
    assert (np.abs(size[:2] - capture.SIZE * 1.1) < 0.15).all()
    assert capture.picture(made).size == (384, 256)
