"""Light between surfaces from the irradiance cache, against closed forms and Mitsuba's path tracer."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, diffuse, glow, rgb
from twinlens.camera import Camera, Projector, Rig, patterns
from twinlens.rendering.build import build
from twinlens.rendering.integrators import for_denoising
from twinlens.rendering.projectors import lit_by_projectors
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Scene, SceneObject

CAMERA = Camera.from_fov(64, 48, 60)
LARGE = Rig.stereo(Camera.from_fov(160, 120, 60), 0.1)
MIDDLE = Rig.stereo(Camera.from_fov(80, 60, 60), 0.1)
REFLECTANCE = 0.6
MATTE = diffuse(REFLECTANCE)
LAMP = glow(1000.0)


def room(shape, paint, depth, *things, **materials):
    """The inside of a closed shape of 4 m, and things in it."""
    inside = {"type": shape, "flip_normals": True}
    size = np.diag([2.0, 2.0, 2.0, 1.0])
    objects = SceneObject("walls", inside, "paint", size), *things
    materials["paint"] = paint
    path = {"type": "path", "max_depth": depth}
    return Scene("room", objects, materials, HERE, (0.5, 4.0), {}, path)


def bulb(centre):
    """A lamp of radius 5 cm."""
    shape = {"type": "sphere", "center": centre, "radius": 0.05}
    return SceneObject("lamp", shape, "paint", emitter=LAMP)


def lit_cube(paint=MATTE, depth=6, *things, **materials):
    """A cube with a lamp above the camera, and other things."""
    return room("cube", paint, depth, bulb([0.0, -1.5, 0.5]), *things, **materials)


def level(name, height, half, thickness=0.0):
    """A horizontal square above the camera, below the lamp, that shows its back; or a slab."""
    shape = {"type": "cube" if thickness else "rectangle"}
    pose = np.eye(4)
    pose[:3, 0] = half, 0, 0
    pose[:3, 1] = 0, 0, -half
    pose[:3, 2] = 0, thickness or 1, 0
    pose[:3, 3] = 0, height, 0.5
    return SceneObject(name, shape, name, pose)


def lamp_before_a_wall(gap):
    """A square lamp of 60 cm that shines only at the wall behind the camera, at a distance of `gap`."""
    pose = np.diag([0.3, 0.3, -1.0, 1.0])
    pose[:3, 3] = 0.5, 0.3, gap - 2
    lamp = SceneObject("lamp", {"type": "rectangle"}, "paint", pose, emitter=LAMP)
    return room("cube", MATTE, 5, lamp)


def images(scene, rig, spp, seeds, cached=True, sampler="independent"):
    """Images (N, H, W, 3) of the first camera before denoising, with or without a cache for each seed."""
    stack = []
    for seed in seeds:
        built = lit_by_projectors(build(scene), rig, "rgb")
        if cached:
            built = for_denoising(built, rig, "rgb", seed)
        view = rig.cameras[0], rig.world_from_cams[0], tl.Pinhole()
        sensor = make_sensor(*view, spp, sampler)
        image = built.integrator.render(built.mi_scene, sensor, seed=seed, spp=spp)
        stack.append(np.asarray(image, dtype=np.float64)[..., :3])
    return np.array(stack)


def mean_light(scene, rig, spp, seeds):
    """Of images with a cache, and of Mitsuba's with other seeds."""
    others = [seed + 100 for seed in seeds]
    cached = images(scene, rig, spp, seeds)
    mitsubas = images(scene, rig, spp, others, cached=False)
    return cached.mean(), mitsubas.mean()


@pytest.mark.parametrize("depth", [3, pytest.param(6, marks=pytest.mark.slow), -1])
def test_an_integrating_sphere_has_its_closed_form(depth):
    """A lamp in the middle of a matte sphere lights it evenly by E, and n reflections add E (r + r^2 + ... + r^n)."""
    scene = room("sphere", MATTE, depth, bulb([0.0, 0.0, 0.0]))
    pose = np.eye(4)
    pose[2, 3] = 0.3  # the camera looks away from the lamp
    direct = np.pi * 1000 * (0.05 / 2) ** 2
    light = direct * sum(REFLECTANCE**n for n in range(depth - 1 if depth > 0 else 100))
    measured = images(scene, Rig.stereo(CAMERA, 0.1, pose), 16, range(4)).mean()
    assert measured == pytest.approx(REFLECTANCE / np.pi * light, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "tabletop", "staircase", "corner"])
def test_images_have_the_brightness_of_mitsubas(name):
    scene = tl.load_scene(name)
    rig = Rig.stereo(LARGE.cameras[0], 0.1, scene.world_from_left)
    ours, theirs = mean_light(scene, rig, 64, range(3))
    assert ours == pytest.approx(theirs, rel=0.01)


@pytest.mark.slow
def test_what_is_looked_up_is_the_mean_of_surfaces_that_are_met_from_afar(monkeypatch):
    """Below the things on a table, surfaces are met from nearby, and not looked up; their cells were 0.9 % too dark."""
    from twinlens.rendering import irradiance_cache

    kept = []
    tables = irradiance_cache._tables

    def keeping(paths, cell, *options):
        kept.append((paths, cell, tables(paths, cell, *options)))
        return kept[0][2]

    monkeypatch.setattr(irradiance_cache, "_tables", keeping)
    scene = tl.load_scene("tabletop")
    rig = Rig.stereo(LARGE.cameras[0], 0.1, scene.world_from_left)
    cache = for_denoising(build(scene), rig, "rgb", 0).integrator.cache
    [(paths, cell, irradiance)] = kept
    [size] = np.array(cache._size)
    is_far = (cell[1:-1] >= 0) & (paths.distance[1:-1] > size)
    assert 0.7 < is_far.sum() / (cell[1:-1] >= 0).sum() < 0.9
    shared = irradiance[0][cell[1:-1][is_far]]
    own = paths.irradiance[1:-1][is_far]
    np.testing.assert_allclose(shared.mean(axis=0), own.mean(axis=0), rtol=1e-3)


