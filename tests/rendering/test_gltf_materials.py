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
from twinlens.scenes.scene import Mesh, SceneObject

SPACING = 200.0  # metres: no object lights another
BALLS = [(color, metallic, roughness) for color in ((0.1, 0.1, 0.1), (0.8, 0.3, 0.05), (1.0, 1.0, 1.0))
         for metallic, roughness in ((0.0, 0.1), (0.0, 0.5), (0.0, 1.0), (1.0, 0.2), (1.0, 1.0))]  # fmt: skip
PLANES = [((0.5, 0.5, 0.5), 0.0, 0.4), ((0.2, 0.4, 0.9), 1.0, 0.5), ((0.9, 0.6, 0.1), 0.5, 0.3), ((0, 0, 0), 0.0, 0.2),
          ((0.6, 0.6, 0.6), 0.2, 0.8)]  # fmt: skip


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


def pbr(color, metallic, roughness):
    rgba = np.append(np.asarray(color, float), 1.0)
    table = {
        "baseColorFactor": rgba.tolist(),
        "metallicFactor": metallic,
        "roughnessFactor": roughness,
    }
    return {"materials/0/pbrMetallicRoughness": table}


def ball():
    made = trimesh.creation.icosphere(subdivisions=5)
    made.visual = square().visual.copy()
    made.visual.uv = np.zeros((len(made.vertices), 2))
    return made


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    """Objects and materials of all balls, then all planes, each from its own file, along x. Planes face -y."""
    folder = tmp_path_factory.mktemp("gallery")
    things, materials = [], {}
    for i, look in enumerate([*BALLS, *PLANES]):
        path = write(
            folder / f"{i}.glb", ball() if i < len(BALLS) else square(), pbr(*look)
        )
        model = read_model(path, SceneContext(folder))
        pose = np.array(
            [[1, 0, 0, i * SPACING], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]
        )
        things.append(SceneObject(f"{i}", model.mesh, tuple(model.materials), pose))
        materials |= model.materials
    return things, materials


def coat_over(look, roughness):
    coat = {"clearcoatFactor": 1.0, "clearcoatRoughnessFactor": roughness}
    return pbr(*look) | with_extensions(clearcoat=coat)


@pytest.fixture(scope="module")
def coated(tmp_path_factory):
    """Planes under a clear coat, as `gallery`; and their base, and the roughness of their coat."""
    folder = tmp_path_factory.mktemp("coated")
    looks = [(((0, 0, 0), 0.0, 1.0), 0.3), (((1.0, 1.0, 1.0), 0.0, 1.0), 0.05), (((0.5, 0.1, 0.1), 0.0, 0.5), 0.1),
             (((0.8, 0.8, 0.8), 1.0, 0.4), 0.1)]  # fmt: skip
    things, materials = [], {}
    for i, (look, roughness) in enumerate(looks):
        path = write(folder / f"{i}.glb", square(), coat_over(look, roughness))
        model = read_model(path, SceneContext(folder))
        pose = np.array(
            [[1, 0, 0, i * SPACING], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]
        )
        things.append(SceneObject(f"{i}", model.mesh, tuple(model.materials), pose))
        materials |= model.materials
    return looks, (things, materials)


def seen_at(gallery, light, angles_deg, spp, chosen=range(20)):
    """The mean radiance (N, len(angles), 3) of a spot of each object, seen at these angles from its normal, -y."""
    things, materials = gallery
    scene = tl.Scene(
        "gallery",
        tuple(things[i] for i in chosen),
        materials,
        np.eye(4),
        (1.0, 99.0),
        {"sky": light},
    )
    poses = []
    for i in chosen:
        is_ball = things[i].shape.vertices.min() < -0.9
        spot = np.array([i * SPACING, -1.0, 0.0] if is_ball else [i * SPACING, 0, 0.5])
        poses += [
            tl.geometry.look_at(spot + 40 * view(angle), spot) for angle in angles_deg
        ]
    rig = tl.Rig((tl.Camera(4, 4, 8000.0, 8000.0, 1.5, 1.5),) * len(poses), poses)
    found = np.array(
        [
            image.mean(axis=(0, 1))
            for image in tl.render(scene, rig, tl.Pinhole(), spp=spp, seed=1)
        ]
    )
    return found.reshape(len(chosen), len(angles_deg), 3)


