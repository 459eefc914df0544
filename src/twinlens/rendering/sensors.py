"""Mitsuba sensors for a camera and a lens: one in Python for the JIT backends, Mitsuba's own for the scalar backend.

In scalar mode a sensor written in Python is about forty times slower. Mitsuba's own sensors support square pixels, disk
apertures, and principal points at multiples of half a pixel.
"""

from typing import Any

import numpy as np

from twinlens.camera import Camera, Disk, Lens, Projector, ThinLens
from twinlens.errors import BackendError
from twinlens.geometry import Float
from twinlens.optics import fov_x_deg
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.samplers import load_sampler

Plugin = dict[str, Any]


def make_sensor(camera: Camera, pose: Float, lens: Lens, spp: int, sampler: str) -> Any:
    """The Mitsuba sensor of a camera and a lens in this backend. A box filter makes images reproducible to the byte."""
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
        "sample_border": False,
    }
    if not backend().is_jit:
        return builtin_sensor(
            camera, pose, lens, film, {"type": sampler, "sample_count": spp}
        )
    from twinlens.rendering.ray_generation import TwinlensCamera  # sets up the backend

    return TwinlensCamera(
        camera,
        pose,
        lens,
        mitsuba().load_dict(film),
        load_sampler(sampler, spp, camera.width),
    )


NEEDS_JIT = "needs the LLVM or CUDA backend (Debian, Ubuntu: apt install libllvm19)"
_NEAR_CLIP = 1e-3


def builtin_sensor(
    camera: Camera, world_from_cam: Float, lens: Lens, film: Plugin, sampler: Plugin
) -> Any:
    """Mitsuba's `perspective` or `thinlens`. Raises BackendError for cameras and lenses that need a JIT backend.

    Principal points are moved by cropping the smallest film that is centred on them.
    """
    mi = mitsuba()
    check_camera_supported(camera)
    check_lens_supported(lens)
    mitsuba_from_opencv = np.diag(
        [-1.0, -1.0, 1.0, 1.0]
    )  # Mitsuba's x points left, its y up
    (offset_x, full_width), (offset_y, full_height) = (
        (max(0, round(size - 1 - 2 * c)), round(max(2 * c + 1, 2 * (size - c) - 1)))
        for size, c in ((camera.width, camera.cx), (camera.height, camera.cy))
    )
    plugin: dict[str, Any] = {
        "type": "perspective",
        "near_clip": _NEAR_CLIP,
        "far_clip": 1e5,
        "fov": fov_x_deg(full_width, camera.fx),
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
        plugin |= {"type": "thinlens", "aperture_radius": 0.5 * lens.aperture_diameter}
        plugin["focus_distance"] = 1.0 / lens.vergence
    return mi.load_dict(plugin)


def check_lens_supported(lens: Lens) -> None:
    """Raise BackendError if this process's backend does not support the lens."""
    disk = isinstance(lens.aperture, Disk)
    if (
        lens.aperture_diameter == 0
        or (disk and lens.vergence > 1e-5)
        or backend().is_jit
    ):
        return
    if disk and isinstance(lens, ThinLens) and lens.defocus:
        raise BackendError(
            f"a lens that focus_um of a mismatch focuses beyond infinity {NEEDS_JIT}; or use focus_um=0"
        )
    raise BackendError(
        f"this lens {NEEDS_JIT}; without it, use a pinhole or a disk aperture with a finite focus"
    )


def check_sampler_supported(sampler: str) -> None:
    """Raise BackendError if this process's backend does not have the sampler."""
    if sampler == "sobol" and not backend().is_jit:
        raise BackendError(f"the sampler 'sobol' {NEEDS_JIT}; or use another sampler")


def check_mismatch_supported(distortion_px: float) -> None:
    """Raise BackendError if this process's backend does not support a second camera with this distortion."""
    if distortion_px and not backend().is_jit:
        raise BackendError(
            f"the mismatch's distortion_px={distortion_px:.3g} {NEEDS_JIT}; or use distortion_px=0"
        )


def check_projector_supported(projector: Projector) -> None:
    """Raise BackendError if this process's backend does not support the projector."""
    if projector.aperture_diameter and not backend().is_jit:
        raise BackendError(
            f"a projector with an aperture {NEEDS_JIT}; without it, use no aperture"
        )


def check_camera_supported(camera: Camera) -> None:
    """Raise BackendError if this process's backend does not support the camera."""
    if backend().is_jit:
        return
    if camera.fx != camera.fy:
        raise BackendError(
            f"a camera with pixels that are not square (fx={camera.fx}, fy={camera.fy}) {NEEDS_JIT}"
        )
    if camera.distortion is not None:
        raise BackendError(f"lens distortion {NEEDS_JIT}")
    if any(2 * c % 1 for c in (camera.cx, camera.cy)):
        raise BackendError(
            f"a principal point off the half-pixel grid (cx={camera.cx}, cy={camera.cy}) {NEEDS_JIT}"
        )
