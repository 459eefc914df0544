"""The one translator of materials to Mitsuba's BSDFs, and the kind of a material in the ground truth.

`bsdf_of` gives a tree of plugins in plain Python (`scenes.materials.Plugin`), which `rendering.build` loads. Colours
per vertex become attributes of the mesh (`vertex_attributes`). With fixed weights of its lobes a BSDF is linear in its
base colour, so that those of vertices mix its colours for black and for the material's own (`rendering.textures`).

glTF's surface mixes a diffuse lobe below a dielectric, and a metal. Both have GGX facets of alpha = roughness^2 whose
reflectance is Schlick's, F + (1 - F) s with s = (1 - cos)^5. Mitsuba's `principled` has these facets, with two
differences: one colour sets its diffuse lobe and its metal, and its dielectric follows Fresnel's equations, which
differ from Schlick's formula by a quarter at 60 degrees. A `blendbsdf` of two `principled` avoids both:

    weight w      a metal of colour F / w, whose facets reflect F / w + (1 - F / w) s
    weight 1 - w  a diffuse lobe below facets that reflect s: no reflectance at normal incidence, full `spec_tint`

The facets add up to w (F / w + (1 - F / w) s) + (1 - w) s = F + (1 - F) s for every w. The diffuse lobe of `principled`
is too bright at grazing angles if the surface is rough, so it is replaced by Lambert's from roughness 0.6 to 1. Source:
glTF 2.0, appendix B.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.geometry import Float
from twinlens.rendering.backends import mitsuba
from twinlens.scenes.materials import (
    MATTE_ROUGHNESS,
    AnyMaterial,
    Bitmap,
    Color,
    ComplexIndex,
    Material,
    Plugin,
    VertexColor,
)
from twinlens.scenes.scene import Mesh

Pixels = NDArray[np.float32]

_ATTRIBUTE_PREFIXES = ("vertex_", "face_")  # Mitsuba knows no others

_MATTE_MODELS = ("gltf", "principled")
_MOST_METAL_OF_MATTE = 0.01  # largest metalness and coat of a matte material

_LAMBERT_FROM = 0.6
"""Roughness from which a part of the diffuse light is Lambert's; all of it is at roughness 1."""

_LAMBERT_MOST = 2.5
"""Largest reflectance of Lambert's lobe, whose weight is smaller for it. A small weight has more noise, as `blendbsdf`
samples by weight; a large one leaves less for the facets, whose reflectance is 1 at grazing angles."""

_COAT_F0 = 0.04
_COAT_MOST = 0.99  # weight of a coat in the blend with what is below
_SMOOTHEST = 0.03  # roughness below which transmission is without facets
_STEEPNESS = 2.0**16  # of the ramp of opacity at a cutoff
_LEAST_IOR = 1.0001  # of glass, whose facets must refract


def bsdf_of(material: AnyMaterial) -> Plugin:
    """The BSDF of a material, as a tree of plugins."""
    if not isinstance(material, Material):
        return material
    return _translated(_Maps(material))


def vertex_attributes(material: AnyMaterial, mesh: Mesh) -> dict[str, Float]:
    """The attributes (V, C) of a mesh that `bsdf_of(material)` may read, by their names in Mitsuba."""
    base = material.base_color if isinstance(material, Material) else None
    if not isinstance(material, Material) or not isinstance(base, VertexColor):
        return {
            name: values
            for name, values in mesh.attributes.items()
            if name.startswith(_ATTRIBUTE_PREFIXES)
        }
    colors = mesh.attributes[base.attribute]
    return {
        _color_name(base): colors[:, :3],
        _opacity_name(base): colors[:, 3:],
    }


def _color_name(colors: VertexColor) -> str:
    return f"vertex_{colors.attribute}"


def _opacity_name(colors: VertexColor) -> str:
    return f"vertex_{colors.attribute}_opacity"


def emitter_of(material: AnyMaterial) -> Plugin | None:
    """The area light of a material that emits light."""
    if not isinstance(material, Material) or material.emission is None:
        return None
    return {"type": "area", "radiance": _covered(material.emission, material)}


