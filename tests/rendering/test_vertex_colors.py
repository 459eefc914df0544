"""Colours of vertices times a texture, in rendered images, ground truth and guides, against closed forms."""

import numpy as np
import pytest

import twinlens as tl
from tests.scenes.gltf_files import (
    picture,
    square,
    with_extensions,
    write,
    write_colored,
)
from twinlens.rendering.build import build
from twinlens.rendering.guides import render_guides
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.assets import SceneContext, linear_from_srgb
from twinlens.scenes.model_files import read_model

SKY = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
EYE = tl.geometry.rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.5, 4.0]))
CAMERA = tl.Camera(24, 24, 96.0, 96.0, 11.5, 11.5)
"""The square covers its image: a pixel is 1/24 m."""

TEXELS = np.array([[[1.0, 0.4, 0.2], [0.2, 0.6, 1.0]], [[0.8, 0.8, 0.0], [1.0, 1.0, 1.0]]])  # fmt: skip
COLORS = np.array([[1, 0.2, 0.4, 1], [0.4, 1, 0, 0.8], [0.2, 0.4, 1, 0.2], [1, 1, 1, 0.4]])  # fmt: skip
LINEAR = {"baseColorTexture": picture(TEXELS), "metallicFactor": 0.0, "roughnessFactor": 1.0}  # fmt: skip
NEAREST = {"samplers": [{"magFilter": 9728}], "textures/0/sampler": 0}
LAMBERT = with_extensions(specular={"specularFactor": 0.0})


def scene_of(path):
    model = read_model(path, SceneContext(path.parent))
    item = SceneObject("square", model.mesh, tuple(model.materials), np.eye(4))
    return Scene("square", (item,), model.materials, EYE, (1.0, 9.0), SKY)


def seen(scene, camera=CAMERA, spp=64):
    rig = tl.Rig([camera], [EYE])
    return tl.render(scene, rig, tl.Pinhole(), spp=spp, seed=1)[0]


def places():
    """(u, v) of the centre of each pixel, (24, 24) each; v up."""
    along = (np.arange(24) + 0.5) / 24
    return np.meshgrid(along, along[::-1])


def of_vertices(values):
    """Values (4, C) of the square's corners at the centre of each pixel: linear on (0, 1, 2) and on (0, 2, 3)."""
    u, v = (axis[..., None] for axis in places())
    lower = values[0] + u * (values[1] - values[0]) + v * (values[2] - values[1])
    upper = values[0] + v * (values[3] - values[0]) + u * (values[2] - values[3])
    return np.where(u >= v, lower, upper)


def of_texels(texels):
    """The nearest of 2x2 texels at the centre of each pixel; row 0 is the top."""
    u, v = places()
    return texels[(v < 0.5).astype(int), (u >= 0.5).astype(int)]


STORED = [("<f4", 3), ("<f4", 4), ("u1", 3), ("u1", 4), ("<u2", 3), ("<u2", 4)]


@pytest.mark.parametrize(("dtype", "channels"), STORED)
def test_radiance_and_albedo_are_texture_times_colors(tmp_path, dtype, channels):
    """Under a constant sky of radiance 1 a Lambertian surface has the radiance of its reflectance."""
    factor = [0.5, 1.0, 0.75, 1.0]
    path = write_colored(tmp_path / "m.glb", COLORS[:, :channels], dtype, LAMBERT | NEAREST,
                         baseColorFactor=factor, **LINEAR)  # fmt: skip
    scene = scene_of(path)
    stored = np.round(255 * TEXELS) / 255
    expected = of_vertices(COLORS[:, :3]) * of_texels(linear_from_srgb(stored)) * factor[:3]  # fmt: skip
    # Between two texels and on the diagonal a pixel is a mean of both sides.
    inside = np.abs(np.subtract(*places())) > 0.01
    bound = {"<f4": 2e-3, "u1": 4e-3, "<u2": 2e-3}[dtype]
    error = (seen(scene) - expected)[inside]
    assert np.abs(error).max() < 0.03  # of the noise of 64 samples
    assert np.abs(error.mean(axis=0)).max() < 1e-3
    guides = render_guides(build(scene), CAMERA, EYE, tl.Pinhole(), [("multijitter", 64, 0)])  # fmt: skip
    np.testing.assert_allclose(guides.albedo[inside], expected[inside], atol=bound)


OTHER_LOOKS = [(0.0, 0.2, 0.0), (0.0, 0.8, 1.0), (1.0, 0.3, 1.0)]
LOOKS = [(0.5, 0.5, 0.0), *(pytest.param(*look, marks=pytest.mark.slow) for look in OTHER_LOOKS)]  # fmt: skip
"""Metallic, roughness and the weight of a clear coat."""