@pytest.mark.parametrize("gap", [0.002, 0.02, 0.2])
def test_no_sample_of_the_irradiance_is_far_above_what_lights_can_give(gap):
    """A lamp of radiance L gives at most pi L, and no sample more than 1.5 pi L; so do the means of cells."""
    built = build(lamp_before_a_wall(gap))
    for seed in range(2):
        cache = for_denoising(built, LARGE, "rgb", seed).integrator.cache
        direct = np.array(cache._tables).reshape(-1, int(cache._count[0]), 3)[0]
        assert 0 < direct.max() < 1.5 * np.pi * 1000


def principled(**lobes):
    return {"type": "principled", "base_color": rgb(0.6), **lobes}


BALL = {"type": "sphere", "center": [0.0, -1.5, 0.5], "radius": 0.2}
GLOBE = SceneObject("globe", BALL, "globe")
FROST = {"type": "roughdielectric", "alpha": 0.3}
NET = {"type": "mask", "opacity": 0.5, "bsdf": {"type": "twosided", "bsdf": MATTE}}
PANE = {"type": "dielectric"}
CASES = {
    "a lamp before a wall": lamp_before_a_wall(0.2),
    "white, any depth": lit_cube(diffuse(0.8), -1),
    "glossy": lit_cube(principled(roughness=0.3)),
    "a pane below the lamp": lit_cube(
        MATTE, -1, level("pane", -1.2, 1.9, 0.05), pane=PANE
    ),
    "matte": lit_cube(),
    "metal": lit_cube(principled(metallic=1.0, roughness=0.2)),
    "varnished": lit_cube({"type": "plastic", "diffuse_reflectance": rgb(0.5)}),
    "the back of a panel": lit_cube(MATTE, 6, level("panel", -1.0, 1.0), panel=MATTE),
    "a net below the lamp": lit_cube(MATTE, 6, level("net", -1.2, 1.0), net=NET),
    "a globe of rough glass": lit_cube(MATTE, -1, GLOBE, globe=FROST),
}
SIZES = [
    ("a lamp before a wall", MIDDLE),
    *(pytest.param(name, LARGE, marks=pytest.mark.slow) for name in CASES),
]


@pytest.mark.parametrize(("name", "rig"), SIZES)
def test_the_light_is_that_of_mitsubas_path_tracer(name, rig):
    """Within 1 % and five standard errors, as a whole and in its quarters; no negative light to speak of."""
    scene = CASES[name]
    count = 8
    height, width = rig.cameras[0].height, rig.cameras[0].width
    ours = images(scene, rig, 16, range(count))
    theirs = images(scene, rig, 16, range(20, 20 + count), cached=False)
    for parts in (1, 2):
        means = []
        variance = 0.0
        for stack in (ours, theirs):
            cut = stack.reshape(count, parts, height // parts, parts, width // parts, 3)
            blocks = cut.mean(axis=(2, 4, 5))
            means.append(blocks.mean(axis=0))
            variance = variance + blocks.var(axis=0, ddof=1) / count
        bound = 0.01 * means[1] + 5 * np.sqrt(variance)
        assert (np.abs(means[0] - means[1]) < bound).all()
    assert np.minimum(ours, 0).sum() > -1e-3 * ours.sum()


def test_the_light_of_projectors_is_in_the_cache():
    beam = Projector(HERE, CAMERA, patterns.checker(64, 48, 8), 10.0, band="rgb")
    scene = lit_cube(depth=5).with_ambient(0)
    rig = MIDDLE.with_projectors([beam])
    ours, theirs = mean_light(scene, rig, 32, range(2))
    assert theirs > 0.01
    assert ours == pytest.approx(theirs, rel=0.01)


def test_there_is_no_cache_without_a_third_surface():
    built = build(lit_cube(depth=2))
    assert for_denoising(built, LARGE, "rgb", 0).integrator.cache is None


def test_light_that_would_grow_without_limit_ends():
    """Two cells whose only samples reflect 1.5 times the light at each other, and a box that absorbs nothing."""
    from twinlens.rendering.irradiance_cache import _Paths, _tables

    ones = np.ones((4, 2), np.uint32)
    colours = np.ones((4, 2, 3), np.float32)
    met = 2 * ones
    cell = np.array([[0, 1], [0, 1], [1, 0], [0, 1]])
    unused = np.float32(ones)
    paths = _Paths(
        met, unused, colours, colours, 1.5 * colours, colours, 0 * colours, colours
    )
    assert _tables(paths, cell, 2, -1).max() < 200
    after_bounces = _tables(paths, cell, 2, 3)[:, 0, 0]
    np.testing.assert_allclose(after_bounces, np.cumsum(1.5 ** np.arange(4)))
    white = lit_cube(diffuse(1.0), -1)
    assert np.isfinite(images(white, Rig.stereo(CAMERA, 0.1), 1, [0])).all()
