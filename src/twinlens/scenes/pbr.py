"""Materials of glTF 2.0 as Mitsuba plugins.

glTF's surface is a mix of a diffuse lobe below a dielectric and of a metal, both with GGX facets of alpha = roughness^2
and Schlick's reflectance F + (1 - F) s, s = (1 - cos)^5. Mitsuba's `principled` has the same facets, but one colour for
its diffuse lobe and its metal, and Fresnel's equations for dielectrics, which differ from Schlick by a quarter at 60
degrees. So a surface becomes a `blendbsdf` of two: a metal, whose colour is F / weight, and a dielectric of no
reflectance at normal incidence with the full `spec_tint`, which has a diffuse lobe and facets of reflectance s. The sum
of their facets is Schlick's reflectance for every weight. The diffuse lobe of `principled` is too bright at grazing
angles if it is rough; there, more and more of it is Lambert's. Source: glTF 2.0, appendix B.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.scenes.assets import check_picture_size, linear_from_srgb
from twinlens.scenes.gltf_tables import PbrMaterial, Sampler, Texture, TextureInfo
from twinlens.scenes.scene import MATTE_ROUGHNESS, Bitmap, Color, Plugin

Pixels = NDArray[np.float32]
Stored = NDArray[np.uint8] | NDArray[np.uint16]
_LAMBERT_FROM = 0.6  # roughness from which a part of the diffuse light is Lambert's; all of it is at roughness 1
_LAMBERT_MOST = 2.5
"""Largest reflectance of Lambert's lobe, whose weight is smaller for it. A small weight has more noise, as `blendbsdf`
samples by weight; a large one leaves less for the facets, whose reflectance is 1 at grazing angles."""

_COAT_F0 = 0.04
_COAT_MOST = 0.99  # weight of a coat in the blend with what is below
_SMOOTHEST = 0.03  # roughness below which transmission is without facets
_NEAREST, _CLAMP, _MIRROR = 9728, 33071, 33648
_FORMATS = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG"}
_IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class _Frame:
    """How a texture lies on the surface."""

    to_uv: Float = field(default_factory=lambda: _IDENTITY)
    wrap: str = "repeat"
    filter: str = "bilinear"

    def agrees(self, other: "_Frame") -> bool:
        same = (self.wrap, self.filter) == (other.wrap, other.filter)
        return same and np.array_equal(self.to_uv, other.to_uv)

    def bitmap(self, pixels: NDArray[Any]) -> Bitmap:
        matrix = np.eye(4)
        matrix[np.ix_([0, 1, 3], [0, 1, 3])] = self.to_uv
        return Bitmap(
            np.ascontiguousarray(pixels, dtype=np.float32),
            self.filter,
            self.wrap,
            matrix,
        )


@dataclass(eq=False)
class Textures:
    """The textures of a file. `picture` gives the encoded bytes of an image; `lost` collects what is not rendered."""

    textures: list[Texture]
    samplers: list[Sampler]
    picture: Callable[[int], bytes]
    lost: list[str] = field(default_factory=list)
    _decoded: dict[int, Stored] = field(default_factory=dict)

    def read(
        self,
        info: TextureInfo | None,
        coordinate_set: int,
        channels: slice,
        srgb: bool = False,
    ) -> tuple[Pixels, _Frame] | None:
        """Channels of the texels (H, W, C) in [0, 1], and how they lie; None if there is nothing to render.

        With `srgb`, the first three channels are made linear.
        """
        if info is None:
            return None
        texture = self.textures[info.index]
        if texture.source is None:
            self.lost.append(f"textures[{info.index}] without a .png or .jpg picture")
            return None
        if info.coordinate_set != coordinate_set:
            self.lost.append("a second set of texture coordinates")
        if texture.source not in self._decoded:
            self._decoded[texture.source] = _decoded(
                self.picture(texture.source), texture.source
            )
            check_picture_size(
                f"images[{texture.source}]",
                1,
                sum(each[..., 0].size for each in self._decoded.values()),
            )
        stored = self._decoded[texture.source][..., channels]
        most = np.iinfo(stored.dtype).max
        pixels: Pixels = np.divide(stored, most, dtype=np.float32)
        linear = linear_from_srgb(np.linspace(0, 1, most + 1))
        for channel in range(
            3 if srgb else 0
        ):  # one by one: NumPy converts indices to 8 bytes each
            pixels[..., channel] = linear[stored[..., channel]]
        sampler = (
            Sampler() if texture.sampler is None else self.samplers[texture.sampler]
        )
        if sampler.wrapS != sampler.wrapT:
            self.lost.append("different wrapping along u and v")
        wrap = {_CLAMP: "clamp", _MIRROR: "mirror"}.get(sampler.wrapS, "repeat")
        matrix = info.extensions.KHR_texture_transform.matrix()
        return pixels, _Frame(
            matrix, wrap, "nearest" if sampler.magFilter == _NEAREST else "bilinear"
        )


def _decoded(data: bytes, index: int) -> Stored:
    """A .png or .jpg picture as stored values (H, W, 4), whatever its suffix and media type."""
    from PIL import Image as Pillow

    kind = next(
        (name for magic, name in _FORMATS.items() if data.startswith(magic)), None
    )
    if kind is None:
        raise InputError(f"images[{index}] must be a .png or .jpg picture")
    with Pillow.open(BytesIO(data), formats=[kind]) as image:
        check_picture_size(f"images[{index}]", image.width, image.height)
        if image.mode.startswith("I"):
            grey = np.asarray(image).astype(np.uint16)
            return np.stack([grey, grey, grey, np.full_like(grey, 65535)], axis=-1)
        return np.asarray(image.convert("RGBA"))


class _Maps:
    """Values of a material over its texels, factors included, in the frame of the first texture.

    With vertex colours the values are computed at vertices, as (1, V, C), and go into `attributes` (V, C).
    """

    def __init__(
        self, material: PbrMaterial, textures: Textures, colors: Float | None
    ) -> None:
        self.material, self.textures, self.colors = material, textures, colors
        self.frame: _Frame | None = None
        self.attributes: dict[str, Float] = {}

    def base(self) -> Pixels:
        """The base colour and alpha (H, W, 4)."""
        rough = self.material.pbrMetallicRoughness
        if self.colors is None:
            return self.shared(
                rough.baseColorTexture, rough.baseColorFactor, slice(0, 4), srgb=True
            )
        return np.asarray(self.colors[None] * rough.baseColorFactor, dtype=np.float32)

    def shared(
        self, info: TextureInfo | None, factor: Any, channels: slice, srgb: bool = False
    ) -> Pixels:
        """`factor` times the texture's `channels`, (H, W, C), or (1, 1, C) without a texture.

        Values that are computed together need one frame. A texture with another one is replaced by its mean.
        """
        scale: Pixels = np.asarray(factor, dtype=np.float32).reshape(1, 1, -1)
        found = self.textures.read(info, self.material.coordinate_set, channels, srgb)
        if found is None:
            return scale
        pixels, frame = found
        if self.colors is not None or not (
            self.frame is None or frame.agrees(self.frame)
        ):
            self.textures.lost.append(
                "textures of one material placed in different ways"
            )
            pixels = pixels.mean(axis=(0, 1), keepdims=True)
        else:
            self.frame = frame
        return np.asarray(scale * pixels, dtype=np.float32)

    def own(
        self, info: TextureInfo | None, factor: float, channel: int
    ) -> float | Bitmap:
        """`factor`, or `factor` times a channel of a texture, in the texture's own frame."""
        found = self.textures.read(
            info, self.material.coordinate_set, slice(channel, channel + 1)
        )
        return (
            factor
            if found is None
            else found[1].bitmap(np.float32(factor) * found[0][..., 0])
        )

    def value(self, name: str, pixels: Pixels) -> Any:
        """A Mitsuba value of (H, W, C): a number or a colour if it is uniform, else a mesh attribute or a Bitmap."""
        if self.colors is None and (pixels == pixels[:1, :1]).all():
            pixels = pixels[:1, :1]
        if pixels.shape[:2] != (1, 1) and self.colors is not None:
            self.attributes[f"vertex_{name}"] = pixels[0].astype(np.float64)
            return {"type": "mesh_attribute", "name": f"vertex_{name}"}
        if pixels.shape[:2] != (1, 1):
            return (self.frame or _Frame()).bitmap(
                pixels[..., 0] if pixels.shape[2] == 1 else pixels
            )
        if pixels.shape[2] == 1:
            return float(pixels[0, 0, 0])
        if pixels.max() > 1:  # Mitsuba refuses such a colour, but not such a picture
            return Bitmap(np.ascontiguousarray(pixels))
        return Color(tuple(pixels[0, 0].astype(float).tolist()))