def _covered(emission: Any, material: Material) -> Any:
    """The radiance of a surface that emits, where its opacity is a texture: nothing is emitted where nothing is.

    A texture of emission that lies or is sized differently keeps its light at cut-outs.
    """
    opacity = _own(material.opacity)
    if not isinstance(opacity, Bitmap) or opacity.pixels.ndim != 2:
        return emission
    share = np.clip(_cut(opacity.pixels, material.alpha_cutoff), 0, 1)[..., None]
    if isinstance(emission, Color):
        return _like(opacity, share * np.array(emission.rgb, dtype=np.float32))
    is_same = isinstance(emission, Bitmap) and emission.lies_like(opacity)
    if is_same and emission.pixels.shape[:2] == opacity.pixels.shape:
        return _like(opacity, share * np.atleast_3d(emission.pixels))
    return emission


def _own(value: Any) -> Any:
    """A value of a material without the colours of vertices, which it is multiplied by."""
    return value.factor if isinstance(value, VertexColor) else value


def _mixed(share: str, low: Any, high: Any) -> Plugin:
    """The texture low + share (high - low), where an attribute of vertices is the share."""
    attribute = {"type": "mesh_attribute", "name": share}
    return {"type": "vertex_mix", "low": low, "high": high, "share": attribute}


def _translated(maps: "_Maps") -> Plugin:
    """The core of the model, below a normal map, a clear coat and a mask, in this order from inside to outside."""
    material = maps.material
    core = _MODELS[material.model](maps)
    plugin = _normal_mapped(material.normal, material, core)
    plugin = _bumped(material, plugin)
    plugin = _coated(maps, plugin)
    return _masked(maps, plugin)


def _both_sides(material: Material, plugin: Plugin) -> Plugin:
    return {"type": "twosided", "bsdf": plugin} if material.two_sided else plugin


def _normal_mapped(
    normals: Bitmap | None, material: Material, plugin: Plugin
) -> Plugin:
    """`plugin` below a normal map."""
    if normals is None:
        return plugin
    if material.mirrored:
        # Mitsuba's tangents follow (u, v): where these are mirrored, its green axis points to the bottom.
        flipped = np.abs(normals.pixels - np.array([0, 1, 0], dtype=np.float32))
        normals = replace(normals, pixels=flipped)
    return {"type": "normalmap", "normalmap": normals, "bsdf": plugin}


def _bumped(material: Material, plugin: Plugin) -> Plugin:
    if material.bump is None:
        return plugin
    return {
        "type": "bumpmap",
        "bump": material.bump,
        "scale": material.bump_scale,
        "bsdf": plugin,
    }


def _masked(maps: "_Maps", plugin: Plugin) -> Plugin:
    """`plugin` where the surface is."""
    value = _opacity(maps)
    if isinstance(value, float) and value == 1.0:
        return plugin
    return {"type": "mask", "opacity": value, "bsdf": plugin}


def _opacity(maps: "_Maps") -> Any:
    """The opacity of a `mask`. It is in no formula with other values, so its texture keeps a frame of its own."""
    opacity, cutoff = maps.material.opacity, maps.material.alpha_cutoff
    if isinstance(opacity, VertexColor):
        name = _opacity_name(opacity)
        if cutoff is None:
            return _mixed(name, 0.0, opacity.factor)
        return _mixed(name, _ramp(0.0, cutoff), _ramp(opacity.factor, cutoff))
    if isinstance(opacity, float):
        return float(_cut(np.array(opacity, dtype=np.float32), cutoff))
    pixels = _cut(opacity.pixels, cutoff)
    if (pixels == pixels[0, 0]).all():
        return float(pixels[0, 0].mean())
    return opacity if cutoff is None else _like(opacity, pixels)


def _cut(opacity: Pixels, cutoff: float | None) -> Pixels:
    """Opacity with a step from 0 to 1 at the cutoff, after interpolation between texels or vertices.

    glTF compares the interpolated opacity with the cutoff. Interpolation is linear and `mask` clips to [0, 1], so a
    steep ramp of the values themselves, from 0 to 1 just below the cutoff, is the same.
    """
    if cutoff is None:
        return opacity
    ramp = np.asarray(_ramp(opacity, cutoff))
    if ramp.min() >= 1:
        return np.ones_like(ramp)
    return np.zeros_like(ramp) if ramp.max() <= 0 else ramp


