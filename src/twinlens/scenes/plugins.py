"""Materials, lights and integrators of a scene file, under the names of Mitsuba's plugins and parameters.

The lists are closed on purpose. Mitsuba opens a shared library for every plugin name that it does not know, path
included, so only the names written here reach it. A parameter that Mitsuba would ignore or misread is rejected.

A material becomes a `Material` where that has the same meaning (`material_of`), and else stays a plugin.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from operator import methodcaller
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from twinlens.errors import InputError
from twinlens.scenes.assets import Sky
from twinlens.scenes.materials import (
    AnyMaterial,
    Bitmap,
    ComplexIndex,
    Material,
    Plugin,
    glass,
    lambert,
    metal,
    plastic,
)
from twinlens.scenes.placement import Placement, Pose, Vector3, rotation
from twinlens.scenes.texture_tables import TextureMap, number_or_texture, spectrum
from twinlens.schema import (
    Fraction,
    NonNegative,
    StrictModel,
    exactly,
    number,
    one_of,
    reads,
    tagged,
    variants,
    whole,
)

# fmt: off
CONDUCTORS = (
    "a-C", "Ag", "Al", "AlAs", "AlSb", "Au", "Be", "Cr", "CsI", "Cu", "Cu2O", "CuO", "d-C", "Hg", "HgTe", "Ir",
    "K", "Li", "MgO", "Mo", "Na_palik", "Nb", "Ni_palik", "Rh", "Se", "SiC", "SnTe", "Ta", "Te", "ThF4", "TiC",
    "TiN", "TiO2", "VC", "V_palik", "VN", "W", "none",
)
DIELECTRICS = {
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277, "carbon_dioxide": 1.00045,
    "water": 1.3330, "acetone": 1.36, "ethanol": 1.361, "carbon_tetrachloride": 1.461, "glycerol": 1.4729,
    "benzene": 1.501, "silicone_oil": 1.52045, "bromine": 1.661, "water_ice": 1.31, "fused_quartz": 1.458,
    "pyrex": 1.470, "acrylic_glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium_chloride": 1.544,
    "amber": 1.55, "pet": 1.5750, "diamond": 2.419,
}
"""Refractive indices by the names that Mitsuba has for them."""

# fmt: on
_DIELECTRIC = Annotated[
    str,
    one_of("dielectric", DIELECTRICS),
    pydantic.AfterValidator(lambda name: name.replace("_", " ")),
]
_IOR = number(1, 5) | _DIELECTRIC | None
_REFLECTANCE: Any = spectrum(1.0) | None
_RADIANCE = spectrum(1e9) | None
_METAL_INDEX = spectrum(20.0) | None
_FRACTION_MAP = number_or_texture(0.0, 1.0)
_ALPHA_MAP = number_or_texture(1e-4, 1.0) | None
_FLAG = bool | None
_POSITIVE_DEG = number(0, 180, above=True) | None
_FACETS = Literal["beckmann", "ggx"] | None
_BSDF = Annotated[
    Any,
    pydantic.PlainValidator(
        lambda table, info: _NESTED.validate_python(table, context=info.context)
    ),
]


class PluginTable(StrictModel):
    """A table whose `type` is a Mitsuba plugin, and whose keys are its parameters, except for `extra_keys`."""

    extra_keys: ClassVar[frozenset[str]] = frozenset()

    def plugin(self) -> dict[str, Any]:
        """Mitsuba's dictionary, with the parameters that were given."""
        keys = self.model_fields_set - self.extra_keys | {"type"}
        return {
            key: getattr(self, key)
            for key in ("type", *type(self).model_fields)
            if key in keys
        }


class MaterialBase(PluginTable):
    """`twosided` makes both faces of a one-sided material visible. `nir` is the near infrared reflectance."""

    extra_keys = frozenset({"twosided"})
    twosided: bool = False
    nir: _REFLECTANCE = None

    @pydantic.model_validator(mode="after")
    def _check_pairs(self) -> "MaterialBase":
        keys, fields = self.model_fields_set, type(self).model_fields
        for first, second, instead in (
            ("alpha_u", "alpha_v", "alpha"),
            ("eta", "k", "material"),
        ):
            if second in fields and (first in keys) != (second in keys):
                raise InputError(
                    f"{first!r} and {second!r} go together; give both or neither"
                )
            if {first, instead} <= keys:
                raise InputError(f"{instead!r} excludes {first!r} and {second!r}")
        return self

    def plugin(self) -> dict[str, Any]:
        plugin = super().plugin()
        plugin |= dict(zip(("bsdf_0", "bsdf_1"), plugin.pop("bsdfs", ()), strict=False))
        return {"type": "twosided", "bsdf": plugin} if self.twosided else plugin


