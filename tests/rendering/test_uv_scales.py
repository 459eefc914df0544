"""A picture that repeats looks the same on a mesh, whose (u, v) take the repeats in, and on a rectangle without any."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.rendering.build import move_uv_scales
from twinlens.scenes import Bitmap, Mesh, Scene, SceneObject

FACING = np.diag([1.0, -1.0, -1.0, 1.0])
POSE = FACING.copy()
POSE[2, 3] = 2.0
QUAD = Mesh(
    np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float),
    np.array([[0, 1, 2], [0, 2, 3]]),
    uv=np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float),
)
PIXELS = np.random.default_rng(5).random((5, 7, 3), dtype=np.float32)


def card(shape, scale, **more):
    picture = Bitmap(PIXELS, to_uv=np.diag([*scale, 1.0, 1.0]), filter="nearest")
    materials = {"card": {"type": "diffuse", "reflectance": picture, **more}}
    lights = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    objects = (SceneObject("card", shape, "card", POSE),)
    return Scene("card", objects, materials, np.eye(4), (1.0, 4.0), lights, {"type": "path", "max_depth": 2})


def photograph(scene):
    camera = tl.Camera.from_fov(64, 48, 40)
    return tl.render(scene, tl.Rig((camera,), (np.eye(4),)), tl.Pinhole(), spp=16, seed=2)[0]


def test_texture_repeats_on_a_mesh_look_as_on_a_rectangle():
    on_mesh, on_rectangle = (photograph(card(shape, (3.0, 2.0))) for shape in (QUAD, {"type": "rectangle"}))
    once = photograph(card(QUAD, (1.0, 1.0)))
    assert np.mean(np.abs(on_mesh - on_rectangle) > 1e-3) < 0.01  # rounding at the edges between the picture's pixels
    assert np.mean(np.abs(on_mesh - once) > 1e-3) > 0.5


def test_only_meshes_take_over_texture_repeats():
    _, factors = move_uv_scales(card(QUAD, (3.0, 2.0)))
    assert factors["card"].tolist() == [3.0, 2.0]
    assert move_uv_scales(card({"type": "rectangle"}, (3.0, 2.0)))[1] == {}
    assert move_uv_scales(card(QUAD, (1.0, 1.0)))[1] == {}


@pytest.mark.parametrize("other", [Bitmap(PIXELS), {"type": "checkerboard", "to_uv": np.diag([2.0, 2.0, 1.0, 1.0])}])
def test_textures_of_different_repeats_are_kept(other):
    assert move_uv_scales(card(QUAD, (3.0, 2.0), specular_transmittance=other))[1] == {}
