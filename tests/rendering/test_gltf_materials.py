"""Materials of glTF files in rendered images, against closed forms and a naive integrator of glTF's reflectance."""

import numpy as np
import pytest
import trimesh

import twinlens as tl
from tests.rendering.gltf_brdf import reflected
from tests.scenes.gltf_files import picture, square, with_extensions, write
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.rendering.build import build
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.gltf_materials import PbrMaterial, Textures, material_of
from twinlens.scenes.materials import Bitmap
from twinlens.scenes.model_files import read_model
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene import Mesh, Scene, SceneObject

SPACING = 200.0  # metres: no object lights another
DARK = (0.1, 0.1, 0.1)
ORANGE = (0.8, 0.3, 0.05)
WHITE = (1.0, 1.0, 1.0)
FINISHES = ((0.0, 0.1), (0.0, 0.5), (0.0, 1.0), (1.0, 0.2), (1.0, 1.0))
BALLS = [(color, *finish) for color in (DARK, ORANGE, WHITE) for finish in FINISHES]
PLANES = [((0.5, 0.5, 0.5), 0.0, 0.4), ((0.2, 0.4, 0.9), 1.0, 0.5), ((0.9, 0.6, 0.1), 0.5, 0.3), ((0, 0, 0), 0.0, 0.2),
          ((0.6, 0.6, 0.6), 0.2, 0.8)]  # fmt: skip
LOOKS = [*BALLS, *PLANES]
"""Base colour, metallic and roughness."""

FACING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns a surface's normal, z, to -y of the world."""


def constant(directions):
    return np.ones((*directions.shape[:-1], 3))


def gradient(directions):
    """Brighter and bluer towards +z of the world."""
    z = directions[..., 2:]
    return np.concatenate([0.6 + 0.3 * z, 0.7 + 0.5 * z, 0.8 + 0.75 * z], axis=-1)


def panorama(sky, rows=128):
    """`sky`, which depends on z alone, as an environment map, the top row at +z."""
    z = np.cos(np.pi * (np.arange(rows) + 0.5) / rows)
    column = sky(np.stack([np.sqrt(1 - z**2), 0 * z, z], axis=-1))
    return np.repeat(column[:, None], 2 * rows, axis=1).astype(np.float32)


UPRIGHT = {"bitmap": Bitmap(panorama(gradient)), "to_world": rotation([1.0, 0, 0], 90)}
SKIES = {
    "constant": (constant, {"type": "constant", "radiance": 1.0}),
    "hdri": (gradient, {"type": "envmap", **UPRIGHT}),
}


def pbr(color, metallic, roughness):
    """Values of a header: its material is this one."""
    table = {
        "baseColorFactor": [*map(float, color), 1.0],
        "metallicFactor": metallic,
        "roughnessFactor": roughness,
    }
    return {"materials/0/pbrMetallicRoughness": table}


def coated(look, roughness):
    """The same under a clear coat."""
    coat = {"clearcoatFactor": 1.0, "clearcoatRoughnessFactor": roughness}
    return pbr(*look) | with_extensions(clearcoat=coat)


def ball():
    sphere = trimesh.creation.icosphere(subdivisions=5)
    sphere.visual = square().visual.copy()
    sphere.visual.uv = np.zeros((len(sphere.vertices), 2))
    return sphere


