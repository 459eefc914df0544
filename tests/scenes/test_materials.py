"""A `Material` is neutral: a second translator, to glTF's tables, needs nothing but its fields."""

from dataclasses import fields

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.families import FAMILIES, random_scene
from twinlens.scenes.gltf_materials import PbrMaterial, Textures, material_of
from twinlens.scenes.materials import (
    Bitmap,
    Color,
    Material,
    VertexColor,
    glass,
    lambert,
    metal,
)


def mean_rgb(value):
    """The mean colour of a value."""
    if isinstance(value, Bitmap):
        value = value.pixels.mean(axis=(0, 1))
    return np.broadcast_to(getattr(value, "rgb", value), 3).astype(float).tolist()


def mean(value):
    return float(np.mean(mean_rgb(value)))


def alpha_mode(material):
    if material.alpha_cutoff is not None:
        return "MASK"
    return "BLEND" if mean(material.opacity) < 1 else "OPAQUE"


def gltf_of(material):
    """A renderer of glTF without textures, in short: the factors of a material."""
    emission = [0.0] * 3 if material.emission is None else mean_rgb(material.emission)
    strength = max(1.0, *emission)
    extensions = {
        "ior": {"ior": material.ior},
        "specular": {
            "specularFactor": mean(material.specular),
            "specularColorFactor": mean_rgb(material.specular_color),
        },
        "transmission": {"transmissionFactor": mean(material.transmission)},
        "volume": {"thicknessFactor": float(not material.thin_walled)},
        "clearcoat": {
            "clearcoatFactor": mean(material.coat),
            "clearcoatRoughnessFactor": mean(material.coat_roughness),
        },
        "emissive_strength": {"emissiveStrength": strength},
    }
    table = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [*mean_rgb(material.base_color), mean(material.opacity)],
            "metallicFactor": mean(material.metallic),
            "roughnessFactor": mean(material.roughness),
        },
        "emissiveFactor": [channel / strength for channel in emission],
        "alphaMode": alpha_mode(material),
        "doubleSided": material.two_sided,
        "extensions": {f"KHR_materials_{key}": extensions[key] for key in extensions},
    }
    if material.alpha_cutoff is not None:
        table["alphaCutoff"] = material.alpha_cutoff
    return table


def read_back(material):
    table = PbrMaterial.model_validate(gltf_of(material))
    return material_of(table, Textures([], [], lambda _: b""))


def test_a_material_of_gltf_survives_the_other_translator():
    color = Color((0.5, 0.25, 0.75))
    materials = [
        Material(base_color=color, metallic=0.25, roughness=0.5, two_sided=True),
        Material(base_color=color, opacity=0.5, alpha_cutoff=0.25, ior=1.25),
        Material(base_color=color, specular=0.5, specular_color=color, coat=0.5),
        Material(base_color=color, transmission=0.5, coat_roughness=0.25, opacity=0.5),
        Material(base_color=color, thin_walled=False, transmission=1.0),
        Material(base_color=color, emission=Color((4.0, 2.0, 1.0))),
    ]
    for material in materials:
        again = read_back(material)
        for field in fields(Material):
            expected, value = getattr(material, field.name), getattr(again, field.name)
            if field.name in ("specular_color", "base_color"):
                expected, value = mean_rgb(expected), mean_rgb(value)
            assert value == expected, field.name


def test_other_models_keep_their_meaning_without_their_formulas():
    assert read_back(lambert(0.5)).specular == 0.0
    assert read_back(metal("Cu")).metallic == 1.0
    assert read_back(glass(1.5)).transmission == 1.0


def check_translation(scene):
    for name, material in scene.materials.items():
        assert isinstance(material, Material), name
        assert read_back(material).roughness == pytest.approx(mean(material.roughness))


@pytest.mark.parametrize("name", FAMILIES)
def test_all_materials_of_a_random_scene_can_be_translated(name):
    check_translation(random_scene(name, 1, width=64, object_count=6))


def test_wrong_materials_are_refused():
    with pytest.raises(InputError, match="unknown model of materials 'velvet'"):
        Material(model="velvet")
    with pytest.raises(InputError, match="needs base_color per vertex"):
        Material(opacity=VertexColor())
    assert isinstance(Material(metallic=1).metallic, float)
