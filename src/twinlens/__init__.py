"""Physically based synthetic stereo: real optics, exact ground truth, and a benchmark for stereo matchers.

The public names, loaded when they are first used: importing twinlens imports neither mitsuba nor numba.
"""

import importlib
from typing import Any

_HOMES = {
    "BareAperture": "camera",
    "Camera": "camera",
    "Pinhole": "camera",
    "Rig": "camera",
    "ThinLens": "camera",
    "Dataset": "dataset",
    "Sensor": "sensor",
    "Scene": "scenes",
    "TwinlensError": "errors",
    "bundled_scenes": "scenes",
    "evaluate": "scoring",
    "ground_truth": "rendering",
    "jaccard": "matching",
    "load_scene": "scenes",
    "match": "matching",
    "ncc": "matching",
    "render": "rendering",
    "render_lens_grid": "rendering",
    "sad": "matching",
    "ssd": "matching",
    "zncc": "matching",
    "zsad": "matching",
    "zssd": "matching",
}

__all__ = [*_HOMES]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'twinlens' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"twinlens.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
