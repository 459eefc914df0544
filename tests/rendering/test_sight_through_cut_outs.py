"""What guides and hidden skies take of partly opaque cards: closed forms, and images that are not denoised."""

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.rendering.cut_out_cases import facing
from twinlens.camera import Pinhole, Projector
from twinlens.rendering.build import build
from twinlens.rendering.guides import render_guides
from twinlens.scenes import Scene, SceneObject, Sky

CAMERA = tl.Camera.from_fov(24, 24, fov_x_deg=30)
HERE = np.eye(4)
ALONE = tl.Rig((CAMERA,), (HERE,))
CHALK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.5}}
PLASTIC = {"type": "plastic", "diffuse_reflectance": 0.5}
WHITE = np.ones((3, 6, 3), np.float32)
INNER = slice(6, -6)


def slow(value):
    return pytest.param(value, marks=pytest.mark.slow)


def masked(opacity, bsdf=CHALK):
    return {"type": "mask", "opacity": opacity, "bsdf": bsdf}


def card(name, material, z, size=6.0):
    return SceneObject(name, {"type": "rectangle"}, material, facing((0, 0, z), size))


def scene_of(*objects, lights=None, integrator=None, **materials):
    lights = lights or {}
    integrator = integrator or {"type": "path"}
    materials = {"chalk": CHALK, **materials}
    return Scene("sight", objects, materials, HERE, (0.5, 10.0), lights, integrator)


def by_lamp(scene, denoise, spp=256):
    intrinsics = tl.Camera.from_fov(16, 16, fov_x_deg=60)
    lamp = Projector(HERE, intrinsics, power=50.0, band="rgb")
    rig = tl.Rig((CAMERA,), (HERE,), projectors=(lamp,))
    (image,) = tl.render(scene, rig, spp=spp, seed=1, denoise=denoise)
    return image[INNER, INNER].mean()


@pytest.mark.parametrize(
    "layers", [slow([0.1]), slow([0.3]), [0.45], slow([0.55]), [0.3, 0.45]]
)
def test_denoised_cards_keep_the_light_of_a_projector(layers):
    """Beside nothing: all light is the projector's, and the raw image is the reference."""
    cards = [card(f"card{i}", f"soft{i}", 2 + 0.5 * i) for i in range(len(layers))]
    materials = {f"soft{i}": masked(opacity) for i, opacity in enumerate(layers)}
    scene = scene_of(*cards, **materials)
    raw, denoised = (by_lamp(scene, denoise) for denoise in (False, True))
    assert denoised == pytest.approx(raw, rel=0.05)


@pytest.mark.parametrize("rr_depth", [1, 3])
def test_denoised_walls_keep_the_light_of_a_projector_behind_cards(rr_depth):
    path = {"type": "path", "rr_depth": rr_depth}
    cards = [card(f"card{i}", "soft", 1.5 + 0.3 * i) for i in range(3)]
    wall = card("wall", "chalk", 4.0)
    scene = scene_of(*cards, wall, integrator=path, soft=masked(0.25))
    raw, denoised = (by_lamp(scene, denoise) for denoise in (False, True))
    assert denoised == pytest.approx(raw, rel=0.05)


# Fresnel's reflectance at normal incidence, of plastic with Mitsuba's default indices.
FRESNEL = ((1.49 - 1.000277) / (1.49 + 1.000277)) ** 2


def coat_of(*objects, **materials):
    """The coat in the middle of the image, where the coat shows a wall of albedo 0.5 behind the camera."""
    pose = facing((0, 0, -3), 20.0, towards=(0, 0, 1))
    behind = SceneObject("behind", {"type": "rectangle"}, "chalk", pose)
    scene = scene_of(*objects, behind, lights={"sky": {"type": "constant"}}, **materials)  # fmt: skip
    passes = [("independent", 16, 1)]
    built = build(scene)
    pose = built.frame.affine(HERE)
    guides = render_guides(built, CAMERA, pose, Pinhole(), passes)
    return guides.coat[10:14, 10:14].mean()


def blend(weight, first, second):
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


@pytest.mark.parametrize(
    ("share", "material"),
    [
        (1.0, PLASTIC),
        (1.0, masked(1.0, PLASTIC)),
        (0.6, masked(0.6, PLASTIC)),
        (0.2, masked(0.2, {"type": "twosided", "bsdf": PLASTIC})),
        (0.0, masked(0.0, PLASTIC)),
        (0.3, blend(0.3, CHALK, {"type": "twosided", "bsdf": PLASTIC})),
        (0.7, blend(0.3, {"type": "twosided", "bsdf": PLASTIC}, CHALK)),
        (1.0, blend(0.3, PLASTIC, PLASTIC)),
        (0.0, blend(1.0, PLASTIC, {"type": "diffuse"})),
    ],
)
def test_coats_are_weighted_by_their_share(share, material):
    """And show nothing of the white wall behind them."""
    wall = card("wall", "white", 4.0)
    white = {"type": "diffuse", "reflectance": 1.0}
    coat = coat_of(card("coated", "coated", 2.0), wall, coated=material, white=white)
    assert coat == pytest.approx(0.5 * share * FRESNEL, rel=0.05, abs=1e-7)


