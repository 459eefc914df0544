"""Light between surfaces from the irradiance cache, against closed forms and Mitsuba's path tracer."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE
from twinlens.camera import Camera, Projector, Rig, patterns
from twinlens.rendering.build import build
from twinlens.rendering.integrators import for_denoising
from twinlens.rendering.projectors import lit_by_projectors
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Scene, SceneObject

CAMERA = Camera.from_fov(64, 48, 60)
LARGE = Camera.from_fov(160, 120, 60)
REFLECTANCE = 0.6


def rgb(value):
    return {"type": "rgb", "value": value}


MATTE = {"type": "diffuse", "reflectance": rgb(REFLECTANCE)}
LAMP = {"type": "area", "radiance": rgb(1000.0)}


def room(shape, paint, lamp, depth, *things, **materials):
    """The inside of a closed shape of 4 m, with a spherical lamp of radius 5 cm at `lamp`, and other things."""
    walls = SceneObject(
        "walls",
        {"type": shape, "flip_normals": True},
        "paint",
        np.diag([2.0, 2.0, 2.0, 1.0]),
    )
    bulb = SceneObject(
        "lamp",
        {"type": "sphere", "center": lamp, "radius": 0.05},
        "paint",
        emitter=LAMP,
    )
    integrator = {"type": "path", "max_depth": depth}
    return Scene(
        "room",
        (walls, bulb, *things),
        {"paint": paint, **materials},
        HERE,
        (0.5, 4.0),
        {},
        integrator,
    )


def lit_cube(paint=MATTE, depth=6, thing=None, **material):
    """A cube with a lamp above the camera, and one thing."""
    return room(
        "cube",
        paint,
        [0.0, -1.5, 0.5],
        depth,
        *([] if thing is None else [thing]),
        **material,
    )


def level(name, height, half, thickness=0.0):
    """A horizontal square above the camera, below the lamp, that shows its back; or a slab."""
    shape = {"type": "cube" if thickness else "rectangle"}
    pose = np.array(
        [
            [half, 0, 0, 0],
            [0, 0, thickness or 1, height],
            [0, -half, 0, 0.5],
            [0, 0, 0, 1.0],
        ]
    )
    return SceneObject(name, shape, name, pose)


def images(scene, rig, spp, seeds, cached=True, sampler="independent"):
    """Images (N, H, W, 3) of the first camera before denoising, with or without a cache for each seed."""
    found = []
    for seed in seeds:
        built = lit_by_projectors(build(scene), rig, "rgb")
        if cached:
            built = for_denoising(built, rig, "rgb", seed)
        sensor = make_sensor(
            rig.cameras[0], rig.world_from_cams[0], tl.Pinhole(), spp, sampler
        )
        found.append(
            np.asarray(
                built.integrator.render(built.mi_scene, sensor, seed=seed, spp=spp),
                dtype=np.float64,
            )[..., :3]
        )
    return np.array(found)


@pytest.mark.parametrize("depth", [3, 6, -1])
def test_an_integrating_sphere_has_its_closed_form(depth):
    """A lamp in the middle of a matte sphere lights it evenly by E, and n reflections add E (r + r^2 + ... + r^n)."""
    scene = room("sphere", MATTE, [0.0, 0.0, 0.0], depth)
    pose = np.eye(4)
    pose[2, 3] = 0.3  # the camera looks away from the lamp
    direct = np.pi * 1000 * (0.05 / 2) ** 2
    light = direct * sum(REFLECTANCE**n for n in range(depth - 1 if depth > 0 else 100))
    found = images(scene, Rig.stereo(CAMERA, 0.1, pose), 16, range(4))
    assert found.mean() == pytest.approx(REFLECTANCE / np.pi * light, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "tabletop", "staircase"])
def test_images_have_the_brightness_of_mitsubas(name):
    scene = tl.load_scene(name)
    rig = Rig.stereo(LARGE, 0.1, scene.world_from_left)
    ours, theirs = (
        images(scene, rig, 64, range(k, k + 3), cached)
        for k, cached in ((0, True), (9, False))
    )
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)


def test_light_between_surfaces_has_less_noise():
    """In `room`, where it is 43 % of the light and most of the noise."""
    scene = tl.load_scene("room")
    rig = Rig.stereo(LARGE, 0.1, scene.world_from_left)
    ours, theirs = (
        images(scene, rig, 16, range(4), cached, "multijitter")
        for cached in (True, False)
    )
    assert np.median(ours.var(axis=0, ddof=1)) < 0.6 * np.median(
        theirs.var(axis=0, ddof=1)
    )


def lamp_before_a_wall(gap):
    """A square lamp of 60 cm that shines only at the wall behind the camera, at a distance of `gap`."""
    walls = SceneObject(
        "walls",
        {"type": "cube", "flip_normals": True},
        "paint",
        np.diag([2.0, 2.0, 2.0, 1.0]),
    )
    pose = np.diag([0.3, 0.3, -1.0, 1.0])
    pose[:3, 3] = 0.5, 0.3, gap - 2
    lamp = SceneObject("lamp", {"type": "rectangle"}, "paint", pose, emitter=LAMP)
    return Scene(
        "room",
        (walls, lamp),
        {"paint": MATTE},
        HERE,
        (0.5, 4.0),
        {},
        {"type": "path", "max_depth": 5},
    )


def test_surfaces_that_face_the_same_way_share_no_light():
    """The back of a lamp 5 cm in front of a wall that it lights, in cells of 6 cm."""
    scene, rig = lamp_before_a_wall(0.05), Rig.stereo(LARGE, 0.1)
    ours = images(scene, rig, 16, range(8), True, "multijitter").mean(axis=(1, 2, 3))
    theirs = images(scene, rig, 64, range(4), False).mean()
    assert ours.mean() == pytest.approx(theirs, rel=0.1)


def test_no_sample_of_the_irradiance_is_far_above_what_lights_can_give():
    """A lamp of radiance L gives at most pi L, and no sample more than 1.5 pi L; so do the means of cells."""
    for gap in (0.002, 0.02, 0.2):
        scene, rig = lamp_before_a_wall(gap), Rig.stereo(LARGE, 0.1)
        for seed in range(4):
            cache = for_denoising(build(scene), rig, "rgb", seed).integrator.cache
            direct = np.array(cache._tables).reshape(-1, int(cache._count[0]), 3)[0]
            assert 0 < direct.max() < 1.5 * np.pi * 1000


GLOBE = SceneObject(
    "globe", {"type": "sphere", "center": [0.0, -1.5, 0.5], "radius": 0.2}, "globe"
)
NET = {"type": "mask", "opacity": 0.5, "bsdf": {"type": "twosided", "bsdf": MATTE}}
CASES = {
    "matte": lit_cube(),
    "white, any depth": lit_cube({"type": "diffuse", "reflectance": rgb(0.8)}, -1),
    "glossy": lit_cube(
        {"type": "principled", "base_color": rgb(0.6), "roughness": 0.3}
    ),
    "metal": lit_cube(
        {
            "type": "principled",
            "base_color": rgb(0.6),
            "metallic": 1.0,
            "roughness": 0.2,
        }
    ),
    "varnished": lit_cube({"type": "plastic", "diffuse_reflectance": rgb(0.5)}),
    "the back of a panel": lit_cube(thing=level("panel", -1.0, 1.0), panel=MATTE),
    "a net below the lamp": lit_cube(thing=level("net", -1.2, 1.0), net=NET),
    "a globe of rough glass": lit_cube(
        depth=-1, thing=GLOBE, globe={"type": "roughdielectric", "alpha": 0.3}
    ),
    "a lamp before a wall": lamp_before_a_wall(0.2),
    "a pane below the lamp": lit_cube(
        depth=-1, thing=level("pane", -1.2, 1.9, 0.05), pane={"type": "dielectric"}
    ),
}


LONG = ("varnished", "metal", "the back of a panel", "a net below the lamp")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in CASES],
)
def test_the_light_is_that_of_mitsubas_path_tracer(name):
    """Within 1 % and five standard errors, as a whole and in its quarters; no negative light to speak of."""
    rig = Rig.stereo(LARGE, 0.1)
    ours, theirs = (
        images(CASES[name], rig, 16, range(k, k + 8), cached)
        for k, cached in ((0, True), (20, False))
    )
    for parts in (1, 2):
        blocks = [
            of.reshape(8, parts, 120 // parts, parts, 160 // parts, 3).mean(
                axis=(2, 4, 5)
            )
            for of in (ours, theirs)
        ]
        means = [of.mean(axis=0) for of in blocks]
        error = np.sqrt(sum(of.var(axis=0, ddof=1) / 8 for of in blocks))
        assert (np.abs(means[0] - means[1]) < 0.01 * means[1] + 5 * error).all()
    assert np.minimum(ours, 0).sum() > -1e-3 * ours.sum()


def test_the_light_of_projectors_is_in_the_cache():
    beam = Projector(np.eye(4), CAMERA, patterns.checker(64, 48, 8), 10.0, band="rgb")
    scene, rig = (
        lit_cube(depth=5),
        Rig.stereo(Camera.from_fov(80, 60, 60), 0.1).with_projectors([beam]),
    )
    ours, theirs = (
        images(scene.with_ambient(0), rig, 64, range(k, k + 3), cached)
        for k, cached in ((0, True), (9, False))
    )
    assert theirs.mean() > 0.01
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)


def test_there_is_no_cache_without_a_third_surface():
    scene, rig = lit_cube(depth=2), Rig.stereo(CAMERA, 0.1)
    assert for_denoising(build(scene), rig, "rgb", 0).integrator.cache is None


def test_light_that_would_grow_without_limit_ends():
    """Two cells whose only samples reflect 1.5 times the light at each other, and a box that absorbs nothing."""
    from twinlens.rendering.irradiance_cache import _Paths, _tables

    ones, colours = np.ones((4, 2), np.uint32), np.ones((4, 2, 3), np.float32)
    met, cell = 2 * ones, np.array([[0, 1], [0, 1], [1, 0], [0, 1]])
    paths = _Paths(met, ones, colours, 1.5 * colours, colours, 0 * colours, colours)
    assert _tables(paths, cell, 2, -1).max() < 200
    np.testing.assert_allclose(
        _tables(paths, cell, 2, 3)[:, 0, 0], np.cumsum(1.5 ** np.arange(4))
    )
    white = lit_cube({"type": "diffuse", "reflectance": rgb(1.0)}, -1)
    assert np.isfinite(images(white, Rig.stereo(CAMERA, 0.1), 1, [0])).all()
