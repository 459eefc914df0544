"""Light falls through cut-outs: beside scenes without them, Mitsuba's volpath, and closed forms of shadows."""

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

import twinlens as tl
from tests.rendering.cut_out_cases import Card, blobs, cast, facing
from twinlens.camera import Projector
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.materials import Bitmap, Color, lambert

CAMERA = tl.Camera.from_fov(32, 24, fov_x_deg=40)
ALONE = tl.Rig((CAMERA,), (np.eye(4),))
CHALK = {"type": "twosided", "bsdf": {"type": "diffuse"}}
HOLE = {"type": "mask", "opacity": 0.0, "bsdf": CHALK}
SUN = {"sun": {"type": "directional", "direction": [0.2, 0.1, 1.0]}}
SKY = {"sky": {"type": "constant"}}
SHORT = {"type": "path", "max_depth": 4}


def sheet(name, material, z, size=12.0):
    return SceneObject(name, {"type": "rectangle"}, material, facing((0, 0, z), size))


def scene_of(*objects, lights=SUN, integrator=SHORT, **materials):
    materials = {"chalk": CHALK, "hole": HOLE, **materials}
    return Scene(
        "light", objects, materials, np.eye(4), (0.5, 10.0), lights, integrator
    )


def two_walls():
    """A wall, and a second one at an angle that lights it."""
    pose = facing((2.5, 0, 3), 6.0, towards=(-1, 0, -0.3))
    side = SceneObject("side", {"type": "rectangle"}, "chalk", pose)
    return sheet("wall", "chalk", 4.0), side


@pytest.mark.parametrize(
    ("lights", "denoise"), [(SUN, False), (SKY, False), (SUN, True)]
)
def test_surfaces_that_are_not_there_change_no_light(lights, denoise):
    """Twelve of them, more than `max_depth`, and between the surfaces too."""
    holes = [sheet(f"hole{i}", "hole", 0.5 + 0.3 * i) for i in range(12)]
    with_holes, without = (
        scene_of(*two_walls(), *more, lights=lights) for more in (holes, ())
    )
    (image,), (expected,) = (
        tl.render(scene, ALONE, spp=64, seed=1, denoise=denoise)
        for scene in (with_holes, without)
    )
    assert expected.mean() > 0.05
    np.testing.assert_allclose(image.mean(), expected.mean(), rtol=0.01)
    difference = image.mean(axis=-1) - expected.mean(axis=-1)
    assert np.abs(difference).max() < 0.15 * expected.mean()


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_light_through_leaves_is_that_of_volpath(mode):
    """Mitsuba's volpath counts no surface that it passes, and finds lights behind them."""
    leaf = Card("leaf", facing((0.2, 0.1, 3.2), 1.5, 0.3), blobs(9, 12, 1), mode=mode)
    objects = (*two_walls(), leaf.scene_object("leaf"))
    lights = {**SUN, "sky": {"type": "constant", "radiance": 0.3}}
    images = [
        tl.render(
            scene_of(*objects, lights=lights, integrator=integrator, leaf=leaf.material()),
            ALONE, spp=256, seed=2,
        )[0]
        for integrator in (SHORT, {"type": "volpath", "max_depth": 4})
    ]  # fmt: skip
    ours, expected = (image.mean(axis=-1) for image in images)
    np.testing.assert_allclose(ours.mean(), expected.mean(), rtol=0.005)
    blocks = [image.reshape(6, 4, 8, 4).mean(axis=(1, 3)) for image in (ours, expected)]
    np.testing.assert_allclose(*blocks, rtol=0.06)


@pytest.mark.parametrize("denoise", [False, True])
def test_a_projector_lights_what_the_truth_calls_lit(denoise):
    """A leaf between the lamp and the wall, out of the camera's sight: its shadow, in closed form."""
    leaf = Card("leaf", facing((0.75, 0, 2.0), 0.7), blobs(8, 8, 2), 0.5)
    wall = Card("wall", facing((0, 0, 4.0), 12.0), np.ones((1, 1)))
    materials = {"leaf": leaf.material(), "wall": wall.material()}
    objects = (leaf.scene_object("leaf"), wall.scene_object("wall"))
    scene = scene_of(*objects, lights={"dim": {"type": "constant", "radiance": 0.001}}, **materials)  # fmt: skip
    side = np.eye(4)
    side[0, 3] = 1.5
    intrinsics = tl.Camera.from_fov(64, 64, fov_x_deg=90)
    lamp = Projector(side, intrinsics, power=50.0, band="rgb")
    rig = tl.Rig((CAMERA,), (np.eye(4),), projectors=(lamp,))
    (image,) = tl.render(scene, rig, spp=64, seed=1, denoise=denoise)
    seen = tl.projection(scene, rig)
    (truth,) = tl.ground_truth(scene, rig)
    is_wall = truth.object_id == 2

    offset = truth.position.reshape(-1, 3) - side[:3, 3]
    length = np.linalg.norm(offset, axis=1)
    origin = np.broadcast_to(side[:3, 3], offset.shape)
    _, reach, margin = cast([leaf, wall], origin, offset / length[:, None])
    lit = (reach > 0.999 * length).reshape(is_wall.shape)
    sure = (margin > 1e-4).reshape(is_wall.shape) & is_wall
    assert 0.1 < lit[sure].mean() < 0.9
    assert np.array_equal(seen.lit[sure], lit[sure])

    # Pixels whose neighbours agree are wholly in the light or wholly in the shadow.
    light = image.mean(axis=-1)
    bright = minimum_filter(lit & sure, 3)
    dark = minimum_filter(~lit & sure, 3)
    assert bright.sum() > 20
    assert dark.sum() > 20
    assert light[dark].max() < 0.2 * light[bright].min()


@pytest.mark.parametrize("is_textured", [False, True])
def test_nothing_shines_where_nothing_is(is_textured):
    """A card that emits light, its left half cut out, in the dark."""
    alpha = np.repeat([[0.0, 1.0]], 2, axis=0).astype(np.float32)
    opacity = Bitmap(alpha, "nearest")
    glow = Color((2.0, 1.0, 0.5))
    emission = Bitmap(np.full((2, 2, 3), glow.rgb, np.float32), "nearest")
    paint = lambert(
        0.0,
        opacity=opacity,
        alpha_cutoff=0.5,
        emission=emission if is_textured else glow,
        two_sided=True,
    )
    card = Card("card", facing((0, 0, 2), 1.0), alpha, filter="nearest")
    scene = scene_of(card.scene_object("paint"), lights={}, paint=paint)
    (image,) = tl.render(scene, ALONE, spp=16, seed=1)
    directions = CAMERA.rays(CAMERA.pixel_grid()).reshape(-1, 3)
    first, _, _ = cast([card], np.zeros_like(directions), directions)
    is_there = (first == 0).reshape(image.shape[:2])
    inside, outside = minimum_filter(is_there, 3), minimum_filter(~is_there, 3)
    assert inside.sum() > 10
    np.testing.assert_allclose(image[inside], np.tile(glow.rgb, (inside.sum(), 1)), rtol=1e-4)  # fmt: skip
    assert image[outside].max() == 0
