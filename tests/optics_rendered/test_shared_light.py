"""Light fields of shared light: each view is what a pinhole camera sees that is rendered by itself."""

from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    block_means,
    chequered_room,
    diffuse,
    error_over_noise,
    facing,
    glow,
    rgb,
    scene_of,
    wall_of,
)
from twinlens.camera import Projector, patterns
from twinlens.errors import InputError
from twinlens.rendering import backend
from twinlens.scenes import SceneObject, Sky

backend()
import drjit  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
NARROW = tl.ThinLens(0.03, 2.0)
WIDE = tl.ThinLens(0.3, 2.0)
CLOTH = {"type": "twosided", "bsdf": {"type": "diffuse"}}
LACQUER = {"type": "roughplastic", "alpha": 0.15, "nonlinear": True}
SURFACES = {
    "rough metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.3},
    "polished metal": {"type": "roughconductor", "material": "Cu", "alpha": 0.03},
    "mirror": {"type": "conductor", "material": "Ag"},
    "lacquer": LACQUER,
    "glaze": {"type": "plastic"},
    "glass": {"type": "dielectric"},
    "frosted glass": {"type": "roughdielectric", "alpha": 0.3},
    "gauze": {"type": "mask", "opacity": 0.5, "nested": CLOTH},
    "paper": {"type": "principledthin", "diff_trans": 1.0},
}


def narrow_rig(side=3):
    return tl.light_field_rig(CAMERA, NARROW, side)


def ratio(scene: tl.Scene, rig: tl.Rig, view: int, spp: int = 128) -> float:
    """The squared error of a view's means over 4 x 4 pixels against pinholes, over its expectation from noise."""
    camera = rig.cameras[view]
    pose = rig.world_from_cams[view]
    alone = tl.Rig([camera], [pose], projectors=rig.projectors)
    theirs = [tl.render(scene, alone, spp=spp, seed=seed)[0] for seed in (1, 2)]
    ours = [tl.render_light_field(scene, rig, spp, seed)[view] for seed in (3, 4)]
    return error_over_noise([*map(block_means, ours)], [*map(block_means, theirs)])


QUICK = ("mirror", "glass")  # rough metal: test_highlights_move_between_views
SLOW = (
    pytest.param(surface, marks=pytest.mark.slow)
    for surface in SURFACES
    if surface not in QUICK
)


@pytest.mark.parametrize("surface", [*QUICK, *SLOW])
def test_a_view_is_what_a_pinhole_sees(surface):
    assert ratio(chequered_room(surface=SURFACES[surface]), narrow_rig(), 0) < 2


@pytest.mark.parametrize("lens", [NARROW, WIDE])
@pytest.mark.parametrize("view", [pytest.param(1, marks=pytest.mark.slow), 8])
def test_views_of_a_matte_room_differ_by_parallax(view, lens):
    """Another view's pinhole differs, where views are far apart."""
    scene = chequered_room()
    rig = tl.light_field_rig(CAMERA, lens, 3)
    assert ratio(scene, rig, view) < 2
    if lens is WIDE:
        cameras = rig.cameras
        poses = rig.world_from_cams
        turned = tl.Rig([*cameras[1:], cameras[0]], [*poses[1:], poses[0]])
        theirs = [tl.render(scene, turned, spp=32, seed=seed)[view] for seed in (1, 2)]
        ours = [tl.render_light_field(scene, rig, 32, seed)[view] for seed in (3, 4)]
        blocks = [[*map(block_means, images)] for images in (ours, theirs)]
        assert error_over_noise(*blocks) > 20


def test_highlights_move_between_views():
    """Views focused on a wall of rough metal see its same points. Between them only a lamp's highlight moves."""
    bulb = {"type": "sphere", "center": [0.2, 0.1, -1.0], "radius": 0.1}
    wall_pose = facing((0.0, 0.0, 2.0), 9.0)
    scene = scene_of(
        SceneObject("wall", {"type": "rectangle"}, "metal", wall_pose),
        SceneObject("bulb", bulb, "metal", emitter=glow(100.0)),
        metal={"type": "roughconductor", "material": "Cu", "alpha": 0.2},
    )
    rig = tl.light_field_rig(CAMERA, tl.ThinLens(0.1, 2.0), 3)
    ours = np.array(tl.render_light_field(scene, rig, 256), np.float64)
    theirs = np.array(tl.render(scene, rig, spp=256, seed=1), np.float64)
    for a, b in ((3, 5), (1, 7), (0, 4)):
        change, expected = (images[b] - images[a] for images in (ours, theirs))
        assert np.abs(expected).mean() > 0.005 * theirs.mean()
        slope = (change * expected).sum() / np.square(expected).sum()
        assert slope == pytest.approx(1, abs=0.05)


