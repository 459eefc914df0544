"""Materials: how a surface reflects light, in the terms of glTF 2.0 and OpenPBR, for any renderer.

Readers of files and `twinlens.families` make `Material`s; `twinlens.rendering.materials` alone translates them to
BSDFs. A material of a scene may also be a `Plugin`, which names a BSDF of Mitsuba and its parameters directly: for what
a `Material` cannot express, such as `blendbsdf`. Another renderer would have to refuse it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_known
from twinlens.geometry import Float

Plugin = Mapping[str, Any]
"""A Mitsuba plugin in plain Python: ``{"type": "roughplastic", "alpha": 0.1, ...}``, under its own parameter names.

Besides numbers, strings and booleans a value may be a `Color`, a `Bitmap`, a nested plugin (a texture, a BSDF), or,
under `to_world` and `to_uv`, a 4x4 float64 array. The key `nir` of a material is its near infrared reflectance, that of
a light its share of this band (`twinlens.scenes.bands`).
"""

MATTE_ROUGHNESS = 0.44
"""Roughness of 5 gloss units at 60 degrees, the most of matte paint (docs/realism.md)."""

MODELS = ("gltf", "lambert", "plastic", "metal", "glass", "principled")
"""The formulas of a `Material`, by the name of its `model`."""


@dataclass(frozen=True)
class Color:
    """A colour in linear sRGB."""

    rgb: tuple[float, float, float]


Wrap = str | tuple[str, str]
"""What is outside a picture, in both directions or along u and along v: "repeat", "mirror" or "clamp"."""


def wrap_along(u: str, v: str) -> Wrap:
    """The `Wrap` of two directions."""
    return u if u == v else (u, v)


@dataclass(frozen=True, eq=False)
class Bitmap:
    """A texture in memory: float32 (H, W, 3) or (H, W), linear; row 0 is v = 1, the top of the picture.

    `to_uv` (4x4) maps a surface's (u, v) to the picture's, which covers [0, 1]^2: a scale of 3 repeats it 3 times.
    """

    pixels: NDArray[np.float32]
    filter: str = "bilinear"  # bilinear | nearest
    wrap: Wrap = "repeat"
    to_uv: Float = field(default_factory=lambda: np.eye(4))

    def lies_like(self, bitmap: "Bitmap") -> bool:
        """Whether both pictures are placed, repeated and filtered in the same way."""
        same = (self.wrap, self.filter) == (bitmap.wrap, bitmap.filter)
        return same and np.array_equal(self.to_uv, bitmap.to_uv)


@dataclass(frozen=True)
class VertexColor:
    """The attribute of a mesh with a value (V, 4) per vertex, a linear colour and an opacity in [0, 1], times `factor`.

    factor : for a colour a grey, a colour or a texture, for an opacity a number or a texture.
    """

    attribute: str = "color"
    factor: "float | Color | Bitmap" = 1.0


@dataclass(frozen=True)
class ComplexIndex:
    """The refractive index eta + i k of a metal, by channel."""

    eta: Any
    k: Any


Number = float | Bitmap
"""A number, or one per texel (H, W)."""

ColorValue = float | Color | Bitmap | VertexColor
"""A grey, a colour, one per texel (H, W, 3), or one per vertex."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Material:
    """A surface, in the terms of glTF 2.0 and its extensions.

    model : the formulas of the reflectance, one of `MODELS`. A renderer without them may use its own: the parameters
        keep their meaning. "gltf": glTF 2.0, appendix B. "lambert": Lambert's law. "plastic": Lambert's law below a
        dielectric interface, with the light that is reflected inside it. "metal", "glass": Fresnel's equations.
        "principled": Burley, Physically Based Shading at Disney, SIGGRAPH 2012.
    base_color : reflectance of the diffuse light, of a metal at normal incidence (of "metal": a factor of it), or
        transmittance of glass.
    metallic, roughness : 0 to 1. The facets have alpha = roughness^2.
    facets : their distribution, "ggx" or "beckmann".
    ior : refractive index; 0 is an infinite one.
    specular, specular_color : factors of the reflectance of a dielectric (KHR_materials_specular).
    conductor : the metal of the model "metal", a name of `twinlens.scenes.plugins.CONDUCTORS` or an index.
    transmission, thin_walled : the share of the light that is not diffuse but passes; through a pane, or into a solid.
    coat, coat_roughness : weight and roughness of a clear coat of index 1.5.
    sheen : weight of the reflection of cloth at grazing angles.
    emission : emitted radiance.
    normal, coat_normal : maps of normals in tangent space, (n + 1) / 2, their green channel towards the picture's top.
    bump, bump_scale : a map of heights, and its factor in metres.
    mirrored : whether the texture coordinates are a mirror image of the surface, as tangents of w = -1 in glTF.
    opacity, alpha_cutoff : the share of the surface that is there; with a cutoff, all of it where opacity >= cutoff.
    two_sided : whether both sides are visible; otherwise the back is black.
    nir : near infrared reflectance in place of that derived from `base_color`.

    Raises InputError for an unknown model, and for opacity per vertex without colours per vertex.
    """

    model: str = "gltf"
    base_color: ColorValue = 1.0
    metallic: Number = 0.0
    roughness: Number = 1.0
    facets: Literal["ggx", "beckmann"] = "ggx"
    ior: float = 1.5
    specular: Number = 1.0
    specular_color: ColorValue = 1.0
    conductor: str | ComplexIndex | None = None
    transmission: Number = 0.0
    thin_walled: bool = True
    coat: Number = 0.0
    coat_roughness: Number = 0.0
    sheen: Number = 0.0
    emission: ColorValue | None = None
    normal: Bitmap | None = None
    coat_normal: Bitmap | None = None
    bump: Bitmap | None = None
    bump_scale: float = 1.0
    mirrored: bool = False
    opacity: Number | VertexColor = 1.0
    alpha_cutoff: float | None = None
    two_sided: bool = False
    nir: ColorValue | None = None

    def __post_init__(self) -> None:
        check_known("model of materials", self.model, MODELS)
        for parameter in fields(self):
            value = getattr(self, parameter.name)
            if isinstance(value, int) and not isinstance(value, bool):
                object.__setattr__(self, parameter.name, float(value))
        if isinstance(self.opacity, VertexColor):
            attribute = getattr(self.base_color, "attribute", None)
            if attribute != self.opacity.attribute:
                raise InputError("opacity per vertex needs base_color per vertex")

    @property
    def has_normal_maps(self) -> bool:
        """Whether the surface or its clear coat has a normal map."""
        return self.normal is not None or self.coat_normal is not None