def _fitted(*maps: Pixels) -> list[Pixels]:
    """Maps at the largest height and width among them, by the nearest texel; uniform ones stay (1, 1, C)."""
    height, width = (max(each.shape[axis] for each in maps) for axis in (0, 1))
    fitted = []
    for each in maps:
        rows, columns = (
            (np.arange(n) + 0.5) * size // n
            for n, size in zip((height, width), each.shape, strict=False)
        )
        whole = each.shape[:2] in ((1, 1), (height, width))
        fitted.append(
            each if whole else each[rows.astype(int)[:, None], columns.astype(int)]
        )
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
) -> Lobes:
    """The lobes of base colour, metalness, roughness, a dielectric's reflectance at normal and grazing incidence, coat.

    Source: glTF 2.0, B.3.5; KHR_materials_specular, KHR_materials_clearcoat. Of the diffuse light, 1 - F0 leaves the
    dielectric: the mean of glTF's 1 - F over directions differs from it by less than 0.02.
    """
    color, metallic, roughness, dielectric, grazing, coat = _fitted(
        color, metallic, roughness, dielectric, grazing, coat
    )
    at_normal = (1 - metallic) * dielectric + metallic * color
    at_grazing = (1 - metallic) * grazing + metallic
    diffuse = (1 - metallic) * (1 - _brightest(dielectric)) * color
    most = np.ones_like(coat)
    if coat.any():  # at grazing angles a coat reflects its weight; what is below is divided by the rest
        most = np.clip(
            1 - (1 - _COAT_F0) * _brightest(diffuse + at_normal), _COAT_F0, _COAT_MOST
        )
        below = (1 - _COAT_F0 * coat) / (1 - coat * most)
        at_normal, diffuse = below * at_normal, below * diffuse
    lambert = np.clip((roughness - _LAMBERT_FROM) / (1 - _LAMBERT_FROM), 0, 1)
    lambert = np.where(at_grazing > 0, lambert, 1)
    # Disney's lobe reflects 0.976 + 0.06 roughness at normal incidence.
    unit = (1 - lambert) * (0.976 + 0.06 * roughness) + lambert
    share = _brightest(diffuse) / unit / (1 + (_LAMBERT_MOST - 1) * lambert)
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(at_grazing > 0, _brightest(at_normal) / at_grazing, 0)
        weight = np.where(at_grazing > 0, np.clip(1 - share, least, 1), 0).astype(
            np.float32
        )
        schlick = np.minimum(at_grazing / (weight + (1 - weight) * (1 - lambert)), 1)
        schlick = np.where(at_grazing > 0, schlick, 0)
        facets = np.where(
            weight * schlick > 0, np.clip(at_normal / (weight * schlick), 0, 1), 0
        )
        rest = (
            diffuse - weight * (1 - schlick) * facets
        )  # a metal has a diffuse lobe where schlick < 1
        diffuse = np.where(weight < 1, np.maximum(rest, 0) / ((1 - weight) * unit), 0)
    found = diffuse, lambert, weight, facets, schlick, coat * most, _COAT_F0 / most
    return Lobes(*(np.asarray(each, dtype=np.float32) for each in found))


