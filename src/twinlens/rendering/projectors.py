"""A built scene with the light of a rig's projectors: Mitsuba's `projector`, with the intrinsics of `Projector`.

Mitsuba's plugin has a centred frustum with square pixels, and its texture is the irradiance over pi at depth 1. The
frustum is made wide enough for the pattern, and the texture's transform places the pattern in it, inside a border of
dark pixels. With distortion, the pattern is first resampled to a grid without it, `_FINER` times as fine.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from twinlens.camera import Projector, Rig
from twinlens.camera.distortion import Distortion
from twinlens.errors import InputError
from twinlens.geometry import Float, image_border
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene, build
from twinlens.scenes import Scene

_BANDS = 3  # that share the power
_FINER = 4  # samples per projector pixel and axis
_MOST_SAMPLES = 1 << 27


def build_lit(scene: Scene, rig: Rig) -> BuiltScene:
    """`build(scene)` with the projectors of `rig` as lights, for images. The last projectors of a scene are cached."""
    built, poses = build(scene), rig.world_from_projectors
    if not rig.projectors:
        return built
    if built.parts is None:
        raise InputError(f"{scene.xml}: has instances; projectors can light only Mitsuba files without any")
    key = rig.projectors, [pose.tolist() for pose in poses]
    if built.cache.get("projectors", (None,))[0] != key:
        lights = {f"projector{i:04d}": _plugin(*each) for i, each in enumerate(zip(rig.projectors, poses, strict=True))}
        built.cache["projectors"] = key, mitsuba().load_dict({**built.parts, **lights}, optimize=False)
    return replace(built, mi_scene=built.cache["projectors"][1])


def _plugin(projector: Projector, world_from_projector: Float) -> dict[str, Any]:
    mi, camera = mitsuba(), projector.intrinsics
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    light = projector.power / (_BANDS * camera.width * camera.height) * fx * fy / math.pi
    pattern = projector.pattern.astype(np.float64)
    if camera.distortion is not None:
        pattern, (fx, fy, cx, cy) = _undistorted(projector, camera.distortion)
    texture = np.pad(pattern, 1)
    rows, columns = texture.shape
    # Half-widths of the frustum at depth 1, in the texture's aspect ratio, as Mitsuba derives it from the width.
    reach_x = 1.0 + max(cx + 1.5, columns - 0.5 - cx)
    reach_y = 1.0 + max(cy + 1.5, rows - 0.5 - cy)
    half_x = max(reach_x / fx, reach_y / fy * columns / rows)
    half_y = half_x * rows / columns
    uv = np.array(
        [
            [2 * half_x * fx / columns, 0.0, (cx + 1.5 - half_x * fx) / columns],
            [0.0, 2 * half_y * fy / rows, (cy + 1.5 - half_y * fy) / rows],
            [0.0, 0.0, 1.0],
        ]
    )
    return {
        "type": "projector",
        "fov": 2 * math.degrees(math.atan(half_x)),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(world_from_projector @ np.diag([-1.0, -1.0, 1.0, 1.0])),  # x left, y up
        "irradiance": {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(light * texture[..., None], dtype=np.float32)),
            "raw": True,
            "filter_type": projector.filter,
            "wrap_mode": "clamp",
            "to_uv": mi.ScalarTransform3f(uv),
        },
    }


def _undistorted(projector: Projector, distortion: Distortion) -> tuple[Float, tuple[float, float, float, float]]:
    """The flux per pixel without distortion (h, w), relative to power / (W H), and its fx, fy, cx, cy.

    Where the distortion stretches a pixel, its flux covers more directions: the factor is the Jacobian's determinant.
    """
    from scipy.ndimage import map_coordinates

    camera = projector.intrinsics
    border = camera.unproject(image_border(camera.width, camera.height, margin=0.5))[:, :2]
    fx, fy = _FINER * camera.fx, _FINER * camera.fy
    low = np.floor(border.min(axis=0) * (fx, fy))
    width, height = (np.ceil(border.max(axis=0) * (fx, fy)) - low + 1).astype(int)
    if width * height > _MOST_SAMPLES:
        raise InputError(f"a projector's distortion needs {width} x {height} samples: use fewer pixels, or less of it")
    x, y = (np.arange(width) + low[0]) / fx, (np.arange(height) + low[1]) / fy
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    inside = distortion.valid(xy)
    xy = np.where(inside[..., None], xy, 0.0)
    u, v = np.moveaxis(distortion.distort(xy) * (camera.fx, camera.fy) + (camera.cx, camera.cy), -1, 0)
    order = 1 if projector.filter == "bilinear" else 0
    light = map_coordinates(projector.pattern.astype(np.float64), [v, u], order=order, mode="grid-constant")
    light *= np.abs(np.linalg.det(distortion.jacobian(xy))) * inside
    return light, (fx, fy, -low[0], -low[1])
