"""A built scene with the light of a rig's projectors: Mitsuba's `projector`, with the intrinsics of `Projector`.

Mitsuba's plugin has a centred frustum with square pixels, and its texture is the irradiance over pi at depth 1. The
frustum is made wide enough for the pattern, and the texture's transform places the pattern in it, inside a border of
dark pixels. With distortion, the pattern is first resampled to a grid without it, `_FINER` times as fine. An aperture
makes it one of many: `rendering.projector_aperture`. Our own integrator adds its light (`rendering.paths`);
in Mitsuba files and with other integrators, it is a light of the scene, which is more noisy.
"""

import math
import sys
import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Projector, Rig
from twinlens.camera.distortion import Distortion
from twinlens.errors import InputError
from twinlens.geometry import Float, image_border, rotate
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.frames import SceneFrame
from twinlens.rendering.integrators import own_paths
from twinlens.rendering.materials import has_pane
from twinlens.rendering.tracing import Rays, intersect

_CHANNELS = 3  # that share the power
_FINER = 4  # samples per projector pixel and axis
_MOST_SAMPLES = 1 << 27
_RAYS_ACROSS = 32  # of each axis, to find glass in front of a projector


class ProjectorWarning(UserWarning):
    """Light of a projector that images lack."""


@dataclass(eq=False)
class _Lit:
    """A scene with projectors: the parameters of each, and what they are set to. `kinds` cannot be changed."""

    kinds: list[Any]
    built: BuiltScene
    lamps: list[Any]
    shown: tuple[Projector, ...] = ()
    poses: list[Any] = field(default_factory=list)


def lit_by_projectors(built: BuiltScene, rig: Rig, band: str) -> BuiltScene:
    """`built`, a scene in a band, with the projectors of `rig` in this band as lights, for images.

    The last scene with projectors is cached in each thread, so that threads which render at the same time do not change
    each other's projectors. Where only patterns, powers and poses of projectors differ, it is not loaded again but
    changed to those of `rig`. Gives a `ProjectorWarning` for smooth glass in front of a projector.
    """
    pairs = zip(rig.projectors, rig.world_from_projectors, strict=True)
    placed = [(projector, pose) for projector, pose in pairs if projector.band == band]
    if not placed:
        return built
    shown = tuple(projector for projector, _ in placed)
    kinds = [
        (lamp.intrinsics, lamp.filter, lamp.aperture_diameter, lamp.focus_distance)
        for lamp in shown
    ]
    of_this_thread = built.cache.setdefault("projectors", threading.local())
    lit: _Lit | None = getattr(of_this_thread, "lit", None)
    if lit is None or lit.kinds != kinds:
        lit = _loaded(built, shown, kinds)
        of_this_thread.lit = lit
    poses = [pose.tolist() for _, pose in placed]
    if lit.poses != poses:
        _warn_of_glass(built, rig, band)
    if lit.shown != shown or lit.poses != poses:
        for lamp, (projector, pose) in zip(lit.lamps, placed, strict=True):
            _set_lamp(lamp, projector, pose, built.frame)
        lit.shown, lit.poses = shown, poses
    return lit.built


def _loaded(
    built: BuiltScene, projectors: Sequence[Projector], kinds: list[Any]
) -> _Lit:
    """The scene with the projectors as lights, whose patterns and poses are not set yet."""
    lamps = [mitsuba().load_dict(_plugin(projector)) for projector in projectors]
    lights = [
        _opened(lamp, projector, built.frame.scale)
        for lamp, projector in zip(lamps, projectors, strict=True)
    ]
    parameters = [mitsuba().traverse(lamp) for lamp in lamps]
    return _Lit(kinds, _with_lights(built, lights), parameters)