def plugin_of(
    material: PbrMaterial, textures: Textures, colors: Float | None = None
) -> tuple[Plugin, dict[str, Float]]:
    """The Mitsuba plugin of a material, and the attributes (V, C) of vertices that have `colors` (V, 4).

    The plugin's keys `emitter` and `matte` are those of `Scene.materials`. What cannot be mapped is added to
    `textures.lost`.
    """
    maps, more = _Maps(material, textures, colors), material.extensions
    textures.lost += sorted(more.model_extra or {})
    base = maps.base()
    found, metallic, matte = _lobes_of(material, maps, base[..., :3])
    plugin = _transmissive(
        material,
        maps,
        base[..., :3],
        metallic,
        _sides(material, _opaque(material, maps, found)),
    )
    plugin = _normal_mapped(material.normalTexture, maps, plugin)
    plugin = _coated(material, maps, found, plugin)
    if material.alphaMode != "OPAQUE":
        alpha = base[..., 3:]
        opacity = (
            (alpha >= material.alphaCutoff).astype(np.float32)
            if material.alphaMode == "MASK"
            else alpha
        )
        plugin = {
            "type": "mask",
            "opacity": maps.value("opacity", opacity),
            "bsdf": plugin,
        }
    return {
        **plugin,
        **_emission(material, maps),
        **({"matte": True} if matte else {}),
    }, maps.attributes


