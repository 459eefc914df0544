"""Mitsuba's own sensors for the scalar mode, in which a sensor written in Python is some forty times slower.

They know square pixels, a disk lens, and, through the crop of a larger film, a principal point at half pixels.
"""

import math
from typing import Any

import numpy as np

from twinlens.camera import Camera, Disk, Lens
from twinlens.errors import BackendError
from twinlens.geometry import Float
from twinlens.rendering.backends import backend, mitsuba

_NEEDS_JIT = "needs the LLVM or CUDA backend (Debian, Ubuntu: apt install libllvm19)"
_NEAR_CLIP = 1e-3


def builtin_sensor(
    camera: Camera, world_from_cam: Float, lens: Lens, film: dict[str, Any], sampler: dict[str, Any]
) -> Any:
    """Mitsuba's `perspective` or `thinlens` for this camera, or BackendError saying what the scalar mode cannot do."""
    mi = mitsuba()
    _check_camera(camera)
    _check_lens(lens)
    mitsuba_from_opencv = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's x points left, its y up
    full_width, full_height, offset_x, offset_y = _centred_film(camera)
    plugin: dict[str, Any] = {
        "type": "perspective",
        "near_clip": _NEAR_CLIP,
        "far_clip": 1e5,
        "fov": math.degrees(2 * math.atan(0.5 * full_width / camera.fx)),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(world_from_cam @ mitsuba_from_opencv),
        "film": {
            **film,
            "width": full_width,
            "height": full_height,
            "crop_width": camera.width,
            "crop_height": camera.height,
            "crop_offset_x": offset_x,
            "crop_offset_y": offset_y,
        },
        "sampler": sampler,
    }
    if lens.aperture_diameter > 0:
        plugin |= {
            "type": "thinlens",
            "aperture_radius": 0.5 * lens.aperture_diameter,
            "focus_distance": 1.0 / lens.vergence,
        }
    return mi.load_dict(plugin)


def check_possible(lens: Lens) -> None:
    """Raise BackendError for a lens that this process's backend cannot photograph through, whatever its camera."""
    if not backend().is_jit:
        _check_lens(lens)


def _check_camera(camera: Camera) -> None:
    if camera.fx != camera.fy:
        raise BackendError(f"rendering pixels that are not square (fx={camera.fx}, fy={camera.fy}) {_NEEDS_JIT}")
    if camera.distortion is not None:
        raise BackendError(f"rendering lens distortion {_NEEDS_JIT}")
    if any(2 * c % 1 for c in (camera.cx, camera.cy)):
        raise BackendError(f"a principal point off the half-pixel grid (cx={camera.cx}, cy={camera.cy}) {_NEEDS_JIT}")


def _check_lens(lens: Lens) -> None:
    if lens.aperture_diameter > 0 and not (isinstance(lens.aperture, Disk) and lens.vergence > 1e-5):
        raise BackendError(f"a lens that is no disk focused at a finite distance {_NEEDS_JIT}")


def _centred_film(camera: Camera) -> tuple[int, int, int, int]:
    """(width, height, crop x, crop y) of the smallest film centred on the principal point that holds the image."""
    (left, full_width), (top, full_height) = (
        (max(0, round(size - 1 - 2 * c)), round(max(2 * c + 1, 2 * (size - c) - 1)))
        for size, c in ((camera.width, camera.cx), (camera.height, camera.cy))
    )
    return full_width, full_height, left, top
