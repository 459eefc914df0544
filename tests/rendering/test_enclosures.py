"""Light inside closed surfaces, against closed forms: all reflections count, and backs of lamps do not shine.

Inside a closed matte surface that emits L0 everywhere and reflects the share r, n reflections leave the radiance
L0 (1 + r + ... + r^n), whatever the surface's form; all of them L0 / (1 - r).
"""

from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, diffuse, glow
from twinlens.camera import Camera, Rig
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.shapes import creation

RIG = Rig([Camera.from_fov(24, 24, 70)], [HERE])
LENS = tl.ThinLens(0.05, 1.0)


def slow(value):
    return pytest.param(value, marks=pytest.mark.slow)


def enclosure(reflectance, *parts, **options):
    """A scene whose surfaces reflect light on both sides."""
    paint = {"type": "twosided", "bsdf": diffuse(reflectance)}
    return Scene("enclosure", parts, {"paint": paint}, HERE, (0.5, 4.0), **options)


def shell(shape, light=None, middle=(0.0, 0.0, 0.0), size=2.0):
    pose = np.diag([size, size, size, 1.0])
    pose[:3, 3] = middle
    emitter = None if light is None else glow(light)
    return SceneObject("shell", shape, "paint", pose, emitter)


def glowing(kind, reflectance, **options):
    """A closed shape that shines inward with a radiance of 1."""
    inward = {"type": kind, "flip_normals": True}
    return enclosure(reflectance, shell(inward, 1.0), **options)


def lit_sphere(reflectance, **options):
    """A sphere of radius 2 around a small light of intensity 1, which lights it by 1 / 2^2."""
    bulb = {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": 1.0}
    inward = {"type": "sphere", "flip_normals": True}
    return enclosure(reflectance, shell(inward), lights={"bulb": bulb}, **options)


@pytest.mark.parametrize("denoise", [False, True])
@pytest.mark.parametrize("reflectance", [slow(0.5), slow(0.8), 0.9])
def test_a_glowing_sphere_has_the_light_of_all_reflections(reflectance, denoise):
    """512 samples of 576 pixels: a standard error below 0.2 %."""
    scene = glowing("sphere", reflectance)
    image = tl.render(scene, RIG, spp=512, seed=1, denoise=denoise)[0]
    assert image.mean() == pytest.approx(1 / (1 - reflectance), rel=0.01)


@pytest.mark.parametrize("denoise", [False, True])
@pytest.mark.parametrize("reflectance", [slow(0.5), slow(0.8), 0.9])
def test_an_integrating_sphere_has_the_light_of_all_reflections(reflectance, denoise):
    """The first reflection leaves r E / pi, all of them r / (1 - r) E / pi."""
    scene = lit_sphere(reflectance)
    image = tl.render(scene, RIG, spp=512, seed=1, denoise=denoise)[0]
    expected = reflectance / (1 - reflectance) * 0.25 / np.pi
    assert image.mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("reflectance", [slow(0.5), 0.9])
def test_a_glowing_cube_has_the_light_of_all_reflections(reflectance):
    image = tl.render(glowing("cube", reflectance), RIG, LENS, spp=512, seed=2)[0]
    assert image.mean() == pytest.approx(1 / (1 - reflectance), rel=0.01)


@pytest.mark.parametrize("denoise", [False, True])
@pytest.mark.parametrize("depth", [2, slow(4), 12])
def test_an_explicit_depth_is_a_limit(depth, denoise):
    path = {"type": "path", "max_depth": depth}
    scene = glowing("sphere", 0.8, integrator=path)
    image = tl.render(scene, RIG, spp=512, seed=3, denoise=denoise)[0]
    expected = sum(0.8**reflections for reflections in range(depth))
    assert image.mean() == pytest.approx(expected, rel=0.01)


def test_a_sphere_without_losses_ends():
    """Its light grows without limit, but each path ends."""
    image = tl.render(glowing("sphere", 1.0), RIG, spp=16, seed=4)[0]
    assert np.isfinite(image).all()
    assert image.mean() > 10


def test_lens_grids_and_light_fields_have_the_light_of_all_reflections():
    scene = glowing("sphere", 0.8)
    grid = tl.render_lens_grid(scene, RIG, [LENS], spp=256, seed=5)[0][0]
    assert grid.mean() == pytest.approx(5.0, rel=0.01)
    pair = Rig.stereo(RIG.cameras[0], 0.1)
    views = tl.rendering.render_light_field(scene, pair, spp=256, seed=5)
    assert np.mean(views) == pytest.approx(5.0, rel=0.01)


OUTWARD = {
    "sphere": {"type": "sphere"},
    "sphere with a pose": {"type": "sphere", "center": [0.1, 0.0, 0.2], "radius": 1.1},
    "cube": {"type": "cube"},
    "cylinder": {"type": "cylinder", "p0": [0.0, 0.0, -1.0], "p1": [0.0, 0.0, 1.0]},
    "flat mesh": replace(creation("icosphere", subdivisions=3), normals=None),
}


@pytest.mark.parametrize("denoise", [False, slow(True)])
@pytest.mark.parametrize("middle", [slow((0.0, 0.0, 0.0)), (0.7, -0.4, 0.3)])
@pytest.mark.parametrize("shape", OUTWARD)
def test_a_lamp_that_shines_outward_is_dark_inside(shape, middle, denoise):
    """But for rounding: its own radiance is 1."""
    scene = enclosure(0.8, shell(OUTWARD[shape], 1.0, middle))
    image = tl.render(scene, RIG, spp=64, seed=6, denoise=denoise)[0]
    assert image.max() < 1e-4


def test_smooth_normals_let_little_light_inside():
    """Whether a point shines towards another depends on its normals. Those of a smooth mesh differ from its triangles',
    so that each triangle may light itself and its neighbours: one of N has the share 1 / N of the shell's light, and
    reflections inside make it 1 / (1 - r) of that."""
    ball = creation("icosphere", subdivisions=3)
    image = tl.render(enclosure(0.8, shell(ball, 1.0)), RIG, spp=64, seed=6)[0]
    assert image.mean() < 1 / len(ball.faces) / (1 - 0.8)
