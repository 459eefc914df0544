"""Placeholders in Dr.Jit's registry, with which random scenes share kernels.

Dr.Jit numbers the objects of each class (materials, shapes, lights) in a registry. A kernel contains the methods of all
registered objects of a class and a table with one row for each id up to the largest one in use; the smallest id in use
determines the order of the kernel's variables. So kernels of two scenes differ if one has more objects, or other types
of them. Placeholders of every type that random scenes use, with ids below theirs, and one of each kind above them make
kernels equal. No scene refers to a placeholder, so no ray reaches one, and images do not change.
"""

from typing import Any

import numpy as np

from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import mitsuba_mesh
from twinlens.scenes import Mesh

# Ids for a scene's objects; a larger scene has kernels of its own.
_BODIES = 256
_LIGHTS = 16
# Kernels depend on the number of levels of an environment map, which follows from its height.
_SKY_HEIGHTS = (4, 128, 256)
# (faces, whether it is a light): kernels depend on the logarithm of the number of faces of a light.
_MESHES = ((2, False), (2, True), (80, True))

_placeholders: list[Any] = []


def share_kernels() -> None:
    """Let the scenes of all families share kernels, for the rest of the process. Call it before the first scene.

    The first kernel takes twice as long to compile, and most later scenes compile none.
    """
    if not _placeholders:
        _placeholders.extend(_make_placeholders())


def _make_placeholders() -> list[Any]:
    """The placeholders, in the order in which they take ids."""
    mi = mitsuba()
    materials = _materials()
    bsdfs = [mi.load_dict(material) for material in materials]
    parts = {
        f"body{i}": _square(bsdfs[0], faces, emits)
        for i, (faces, emits) in enumerate(_MESHES)
    }
    skies = [
        mi.Bitmap(np.ones((height, 2 * height, 3), dtype=np.float32))
        for height in _SKY_HEIGHTS
    ]
    # Each sky is in a scene of its own, which sets the bounds that a sky needs.
    scenes = []
    for sky in skies:
        plugin = {"type": "envmap", "bitmap": sky}
        scenes.append(mi.load_dict({"type": "scene", **parts, "sky": plugin}))
    # All but the last of these are freed, and with them ids for the objects of scenes.
    fillers = [mi.load_dict(materials[0]) for _ in range(_BODIES)]
    lights = [_square(bsdfs[0], 2, emits=True) for _ in range(_LIGHTS)]
    bodies = [_square(bsdfs[0], 2, emits=False) for _ in range(_BODIES)]
    return [*bsdfs, *scenes, fillers[-1], lights[-1], bodies[-1]]


def _materials() -> list[dict[str, Any]]:
    """A material of each type that random scenes use, with textures of each kind."""
    repeated = _texture("repeat")
    lobes = ("roughness", "metallic", "sheen", "clearcoat", "clearcoat_gloss")
    principled = {"type": "principled", **dict.fromkeys(lobes, 0.5)}
    return [
        {"type": "diffuse", "reflectance": repeated},
        {**principled, "base_color": _texture("repeat")},
        {**principled, "base_color": _texture("clamp")},
        {**principled, "base_color": _texture("mirror")},
        {**principled, "base_color": _texture("repeat", "nearest")},
        {"type": "conductor", "material": "Ag", "specular_reflectance": repeated},
        {"type": "dielectric", "int_ior": 1.5},
    ]


def _texture(wrap: str, filter_type: str = "bilinear") -> dict[str, Any]:
    grey = np.full((2, 2, 3), 0.5, dtype=np.float32)
    return {
        "type": "bitmap",
        "bitmap": mitsuba().Bitmap(grey),
        "raw": True,
        "wrap_mode": wrap,
        "filter_type": filter_type,
    }


def _square(bsdf: Any, faces: int, emits: bool) -> Any:
    """A mesh with normals and texture coordinates."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    triangles = np.resize([[0, 1, 2], [0, 2, 3]], (faces, 3))
    square = Mesh(corners, triangles, np.tile([0, 0, 1], (4, 1)), corners[:, :2])
    light = None
    if emits:
        white = {"type": "rgb", "value": 1.0}
        light = mitsuba().load_dict({"type": "area", "radiance": white})
    return mitsuba_mesh("", square, np.eye(4), bsdf, light)