def view(angle_deg):
    """The direction to a camera in the plane x = 0, from below the level of its spot."""
    angle = np.radians(angle_deg)
    return np.array([0, -np.cos(angle), -np.sin(angle)])


def expected(look, sky, angle_deg):
    """glTF's radiance on a surface whose normal is -y."""
    world_from_local = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    color, metallic, roughness = look
    local = view(angle_deg) @ world_from_local
    return reflected(
        local,
        lambda light: sky(light @ world_from_local.T),
        color=color,
        metallic=metallic,
        roughness=roughness,
    )


SKIES = {
    "constant": (constant, {"type": "constant", "radiance": 1.0}),
    "hdri": (
        gradient,
        {
            "type": "envmap",
            "bitmap": Bitmap(panorama(gradient)),
            "to_world": rotation([1.0, 0, 0], 90.0),
        },
    ),
}


ANGLES = (0.0, 45.0, 60.0)
FEW = [BALLS.index(((0.8, 0.3, 0.05), 0.0, 0.1)), BALLS.index(((1.0, 1.0, 1.0), 0.0, 0.1)),
       BALLS.index(((0.8, 0.3, 0.05), 1.0, 0.2)), BALLS.index(((1.0, 1.0, 1.0), 1.0, 0.2)),
       BALLS.index(((0.8, 0.3, 0.05), 0.0, 1.0))]  # fmt: skip


@pytest.fixture(scope="module")
def few(gallery):
    return dict(
        zip(
            FEW,
            seen_at(gallery, SKIES["constant"][1], ANGLES, spp=256, chosen=FEW),
            strict=True,
        )
    )


def assert_that_of_gltf(found, sky):
    for i, radiance in found.items():
        look = [*BALLS, *PLANES][i]
        for k, angle in enumerate(ANGLES):
            np.testing.assert_allclose(
                radiance[k],
                expected(look, sky, angle),
                rtol=0.03,
                err_msg=f"{look} at {angle}",
            )


def test_radiance_of_some_materials_is_that_of_gltf_within_3_percent(few):
    assert_that_of_gltf(few, constant)


@pytest.mark.slow
@pytest.mark.parametrize("sky", SKIES)
def test_radiance_of_twenty_materials_is_that_of_gltf_within_3_percent(gallery, sky):
    radiance, light = SKIES[sky]
    found = seen_at(gallery, light, ANGLES, spp=256)
    assert len(found) == 20
    assert_that_of_gltf(dict(enumerate(found)), radiance)


def test_a_white_surface_returns_all_light(few):
    """Of the smooth ones: rough facets lose light that a second reflection would return, in glTF too."""
    for look in (((1.0, 1.0, 1.0), 0.0, 0.1), ((1.0, 1.0, 1.0), 1.0, 0.2)):
        np.testing.assert_allclose(few[BALLS.index(look)][0], 1, rtol=0.01)


def test_a_metal_reflects_its_color_at_normal_incidence(few):
    for look in (((0.8, 0.3, 0.05), 1.0, 0.2), ((1.0, 1.0, 1.0), 1.0, 0.2)):
        np.testing.assert_allclose(few[BALLS.index(look)][0], look[0], rtol=0.02)


_GLASS = {
    "KHR_materials_transmission": {"transmissionFactor": 1.0},
    "KHR_materials_volume": {"thicknessFactor": 0.1},
}