_IORS = {"int_ior": _IOR, "ext_ior": _IOR}
_GLASS = {
    **_IORS,
    "specular_reflectance": _REFLECTANCE,
    "specular_transmittance": _REFLECTANCE,
}
_PLASTIC = {
    **_IORS,
    "diffuse_reflectance": _REFLECTANCE,
    "specular_reflectance": _REFLECTANCE,
    "nonlinear": _FLAG,
}
_METAL = {
    "material": Annotated[str, one_of("conductor", CONDUCTORS)] | None,
    "eta": _METAL_INDEX,
    "k": _METAL_INDEX,
    "specular_reflectance": _REFLECTANCE,
}
_FACET_KEYS = {"distribution": _FACETS, "sample_visible": _FLAG}
_ROUGH = {
    "alpha": _ALPHA_MAP,
    "alpha_u": _ALPHA_MAP,
    "alpha_v": _ALPHA_MAP,
    **_FACET_KEYS,
}
_MAPPED = (
    "roughness",
    "anisotropic",
    "spec_trans",
    "spec_tint",
    "sheen",
    "sheen_tint",
    "flatness",
)
_PRINCIPLED = {
    "base_color": _REFLECTANCE,
    **dict.fromkeys(_MAPPED, _FRACTION_MAP | None),
    "eta": number(1, 5, above=True) | None,
}
MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": {"reflectance": _REFLECTANCE},
    "dielectric": _GLASS,
    "thindielectric": _GLASS,
    "roughdielectric": _GLASS | _ROUGH,
    "conductor": _METAL,
    "roughconductor": _METAL | _ROUGH,
    "plastic": _PLASTIC,
    "roughplastic": {**_PLASTIC, "alpha": number(1e-4, 1) | None, **_FACET_KEYS},
    "principled": {
        **_PRINCIPLED,
        "specular": Fraction | None,
        **dict.fromkeys(
            ("metallic", "clearcoat", "clearcoat_gloss"), _FRACTION_MAP | None
        ),
    },
    "principledthin": {**_PRINCIPLED, "diff_trans": number_or_texture(0.0, 2.0) | None},
    "twosided": {"bsdf": _BSDF},
    "mask": {"bsdf": _BSDF, "opacity": _FRACTION_MAP},
    "blendbsdf": {
        "bsdfs": Annotated[list[_BSDF], exactly(2, _BSDF)],
        "weight": _FRACTION_MAP,
    },
    "bumpmap": {"bsdf": _BSDF, "bump": TextureMap, "scale": number(0, 1000) | None},
    "normalmap": {"bsdf": _BSDF, "normalmap": TextureMap},
    "null": {},
}


class LightBase(PluginTable):
    """`sampling_weight` is how often a light is sampled, relative to the others.

    `nir` is the share of near infrared light: a kind of light, or the power relative to the visible.
    """

    sampling_weight: NonNegative | None = None
    nir: Literal["daylight", "tungsten", "led"] | NonNegative | None = None

    @pydantic.model_validator(mode="after")
    def _check_light(self) -> "LightBase":
        plugin = self.plugin()
        for key in ("direction", "sun_direction"):
            if key in plugin and not np.linalg.norm(plugin[key]) > 1e-9:
                raise InputError(f"{key} must not be zero")
        if "direction" in plugin and "to_world" in plugin:
            raise InputError(
                "'direction' and the keys that place the light exclude each other"
            )
        if plugin.get("beam_width", 0.0) > plugin.get("cutoff_angle", 20.0):
            raise InputError(
                "beam_width must not be wider than cutoff_angle (default: 20)"
            )
        return self


class PlacedLight(LightBase, Placement):
    """A light that may be placed like an object."""

    extra_keys = frozenset(Placement.placing_keys)

    def plugin(self) -> dict[str, Any]:
        placed = not self.extra_keys.isdisjoint(self.model_fields_set)
        return super().plugin() | (
            {"to_world": self.world_from_object()} if placed else {}
        )


class EnvironmentMap(LightBase, Pose):
    """Light from a panorama, z up; `scale` multiplies its radiance."""

    extra_keys = frozenset(Pose.placing_keys)

    def plugin(self) -> dict[str, Any]:
        upright = rotation(
            [1.0, 0.0, 0.0], 90.0
        )  # Mitsuba's maps are y up, twinlens's worlds z up
        return super().plugin() | {"to_world": self.world_from_object() @ upright}