class Gallery:
    """Objects, each from its own file, in a row along x, that face -y."""

    def __init__(self, folder, models):
        self.objects, self.materials, self.spots = [], {}, []
        for i, (shape, values) in enumerate(models):
            path = write(folder / f"{i}.glb", shape, values)
            model = read_model(path, SceneContext(folder))
            place = np.array([i * SPACING, 0.0, 0.0])
            pose = tl.geometry.rigid(FACING, place)
            item = SceneObject(f"{i}", model.mesh, tuple(model.materials), pose)
            is_ball = model.mesh.vertices.min() < -0.9
            self.spots.append(place + ([0, -1.0, 0] if is_ball else [0, 0, 0.5]))
            self.objects.append(item)
            self.materials |= model.materials

    def seen(self, light, angles_deg, chosen):
        """The mean radiance (N, len(angles), 3) of a spot of each object, at these angles from its normal."""
        objects = tuple(self.objects[i] for i in chosen)
        lights = {"sky": light}
        scene = Scene("row", objects, self.materials, np.eye(4), (1.0, 99.0), lights)
        poses = []
        for i in chosen:
            for angle in angles_deg:
                eye = self.spots[i] + 40 * towards(angle)
                poses.append(tl.geometry.look_at(eye, self.spots[i]))
        camera = tl.Camera(4, 4, 8000.0, 8000.0, 1.5, 1.5)
        rig = tl.Rig([camera] * len(poses), poses)
        images = tl.render(scene, rig, tl.Pinhole(), spp=256, seed=1)
        means = np.mean(images, axis=(1, 2))
        return means.reshape(len(chosen), len(angles_deg), 3)


def towards(angle_deg):
    """The direction to a camera in the plane x = 0, from below the level of its spot."""
    angle = np.radians(angle_deg)
    return np.array([0, -np.cos(angle), -np.sin(angle)])


def of_gltf(look, sky, angle_deg):
    """glTF's radiance on a surface whose normal is -y."""
    color, metallic, roughness = look
    material = {"color": color, "metallic": metallic, "roughness": roughness}
    view = towards(angle_deg) @ FACING
    return reflected(view, lambda light: sky(light @ FACING.T), **material)


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    shapes = [ball()] * len(BALLS) + [square()] * len(PLANES)
    values = [pbr(*look) for look in LOOKS]
    models = zip(shapes, values, strict=True)
    return Gallery(tmp_path_factory.mktemp("gallery"), models)


ANGLES = (0.0, 45.0, 60.0)
PLASTIC = (0.0, 0.1)
METAL = (1.0, 0.2)
FEW = [(ORANGE, *PLASTIC), (WHITE, *PLASTIC), (ORANGE, *METAL), (WHITE, *METAL), (ORANGE, 0.0, 1.0)]  # fmt: skip


@pytest.fixture(scope="module")
def few(gallery):
    """Radiance of some of the balls, by look."""
    light = SKIES["constant"][1]
    rows = gallery.seen(light, ANGLES, [BALLS.index(look) for look in FEW])
    return dict(zip(FEW, rows, strict=True))


def assert_that_of_gltf(radiance_by_look, sky):
    for look, radiance in radiance_by_look.items():
        expected = [of_gltf(look, sky, angle) for angle in ANGLES]
        np.testing.assert_allclose(radiance, expected, rtol=0.03, err_msg=f"{look}")


def test_radiance_of_some_materials_is_that_of_gltf_within_3_percent(few):
    assert_that_of_gltf(few, constant)


@pytest.mark.slow
@pytest.mark.parametrize("sky", SKIES)
def test_radiance_of_twenty_materials_is_that_of_gltf_within_3_percent(gallery, sky):
    radiance, light = SKIES[sky]
    rows = gallery.seen(light, ANGLES, range(len(LOOKS)))
    assert len(rows) == 20
    assert_that_of_gltf(dict(zip(LOOKS, rows, strict=True)), radiance)


def test_a_white_surface_returns_all_light_and_a_metal_its_color(few):
    """At normal incidence. Rough facets lose light that a second reflection would return, in glTF too."""
    np.testing.assert_allclose(few[WHITE, *PLASTIC][0], 1, rtol=0.01)
    np.testing.assert_allclose(few[WHITE, *METAL][0], 1, rtol=0.01)
    np.testing.assert_allclose(few[ORANGE, *METAL][0], ORANGE, rtol=0.02)


GLASS = {
    "KHR_materials_transmission": {"transmissionFactor": 1.0},
    "KHR_materials_volume": {"thicknessFactor": 0.1},
}
COAT = {"KHR_materials_clearcoat": {"clearcoatFactor": 1.0}}