def _sides(material: PbrMaterial, plugin: Plugin) -> Plugin:
    return {"type": "twosided", "bsdf": plugin} if material.doubleSided else plugin


def _lobes_of(
    material: PbrMaterial, maps: _Maps, color: Pixels
) -> tuple[Lobes, Pixels, bool]:
    """The reflecting surface, the metalness (H, W, 1), and whether it is as matte as matte paint."""
    rough, coat = (
        material.pbrMetallicRoughness,
        material.extensions.KHR_materials_clearcoat,
    )
    factors = [rough.roughnessFactor, rough.metallicFactor]
    roughness, metallic = np.split(
        maps.shared(rough.metallicRoughnessTexture, factors, slice(1, 3)), 2, axis=-1
    )
    coated = maps.shared(coat.clearcoatTexture, coat.clearcoatFactor, slice(0, 1))
    matte = bool(
        roughness.min() >= MATTE_ROUGHNESS
        and metallic.max() < 0.01
        and not coated.any()
    )
    return (
        lobes(color, metallic, roughness, *_dielectric(material, maps), coated),
        metallic,
        matte,
    )


def _opaque(material: PbrMaterial, maps: _Maps, found: Lobes) -> Plugin:
    """The plugin of the reflecting surface without its clear coat."""
    rough = material.pbrMetallicRoughness
    facets = {
        "type": "principled",
        "roughness": maps.own(rough.metallicRoughnessTexture, rough.roughnessFactor, 1),
        "eta": 1.01,  # almost no Fresnel reflectance; 1 would switch the facets off
    }
    diffuse, schlick = (
        maps.value("diffuse", found.diffuse),
        maps.value("schlick", found.schlick),
    )
    lower = _blend(
        maps.value("lambert", found.lambert),
        {**facets, "base_color": diffuse, "spec_tint": schlick},
        {"type": "diffuse", "reflectance": diffuse},
    )
    metal = {
        **facets,
        "base_color": maps.value("facets", found.facets),
        "metallic": schlick,
    }
    return _blend(maps.value("weight", found.weight), lower, metal)


def _coated(material: PbrMaterial, maps: _Maps, found: Lobes, plugin: Plugin) -> Plugin:
    """`plugin` below a clear coat, which has facets and a normal map of its own."""
    coat = material.extensions.KHR_materials_clearcoat
    if not found.coat_weight.any():
        return plugin
    layer: Plugin = {
        "type": "principled",
        "base_color": maps.value("coat_facets", found.coat_facets),
        "metallic": 1.0,
        "roughness": maps.own(
            coat.clearcoatRoughnessTexture, coat.clearcoatRoughnessFactor, 1
        ),
    }
    layer = _normal_mapped(coat.clearcoatNormalTexture, maps, _sides(material, layer))
    return _blend(maps.value("coat_weight", found.coat_weight), plugin, layer)


def _blend(weight: Any, first: Plugin, second: Plugin) -> Plugin:
    if weight in (0.0, 1.0):
        return second if weight else first
    return {"type": "blendbsdf", "weight": weight, "bsdf_0": first, "bsdf_1": second}


