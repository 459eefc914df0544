"""Denoised images keep the light and the contrast of fine textures, also where other pixels are black."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, diffuse, facing
from twinlens.camera import Camera, Rig
from twinlens.rendering.denoising import denoise_image
from twinlens.rendering.guides import Guides
from twinlens.scenes import Bitmap, Scene, SceneObject
from twinlens.scenes.scene import Sky

RIG = Rig([Camera.from_fov(96, 72, 50)], [HERE])
DEPTH = 1.2
SPECKLES = np.random.default_rng(1).uniform(0.1, 0.9, (128, 128))
FINE = np.random.default_rng(2).uniform(0.5, 0.55, (128, 128))
CHESS = np.indices((24, 24)).sum(axis=0) % 2.0
SKY = Sky(np.ones((8, 16, 3), np.float32))
HIDDEN = Sky(SKY.pixels, visible=False)


def wall(texture, half=0.8):
    pixels = np.repeat(np.repeat(texture, 4, axis=0), 4, axis=1).astype(np.float32)
    paint = {"type": "diffuse", "reflectance": Bitmap(pixels, filter="nearest")}
    pose = facing((0.0, 0.0, DEPTH), half)
    return SceneObject("wall", {"type": "rectangle"}, "paint", pose), paint


def scene_of(texture, card=None, sky=SKY, half=0.8):
    """A textured wall that fills the view, or not, and a small card of a reflectance before it, in the upper right."""
    shown, paint = wall(texture, half)
    materials, objects = {"paint": paint}, [shown]
    if card is not None:
        materials["card"] = diffuse(card)
        place = facing((0.2, -0.15, 0.75), 0.05)
        objects.append(SceneObject("card", {"type": "rectangle"}, "card", place))
    scene = Scene("wall", tuple(objects), materials, HERE, (0.3, 9.0))
    return scene.lit_by(sky)


SCENES = {
    "speckles": scene_of(SPECKLES),
    "a black card": scene_of(SPECKLES, 0.0),
    "a nearly black card": scene_of(SPECKLES, 0.003),
    "a black card, faint texture": scene_of(FINE, 0.0),
    "black and white": scene_of(CHESS),
    "a hidden sky": scene_of(SPECKLES, sky=HIDDEN, half=0.4),
    "a hidden sky and a black card": scene_of(SPECKLES, 0.0, HIDDEN, half=0.4),
}


QUICK = ("a black card, faint texture", "a hidden sky and a black card")


def quick_or_slow(value, is_quick):
    return pytest.param(value, marks=() if is_quick else pytest.mark.slow)


@pytest.mark.parametrize(
    "name", [quick_or_slow(name, name in QUICK) for name in SCENES]
)
def test_light_and_contrast_are_those_of_a_converged_image(name):
    """The contrast is the factor of the reference's details in the image's, away from the card; noise does not change
    it in the mean. The mean of 576 to 6912 pixels of 16 samples varies by less than 0.1 %."""
    scene = SCENES[name]
    reference = grey(tl.render(scene, RIG, spp=512, seed=1))
    raw = grey(tl.render(scene, RIG, spp=16, seed=2))
    image = grey(tl.render(scene, RIG, spp=16, seed=2, denoise=True))
    assert image.mean() == pytest.approx(reference.mean(), rel=1e-3)
    assert contrast(image, reference) == pytest.approx(1.0, abs=0.02)
    assert rms(image - reference) < rms(raw - reference)


def grey(images):
    return images[0].mean(axis=-1, dtype=np.float64)


def contrast(image, reference):
    """In the lower half, without the borders of a small wall."""
    fine, expected = (
        (picture - gaussian_filter(picture, 2))[40:54, 32:64]
        for picture in (image, reference)
    )
    return (fine * expected).sum() / (expected**2).sum()


def rms(difference):
    return np.sqrt((difference**2).mean())


def test_a_bright_sample_does_not_brighten_what_is_around_it():
    """One pixel that is 100 times as bright as the others."""
    image = np.full((64, 64, 3), 0.5, np.float32)
    features = np.zeros((64, 64, 10), np.float32)
    features[..., :3] = 0.5
    features[..., 5] = 1.0
    image[32, 32] = 50.0
    filtered = denoise_image(image, Guides(features, 16))
    far = np.hypot(*(np.indices((64, 64)) - 32)) > 12
    assert filtered[far] == pytest.approx(0.5, rel=0.01)


def reflected_wall(paint):
    """A square at 45 degrees that fills the view and reflects a textured wall beside it."""
    shown, material = wall(SPECKLES)
    slanted, beside = np.eye(4), np.eye(4)
    normal, along = np.array([1.0, 0.0, -1.0]), np.array([1.0, 0.0, 1.0])
    slanted[:3, 0], slanted[:3, 1] = along, [0.0, 1.5, 0.0]
    slanted[:3, 2], slanted[:3, 3] = normal, [0.0, 0.0, 1.5]
    beside[:3, 0], beside[:3, 1] = [0.0, 0.0, 3.0], [0.0, 3.0, 0.0]
    beside[:3, 2], beside[:3, 3] = [-1.0, 0.0, 0.0], [2.0, 0.0, 1.5]
    mirror = SceneObject("mirror", {"type": "rectangle"}, "coat", slanted)
    shown = SceneObject("wall", {"type": "rectangle"}, "paint", beside)
    materials = {"paint": material, "coat": paint}
    scene = Scene("coat", (mirror, shown), materials, HERE, (0.3, 9.0))
    return scene.lit_by(SKY)


PLASTIC = {
    reflectance: {
        "type": "plastic",
        "diffuse_reflectance": {"type": "rgb", "value": reflectance},
    }
    for reflectance in (0.0, 0.1, 0.5)
}


@pytest.mark.parametrize(
    "reflectance", [quick_or_slow(share, share == 0.1) for share in PLASTIC]
)
def test_reflections_in_plastic_keep_their_contrast(reflectance):
    """From 16 samples. Two references, so that their noise has no share in the details of both."""
    scene = reflected_wall(PLASTIC[reflectance])
    first, second = (
        details(tl.render(scene, RIG, spp=512, seed=seed)) for seed in (1, 2)
    )
    image = details(tl.render(scene, RIG, spp=16, seed=3, denoise=True))
    measured = (image * (first + second)).sum() / (2 * first * second).sum()
    assert measured == pytest.approx(1.0, abs=0.1)


def details(images):
    image = grey(images)
    return (image - gaussian_filter(image, 2))[8:-8, 8:-8]
