"""Mitsuba sensors for a camera and a lens."""

from typing import Any

from twinlens.camera import Camera, Lens
from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.samplers import load_sampler


def make_sensor(camera: Camera, pose: Float, lens: Lens, spp: int, sampler: str) -> Any:
    """The Mitsuba sensor of a camera and a lens. A box filter makes images reproducible to the byte.

    pose : frame_from_cam, which may scale metres to units of the frame.
    """
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
        "sample_border": False,
    }
    mi = mitsuba()
    from twinlens.rendering.ray_generation import TwinlensCamera  # sets up the backend

    return TwinlensCamera(
        camera,
        pose,
        lens,
        mi.load_dict(film),
        load_sampler(sampler, spp, camera.width),
    )