def _ramp(opacity: Any, cutoff: float) -> Any:
    """The ramp of an opacity at the cutoff: of a number, an array or a texture."""
    if isinstance(opacity, Bitmap):
        return _like(opacity, _ramp(opacity.pixels, cutoff))
    ramp = (np.float32(opacity) - np.float32(cutoff)) * np.float32(_STEEPNESS) + 1
    return float(ramp) if np.ndim(ramp) == 0 else ramp


# Models that have one BSDF of the same formulas in Mitsuba.


def _alpha(material: Material) -> dict[str, Any]:
    """The keys of facets; a smooth surface has none."""
    roughness = material.roughness
    assert isinstance(roughness, float)
    return {"distribution": material.facets, "alpha": roughness**2}


def _is_rough(material: Material) -> bool:
    return not (isinstance(material.roughness, float) and material.roughness == 0.0)


def _unless_white(key: str, value: Any) -> dict[str, Any]:
    """A factor, left out if it is 1: Mitsuba has smaller kernels without it."""
    is_white = isinstance(value, float) and value == 1.0
    return {} if is_white else {key: value}


def _lambert(maps: "_Maps") -> Plugin:
    material = maps.material
    plugin = {"type": "diffuse", "reflectance": maps.base_color}
    return _both_sides(material, plugin)


def _plastic(maps: "_Maps") -> Plugin:
    material = maps.material
    rough = _is_rough(material)
    plugin = {
        "type": "roughplastic" if rough else "plastic",
        "int_ior": material.ior,
        "diffuse_reflectance": maps.base_color,
        **_unless_white("specular_reflectance", material.specular_color),
        **(_alpha(material) if rough else {}),
    }
    return _both_sides(material, plugin)


def _metal(maps: "_Maps") -> Plugin:
    material = maps.material
    rough = _is_rough(material)
    conductor = material.conductor or "none"
    index: dict[str, Any] = {"material": conductor}
    if isinstance(conductor, ComplexIndex):
        index = {"eta": conductor.eta, "k": conductor.k}
    plugin = {
        "type": "roughconductor" if rough else "conductor",
        **index,
        **_unless_white("specular_reflectance", maps.base_color),
        **(_alpha(material) if rough else {}),
    }
    return _both_sides(material, plugin)


def _glass(maps: "_Maps") -> Plugin:
    material = maps.material
    kind = "roughdielectric" if _is_rough(material) else "dielectric"
    if material.thin_walled:
        kind = "thindielectric"
    plugin = {
        "type": kind,
        "int_ior": material.ior,
        **_unless_white("specular_transmittance", maps.base_color),
        **_unless_white("specular_reflectance", material.specular_color),
        **(_alpha(material) if kind == "roughdielectric" else {}),
    }
    return _both_sides(material, plugin)


def _principled(maps: "_Maps") -> Plugin:
    """Burley's material. Parameters of 0 are left out: Mitsuba has no such lobe then either."""
    material = maps.material
    plugin: dict[str, Any] = {
        "type": "principled",
        "base_color": maps.base_color,
        "roughness": material.roughness,
    }
    lobes_of = {
        "metallic": material.metallic,
        "sheen": material.sheen,
        "clearcoat": material.coat,
    }
    plugin |= {key: value for key, value in lobes_of.items() if value != 0.0}
    if material.coat != 0.0:
        assert isinstance(material.coat_roughness, float)
        plugin["clearcoat_gloss"] = 1 - material.coat_roughness
    if material.ior != 1.5:
        plugin["eta"] = material.ior
    return _both_sides(material, plugin)


# glTF's model, which has no BSDF of its own.