def _dielectric(material: PbrMaterial, maps: _Maps) -> tuple[Pixels, Pixels]:
    """Reflectance of the dielectric at normal (H, W, 3) and at grazing incidence (H, W, 1)."""
    specular, ior = (
        material.extensions.KHR_materials_specular,
        material.extensions.KHR_materials_ior.ior,
    )
    factor = maps.shared(specular.specularTexture, specular.specularFactor, slice(3, 4))
    tint = maps.shared(
        specular.specularColorTexture,
        specular.specularColorFactor,
        slice(0, 3),
        srgb=True,
    )
    f0 = (
        1.0 if ior == 0 else ((ior - 1) / (ior + 1)) ** 2
    )  # 0 stands for an infinite index
    tint, factor = _fitted(tint, factor)
    return np.minimum(np.float32(f0) * tint, 1) * factor, factor


def _transmissive(
    material: PbrMaterial, maps: _Maps, color: Pixels, metallic: Pixels, opaque: Plugin
) -> Plugin:
    """`opaque` blended with glass: a thin pane, or a solid with KHR_materials_volume."""
    glass, volume = (
        material.extensions.KHR_materials_transmission,
        material.extensions.KHR_materials_volume,
    )
    amount = maps.shared(
        glass.transmissionTexture, glass.transmissionFactor, slice(0, 1)
    )
    if not amount.any():
        return opaque
    roughness, solid = (
        material.pbrMetallicRoughness.roughnessFactor,
        volume.thicknessFactor > 0,
    )
    ior = max(material.extensions.KHR_materials_ior.ior, 1.0)
    keys = {
        "int_ior": max(ior, 1.0001),
        "specular_transmittance": maps.value("transmittance", color),
    }
    if volume.attenuationDistance is not None:
        maps.textures.lost.append("the absorption of KHR_materials_volume")
    if solid and material.pbrMetallicRoughness.metallicRoughnessTexture is not None:
        maps.textures.lost.append("the roughness texture of glass")
    if not solid and roughness > _SMOOTHEST:
        maps.textures.lost.append("the roughness of thin glass")
    if not solid:
        pane: Plugin = {"type": "thindielectric", **keys}
    elif roughness > _SMOOTHEST:
        pane = {
            "type": "roughdielectric",
            "distribution": "ggx",
            "alpha": roughness**2,
            **keys,
        }
    else:
        pane = {"type": "dielectric", **keys}
    amount, metallic = _fitted(amount, metallic)
    return _blend(maps.value("transmission", amount * (1 - metallic)), opaque, pane)


def _normal_mapped(info: TextureInfo | None, maps: _Maps, plugin: Plugin) -> Plugin:
    """`plugin` under a normal map. Its green axis points to the top of the picture, as Mitsuba's does."""
    found = maps.textures.read(info, maps.material.coordinate_set, slice(0, 3))
    if info is None or found is None:
        return plugin
    normal = (2 * found[0] - 1) * np.array(
        [info.scale, info.scale, 1], dtype=np.float32
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    return {
        "type": "normalmap",
        "normalmap": found[1].bitmap((normal + 1) / 2),
        "bsdf": plugin,
    }


def mirrored(plugin: Plugin) -> Plugin:
    """A plugin of `plugin_of` for mirrored texture coordinates, where Mitsuba's green axis points to the bottom."""
    made = {
        key: mirrored(value) if isinstance(value, Mapping) else value
        for key, value in plugin.items()
    }
    if plugin.get("type") == "normalmap":
        upright = plugin["normalmap"]
        made["normalmap"] = replace(
            upright,
            pixels=np.abs(upright.pixels - np.array([0, 1, 0], dtype=np.float32)),
        )
    return made


def _emission(material: PbrMaterial, maps: _Maps) -> Plugin:
    """The `emitter` of a material that shines, under that key."""
    factor = np.float32(
        material.extensions.KHR_materials_emissive_strength.emissiveStrength
    )
    rgb = factor * np.asarray(material.emissiveFactor, dtype=np.float32).reshape(
        1, 1, 3
    )
    if not rgb.any():
        return {}
    found = maps.textures.read(
        material.emissiveTexture, material.coordinate_set, slice(0, 3), srgb=True
    )
    radiance = (
        Color(tuple(rgb[0, 0].astype(float).tolist()))
        if found is None
        else found[1].bitmap(rgb * found[0])
    )
    return {"emitter": {"type": "area", "radiance": radiance}}
