"""Light fields of shared light: each view is what a pinhole camera sees that is rendered by itself."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import FACING, HERE, chequered_room, sky
from tests.optics_rendered.test_light_field import block_means, error_over_noise
from twinlens.camera import Projector, patterns
from twinlens.errors import InputError
from twinlens.rendering import backend
from twinlens.scenes import Scene, SceneObject, Sky

backend()
import drjit  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
NARROW, WIDE = tl.ThinLens(0.03, 2.0), tl.ThinLens(0.3, 2.0)
SURFACES = {
    "rough metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.3},
    "polished metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.03},
    "mirror": {"type": "conductor", "material": "Ag"},
    "lacquer": {"type": "roughplastic", "alpha": 0.15, "nonlinear": True},
    "glaze": {"type": "plastic"},
    "glass": {"type": "dielectric"},
    "frosted glass": {"type": "roughdielectric", "alpha": 0.3},
    "gauze": {
        "type": "mask",
        "opacity": 0.5,
        "nested": {"type": "twosided", "bsdf": {"type": "diffuse"}},
    },
    "paper": {"type": "principledthin", "diff_trans": 1.0},
}


def room(surface: str) -> Scene:
    """The chequered room, whose card and ball are of this surface."""
    scene = chequered_room()
    things = (
        SceneObject(each.name, each.shape, "surface", each.world_from_object)
        if each.name in ("card", "ball")
        else each
        for each in scene.objects
    )
    materials = {**scene.materials, "surface": SURFACES[surface]}
    return Scene(
        "room",
        tuple(things),
        materials,
        HERE,
        (1.0, 6.0),
        scene.lights,
        scene.integrator,
    )


def ratio(scene: Scene, rig: tl.Rig, view: int, spp: int = 128) -> float:
    """The squared error of a view's means over 4 x 4 pixels against pinholes, over its expectation from noise."""
    alone = tl.Rig(
        [rig.cameras[view]], [rig.world_from_cams[view]], projectors=rig.projectors
    )
    theirs = [
        block_means(tl.render(scene, alone, spp=spp, seed=seed)[0]) for seed in (1, 2)
    ]
    ours = [
        block_means(tl.render_light_field(scene, rig, spp, seed)[view])
        for seed in (3, 4)
    ]
    return error_over_noise(ours, theirs)


@pytest.mark.parametrize("surface", SURFACES)
def test_a_view_is_what_a_pinhole_sees(surface):
    assert ratio(room(surface), tl.light_field_rig(CAMERA, NARROW, 3), 0) < 2


@pytest.mark.parametrize("lens", [NARROW, WIDE])
@pytest.mark.parametrize("view", [1, 4, 8])
def test_views_of_a_matte_room_differ_by_parallax(view, lens):
    """Another view's pinhole differs, where views are far apart."""
    scene, rig = chequered_room(), tl.light_field_rig(CAMERA, lens, 3)
    assert ratio(scene, rig, view) < 2
    moved = tl.Rig(
        [*rig.cameras[1:], rig.cameras[0]],
        [*rig.world_from_cams[1:], rig.world_from_cams[0]],
    )
    theirs = [
        block_means(tl.render(scene, moved, spp=32, seed=seed)[view]) for seed in (1, 2)
    ]
    ours = [
        block_means(tl.render_light_field(scene, rig, 32, seed)[view])
        for seed in (3, 4)
    ]
    assert lens is NARROW or error_over_noise(ours, theirs) > 20


def test_highlights_move_between_views():
    """Views focused on a wall of rough metal see its same points. Between them only a lamp's highlight moves."""
    wall = FACING @ np.diag([9.0, 9.0, 1.0, 1.0])
    wall[2, 3] = 2.0
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 100.0}}
    bulb = {"type": "sphere", "center": [0.2, 0.1, -1.0], "radius": 0.1}
    things = (
        SceneObject("wall", {"type": "rectangle"}, "metal", wall),
        SceneObject("bulb", bulb, "metal", emitter=glow),
    )
    metal = {"type": "roughconductor", "material": "Cu", "alpha": 0.2}
    scene = Scene(
        "wall",
        things,
        {"metal": metal},
        HERE,
        (1.0, 3.0),
        {},
        {"type": "path", "max_depth": 2},
    )
    rig = tl.light_field_rig(CAMERA, tl.ThinLens(0.1, 2.0), 3)
    ours, theirs = (np.array(images, np.float64) for images in (
        tl.render_light_field(scene, rig, 256), tl.render(scene, rig, spp=256, seed=1)
    ))  # fmt: skip
    for a, b in ((3, 5), (1, 7), (0, 4)):
        found, expected = (images[b] - images[a] for images in (ours, theirs))
        assert np.abs(expected).mean() > 0.005 * theirs.mean()
        assert (found * expected).sum() / np.square(expected).sum() == pytest.approx(
            1, abs=0.05
        )


def test_a_matte_plane_under_a_uniform_sky_has_its_albedo():
    """A grey wall that faces a sky of radiance 1 all around reflects its albedo, in all views."""
    pose = FACING @ np.diag([9.0, 9.0, 1.0, 1.0])
    pose[2, 3] = 2.0
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.1]}}
    wall = SceneObject("wall", {"type": "rectangle"}, "grey", pose)
    scene = Scene(
        "wall",
        (wall,),
        {"grey": grey},
        HERE,
        (1.0, 3.0),
        sky().lights,
        {"type": "path", "max_depth": 4},
    )
    views = np.array(
        tl.render_light_field(scene, tl.light_field_rig(CAMERA, WIDE, 3), 64)
    )
    np.testing.assert_allclose(
        views.mean(axis=(1, 2)), np.tile([0.6, 0.3, 0.1], (9, 1)), rtol=2e-3
    )