class _Maps:
    """Values of a glTF material over its texels, in the frame of the first texture."""

    def __init__(self, material: Material) -> None:
        self.material = material
        self.frame: Bitmap | None = None

    @cached_property
    def surface(self) -> "Lobes":
        """The lobes of the opaque surface and its clear coat, below colours of vertices."""
        base = self.base()
        return self._lobes(base, base)

    @cached_property
    def black_surface(self) -> "Lobes":
        """As `surface`, with its weights, of a base colour of 0."""
        base = self.base()
        return self._lobes(np.zeros_like(base[:1, :1]), base)

    def _lobes(self, color: Pixels, brightest: Pixels) -> "Lobes":
        material = self.material
        metallic = self.shared(material.metallic)
        roughness = self.shared(material.roughness)
        coat = self.shared(material.coat)
        at_normal, at_grazing = _dielectric(self)
        return lobes(color, metallic, roughness, at_normal, at_grazing, coat, brightest)

    def base(self) -> Pixels:
        """The base colour (H, W, 3), below colours of vertices."""
        return _as_rgb(self.shared(_own(self.material.base_color)))

    @property
    def base_color(self) -> Any:
        """The base colour as a Mitsuba value."""
        return self.times_vertices(_own(self.material.base_color))

    def times_vertices(self, value: Any) -> Any:
        """A Mitsuba value times the colours of vertices, if there are any."""
        colors = self.material.base_color
        if not isinstance(colors, VertexColor):
            return value
        return _mixed(_color_name(colors), 0.0, value)

    def of_lobes(self, color_of: Callable[["Lobes"], Pixels]) -> Any:
        """A colour of the lobes as a Mitsuba value; it is linear in colours of vertices, if there are any."""
        color = color_of(self.surface)
        vertices = self.material.base_color
        if not isinstance(vertices, VertexColor):
            return self.value(color)
        black = color_of(self.black_surface)
        if np.array_equal(color, black):
            return self.value(color)
        return _mixed(_color_name(vertices), self.value(black), self.value(color))

    def shared(self, value: Any) -> Pixels:
        """A value as (H, W, C), or (1, 1, C) without a texture.

        Values that are computed together need one frame. A texture with another one is replaced by its mean.
        """
        if isinstance(value, float):
            return np.full((1, 1, 1), value, dtype=np.float32)
        if isinstance(value, Color):
            return np.asarray(value.rgb, dtype=np.float32).reshape(1, 1, 3)
        pixels: Pixels = np.atleast_3d(value.pixels)
        if self.frame is None or value.lies_like(self.frame):
            self.frame = value
            return pixels
        mean: Pixels = pixels.mean(axis=(0, 1), keepdims=True)
        return mean

    def value(self, pixels: Pixels) -> Any:
        """A Mitsuba value of (H, W, C): a number or a colour if it is uniform, else a Bitmap."""
        if (pixels == pixels[:1, :1]).all():
            return _uniform_value(pixels[:1, :1])
        if pixels.shape[2] == 1:
            pixels = pixels[..., 0]
        pixels = np.ascontiguousarray(pixels, dtype=np.float32)
        return Bitmap(pixels) if self.frame is None else _like(self.frame, pixels)


def _like(frame: Bitmap, pixels: Pixels) -> Bitmap:
    return Bitmap(pixels, frame.filter, frame.wrap, frame.to_uv)


def _uniform_value(pixels: Pixels) -> Any:
    """A number or a colour of (1, 1, C)."""
    if pixels.shape[2] == 1:
        return float(pixels[0, 0, 0])
    if pixels.max() > 1:  # Mitsuba refuses such a colour, but not such a picture
        return Bitmap(np.ascontiguousarray(pixels))
    return Color(tuple(pixels[0, 0].astype(float).tolist()))


def _as_rgb(pixels: Pixels) -> Pixels:
    return np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels


def _fitted(*maps: Pixels) -> list[Pixels]:
    """Maps at the largest height and width among them, by the nearest texel; uniform ones stay (1, 1, C)."""
    height = max(pixels.shape[0] for pixels in maps)
    width = max(pixels.shape[1] for pixels in maps)
    fitted = []
    for pixels in maps:
        if pixels.shape[:2] not in ((1, 1), (height, width)):
            rows = ((np.arange(height) + 0.5) * pixels.shape[0] // height).astype(int)
            columns = ((np.arange(width) + 0.5) * pixels.shape[1] // width).astype(int)
            pixels = pixels[rows[:, None], columns]
        fitted.append(pixels)
    return fitted


def _brightest(pixels: Pixels) -> Pixels:
    """The largest channel (H, W, 1); ten times as fast as `max` along the last axis."""
    return np.maximum(np.maximum(pixels[..., :1], pixels[..., 1:2]), pixels[..., 2:])


@dataclass(frozen=True, eq=False)
class Lobes:
    """A surface as the blend (1 - weight) lower + weight * facets; arrays (H, W, C).

    The lower part has the colour `diffuse`, by Lambert's law for the share `lambert`. `facets` are the reflectances at
    normal incidence, `schlick` the share of the facets that follows Schlick. A clear coat of reflectance `coat_facets`
    is blended over it by `coat_weight`.
    """

    diffuse: Pixels
    lambert: Pixels
    weight: Pixels
    facets: Pixels
    schlick: Pixels
    coat_weight: Pixels
    coat_facets: Pixels


def lobes(
    color: Pixels,
    metallic: Pixels,
    roughness: Pixels,
    dielectric: Pixels,
    grazing: Pixels,
    coat: Pixels,
    brightest: Pixels | None = None,
) -> Lobes:
    """The lobes of base colour, metalness, roughness, a dielectric's reflectance at normal and grazing incidence, coat.

    brightest : the base colour that all weights are chosen for, in place of `color`, which is nowhere above it. With
        it, `diffuse` and `facets` are linear in `color`, except where black would need a diffuse part below 0.

    Source: glTF 2.0, B.3.5; KHR_materials_specular, KHR_materials_clearcoat. Of the diffuse light, 1 - F0 leaves the
    dielectric: the mean of glTF's 1 - F over directions differs from it by less than 0.02.
    """
    brightest = color if brightest is None else brightest
    color, brightest, metallic, roughness, dielectric, grazing, coat = _fitted(
        color, brightest, metallic, roughness, dielectric, grazing, coat
    )
    at_grazing = (1 - metallic) * grazing + metallic
    diffuse, at_normal = _reflected(color, metallic, dielectric)
    most_diffuse, most_at_normal = diffuse, at_normal
    if brightest is not color:
        most_diffuse, most_at_normal = _reflected(brightest, metallic, dielectric)

    most = np.ones_like(coat)
    if coat.any():
        most, below = _coating(coat, most_diffuse + most_at_normal)
        diffuse, at_normal = below * diffuse, below * at_normal
        most_diffuse, most_at_normal = below * most_diffuse, below * most_at_normal

    shares = _shares(most_diffuse, most_at_normal, at_grazing, roughness)
    lambert, weight, schlick, unit = shares
    diffuse, facets = _lobe_colors(diffuse, at_normal, weight, schlick, unit)
    coats = coat * most, _COAT_F0 / most
    arrays = diffuse, lambert, weight, facets, schlick, *coats
    return Lobes(*(np.asarray(array, dtype=np.float32) for array in arrays))


def _coating(coat: Pixels, beneath: Pixels) -> tuple[Pixels, Pixels]:
    """(the largest weight of the coat in the blend, the factor of the light of what is beneath it).

    At grazing angles a coat reflects its weight. The blend takes `coat * most` of the light from what is beneath, which
    is therefore divided by 1 - coat * most: at normal incidence 1 - F0 coat of it has to remain. `most` is as large as
    keeps the brightest colour beneath below 1: (1 - F0) beneath / (1 - most) <= 1.
    """
    most = np.clip(1 - (1 - _COAT_F0) * _brightest(beneath), _COAT_F0, _COAT_MOST)
    below = (1 - _COAT_F0 * coat) / (1 - coat * most)
    return most, below


def _reflected(
    color: Pixels, metallic: Pixels, dielectric: Pixels
) -> tuple[Pixels, Pixels]:
    """The light that a surface scatters, and that it reflects at normal incidence, (H, W, 3)."""
    diffuse = (1 - metallic) * (1 - _brightest(dielectric)) * color
    at_normal = (1 - metallic) * dielectric + metallic * color
    return diffuse, at_normal


def _shares(
    diffuse: Pixels, at_normal: Pixels, at_grazing: Pixels, roughness: Pixels
) -> tuple[Pixels, ...]:
    """(lambert, weight, schlick) of `Lobes`, and the reflectance of a diffuse lobe of colour 1.

    The parts of the blend keep their colours below 1.

    diffuse, at_normal, at_grazing : light that the surface scatters, and reflects at normal and grazing incidence.
    """
    lambert = np.clip((roughness - _LAMBERT_FROM) / (1 - _LAMBERT_FROM), 0, 1)
    lambert = np.where(at_grazing > 0, lambert, 1)
    # Reflectance of a diffuse lobe of colour 1; Disney's is 0.976 + 0.06 roughness at normal incidence.
    unit = (1 - lambert) * (0.976 + 0.06 * roughness) + lambert
    # The diffuse part needs at least this weight in the blend, for its colour to stay below its limit.
    share = _brightest(diffuse) / unit / (1 + (_LAMBERT_MOST - 1) * lambert)
    with np.errstate(divide="ignore", invalid="ignore"):
        # The facets need at least this weight, for their colour F0 / (weight * schlick) to stay below 1.
        least = np.where(at_grazing > 0, _brightest(at_normal) / at_grazing, 0)
        weight = np.where(at_grazing > 0, np.clip(1 - share, least, 1), 0)
        weight = weight.astype(np.float32)
        # Both parts have facets of reflectance s at grazing angles, except for Lambert's share of the lower one.
        schlick = np.minimum(at_grazing / (weight + (1 - weight) * (1 - lambert)), 1)
        schlick = np.where(at_grazing > 0, schlick, 0)
    return lambert, weight, schlick, unit


def _lobe_colors(
    diffuse: Pixels, at_normal: Pixels, weight: Pixels, schlick: Pixels, unit: Pixels
) -> tuple[Pixels, Pixels]:
    """(diffuse, facets) of `Lobes`, for the light that a surface scatters and that it reflects at normal incidence."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # The blend reflects weight * schlick * facets at normal incidence, which is to be F0.
        share = weight * schlick
        facets = np.where(share > 0, np.clip(at_normal / share, 0, 1), 0)
        # A metal has a diffuse lobe where schlick < 1; what it reflects is taken from the lower part.
        rest = diffuse - weight * (1 - schlick) * facets
        diffuse = np.where(weight < 1, np.maximum(rest, 0) / ((1 - weight) * unit), 0)
    return diffuse, facets


def _gltf(maps: _Maps) -> Plugin:
    """The reflecting surface without its clear coat, blended with glass."""
    opaque = _both_sides(maps.material, _opaque(maps))
    return _transmissive(maps, opaque)


def _dielectric(maps: _Maps) -> tuple[Pixels, Pixels]:
    """Reflectance of the dielectric at normal (H, W, 3) and at grazing incidence (H, W, 1)."""
    material = maps.material
    factor = maps.shared(material.specular)
    tint = _as_rgb(maps.shared(material.specular_color))
    infinite = material.ior == 0
    f0 = 1.0 if infinite else ((material.ior - 1) / (material.ior + 1)) ** 2
    tint, factor = _fitted(tint, factor)
    return np.minimum(np.float32(f0) * tint, 1) * factor, factor


def _opaque(maps: _Maps) -> Plugin:
    surface = maps.surface
    facets = {
        "type": "principled",
        "roughness": maps.material.roughness,
        "eta": 1.01,  # almost no Fresnel reflectance; 1 would switch the facets off
    }
    diffuse = maps.of_lobes(lambda lobes: lobes.diffuse)
    schlick = maps.value(surface.schlick)
    lower = _blend(
        maps.value(surface.lambert),
        {**facets, "base_color": diffuse, "spec_tint": schlick},
        {"type": "diffuse", "reflectance": diffuse},
    )
    metal = {
        **facets,
        "base_color": maps.of_lobes(lambda lobes: lobes.facets),
        "metallic": schlick,
    }
    return _blend(maps.value(surface.weight), lower, metal)


def _transmissive(maps: _Maps, opaque: Plugin) -> Plugin:
    """`opaque` blended with glass: a thin pane, or a solid."""
    material = maps.material
    amount = maps.shared(material.transmission)
    if not amount.any():
        return opaque
    color = maps.times_vertices(maps.value(maps.base()))
    pane: dict[str, Any] = {
        "type": "thindielectric",
        "int_ior": max(material.ior, _LEAST_IOR),
        "specular_transmittance": color,
    }
    if not material.thin_walled:
        # One roughness for all of it: Mitsuba's rough glass has none per texel.
        roughness = _mean(material.roughness)
        rough = roughness > _SMOOTHEST
        pane["type"] = "roughdielectric" if rough else "dielectric"
        if rough:
            pane |= {"distribution": "ggx", "alpha": roughness**2}
    amount, metallic = _fitted(amount, maps.shared(material.metallic))
    return _blend(maps.value(amount * (1 - metallic)), opaque, pane)


def _coated(maps: _Maps, plugin: Plugin) -> Plugin:
    """`plugin` below a clear coat, which has facets and a normal map of its own."""
    material = maps.material
    if material.model != "gltf" or not _largest(material.coat):
        return plugin
    layer: Plugin = {
        "type": "principled",
        "base_color": maps.value(maps.surface.coat_facets),
        "metallic": 1.0,
        "roughness": material.coat_roughness,
    }
    layer = _both_sides(material, layer)
    layer = _normal_mapped(material.coat_normal, material, layer)
    return _blend(maps.value(maps.surface.coat_weight), plugin, layer)


def _blend(weight: Any, first: Plugin, second: Plugin) -> Plugin:
    if isinstance(weight, float) and weight in (0.0, 1.0):
        return second if weight else first
    return {"type": "blendbsdf", "weight": weight, "bsdf_0": first, "bsdf_1": second}


def _mean(value: Any) -> float:
    return float(value.pixels.mean()) if isinstance(value, Bitmap) else float(value)


def _largest(value: Any) -> float:
    """The largest number of a value."""
    return float(value.pixels.max()) if isinstance(value, Bitmap) else float(value)


_MODELS: dict[str, Callable[[_Maps], Plugin]] = {
    "gltf": _gltf,
    "lambert": _lambert,
    "plastic": _plastic,
    "metal": _metal,
    "glass": _glass,
    "principled": _principled,
}
"""The BSDF of each of `scenes.materials.MODELS`, without normal map, coat and mask."""


# Kinds of materials in the ground truth.


def material_kind(bsdf: Any, material: AnyMaterial | None = None) -> int:
    """Index into MATERIAL_KINDS from the flags of a BSDF: transmissive, mirror, glossy, or diffuse if it is matte.

    The kind of a masked surface is that of its opaque texels, as ground truth passes the others.
    """
    flags = mitsuba().BSDFFlags
    bsdf = _below_masks(bsdf)
    has = int(bsdf.flags()).__and__
    passes = (
        flags.DiffuseTransmission | flags.GlossyTransmission | flags.DeltaTransmission
    )
    if has(int(passes)) or (has(int(flags.Null)) and has_pane(bsdf)):
        return 4
    glossy = has(int(flags.GlossyReflection | flags.DeltaReflection))
    if has(int(flags.DiffuseReflection)):
        matte = is_matte(material) or _is_matte_plugin(bsdf)
        return 2 if glossy and not matte else 1
    if has(int(flags.GlossyReflection)):
        return 2
    return 3 if has(int(flags.DeltaReflection)) else 1


def _below_masks(bsdf: Any) -> Any:
    """The BSDF that a mask cuts out."""
    while bsdf.class_name() == "MaskBSDF":
        (bsdf,) = parts_of(bsdf, mitsuba().BSDF)
    return bsdf


def parts_of(bsdf: Any, kind: Any) -> list[Any]:
    """The objects of a class of Mitsuba that a BSDF has: those directly below it."""
    below = mitsuba().traverse(bsdf).hierarchy.items()
    return [
        part for part, (parent, _) in below if parent is bsdf and isinstance(part, kind)
    ]


def has_pane(bsdf: Any) -> bool:
    """Whether a BSDF is or has a thin pane of glass. Mitsuba's flag for its passage is that of masks and openings."""
    parts = mitsuba().traverse(bsdf).hierarchy
    return any(part.class_name() == "ThinDielectric" for part in parts)


def is_matte(material: AnyMaterial | None) -> bool:
    """Whether a material has facets as rough as matte paint everywhere, and neither metal nor clear coat."""
    if not isinstance(material, Material) or material.model not in _MATTE_MODELS:
        return False
    roughness = material.roughness
    least = roughness.pixels.min() if isinstance(roughness, Bitmap) else roughness
    metal_or_coat = max(_largest(material.metallic), _largest(material.coat))
    return bool(least >= MATTE_ROUGHNESS and metal_or_coat < _MOST_METAL_OF_MATTE)


def _is_matte_plugin(bsdf: Any) -> bool:
    """As `is_matte`, of a `principled` BSDF without maps of roughness, metal and clear coat."""
    values = mitsuba().traverse(bsdf)
    keys = [f"{name}.value" for name in ("roughness", "metallic", "clearcoat")]
    if not all(key in values for key in keys):
        return False
    roughness, metallic, clearcoat = (np.ravel(values[key])[0] for key in keys)
    metal_or_coat = max(metallic, clearcoat)
    return bool(roughness >= MATTE_ROUGHNESS and metal_or_coat < _MOST_METAL_OF_MATTE)
