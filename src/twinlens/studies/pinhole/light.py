"""Light on the film behind a bare hole: the radiometry of `Sensor`, and path tracing through a real plate.

The path-traced box uses no camera formula: an opaque plate with a hole in front of a black box, under a uniform sky. A
white matt film of reflectance 1 inside the box has the radiance E / pi, where E is its irradiance (Lambert's law).
"""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import BareAperture, Camera, Pinhole, Rig
from twinlens.geometry import look_at
from twinlens.rendering import render
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.pinhole.edge import WAVELENGTH
from twinlens.studies.stage import centred_camera

SENSOR = Sensor.preset(
    "machine_vision", filters="mono", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3, prnu=0.0, dsnu=0.0
)
_SIZE = 10.0
"""Film distance of the path-traced box, metres. Only angles matter, and a large box keeps the renderer's ray offsets of
1e-4 (1 + position) metres negligible: in a box of 50 mm they would move the film by 0.2 %."""
_CORNERS = 512
"""Vertices of the round hole; the polygon misses 3e-5 of its area."""
_HALF_WIDTH = 3.0
"""Of the box, in film distances."""
_PIXELS, _PATCH = 48, 0.02
"""Image side in pixels, and the imaged part of the film in film distances; E varies by 2e-4 within it."""


def white_rate(camera: Camera, hole: BareAperture) -> float:
    """Fraction of white per second for a radiance of 1."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    return float(SENSOR.level_rate(white, camera=camera, lens=hole).mean())


def _exposed(camera: Camera, hole: BareAperture, time: float, seed: int) -> NDArray[np.float64]:
    """The levels (H, W) of a film lit with a radiance of 1, exposed for `time` seconds."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    photo = SENSOR.expose(white, camera=camera, lens=hole, seed=seed, exposure=Exposure(time))
    return photo.image.astype(np.float64)


def exposed_rate(camera: Camera, hole: BareAperture, seed: int) -> float:
    """Mean level per second of a uniformly lit film, exposed to half of white."""
    time = 0.5 / white_rate(camera, hole)
    return float(_exposed(camera, hole, time, seed).mean()) / time


def signal_to_noise(camera: Camera, hole: BareAperture, time: float, seed: int) -> float:
    """Mean over standard deviation of a uniformly lit film; NaN if it saturates."""
    image = _exposed(camera, hole, time, seed)
    return math.nan if image.max() >= 65535 else float(image.mean() / image.std())


def film_light(diameter: float, film: float, spp: int, seed: int) -> float:
    """E / (pi L) at the centre of the film behind a hole in a plate, path-traced: the transmitted share of a sky L.

    diameter: of the hole; film: its distance from the plate; metres. Of n = 2304 spp light paths, a share equal to the
    result passes the hole, so that its relative standard deviation is at most 1/sqrt(n result).
    """
    eye, middle = np.array([0.4, 0.0, 0.3]) * _SIZE, np.array([0.0, 0.0, _SIZE])
    fx = _PIXELS * float(np.linalg.norm(middle - eye)) / (_PATCH * _SIZE)
    rig = Rig((centred_camera(_PIXELS, _PIXELS, fx),), (look_at(eye, middle, up=(0.0, -1.0, 0.0)),))
    picture = render(_box(diameter / film * _SIZE), rig, Pinhole(), spp, seed)[0]
    return float(picture[..., 1].mean(dtype=np.float64))


def _box(diameter: float) -> Scene:
    """A black plate with a hole at z = 0, black walls and a white film at z = _SIZE behind it; a sky of radiance 1."""
    around = np.linspace(0.0, 2.0 * math.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(_CORNERS)], axis=1)
    half = _HALF_WIDTH * _SIZE
    rings = np.concatenate([0.5 * diameter * circle, half * circle, half * circle + [0.0, 0.0, 1.01 * _SIZE]])
    step = np.arange(_CORNERS)
    following = (step + 1) % _CORNERS
    strip = [[step, following, step + _CORNERS], [following, following + _CORNERS, step + _CORNERS]]
    faces = np.concatenate([np.stack(part, axis=1) + ring * _CORNERS for ring in range(2) for part in strip])
    towards_hole = np.diag([2.0 * half, -2.0 * half, -1.0, 1.0])
    towards_hole[2, 3] = _SIZE
    objects = (
        SceneObject("walls", Mesh(rings, faces.astype(np.uint32)), "black"),
        SceneObject("film", {"type": "rectangle"}, "white", towards_hole),
    )
    grey = {name: {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
            for name, value in (("black", 0.0), ("white", 1.0))}  # fmt: skip
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    paths = {"type": "path", "max_depth": 2}
    return Scene("box", objects, grey, np.eye(4), (0.5 * _SIZE, 2.0 * _SIZE), lights={"sky": sky}, integrator=paths)