def test_a_matte_plane_under_a_uniform_sky_has_its_albedo():
    """A wall that faces a sky of radiance 1 all around reflects its albedo, in all views."""
    albedo = [0.6, 0.3, 0.1]
    scene = wall_of(diffuse(albedo), 2.0, depth=4)
    views = tl.render_light_field(scene, tl.light_field_rig(CAMERA, WIDE, 3), 64)
    means = np.mean(views, axis=(1, 2))
    np.testing.assert_allclose(means, np.tile(albedo, (9, 1)), rtol=2e-3)


@pytest.mark.parametrize("side", [1, 2])
def test_black_parts_of_a_texture_do_not_darken_the_rest(side):
    """A chequered wall of black and white, finer than pixels, under a sky of 1: some cells have only black samples."""
    ends = {"color0": rgb(0.0), "color1": rgb(1.0)}
    check = {"type": "checkerboard", **ends, "to_uv": np.diag([120.0, 120.0, 1.0, 1.0])}
    scene = wall_of({"type": "diffuse", "reflectance": check}, 2.0, half=3.0)
    rig = narrow_rig(side)
    means = [np.mean(tl.render_light_field(scene, rig, 16, seed)) for seed in range(8)]
    assert np.mean(means) == pytest.approx(0.5, rel=0.02)


def test_a_plane_between_the_views_reflects_its_albedo():
    """A white floor of two sides, that some views see from above and others from below, under a sky of 1."""
    pose = np.array([[3.0, 0, 0, 0], [0, 0, 1, 0.12], [0, -3, 0, 3.2], [0, 0, 0, 1]])
    floor = SceneObject("floor", {"type": "rectangle"}, "white", pose)
    white = {"type": "twosided", "bsdf": diffuse(1.0)}
    scene = scene_of(floor, sky_radiance=1.0, white=white)
    views = tl.render_light_field(scene, tl.light_field_rig(CAMERA, WIDE, 5), 64)
    np.testing.assert_allclose(np.mean(views, axis=(1, 2, 3)), 1, rtol=5e-3)


def test_light_of_projectors_is_exact():
    """Directly from a projector alone, pixels inside the pattern's squares have no noise and are those of `render`."""
    beam = Projector(HERE, CAMERA, patterns.checker(48, 36, 8), 10.0, band="rgb")
    scene = chequered_room().with_ambient(0)
    assert ratio(scene, narrow_rig().with_projectors([beam]), 0) < 2


def test_near_infrared_is_added_to_colours():
    both = tl.light_field_rig(CAMERA.replace(band="rgb+nir"), NARROW, 2)
    assert ratio(chequered_room(), both, 3) < 2


def test_a_hidden_sky_lights_but_is_not_seen():
    scene = chequered_room().lit_by(Sky(np.ones((4, 8, 3), np.float32), visible=False))
    away_from_room = np.diag([1.0, -1.0, -1.0, 1.0])
    rig = tl.light_field_rig(CAMERA, NARROW, 2, away_from_room)
    assert not np.any(tl.render_light_field(scene, rig, 4))
    assert ratio(scene, narrow_rig(), 8) < 2


def test_images_do_not_depend_on_the_number_of_threads():
    scene = chequered_room(surface=LACQUER)
    rig = narrow_rig()
    usual = drjit.thread_count()
    images = []
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
    assert ratio(chequered_room(depth, surface=LACQUER), narrow_rig(), 4) < 2


INFRARED = CAMERA.replace(band="nir")
TURNED = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
ROOM = chequered_room()
DIRECT = replace(ROOM, integrator={"type": "direct"})


@pytest.mark.parametrize(
    ("scene", "rig", "spp", "message"),
    [
        (ROOM, tl.Rig([CAMERA] * 2, [HERE, TURNED]), 4, "parallel axes"),
        (ROOM, tl.Rig([CAMERA, INFRARED], [HERE] * 2), 4, "see the same bands"),
        (ROOM, narrow_rig(), 0, "spp"),
        (DIRECT, narrow_rig(), 4, "another integrator than 'path'"),
    ],
)
def test_what_shares_no_light_is_refused(scene, rig, spp, message):
    with pytest.raises(InputError, match=message):
        tl.render_light_field(scene, rig, spp)
