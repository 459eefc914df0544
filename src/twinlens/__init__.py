"""Physically based synthetic stereo: real optics, exact ground truth, and a benchmark for stereo matchers.

The public names, loaded when they are first used: importing twinlens imports neither mitsuba nor numba.
"""

import importlib
from typing import Any

_HOMES = {
    "Annulus": "camera",
    "BareAperture": "camera",
    "BrownConrady": "camera",
    "Camera": "camera",
    "Correspondence": "truth",
    "Dataset": "dataset",
    "Disk": "camera",
    "Exposure": "sensor",
    "KannalaBrandt": "camera",
    "MaskAperture": "camera",
    "Misalignment": "camera",
    "Mismatch": "sensor",
    "Pinhole": "camera",
    "Polygon": "camera",
    "Rig": "camera",
    "Scene": "scenes",
    "Sensor": "sensor",
    "ThinLens": "camera",
    "Truth": "truth",
    "TwinlensError": "errors",
    "auto_exposure": "sensor",
    "birchfield_tomasi": "matching",
    "bundled_scenes": "scenes",
    "census": "matching",
    "correspondence": "rendering",
    "diffract": "diffraction",
    "essential_matrix": "epipolar",
    "evaluate": "scoring",
    "film_image": "camera",
    "fundamental_matrix": "epipolar",
    "ground_truth": "rendering",
    "jaccard": "matching",
    "load_scene": "scenes",
    "match": "matching",
    "ncc": "matching",
    "rank": "matching",
    "rectify": "rectification",
    "render": "rendering",
    "render_lens_grid": "rendering",
    "sad": "matching",
    "ssd": "matching",
    "study": "studies",
    "triangulate": "triangulation",
    "undistort_maps": "camera",
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