def _set_lamp(lamp: Any, projector: Projector, pose: Float, frame: SceneFrame) -> None:
    """Set the pattern and the pose of a loaded projector."""
    # The irradiance at one unit of the frame, which is metres / scale.
    light = np.float32(frame.scale**2) * _texture(projector)[0]
    lamp["irradiance.data"] = light[..., None]
    x_left_y_up = np.diag([-1.0, -1.0, 1.0, 1.0])
    lamp["to_world"] = mitsuba().ScalarTransform4f(frame.rigid(pose) @ x_left_y_up)
    lamp.update()


def _warn_of_glass(built: BuiltScene, rig: Rig, band: str) -> None:
    """Give a `ProjectorWarning` for each material that first meets light of a projector and passes it on unscattered.

    No shadow ray passes it, and no path finds a projector by chance. Those of our own integrator pass cut-outs.
    """
    pass_cut_outs = built.path is not None
    for i, (projector, pose) in enumerate(
        zip(rig.projectors, rig.world_from_projectors, strict=True)
    ):
        if projector.band != band:
            continue
        camera = projector.intrinsics
        v, u = (
            np.linspace(0, side - 1, min(side, _RAYS_ACROSS))
            for side in (camera.height, camera.width)
        )
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        ahead = rotate(pose, camera.unproject(pixels))
        light = Rays.from_point(pose[:3, 3], ahead)
        rows = intersect(built, light, pass_cut_outs).body
        bodies = [built.bodies[row] for row in np.unique(rows[rows >= 0])]
        blocking = {
            body.material_id
            for body in bodies
            if body.shape and _blocks(body.shape.bsdf(), pass_cut_outs)
        }
        for material in sorted(blocking):
            name = built.material_names[material - 1]
            message = (
                f"projectors[{i}]: the material {name!r}, smooth glass or a cut-out, is in front of it and blocks its"
                " light, which is a limit of the renderer (docs/projectors.md, Limits)"
            )
            _warn(message)


def _blocks(bsdf: Any, passes_cut_outs: bool) -> bool:
    """Whether a surface passes light on unscattered that no shadow ray finds."""
    flags = mitsuba().BSDFFlags
    has = int(bsdf.flags()).__and__
    if has(int(flags.DeltaTransmission)):
        return True
    is_opening = bool(has(int(flags.Null)))
    return is_opening and (has_pane(bsdf) or not passes_cut_outs)


def can_denoise(built: BuiltScene, rig: Rig, band: str) -> bool:
    """Whether denoised images keep the patterns of the projectors of `rig` in this band, from `lit_by_projectors`.

    They do where the projectors' light is known apart from the scene's.
    """
    is_lit = any(
        projector.emitted_power and projector.band == band
        for projector in rig.projectors
    )
    return built.projected is not None or not is_lit


def warn_of_noise() -> None:
    """Give a `ProjectorWarning` that images which were to be denoised are not, as `can_denoise` says."""
    _warn(
        "images with the light of projectors are not denoised here, as their patterns would be lost: use a"
        " scene with the integrator 'path', or more samples per pixel"
    )


def _warn(message: str) -> None:
    """Give a `ProjectorWarning` at the line of the caller of twinlens."""
    frame: FrameType | None = sys._getframe(1)
    level = 1
    while frame is not None and frame.f_globals.get("__name__", "").startswith(
        "twinlens."
    ):
        frame = frame.f_back
        level += 1
    warnings.warn(message, ProjectorWarning, stacklevel=level)


def _with_lights(built: BuiltScene, lights: list[Any]) -> BuiltScene:
    """`built` with the light of projectors, which our own integrator adds where possible."""
    paths = own_paths(built, lights)
    if paths is not None:
        return built.with_integrator(paths, projected=paths)
    if built.parts is None:
        raise InputError(
            f"{built.name}: has instances; projectors can light only Mitsuba files without any"
        )
    parts = {f"projector{i:04d}": light for i, light in enumerate(lights)}
    return replace(
        built, mi_scene=mitsuba().load_dict({**built.parts, **parts}, optimize=False)
    )