@pytest.mark.parametrize(
    ("kind", "metallic", "roughness", "more"),
    [
        ("diffuse", 0.0, 0.9, {}),
        ("glossy", 0.0, 0.3, {}),
        ("glossy", 1.0, 0.9, {}),
        ("glossy", 0.0, 0.9, {"extensions": COAT}),
        ("transmissive", 0.0, 0.9, {"extensions": GLASS}),
        ("diffuse", 0.0, 0.9, {"alphaMode": "BLEND"}),
    ],
)
def test_the_kind_of_a_material(kind, metallic, roughness, more):
    """Dielectrics as rough as matte paint are diffuse, as `principled` ones are."""
    color = {"baseColorFactor": [0.5, 0.2, 0.2, 0.5]}
    base = {"metallicFactor": metallic, "roughnessFactor": roughness, **color}
    table = PbrMaterial.model_validate({"pbrMetallicRoughness": base, **more})
    material = material_of(table, Textures([], [], lambda _: b""))
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]], np.uint32))
    objects = (SceneObject("triangle", triangle, "m"),)
    scene = Scene("one", objects, {"m": material}, np.eye(4), (1.0, 2.0))
    assert MATERIAL_KINDS[build(scene).bodies[0].material_kind] == kind


COATED = [  # look of the base, roughness of the coat
    (((0, 0, 0), 0.0, 1.0), 0.3),
    ((WHITE, 0.0, 1.0), 0.05),
    (((0.5, 0.1, 0.1), 0.0, 0.5), 0.1),
    (((0.8, 0.8, 0.8), 1.0, 0.4), 0.1),
]


@pytest.mark.slow
def test_a_clear_coat_is_that_of_gltf_within_3_percent(tmp_path):
    """(1 - F(n . v)) base + coat, KHR_materials_clearcoat; a black dielectric has the reflectance of a coat."""
    gallery = Gallery(tmp_path, [(square(), coated(*row)) for row in COATED])
    rows = gallery.seen(SKIES["constant"][1], ANGLES[:2], range(len(COATED)))
    for (look, roughness), radiance in zip(COATED, rows, strict=True):
        for k, angle in enumerate(ANGLES[:2]):
            through = 1 - 0.04 - 0.96 * (1 - np.cos(np.radians(angle))) ** 5
            coat = of_gltf(((0, 0, 0), 0.0, roughness), constant, angle)
            expected = through * of_gltf(look, constant, angle) + coat
            np.testing.assert_allclose(radiance[k], expected, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_a_normal_map_tilts_along_the_texture(tmp_path, signs):
    """Lambert's law with n = 0.36 du + 0.48 dv + 0.8 z; u and v run along or against x and y."""
    signs, tilt = np.array(signs), np.array([0.36, 0.48, 0.8])
    normals = picture(np.tile((tilt + 1) / 2, (2, 2, 1)))
    one = square(metallicFactor=0.0, normalTexture=normals)
    one.visual.uv = 0.5 + signs * (one.visual.uv - 0.5)
    matte = with_extensions(specular={"specularFactor": 0.0})
    model = read_model(write(tmp_path / "m.glb", one, matte), SceneContext(tmp_path))
    to_sun = np.array([0.3, 0.5, 1.0]) / np.linalg.norm([0.3, 0.5, 1.0])
    sun = {"type": "directional", "direction": (-to_sun).tolist(), "irradiance": 1.0}
    pose = tl.geometry.look_at([0, 0.5, 2], [0, 0.5, 0], [0, 1, 0])
    objects = (SceneObject("square", model.mesh, tuple(model.materials)),)
    scene = Scene("tilt", objects, model.materials, pose, (1.0, 3.0), {"sun": sun})
    rig = tl.Rig([tl.Camera.from_fov(4, 4, 10)], [pose])
    (image,) = tl.render(scene, rig, spp=4, seed=0)
    expected = np.append(signs * tilt[:2], tilt[2]) @ to_sun / np.pi
    assert image.mean() == pytest.approx(expected, rel=0.01)  # texels have 8 bits