_PLACED_LIGHTS: dict[str, dict[str, Any]] = {
    "spot": {
        "intensity": _RADIANCE,
        "cutoff_angle": _POSITIVE_DEG,
        "beam_width": _POSITIVE_DEG,
    },
    "directional": {"direction": Vector3 | None, "irradiance": _RADIANCE},
}
_OTHER_LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"position": Vector3 | None, "intensity": _RADIANCE},
    "constant": {"radiance": _RADIANCE},
    "sunsky": {
        "turbidity": number(1, 10) | None,
        "albedo": _REFLECTANCE,
        "sun_direction": Vector3 | None,
        "sun_scale": NonNegative | None,
        "sky_scale": NonNegative | None,
        "sun_aperture": number(0, 90, above=True) | None,
    },
}
_ENVIRONMENT: dict[str, dict[str, Any]] = {
    "envmap": {"filename": Sky, "scale": NonNegative | None}
}
LIGHTS = {**_PLACED_LIGHTS, **_OTHER_LIGHTS, **_ENVIRONMENT}
SURROUNDING_LIGHTS = ("constant", "envmap", "sunsky")
AREA_LIGHTS = {
    "area": {"radiance": _RADIANCE},
    "directionalarea": {"radiance": _RADIANCE},
}
_RENDER_KEYS = {"hide_emitters": _FLAG}
INTEGRATORS: dict[str, dict[str, Any]] = {
    "path": {
        "max_depth": whole(-1, 1024) | None,
        "rr_depth": whole(1, 1024) | None,
        **_RENDER_KEYS,
    },
    "direct": {
        "shading_samples": whole(1, 1024) | None,
        **dict.fromkeys(("emitter_samples", "bsdf_samples"), whole(0, 1024) | None),
        **_RENDER_KEYS,
    },
}


def material_of(plugin: Plugin) -> AnyMaterial:
    """The `Material` of the same meaning as a BSDF of Mitsuba, or the plugin itself where there is none.

    >>> material_of({"type": "plastic", "int_ior": "bk7"}).ior
    1.5046
    """
    if plugin["type"] == "twosided" and plugin["bsdf"]["type"] == "mask":
        # Mitsuba refuses a mask below `twosided`; the same surface has the mask outside.
        mask = plugin["bsdf"]
        sides = {**plugin, "bsdf": mask["bsdf"]}
        return material_of({**mask, "bsdf": sides})
    reader, keys = _MATERIAL_READERS.get(plugin["type"], (None, frozenset()))
    if reader is None or not plugin.keys() <= {"type", "nir", *keys}:
        return plugin
    material = reader(plugin)
    if material is None:
        return plugin
    nir = plugin.get("nir")
    if nir is None or material.nir is not None:
        return material
    return replace(material, nir=nir)


def _index(plugin: Plugin, default: str) -> float:
    """The refractive index of the inside; air is outside."""
    index = plugin.get("int_ior", default)
    if isinstance(index, str):
        return DIELECTRICS[index.replace(" ", "_")]
    return float(index)


def _facets(plugin: Plugin) -> dict[str, Any] | None:
    """The parameters of rough facets, by Mitsuba's defaults; None for a map of alpha."""
    alpha = plugin.get("alpha", 0.1)
    if isinstance(alpha, Bitmap):
        return None
    return {
        "roughness": math.sqrt(alpha),
        "facets": plugin.get("distribution", "beckmann"),
    }


def _diffuse(plugin: Plugin) -> Material | None:
    return lambert(plugin.get("reflectance", 0.5))


def _plastic(plugin: Plugin) -> Material | None:
    is_rough = plugin["type"] == "roughplastic"
    facets = _facets(plugin) if is_rough else {}
    if facets is None:
        return None
    return plastic(
        plugin.get("diffuse_reflectance", 0.5),
        ior=_index(plugin, "polypropylene"),
        specular_color=plugin.get("specular_reflectance", 1.0),
        **facets,
    )


def _conductor(plugin: Plugin) -> Material | None:
    is_rough = plugin["type"] == "roughconductor"
    facets = _facets(plugin) if is_rough else {}
    if facets is None:
        return None
    conductor = plugin.get("material", "none")
    if "eta" in plugin:
        conductor = ComplexIndex(plugin["eta"], plugin["k"])
    return metal(conductor, plugin.get("specular_reflectance", 1.0), **facets)


def _dielectric(plugin: Plugin) -> Material | None:
    is_rough = plugin["type"] == "roughdielectric"
    facets = _facets(plugin) if is_rough else {}
    if facets is None:
        return None
    return glass(
        _index(plugin, "bk7"),
        plugin.get("specular_transmittance", 1.0),
        thin_walled=plugin["type"] == "thindielectric",
        specular_color=plugin.get("specular_reflectance", 1.0),
        **facets,
    )


