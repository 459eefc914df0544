"""The light on a film behind a real hole: an opaque plate in a black box under an even sky, path-traced.

No formula of a camera takes part. The box's inside is photographed: a white matt film of reflectance 1 shows the
radiance E / pi where E falls on it, and all of E comes from the sky, through the hole (Lambert's law).
"""

import math

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Pinhole, Rig
from twinlens.rendering import render
from twinlens.scenes import Mesh, Scene, SceneObject

Float = NDArray[np.float64]

_SIZE = 10.0
"""Film distance of the box that is traced, metres: the law knows angles alone, and rays leave a surface by a step of
1e-4 (1 + place) metres, which in a box of 50 mm would bring the film 0.2 % nearer to the hole."""
_CORNERS = 512
"""Of the round hole: as many leave 3e-5 of its area out."""
_WIDTH = 3.0
"""Half the box's, in film distances."""
_PIXELS, _PATCH = 48, 0.02
"""A side of the picture, and the part of the film distance that it shows: E falls by 2e-4 within it."""


def film_light(diameter: float, film: float, spp: int, seed: int) -> float:
    """E / (pi L) at the film's middle: how much of what an open sky of radiance L would give comes through the hole.

    diameter: the hole's; film: the plate's distance from it; metres. Of n = 2304 spp light paths about the value's
    share find the hole, so that its relative standard deviation is 1/sqrt(n value) or less.
    """
    eye, middle = np.array([0.4, 0.0, 0.3]) * _SIZE, np.array([0.0, 0.0, _SIZE])
    fx = _PIXELS * float(np.linalg.norm(middle - eye)) / (_PATCH * _SIZE)
    camera = Camera(_PIXELS, _PIXELS, fx, fx, 0.5 * (_PIXELS - 1), 0.5 * (_PIXELS - 1))
    picture = render(
        box(diameter / film * _SIZE, _SIZE), Rig((camera,), (_looking(eye, middle),)), Pinhole(), spp, seed
    )[0]
    return float(picture[..., 1].mean(dtype=np.float64))


def box(diameter: float, film: float) -> Scene:
    """The plate with its hole at z = 0 and the walls behind it, black; the film at z = `film`; a sky of radiance 1."""
    around = np.linspace(0.0, 2.0 * math.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(_CORNERS)], axis=1)
    half = _WIDTH * film
    rings = (0.5 * diameter * circle, half * circle, half * circle + [0.0, 0.0, 1.01 * film])
    step = np.arange(_CORNERS)
    following = (step + 1) % _CORNERS
    faces = [
        triangle + ring * _CORNERS
        for ring in range(2)
        for triangle in (
            np.stack([step, following, step + _CORNERS], axis=1),
            np.stack([following, following + _CORNERS, step + _CORNERS], axis=1),
        )
    ]
    walls = Mesh(np.concatenate(rings), np.concatenate(faces).astype(np.uint32))
    towards_hole = np.diag([2.0 * half, -2.0 * half, -1.0, 1.0])
    towards_hole[2, 3] = film
    grey = {name: {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
            for name, value in (("black", 0.0), ("white", 1.0))}  # fmt: skip
    return Scene(
        "box",
        (SceneObject("walls", walls, "black"), SceneObject("film", {"type": "rectangle"}, "white", towards_hole)),
        grey,
        np.eye(4),
        (0.5 * film, 2.0 * film),
        lights={"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}},
        integrator={"type": "path", "max_depth": 2},
    )


def _looking(eye: Float, at: Float) -> Float:
    """The pose of a camera at `eye` that looks at `at`, y down along the world's y."""
    forward = (at - eye) / np.linalg.norm(at - eye)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], forward), [0.0, 1.0, 0.0], forward], axis=1)
    pose[:3, 3] = eye
    return pose
