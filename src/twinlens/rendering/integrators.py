"""When our own path integrator takes the place of Mitsuba's: for the light of projectors, and for denoised images.

Images that are denoised get most of the light between surfaces from a cache (`rendering.irradiance_cache`). It is made
for each request, from what the calibrated cameras of the rig see, and they share it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from twinlens.camera import Pinhole, Rig
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene, sky_hidden
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Scene
from twinlens.seeds import derived_seed


def own_paths(scene: Scene, lamps: Sequence[Any], gives_guides: bool = False) -> Any:
    """`rendering.paths.Paths` in the place of the scene's integrator. None where it does not do the same."""
    plugin = scene.integrator
    if scene.xml is not None or plugin["type"] != "path" or plugin.get("hide_emitters"):
        return None
    from twinlens.rendering.paths import Paths  # sets up the backend

    options = {key: plugin[key] for key in ("max_depth", "rr_depth") if key in plugin}
    return Paths(lamps, **options, gives_guides=gives_guides)


def for_denoising(
    built: BuiltScene, scene: Scene, rig: Rig, band: str, seed: int
) -> BuiltScene:
    """`built` with an integrator that gives guides and has an irradiance cache, `built` itself where it is not ours.

    The cache is made from what the cameras of `rig` in `band` see; without a third surface, paths do not need one.
    """
    paths = own_paths(
        scene,
        () if built.projected is None else built.projected.lamps,
        gives_guides=True,
    )
    if paths is None:
        return built
    depth = scene.integrator.get("max_depth", -1)
    if not 0 <= depth < 3:
        paths.cache = _irradiance_cache(built, rig, band, seed, paths.lamps, depth)
    projected = None if built.projected is None else paths
    return replace(built, integrator=sky_hidden(scene, paths), projected=projected)


def _irradiance_cache(
    built: BuiltScene, rig: Rig, band: str, seed: int, lamps: Sequence[Any], depth: int
) -> Any:
    from twinlens.rendering.irradiance_cache import (
        IrradianceCache,
    )  # sets up the backend

    rays = _camera_rays(rig.nominal, band, derived_seed(seed, 0))
    bounces = depth - 3 if depth >= 0 else -1
    return IrradianceCache(built.mi_scene, rays, derived_seed(seed, 1), lamps, bounces)


def _camera_rays(rig: Rig, band: str, seed: int) -> Any:
    """Rays from the cameras in `band` through random points of their images: `PATHS`, but at most one per pixel."""
    import drjit as dr

    from twinlens.rendering.irradiance_cache import PATHS

    mi = mitsuba()
    views = [
        view
        for view in zip(rig.cameras, rig.world_from_cams, strict=True)
        if band in view[0].bands
    ]
    pixels = sum(camera.width * camera.height for camera, _ in views)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, math.ceil(min(PATHS, pixels) / len(views)))
    rays = []
    for camera, pose in views:
        sensor = make_sensor(camera, pose, Pinhole(), 1, "independent")
        ray, _ = sensor.sample_ray(0.0, 0.5, sampler.next_2d(), sampler.next_2d())
        rays.append((ray.o, ray.d))
    origin, direction = (
        [dr.concat([ray[i] for ray in of]) for i in range(3)]
        for of in zip(*rays, strict=True)
    )
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