@pytest.mark.parametrize(
    ("kind", "metallic", "roughness", "more"),
    [
        ("diffuse", 0.0, 0.9, {}),
        ("diffuse", 0.0, 0.9, {"doubleSided": True}),
        ("glossy", 0.0, 0.3, {}),
        ("glossy", 1.0, 0.9, {}),
        (
            "glossy",
            0.0,
            0.9,
            {"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1.0}}},
        ),
        ("transmissive", 0.0, 0.9, {"extensions": _GLASS}),
        ("transmissive", 0.0, 0.0, {"extensions": _GLASS}),
        ("transmissive", 0.0, 0.9, {"alphaMode": "BLEND"}),
    ],
)
def test_the_kind_of_a_material(kind, metallic, roughness, more):
    """Dielectrics as rough as matte paint are diffuse, as `principled` ones are."""
    base = {
        "metallicFactor": metallic,
        "roughnessFactor": roughness,
        "baseColorFactor": [0.5, 0.2, 0.2, 0.5],
    }
    table = PbrMaterial.model_validate({"pbrMetallicRoughness": base, **more})
    material = material_of(table, Textures([], [], lambda _: b""))
    triangle = Mesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], np.uint32)
    )
    scene = tl.Scene(
        "one",
        (SceneObject("triangle", triangle, "m"),),
        {"m": material},
        np.eye(4),
        (1.0, 2.0),
    )
    assert MATERIAL_KINDS[build(scene).bodies[0].material_kind] == kind


@pytest.mark.slow
def test_a_clear_coat_is_that_of_gltf_within_3_percent(coated):
    """(1 - F(n . v)) base + coat, KHR_materials_clearcoat; a black dielectric has the reflectance of a coat."""
    looks, gallery = coated
    found = seen_at(
        gallery, SKIES["constant"][1], ANGLES[:2], spp=256, chosen=range(len(looks))
    )
    for i, (look, roughness) in enumerate(looks):
        for k, angle in enumerate(ANGLES[:2]):
            through = 1 - 0.04 - 0.96 * (1 - np.cos(np.radians(angle))) ** 5
            coat = expected(((0, 0, 0), 0.0, roughness), constant, angle)
            of_gltf = through * expected(look, constant, angle) + coat
            np.testing.assert_allclose(
                found[i, k], of_gltf, rtol=0.03, err_msg=f"{look} at {angle}"
            )


@pytest.mark.slow
@pytest.mark.parametrize("signs", [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_a_normal_map_tilts_along_the_texture(tmp_path, signs):
    """Lambert's law with n = 0.36 du + 0.48 dv + 0.8 z; u and v run along or against x and y."""
    signs, tilt = np.array(signs), np.array([0.36, 0.48, 0.8])
    one = square(
        metallicFactor=0.0, normalTexture=picture(np.tile((tilt + 1) / 2, (2, 2, 1)))
    )
    one.visual.uv = 0.5 + signs * (one.visual.uv - 0.5)
    path = write(
        tmp_path / "m.glb", one, with_extensions(specular={"specularFactor": 0.0})
    )
    model = read_model(path, SceneContext(tmp_path))
    towards = np.array([0.3, 0.5, 1.0]) / np.linalg.norm([0.3, 0.5, 1.0])
    sun = {"type": "directional", "direction": (-towards).tolist(), "irradiance": 1.0}
    pose = tl.geometry.look_at([0, 0.5, 2], [0, 0.5, 0], [0, 1, 0])
    thing = SceneObject("square", model.mesh, tuple(model.materials))
    scene = tl.Scene("tilt", (thing,), model.materials, pose, (1.0, 3.0), {"sun": sun})
    (image,) = tl.render(
        scene, tl.Rig([tl.Camera.from_fov(4, 4, 10)], [pose]), spp=4, seed=0
    )
    expected = np.append(signs * tilt[:2], tilt[2]) @ towards / np.pi
    assert image.mean() == pytest.approx(expected, rel=0.01)  # texels have 8 bits
