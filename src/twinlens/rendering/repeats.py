"""Repeats of a picture go into the mesh's own (u, v), so that scenes share kernels.

Mitsuba bakes a texture's `to_uv` into the program that it compiles: a scene with ten differently scaled pictures gets
ten copies of each material's code, and a kernel that no other scene can use. A mesh says the same with its texture
coordinates, which are data.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from twinlens.geometry import Float
from twinlens.scenes import Bitmap, Mesh, Plugin, Scene


def without_repeats(scene: Scene) -> tuple[Mapping[str, Plugin], Mapping[str, Float]]:
    """The materials, and for some of them the factors (2,) that the (u, v) of the meshes that wear them must have.

    A material is changed where only meshes with (u, v) wear it and its one or more pictures are all scaled alike.
    """
    materials, factors = dict(scene.materials), {}
    for name, plugin in scene.materials.items():
        scale = _common_scale(plugin)
        worn_by = [thing.shape for thing in scene.objects if thing.material == name]
        if scale is not None and all(isinstance(shape, Mesh) and shape.uv is not None for shape in worn_by):
            materials[name] = _unscaled(plugin)
            factors[name] = scale
    return materials, factors


def _common_scale(plugin: Plugin) -> Float | None:
    """The factors that all pictures of the material have; None without any, or where a scale is not all there is."""
    if any(_is_relief(part) for part in _plugins(plugin)) or any("to_uv" in part for part in _plugins(plugin)):
        return None
    scales = [picture.to_uv for picture in _pictures(plugin)]
    if not scales or any(not np.array_equal(scale, scales[0]) for scale in scales):
        return None
    factors: Float = np.diag(scales[0])[:2].copy()
    only_scale = np.array_equal(scales[0], np.diag([*factors, 1.0, 1.0]))
    return factors if only_scale and not np.array_equal(factors, [1.0, 1.0]) else None


def _is_relief(plugin: Plugin) -> bool:
    """Bumps and normal maps measure slopes along (u, v): another scale would be another relief."""
    return plugin.get("type") in ("bumpmap", "normalmap")


def _plugins(plugin: Plugin) -> Iterator[Plugin]:
    yield plugin
    for value in plugin.values():
        if isinstance(value, Mapping):
            yield from _plugins(value)


def _pictures(plugin: Plugin) -> Iterator[Bitmap]:
    for part in _plugins(plugin):
        yield from (value for value in part.values() if isinstance(value, Bitmap))


def _unscaled(value: Any) -> Any:
    if isinstance(value, Bitmap):
        return replace(value, to_uv=np.eye(4))
    if isinstance(value, Mapping):
        return {key: _unscaled(part) for key, part in value.items()}
    return value
