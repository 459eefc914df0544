"""A picture that repeats looks the same on a mesh and on a rectangle, and with the repeats in a mesh's (u, v)."""

from dataclasses import replace

import numpy as np

import twinlens as tl
from twinlens.scenes import Bitmap, Mesh, Scene, SceneObject
from twinlens.scenes.materials import Material, lambert

FACING = np.diag([1.0, -1.0, -1.0, 1.0])
POSE = FACING.copy()
POSE[2, 3] = 2.0
QUAD = Mesh(
    np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float),
    np.array([[0, 1, 2], [0, 2, 3]]),
    uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float),
)
PIXELS = np.random.default_rng(5).random((5, 7, 3), dtype=np.float32)


def card(shape, scale):
    picture = Bitmap(PIXELS, to_uv=np.diag([*scale, 1.0, 1.0]), filter="nearest")
    materials = {"card": {"type": "diffuse", "reflectance": picture}}
    lights = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    objects = (SceneObject("card", shape, "card", POSE),)
    return Scene(
        "card",
        objects,
        materials,
        np.eye(4),
        (1.0, 4.0),
        lights,
        {"type": "path", "max_depth": 2},
    )


def photograph(scene):
    camera = tl.Camera.from_fov(64, 48, 40)
    return tl.render(
        scene, tl.Rig((camera,), (np.eye(4),)), tl.Pinhole(), spp=16, seed=2
    )[0]


def test_texture_repeats_on_a_mesh_look_as_on_a_rectangle():
    on_mesh, on_rectangle = (
        photograph(card(shape, (3.0, 2.0))) for shape in (QUAD, {"type": "rectangle"})
    )
    in_uv = photograph(card(replace(QUAD, uv=QUAD.uv * [3.0, 2.0]), (1.0, 1.0)))
    once = photograph(card(QUAD, (1.0, 1.0)))
    for other in (on_rectangle, in_uv):
        assert (
            np.mean(np.abs(on_mesh - other) > 1e-3) < 0.01
        )  # rounding at the edges between the picture's pixels
    assert np.mean(np.abs(on_mesh - once) > 1e-3) > 0.5


def test_a_lamp_whose_picture_wraps_differently_lights_the_floor():
    """Nearest texels, of coordinates inside the picture: the wrapping changes neither the lamp nor its light."""
    images = []
    for wrap in ("repeat", ("repeat", "clamp")):
        shining = Material(emission=Bitmap(PIXELS, filter="nearest", wrap=wrap))
        lamp = SceneObject("lamp", QUAD, "lamp", POSE)
        beside = np.diag([1.0, 1.0, 1.0, 1.0])
        beside[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
        beside[:3, 3] = [-1.5, 0.0, 2.0]
        floor = SceneObject("floor", {"type": "rectangle"}, "floor", beside)
        materials = {"lamp": shining, "floor": lambert(0.8, two_sided=True)}
        scene = Scene("lamp", (lamp, floor), materials, np.eye(4), (1.0, 4.0))
        camera = tl.Camera.from_fov(32, 24, 90)
        rig = tl.Rig((camera,), (np.eye(4),))
        images.append(tl.render(scene, rig, tl.Pinhole(), spp=256, seed=2)[0])
    of_lamp = images[0].max(axis=2) > 0.3
    assert 0.1 < of_lamp.mean() < 0.9
    difference = images[1] - images[0]
    assert np.mean(np.abs(difference[of_lamp]) > 0.05) < 0.05
    lit = ~of_lamp & (images[0].max(axis=2) > 0.01)
    assert lit.mean() > 0.02
    np.testing.assert_allclose(images[1][lit].mean(axis=0), images[0][lit].mean(axis=0), rtol=0.05)  # fmt: skip