def _principled(plugin: Plugin) -> Material | None:
    gloss = plugin.get("clearcoat_gloss", 0.0)
    if isinstance(gloss, Bitmap):
        return None
    return Material(
        model="principled",
        base_color=plugin.get("base_color", 0.5),
        roughness=plugin.get("roughness", 0.5),
        metallic=plugin.get("metallic", 0.0),
        sheen=plugin.get("sheen", 0.0),
        coat=plugin.get("clearcoat", 0.0),
        coat_roughness=1 - gloss,
        ior=plugin.get("eta", 1.5),
    )


def _nested(plugin: Plugin) -> Material | None:
    """The BSDF inside another, if it is a `Material` without normal map, bump map and mask."""
    inner = material_of(plugin["bsdf"])
    if not isinstance(inner, Material):
        return None
    is_plain = inner.normal is None and inner.bump is None and inner.opacity == 1.0
    return inner if is_plain else None


def _twosided(plugin: Plugin) -> Material | None:
    inner = _nested(plugin)
    return None if inner is None else replace(inner, two_sided=True)


def _normalmap(plugin: Plugin) -> Material | None:
    inner = _nested(plugin)
    return None if inner is None else replace(inner, normal=plugin["normalmap"])


def _bumpmap(plugin: Plugin) -> Material | None:
    inner = _nested(plugin)
    if inner is None:
        return None
    return replace(inner, bump=plugin["bump"], bump_scale=plugin.get("scale", 1.0))


def _mask(plugin: Plugin) -> Material | None:
    inner = material_of(plugin["bsdf"])
    if not isinstance(inner, Material) or inner.opacity != 1.0:
        return None
    return replace(inner, opacity=plugin["opacity"])


_Reader = Callable[[Plugin], Material | None]
_PLASTIC_KEYS = {"int_ior", "diffuse_reflectance", "specular_reflectance"}
_METAL_KEYS = {"material", "eta", "k", "specular_reflectance"}
_GLASS_KEYS = {"int_ior", "specular_transmittance", "specular_reflectance"}
_ALPHA_KEYS = {"alpha", "distribution"}
_MATERIAL_READERS: dict[str, tuple[_Reader, frozenset[str]]] = {
    "diffuse": (_diffuse, frozenset({"reflectance"})),
    "plastic": (_plastic, frozenset(_PLASTIC_KEYS)),
    "roughplastic": (_plastic, frozenset(_PLASTIC_KEYS | _ALPHA_KEYS)),
    "conductor": (_conductor, frozenset(_METAL_KEYS)),
    "roughconductor": (_conductor, frozenset(_METAL_KEYS | _ALPHA_KEYS)),
    "dielectric": (_dielectric, frozenset(_GLASS_KEYS)),
    "thindielectric": (_dielectric, frozenset(_GLASS_KEYS)),
    "roughdielectric": (_dielectric, frozenset(_GLASS_KEYS | _ALPHA_KEYS)),
    "principled": (
        _principled,
        frozenset(
            {
                "base_color",
                "roughness",
                "metallic",
                "sheen",
                "clearcoat",
                "clearcoat_gloss",
                "eta",
            }
        ),
    ),
    "twosided": (_twosided, frozenset({"bsdf"})),
    "normalmap": (_normalmap, frozenset({"normalmap", "bsdf"})),
    "bumpmap": (_bumpmap, frozenset({"bump", "scale", "bsdf"})),
    "mask": (_mask, frozenset({"opacity", "bsdf"})),
}
"""How BSDFs become a `Material`, and the parameters that it can have; one with others stays a plugin."""


_as_plugin = methodcaller("plugin")
_BASES = (
    (PlacedLight, _PLACED_LIGHTS),
    (LightBase, _OTHER_LIGHTS),
    (EnvironmentMap, _ENVIRONMENT),
)
_LIGHTS = list(
    itertools.chain.from_iterable(
        variants(base, "type", tables) for base, tables in _BASES
    )
)
_AREA_LIGHTS = variants(LightBase, "type", AREA_LIGHTS, "area")
_INTEGRATORS = variants(PluginTable, "type", INTEGRATORS, "path")
_MATERIAL_TABLE = tagged("Material", "type", variants(MaterialBase, "type", MATERIALS))
_Bsdf = Annotated[Plugin, reads(_MATERIAL_TABLE, _as_plugin)]
MaterialTable = Annotated[
    AnyMaterial,
    reads(_MATERIAL_TABLE, lambda table: material_of(table.plugin())),
]
Light = Annotated[Plugin, reads(tagged("Light", "type", _LIGHTS), _as_plugin)]
AreaLight = Annotated[
    Plugin, reads(tagged("AreaLight", "type", _AREA_LIGHTS, "area"), _as_plugin)
]
Integrator = Annotated[
    Plugin, reads(tagged("Integrator", "type", _INTEGRATORS, "path"), _as_plugin)
]
_NESTED: pydantic.TypeAdapter[Plugin] = pydantic.TypeAdapter(_Bsdf)
