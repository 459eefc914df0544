"""Our own path integrator in the place of Mitsuba's `path`, in all images of scene files.

Denoised images get most of the light between surfaces from a cache (`rendering.irradiance_cache`). It is made for each
request, from what the calibrated cameras of the rig see, and they share it.
"""

import math
from collections.abc import Sequence
from typing import Any

from twinlens.camera import Pinhole, Rig
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.cut_outs import cut_outs
from twinlens.rendering.frames import SceneFrame
from twinlens.rendering.sensors import make_sensor
from twinlens.seeds import derived_seed

_LEAST_DEPTH = 3
"""Least `max_depth` for which a cache is made: two surfaces, and a third that lights the second."""


def own_paths(
    built: BuiltScene, lamps: Sequence[Any], gives_guides: bool = False
) -> Any:
    """`rendering.paths.Paths` in the place of the scene's integrator. None where it does not do the same."""
    if built.path is None:
        return None
    from twinlens.rendering.paths import Paths  # sets up the backend

    return Paths(
        lamps,
        **built.path,
        gives_guides=gives_guides,
        openings=cut_outs(built),
        shows_sky=built.sky_visible,
    )


def for_images(built: BuiltScene) -> BuiltScene:
    """`built` with our integrator, unless it has it already; with its own where that does not do the same.

    Both show the sky only if the scene does.
    """
    paths = own_paths(built, ())
    if paths is None:
        return _sky_hidden(built)
    if built.projected is not None:
        return built
    return built.with_integrator(paths)


def for_denoising(built: BuiltScene, rig: Rig, band: str, seed: int) -> BuiltScene:
    """`built` with an integrator that gives guides and has an irradiance cache; as `for_images` where it is not ours.

    The cache is made from what the cameras of `rig` in `band` see; without a third surface, paths do not need one.
    """
    lamps = () if built.projected is None else built.projected.lamps
    if built.path is None:
        return for_images(built)
    paths = own_paths(built, lamps, gives_guides=True)
    depth = built.path.get("max_depth", -1)
    if not 0 <= depth < _LEAST_DEPTH:
        paths.cache = _irradiance_cache(built, rig, band, seed, lamps, depth)
    projected = None if built.projected is None else paths
    return built.with_integrator(paths, projected=projected)


def _sky_hidden(built: BuiltScene) -> BuiltScene:
    if built.sky_visible:
        return built
    from twinlens.rendering.hidden_sky import HiddenSky  # sets up the backend

    return built.with_integrator(HiddenSky(built.integrator, cut_outs(built)))


def _irradiance_cache(
    built: BuiltScene, rig: Rig, band: str, seed: int, lamps: Sequence[Any], depth: int
) -> Any:
    from twinlens.rendering.irradiance_cache import (
        IrradianceCache,
    )  # sets up the backend

    rays = _camera_rays(rig.nominal, built.frame, band, derived_seed(seed, 0))
    bounces = depth - _LEAST_DEPTH if depth >= 0 else -1
    return IrradianceCache(
        built.mi_scene, rays, derived_seed(seed, 1), lamps, bounces, cut_outs(built)
    )


def _camera_rays(rig: Rig, frame: SceneFrame, band: str, seed: int) -> Any:
    """Rays in `frame` from the cameras in `band`, through random points: `PATHS`, but at most one per pixel."""
    import drjit as dr

    from twinlens.rendering.irradiance_cache import PATHS

    mi = mitsuba()
    cameras = [
        (camera, pose)
        for camera, pose in zip(rig.cameras, rig.world_from_cams, strict=True)
        if band in camera.bands
    ]
    pixels = sum(camera.width * camera.height for camera, _ in cameras)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, math.ceil(min(PATHS, pixels) / len(cameras)))
    origins, directions = [], []
    for camera, pose in cameras:
        sensor = make_sensor(camera, frame.affine(pose), Pinhole(), 1, "independent")
        ray, _ = sensor.sample_ray(0.0, 0.5, sampler.next_2d(), sampler.next_2d())
        origins.append(ray.o)
        directions.append(ray.d)
    origin = [dr.concat(list(values)) for values in zip(*origins, strict=True)]
    direction = [dr.concat(list(values)) for values in zip(*directions, strict=True)]
    return mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