AnyMaterial = Material | Plugin
"""A material of a scene."""


def lambert(color: ColorValue, **more: Any) -> Material:
    """A surface that scatters light by Lambert's law; `more` are other parameters of `Material`."""
    return Material(model="lambert", base_color=color, specular=0.0, **more)


def plastic(color: ColorValue, roughness: float = 0.0, **more: Any) -> Material:
    """A surface that scatters light below a dielectric interface."""
    return Material(model="plastic", base_color=color, roughness=roughness, **more)


def metal(
    conductor: str | ComplexIndex,
    tint: ColorValue = 1.0,
    roughness: float = 0.0,
    **more: Any,
) -> Material:
    """A metal with Fresnel's reflectance times `tint`."""
    return Material(
        model="metal",
        conductor=conductor,
        base_color=tint,
        metallic=1.0,
        roughness=roughness,
        **more,
    )


def glass(ior: float, tint: ColorValue = 1.0, **more: Any) -> Material:
    """Clear glass, whose surface passes the share `tint` of the light; a solid unless `thin_walled` is given."""
    solid: dict[str, Any] = {"roughness": 0.0, "thin_walled": False}
    return Material(
        model="glass", base_color=tint, ior=ior, transmission=1.0, **(solid | more)
    )


def emission_of(material: AnyMaterial) -> ColorValue | None:
    """The radiance that a material emits; a plugin emits none."""
    return material.emission if isinstance(material, Material) else None