def _opened(lamp: Any, projector: Projector, scale: float) -> Any:
    """`lamp` with the projector's aperture, in a frame of `scale` units per metre."""
    if not projector.aperture_diameter:
        return lamp
    from twinlens.rendering.projector_aperture import (
        ApertureProjector,
    )  # sets up the backend

    return ApertureProjector(
        lamp,
        projector.aperture_diameter * scale,
        1.0 / (projector.focus_distance * scale),
    )


def _plugin(projector: Projector) -> dict[str, Any]:
    mi = mitsuba()
    texture, (fx, fy, cx, cy) = _texture(projector)
    rows, columns = texture.shape
    # Half-widths of the frustum at depth 1, in the texture's aspect ratio, as Mitsuba derives it from the width.
    reach_x = 1.0 + max(cx + 0.5, columns - 0.5 - cx)
    reach_y = 1.0 + max(cy + 0.5, rows - 0.5 - cy)
    half_x = max(reach_x / fx, reach_y / fy * columns / rows)
    half_y = half_x * rows / columns
    uv = np.array(
        [
            [2 * half_x * fx / columns, 0.0, (cx + 0.5 - half_x * fx) / columns],
            [0.0, 2 * half_y * fy / rows, (cy + 0.5 - half_y * fy) / rows],
            [0.0, 0.0, 1.0],
        ]
    )
    return {
        "type": "projector",
        "fov": 2 * math.degrees(math.atan(half_x)),
        "fov_axis": "x",
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(texture),
            "raw": True,
            "filter_type": projector.filter,
            "wrap_mode": "clamp",
            "to_uv": mi.ScalarTransform3f(uv),
        },
    }


def _texture(
    projector: Projector,
) -> tuple[NDArray[np.float32], tuple[float, float, float, float]]:
    """The irradiance over pi at depth 1, W/m^2, with a border of 0, and its fx, fy, cx, cy."""
    camera = projector.intrinsics
    light = (
        projector.power
        / (_CHANNELS * camera.width * camera.height)
        * camera.fx
        * camera.fy
        / math.pi
    )
    pattern, (fx, fy, cx, cy) = (
        projector.pattern.astype(np.float64),
        (camera.fx, camera.fy, camera.cx, camera.cy),
    )
    if camera.distortion is not None:
        pattern, (fx, fy, cx, cy) = _undistorted(projector, camera.distortion)
    return (light * np.pad(pattern, 1)).astype(np.float32), (fx, fy, cx + 1, cy + 1)


def _undistorted(
    projector: Projector, distortion: Distortion
) -> tuple[Float, tuple[float, float, float, float]]:
    """The flux per pixel without distortion (h, w), relative to power / (W H), and its fx, fy, cx, cy.

    Where the distortion stretches a pixel, its flux covers more directions: the factor is the Jacobian's determinant.
    """
    from scipy.ndimage import map_coordinates

    camera = projector.intrinsics
    border = camera.unproject(image_border(camera.width, camera.height, margin=0.5))[
        :, :2
    ]
    fx, fy = _FINER * camera.fx, _FINER * camera.fy
    low = np.floor(border.min(axis=0) * (fx, fy))
    width, height = (np.ceil(border.max(axis=0) * (fx, fy)) - low + 1).astype(int)
    if width * height > _MOST_SAMPLES:
        raise InputError(
            f"a projector's distortion needs {width} x {height} samples: use fewer pixels, or less of it"
        )
    x, y = (np.arange(width) + low[0]) / fx, (np.arange(height) + low[1]) / fy
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    inside = distortion.valid(xy)
    xy = np.where(inside[..., None], xy, 0.0)
    u, v = np.moveaxis(
        distortion.distort(xy) * (camera.fx, camera.fy) + (camera.cx, camera.cy), -1, 0
    )
    order = 1 if projector.filter == "bilinear" else 0
    light = map_coordinates(
        projector.pattern.astype(np.float64), [v, u], order=order, mode="grid-constant"
    )
    light *= np.abs(np.linalg.det(distortion.jacobian(xy))) * inside
    return light, (fx, fy, -low[0], -low[1])
