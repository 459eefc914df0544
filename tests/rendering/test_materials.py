"""The translator of materials to BSDFs: which plugins, with which parameters."""

import numpy as np
import pytest

from twinlens.rendering.materials import bsdf_of, vertex_attributes
from twinlens.scenes.materials import (
    Bitmap,
    Color,
    Material,
    VertexColor,
    lambert,
)
from twinlens.scenes.plugins import material_of
from twinlens.scenes.scene import Mesh

NOISE = np.random.default_rng(0)
PICTURE = Bitmap(NOISE.random((4, 4, 3)).astype(np.float32))
GREYS = Bitmap(NOISE.random((4, 4)).astype(np.float32))
RED = Color((0.8, 0.2, 0.1))

PLUGINS = {
    "diffuse": {"reflectance": PICTURE},
    "plastic": {"diffuse_reflectance": RED, "int_ior": 1.6},
    "roughplastic": {"diffuse_reflectance": PICTURE, "alpha": 0.25},
    "conductor": {"material": "Ag", "specular_reflectance": PICTURE},
    "roughconductor": {"eta": RED, "k": Color((1.0, 2.0, 3.0)), "alpha": 0.04},
    "dielectric": {"int_ior": 1.4, "specular_transmittance": RED},
    "thindielectric": {"int_ior": 1.4, "specular_reflectance": RED},
    "roughdielectric": {"int_ior": 1.4, "alpha": 0.04, "distribution": "ggx"},
    "principled": {
        "base_color": PICTURE,
        "roughness": GREYS,
        "metallic": 0.5,
        "sheen": 0.2,
        "clearcoat": 0.3,
        "clearcoat_gloss": 0.75,
        "eta": 1.4,
    },
}


def contains(tree, part):
    """Whether a tree of plugins has all keys of another, with the same values."""
    for key, value in part.items():
        if isinstance(value, dict):
            assert contains(tree[key], value)
        else:
            number = isinstance(value, float)
            assert tree[key] == (pytest.approx(value) if number else value), key
    return True


def test_a_plugin_read_as_a_material_is_translated_to_itself():
    """Besides defaults, which become explicit."""
    for kind, keys in PLUGINS.items():
        plugin = {"type": kind, **keys}
        nested = {"type": "twosided", "bsdf": plugin}
        nested = {"type": "normalmap", "normalmap": PICTURE, "bsdf": nested}
        nested = {"type": "mask", "opacity": GREYS, "bsdf": nested}
        bumped = {"type": "bumpmap", "bump": GREYS, "scale": 0.1, "bsdf": plugin}
        for tree in (plugin, nested, bumped):
            material = material_of(tree)
            assert isinstance(material, Material), kind
            assert contains(bsdf_of(material), tree), kind


def test_what_a_material_cannot_express_stays_a_plugin():
    for plugin in (
        {"type": "null"},
        {"type": "plastic", "nonlinear": True},
        {"type": "dielectric", "ext_ior": 1.3},
        {"type": "roughconductor", "alpha": GREYS},
        {"type": "twosided", "bsdf": {"type": "bumpmap", "bump": GREYS,
                                      "bsdf": {"type": "diffuse"}}},
    ):  # fmt: skip
        assert material_of(plugin) is plugin
        assert bsdf_of(plugin) is plugin


def value_of(tree, key):
    """The first value of a key anywhere in a tree of plugins, or None."""
    if not isinstance(tree, dict):
        return None
    if key in tree:
        return tree[key]
    hits = [value_of(value, key) for value in tree.values()]
    return next((hit for hit in hits if hit is not None), None)


def test_opacity_is_cut_at_the_cutoff():
    opacity = Bitmap(np.array([[0.2, 0.6, 1.0]], dtype=np.float32))
    blended = bsdf_of(Material(opacity=opacity))
    np.testing.assert_array_equal(blended["opacity"].pixels, opacity.pixels)
    cut = bsdf_of(Material(opacity=opacity, alpha_cutoff=0.6))
    # Mitsuba's `mask` clips to [0, 1].
    np.testing.assert_array_equal(np.clip(cut["opacity"].pixels, 0, 1), [[0, 1, 1]])
    whole = bsdf_of(Material(opacity=opacity, alpha_cutoff=0.1))
    assert value_of(whole, "opacity") is None


def test_the_green_axis_is_flipped_where_texture_coordinates_are_mirrored():
    upright, mirrored = (
        bsdf_of(Material(normal=PICTURE, coat=0.5, coat_normal=PICTURE, mirrored=side))
        for side in (False, True)
    )
    expected = PICTURE.pixels * [1, -1, 1] + [0, 1, 0]
    assert value_of(upright, "normalmap") is PICTURE
    for branch in ("bsdf_0", "bsdf_1"):
        flipped = value_of(mirrored[branch], "normalmap").pixels
        np.testing.assert_allclose(flipped, expected, atol=1e-6)


def colored_triangle(colors):
    return Mesh(
        np.eye(3), np.array([[0, 1, 2]], np.uint32), attributes={"color": colors}
    )


def test_colors_of_vertices_become_attributes():
    colors = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0.2, 0.4, 0.8, 0]])
    material = Material(base_color=VertexColor(), opacity=VertexColor())
    attributes = vertex_attributes(material, colored_triangle(colors))
    np.testing.assert_array_equal(attributes["vertex_color"], colors[:, :3])
    np.testing.assert_array_equal(attributes["vertex_color_opacity"], colors[:, 3:])
    assert set(names_in(bsdf_of(material))) == attributes.keys()
    assert vertex_attributes(lambert(RED), colored_triangle(colors)) == {}


def test_a_dielectric_has_colors_of_vertices_in_its_diffuse_light_only():
    tree = bsdf_of(Material(base_color=VertexColor(), roughness=0.5))
    assert len(set(names_in(tree))) == 1
    metal = value_of(tree, "bsdf_1")
    assert not set(names_in(metal))
    assert set(names_in(bsdf_of(Material(base_color=VertexColor(), metallic=0.5))))


def names_in(tree):
    """The attributes that a tree of plugins reads."""
    if isinstance(tree, dict):
        if tree.get("type") == "mesh_attribute":
            yield tree["name"]
        for value in tree.values():
            yield from names_in(value)