@pytest.mark.parametrize(("metallic", "roughness", "coat"), LOOKS)
def test_a_surface_is_that_of_the_product(tmp_path, metallic, roughness, coat):
    """Uniform colours of vertices and of the texture, against one colour without either: all lobes."""
    texel, vertex = np.array([0.8, 0.4, 1.0]), np.array([0.5, 1.0, 0.1])
    look = {"metallicFactor": metallic, "roughnessFactor": roughness}
    coated = with_extensions(clearcoat={"clearcoatFactor": coat})
    colored = write_colored(
        tmp_path / "c.glb", np.tile(vertex, (4, 1)), values=coated,
        baseColorTexture=picture(np.tile(texel, (2, 2, 1))), **look,
    )  # fmt: skip
    product = linear_from_srgb(np.round(255 * texel) / 255) * vertex
    # trimesh writes factors in 8 bits.
    factor = {"materials/0/pbrMetallicRoughness/baseColorFactor": [*product, 1.0]}
    plain = write(tmp_path / "p.glb", square(**look), coated | factor)
    tilted = tl.geometry.look_at(np.array([0.0, -2.5, 2.5]), np.array([0.0, 0.5, 0.0]))
    rig = tl.Rig([tl.Camera(4, 4, 4000.0, 4000.0, 1.5, 1.5)], [tilted])
    means = [
        tl.render(scene_of(path), rig, tl.Pinhole(), spp=1024, seed=1)[0].mean((0, 1))
        for path in (colored, plain)
    ]
    np.testing.assert_allclose(means[0], means[1], rtol=0.02)


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_opacity_is_alpha_of_texture_times_vertices(tmp_path, mode):
    """In the truth a surface is where the product is at least the cutoff, or half; a picture shows the same."""
    alpha = np.array([[1.0, 0.6], [0.4, 1.0]])
    texels = np.dstack([np.ones((2, 2, 3)), alpha])
    cut = {"MASK": 0.3, "BLEND": 0.5}[mode]
    path = write_colored(
        tmp_path / "m.glb", COLORS, values=LAMBERT | NEAREST, alphaMode=mode, alphaCutoff=0.3,
        **LINEAR | {"baseColorTexture": picture(texels)},
    )  # fmt: skip
    opacity = of_vertices(COLORS[:, 3:])[..., 0] * of_texels(np.round(255 * alpha) / 255)  # fmt: skip
    scene = scene_of(path)
    truth = tl.ground_truth(scene, tl.Rig([CAMERA], [EYE]))[0]
    clear = np.abs(opacity - cut) > 0.01
    there = np.isfinite(truth.depth)
    np.testing.assert_array_equal(there[clear], (opacity > cut)[clear])
    color = of_vertices(COLORS[:, :3])
    share = opacity[..., None] if mode == "BLEND" else there[..., None]
    image = seen(scene, spp=256)
    far = np.abs(opacity - cut) > 0.05
    error = np.abs(image - (share * color + (1 - share)))[far]
    assert error.mean() < 0.01


def test_emission_is_not_multiplied_by_colors_of_vertices(tmp_path):
    """glTF 2.0, 3.9.2: COLOR_0 is a factor of the base colour alone."""
    shining = {"emissiveFactor": [0.5, 0.25, 1.0]}
    path = write_colored(tmp_path / "m.glb", np.zeros((4, 3)), values=LAMBERT, **shining, **LINEAR)  # fmt: skip
    np.testing.assert_allclose(seen(scene_of(path)), np.full((24, 24, 3), [0.5, 0.25, 1.0]), atol=1e-5)  # fmt: skip


def test_both_are_read_in_a_scene_of_the_near_infrared(tmp_path):
    """White times grey stays grey in both bands."""
    grey = np.full((2, 2, 3), 0.5)
    look = LINEAR | {"baseColorTexture": picture(grey)}
    colors = np.full((4, 3), 0.4)
    path = write_colored(tmp_path / "m.glb", colors, values=LAMBERT, **look)
    camera = tl.Camera(4, 4, 96.0, 96.0, 1.5, 1.5, band="nir")
    scene = scene_of(path)
    lamp = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}, "nir": 1.0}
    scene = Scene("square", scene.objects, scene.materials, EYE, (1.0, 9.0), {"sky": lamp})  # fmt: skip
    expected = 0.4 * linear_from_srgb(np.array(128 / 255))
    np.testing.assert_allclose(seen(scene, camera).mean((0, 1)), expected, rtol=3e-3)
