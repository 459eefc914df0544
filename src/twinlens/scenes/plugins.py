"""Materials, lights and integrators of a scene file, under the names of Mitsuba's plugins and parameters.

The lists are closed on purpose. Mitsuba opens a shared library for every plugin name that it does not know, path
included, so only the names written here reach it. A parameter that Mitsuba would ignore or misread is rejected.
"""

from operator import methodcaller
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from twinlens.errors import InputError
from twinlens.scenes.assets import Sky
from twinlens.scenes.placement import Placement, Pose, Vector3, rotation
from twinlens.scenes.scene import Plugin
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
DIELECTRICS = (
    "vacuum", "helium", "hydrogen", "air", "carbon_dioxide", "water", "acetone", "ethanol",
    "carbon_tetrachloride", "glycerol", "benzene", "silicone_oil", "bromine", "water_ice", "fused_quartz",
    "pyrex", "acrylic_glass", "polypropylene", "bk7", "sodium_chloride", "amber", "pet", "diamond",
)
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
        given = self.model_fields_set - self.extra_keys | {"type"}
        return {
            key: getattr(self, key)
            for key in ("type", *type(self).model_fields)
            if key in given
        }


class MaterialBase(PluginTable):
    """`twosided` makes both faces of a one-sided material visible. `nir` is the near infrared reflectance."""

    extra_keys = frozenset({"twosided"})
    twosided: bool = False
    nir: _REFLECTANCE = None

    @pydantic.model_validator(mode="after")
    def _check_pairs(self) -> "MaterialBase":
        given, known = self.model_fields_set, type(self).model_fields
        for one, other, instead in (
            ("alpha_u", "alpha_v", "alpha"),
            ("eta", "k", "material"),
        ):
            if other in known and (one in given) != (other in given):
                raise InputError(
                    f"{one!r} and {other!r} go together; give both or neither"
                )
            if {one, instead} <= given:
                raise InputError(f"{instead!r} excludes {one!r} and {other!r}")
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


_as_plugin = methodcaller("plugin")
_BASES = (
    (PlacedLight, _PLACED_LIGHTS),
    (LightBase, _OTHER_LIGHTS),
    (EnvironmentMap, _ENVIRONMENT),
)
_LIGHTS = [light for base, tables in _BASES for light in variants(base, "type", tables)]
_AREA_LIGHTS = variants(LightBase, "type", AREA_LIGHTS, "area")
_INTEGRATORS = variants(PluginTable, "type", INTEGRATORS, "path")
Material = Annotated[
    Plugin,
    reads(
        tagged("Material", "type", variants(MaterialBase, "type", MATERIALS)),
        _as_plugin,
    ),
]
Light = Annotated[Plugin, reads(tagged("Light", "type", _LIGHTS), _as_plugin)]
AreaLight = Annotated[
    Plugin, reads(tagged("AreaLight", "type", _AREA_LIGHTS, "area"), _as_plugin)
]
Integrator = Annotated[
    Plugin, reads(tagged("Integrator", "type", _INTEGRATORS, "path"), _as_plugin)
]
_NESTED: pydantic.TypeAdapter[Plugin] = pydantic.TypeAdapter(Material)