@pytest.mark.parametrize("views", [1, 2])
def test_black_parts_of_a_texture_do_not_darken_the_rest(views):
    """A chequered wall of black and white, finer than pixels, under a sky of 1: some cells have only black samples."""
    wall = FACING @ np.diag([3.0, 3.0, 1.0, 1.0])
    wall[2, 3] = 2.0
    ends = {f"color{i}": {"type": "rgb", "value": float(i)} for i in range(2)}
    check = {"type": "checkerboard", **ends, "to_uv": np.diag([120.0, 120.0, 1.0, 1.0])}
    materials = {"check": {"type": "diffuse", "reflectance": check}}
    thing = SceneObject("wall", {"type": "rectangle"}, "check", wall)
    scene = Scene(
        "wall",
        (thing,),
        materials,
        HERE,
        (1.0, 3.0),
        sky().lights,
        {"type": "path", "max_depth": 2},
    )
    rig = tl.light_field_rig(CAMERA, NARROW, views)
    means = [np.mean(tl.render_light_field(scene, rig, 16, seed)) for seed in range(8)]
    assert np.mean(means) == pytest.approx(0.5, rel=0.02)


def test_a_plane_between_the_views_reflects_its_albedo():
    """A white floor of two sides, that some views see from above and others from below, under a sky of 1."""
    floor = np.array([[3.0, 0, 0, 0], [0, 0, 1, 0.12], [0, -3, 0, 3.2], [0, 0, 0, 1]])
    white = {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
    }
    thing = SceneObject("floor", {"type": "rectangle"}, "white", floor)
    scene = Scene(
        "floor",
        (thing,),
        {"white": white},
        HERE,
        (0.2, 6.0),
        sky().lights,
        {"type": "path", "max_depth": 2},
    )
    views = np.array(
        tl.render_light_field(scene, tl.light_field_rig(CAMERA, WIDE, 5), 64)
    )
    np.testing.assert_allclose(views.mean(axis=(1, 2, 3)), 1, rtol=5e-3)


def test_light_of_projectors_is_exact():
    """Directly from a projector alone, pixels inside the pattern's squares have no noise and are those of `render`."""
    beam = Projector(np.eye(4), CAMERA, patterns.checker(48, 36, 8), 10.0, band="rgb")
    scene = chequered_room().with_ambient(0)
    rig = tl.light_field_rig(CAMERA, NARROW, 3).with_projectors([beam])
    assert ratio(scene, rig, 0) < 2


def test_near_infrared_is_added_to_colours():
    scene = chequered_room()
    both = tl.light_field_rig(CAMERA.replace(band="rgb+nir"), NARROW, 2)
    assert ratio(scene, both, 3) < 2


def test_a_hidden_sky_lights_but_is_not_seen():
    scene = chequered_room().lit_by(Sky(np.ones((4, 8, 3), np.float32), visible=False))
    up = np.diag([1.0, -1.0, -1.0, 1.0])  # away from the room
    assert not np.any(
        tl.render_light_field(scene, tl.light_field_rig(CAMERA, NARROW, 2, up), 4)
    )
    assert ratio(scene, tl.light_field_rig(CAMERA, NARROW, 3), 8) < 2


def test_images_do_not_depend_on_the_number_of_threads():
    scene, rig = room("lacquer"), tl.light_field_rig(CAMERA, NARROW, 3)
    usual, images = drjit.thread_count(), []
    try:
        for threads in (2, 3):
            drjit.set_thread_count(threads)
            images.append(tl.render_light_field(scene, rig, 20, seed=5))
    finally:
        drjit.set_thread_count(usual)
    np.testing.assert_array_equal(*images)
    assert np.any(images[0][0] != tl.render_light_field(scene, rig, 20, seed=6)[0])


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_paths_end_where_they_do_in_other_images(depth):
    scene = room("lacquer")
    scene = Scene(
        "room",
        scene.objects,
        scene.materials,
        HERE,
        (1.0, 6.0),
        scene.lights,
        {"type": "path", "max_depth": depth},
    )
    assert ratio(scene, tl.light_field_rig(CAMERA, NARROW, 3), 4) < 2


def test_what_shares_no_light_is_refused():
    scene, rig = chequered_room(), tl.light_field_rig(CAMERA, NARROW, 2)
    turned = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    with pytest.raises(InputError, match="parallel axes"):
        tl.render_light_field(scene, tl.Rig([CAMERA, CAMERA], [HERE, turned]))
    with pytest.raises(InputError, match="see the same bands"):
        tl.render_light_field(
            scene, tl.Rig([CAMERA, CAMERA.replace(band="nir")], [HERE, HERE])
        )
    with pytest.raises(InputError, match="spp"):
        tl.render_light_field(scene, rig, 0)
    direct = Scene(
        "room",
        scene.objects,
        scene.materials,
        HERE,
        (1.0, 6.0),
        scene.lights,
        {"type": "direct"},
    )
    with pytest.raises(InputError, match="another integrator than 'path'"):
        tl.render_light_field(direct, rig)