@pytest.mark.parametrize("opacity", [0.0, 0.4])
def test_coats_behind_cut_outs_are_seen(opacity):
    """The wall is turned: its coat shows what is beside the card in front of it."""
    turned = facing((0, 0, 4), 3.0, towards=(0.5, 0, -1))
    wall = SceneObject("wall", {"type": "rectangle"}, "coated", turned)
    front = card("front", "soft", 1.0, 0.5)
    coat = coat_of(wall, front, coated=PLASTIC, soft=masked(opacity))
    assert coat == pytest.approx(0.5 * (1 - opacity) * FRESNEL, rel=0.05)


def under_hidden_sky(*objects, denoise=False, integrator=None, **materials):
    """The middle of the image under a sky of radiance 1 that cameras do not see, and the truth there."""
    scene = scene_of(*objects, integrator=integrator, **materials)
    scene = scene.lit_by(Sky(WHITE, visible=False))
    (image,) = tl.render(scene, ALONE, spp=256, seed=1, denoise=denoise)
    (truth,) = tl.ground_truth(scene, ALONE)
    return image[INNER, INNER].mean(), np.isfinite(truth.depth[INNER, INNER]).all()


HIDDEN = [[0.0], [0.3], [0.8], [0.0, 0.4], [0.4, 1.0]]
DENOISED = [[0.3], [0.4, 1.0], *map(slow, [[0.0], [0.8], [0.0, 0.4]])]


@pytest.mark.parametrize("layers", HIDDEN)
def test_a_hidden_sky_is_black_through_cut_outs(layers):
    assert_dark_behind(layers, denoise=False)


@pytest.mark.parametrize("layers", DENOISED)
def test_a_hidden_sky_is_black_through_cut_outs_of_denoised_images(layers):
    assert_dark_behind(layers, denoise=True)


def assert_dark_behind(layers, denoise):
    """A plane of reflectance 0.5 is as bright as half the sky; what it lets through is black or the next plane."""
    cards = [card(f"card{i}", f"soft{i}", 2 + 0.1 * i, 400.0) for i in range(len(layers))]  # fmt: skip
    materials = {f"soft{i}": masked(opacity) for i, opacity in enumerate(layers)}
    light, has_truth = under_hidden_sky(*cards, denoise=denoise, **materials)
    assert has_truth == (max(layers) >= 0.5)
    if len(layers) == 1 or layers[0] == 0:
        assert light == pytest.approx(0.5 * layers[-1], rel=0.04, abs=1e-6)
    else:  # the second plane gets the light that passes the first, and less than the sky's
        reflected = 0.5 * layers[0]
        assert reflected < light < 0.5


@pytest.mark.parametrize("kind", ["path", "volpath", "direct"])
def test_all_integrators_hide_the_sky_where_truth_hits_nothing(kind):
    hole, integrator = masked(0.0), {"type": kind}
    light, has_truth = under_hidden_sky(card("hole", "hole", 2.0), integrator=integrator, hole=hole)  # fmt: skip
    assert not has_truth
    assert light == 0


def test_mirrors_behind_cut_outs_show_a_hidden_sky():
    mirror = {"type": "conductor", "material": "none"}
    cards = card("hole", "hole", 2.0), card("mirror", "mirror", 3.0)
    light, _ = under_hidden_sky(*cards, hole=masked(0.0), mirror=mirror)
    assert light == pytest.approx(1.0, rel=1e-4)


def test_guides_of_a_hidden_sky_are_black_through_cut_outs():
    scene = scene_of(card("soft", "soft", 2.0), soft=masked(0.4))
    built = build(scene.lit_by(Sky(WHITE, visible=False)))
    pose = built.frame.affine(HERE)
    guides = render_guides(built, CAMERA, pose, Pinhole(), [("independent", 16, 1)])
    np.testing.assert_allclose(guides.albedo[INNER, INNER], 0.4 * 0.5, rtol=1e-4)


@pytest.mark.parametrize("opacity", [0.0, 0.4])
@pytest.mark.parametrize(
    ("kind", "key"), [("normalmap", "normalmap"), ("bumpmap", "texture")]
)
def test_masks_below_flat_bumps_are_cut_outs(tmp_path, opacity, kind, key):
    file = tmp_path / "flat.png"
    cv2.imwrite(str(file), np.full((2, 2, 3), (255, 128, 128), np.uint8))
    picture = {"type": "bitmap", "filename": str(file), "raw": True}
    bumped = {"type": kind, key: picture, "bsdf": masked(opacity)}
    light, has_truth = under_hidden_sky(card("soft", "soft", 2.0, 400.0), soft=bumped)
    assert not has_truth
    assert light == pytest.approx(0.5 * opacity, rel=0.04, abs=1e-6)
