"""The Mitsuba plugins a scene file may use, each with its parameters under Mitsuba's own names.

The lists are closed on purpose. Mitsuba opens a shared library for every plugin name it does not know yet, path and
all, so no name reaches it that is not written here; and a parameter that Mitsuba would ignore or misread is refused
with the nearest known one.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from twinlens.scenes.assets import sky_picture
from twinlens.scenes.colors import color
from twinlens.scenes.paint import texture
from twinlens.scenes.placement import KEYS, placement, rotation
from twinlens.scenes.scene import Bitmap, Color, Plugin
from twinlens.scenes.table import At, Parser, Table, boolean, choice, listed, number, text, vector, whole

# fmt: off
CONDUCTORS = (
    "a-C", "Ag", "Al", "AlAs", "AlSb", "Au", "Be", "Cr", "CsI", "Cu", "Cu2O", "CuO", "d-C", "Hg", "HgTe", "Ir",
    "K", "Li", "MgO", "Mo", "Na_palik", "Nb", "Ni_palik", "Rh", "Se", "SiC", "SnTe", "Ta", "Te", "ThF4", "TiC",
    "TiN", "TiO2", "VC", "V_palik", "VN", "W", "none",
)
# fmt: on
# fmt: off
DIELECTRICS = (
    "vacuum", "helium", "hydrogen", "air", "carbon_dioxide", "water", "acetone", "ethanol",
    "carbon_tetrachloride", "glycerol", "benzene", "silicone_oil", "bromine", "water_ice", "fused_quartz",
    "pyrex", "acrylic_glass", "polypropylene", "bk7", "sodium_chloride", "amber", "pet", "diamond",
)
# fmt: on
_MITSUBA_SPACES = {"carbon_dioxide", "carbon_tetrachloride", "silicone_oil", "water_ice", "fused_quartz"}


def _spectrum(limit: float, what: str) -> Parser[Color | Bitmap]:
    """A colour, a texture table or the name of a texture, nowhere above `limit`."""

    def parse(at: At, value: Any) -> Color | Bitmap:
        named = isinstance(value, str) and not value.startswith("#")
        result = texture(at, value) if named or isinstance(value, Mapping) else color(at, value)
        highest = result.pixels.max() if isinstance(result, Bitmap) else max(result.rgb)
        if highest > limit + 1e-6:
            raise at.wrong(f"{what} lies in [0, {limit:g}], got {float(highest):g}")
        return result

    return parse


def _scalar(parser: Parser[float]) -> Parser[float | Bitmap]:
    """A number, or a texture whose grey values stand for it."""

    def parse(at: At, value: Any) -> float | Bitmap:
        if not isinstance(value, (Mapping, str)):
            return parser(at, value)
        result = texture(at, value)
        for extreme in (result.pixels.min(), result.pixels.max()):
            parser(at, float(extreme))
        return result

    return parse


def _index_of_refraction(at: At, value: Any) -> float | str:
    if isinstance(value, str):
        name = choice(*DIELECTRICS)(at, value)
        return name.replace("_", " ") if name in _MITSUBA_SPACES else name
    return number(1.0, 5.0)(at, value)


def _child(at: At, value: Any) -> Plugin:
    return bsdf(at, value)


def _two_children(at: At, value: Any) -> list[Plugin]:
    return listed(_child, 2, 2)(at, value)


REFLECTANCE = _spectrum(1.0, "a reflectance")
RADIANCE = _spectrum(1e9, "a radiance")
_FRACTION = number(0.0, 1.0)
_FRACTION_MAP = _scalar(_FRACTION)
_ALPHA = number(1e-4, 1.0)
_ALPHA_MAP = _scalar(_ALPHA)
_FACETS = choice("beckmann", "ggx")
_PLAIN = _spectrum(20.0, "eta or k")
_IORS: dict[str, Parser[Any]] = {"int_ior": _index_of_refraction, "ext_ior": _index_of_refraction}
_ROUGH: dict[str, Parser[Any]] = {
    "alpha": _ALPHA_MAP,
    "alpha_u": _ALPHA_MAP,
    "alpha_v": _ALPHA_MAP,
    "distribution": _FACETS,
    "sample_visible": boolean,
}
_GLASS: dict[str, Parser[Any]] = {
    **_IORS,
    "specular_reflectance": REFLECTANCE,
    "specular_transmittance": REFLECTANCE,
}
_PLASTIC: dict[str, Parser[Any]] = {
    **_IORS,
    "diffuse_reflectance": REFLECTANCE,
    "specular_reflectance": REFLECTANCE,
    "nonlinear": boolean,
}
_METAL: dict[str, Parser[Any]] = {
    "material": choice(*CONDUCTORS),
    "eta": _PLAIN,
    "k": _PLAIN,
    "specular_reflectance": REFLECTANCE,
}
_PRINCIPLED: dict[str, Parser[Any]] = {
    "base_color": REFLECTANCE,
    "roughness": _FRACTION_MAP,
    "anisotropic": _FRACTION_MAP,
    "spec_trans": _FRACTION_MAP,
    "spec_tint": _FRACTION_MAP,
    "sheen": _FRACTION_MAP,
    "sheen_tint": _FRACTION_MAP,
    "flatness": _FRACTION_MAP,
    "eta": number(1.0, 5.0, above=1.0),
}

BSDFS: dict[str, dict[str, Parser[Any]]] = {
    "diffuse": {"reflectance": REFLECTANCE},
    "dielectric": _GLASS,
    "thindielectric": _GLASS,
    "roughdielectric": {**_GLASS, **_ROUGH},
    "conductor": _METAL,
    "roughconductor": {**_METAL, **_ROUGH},
    "plastic": _PLASTIC,
    "roughplastic": {**_PLASTIC, "alpha": _ALPHA, "distribution": _FACETS, "sample_visible": boolean},
    "principled": {
        **_PRINCIPLED,
        "metallic": _FRACTION_MAP,
        "specular": _FRACTION,
        "clearcoat": _FRACTION_MAP,
        "clearcoat_gloss": _FRACTION_MAP,
    },
    "principledthin": {**_PRINCIPLED, "diff_trans": _scalar(number(0.0, 2.0))},
    "twosided": {"bsdf": _child},
    "mask": {"bsdf": _child, "opacity": _FRACTION_MAP},
    "blendbsdf": {"bsdfs": _two_children, "weight": _FRACTION_MAP},
    "bumpmap": {"bsdf": _child, "bump": texture, "scale": number(0.0, 1000.0)},
    "normalmap": {"bsdf": _child, "normalmap": texture},
    "null": {},
}
_BSDF_NEEDS = {
    "twosided": ("bsdf",),
    "mask": ("bsdf", "opacity"),
    "blendbsdf": ("bsdfs", "weight"),
    "bumpmap": ("bsdf", "bump"),
    "normalmap": ("bsdf", "normalmap"),
}
_WEIGHT: dict[str, Parser[Any]] = {"sampling_weight": number(0.0)}
EMITTERS: dict[str, dict[str, Parser[Any]]] = {
    "point": {**_WEIGHT, "position": vector(3), "intensity": RADIANCE},
    "spot": {
        **_WEIGHT,
        "intensity": RADIANCE,
        "cutoff_angle": number(0.0, 180.0, above=0.0),
        "beam_width": number(0.0, 180.0, above=0.0),
    },
    "directional": {**_WEIGHT, "direction": vector(3), "irradiance": RADIANCE},
    "constant": {**_WEIGHT, "radiance": RADIANCE},
    "envmap": {**_WEIGHT, "filename": sky_picture, "scale": number(0.0)},
    "sunsky": {
        **_WEIGHT,
        "turbidity": number(1.0, 10.0),
        "albedo": REFLECTANCE,
        "sun_direction": vector(3),
        "sun_scale": number(0.0),
        "sky_scale": number(0.0),
        "sun_aperture": number(0.0, 90.0, above=0.0),
    },
}
PLACED_EMITTERS = ("spot", "directional", "envmap")
AREA_EMITTERS: dict[str, dict[str, Parser[Any]]] = {
    "area": {**_WEIGHT, "radiance": RADIANCE},
    "directionalarea": {**_WEIGHT, "radiance": RADIANCE},
}
_LARGEST_DEPTH = 1024
INTEGRATORS: dict[str, dict[str, Parser[Any]]] = {
    "path": {
        "max_depth": whole(-1, _LARGEST_DEPTH),
        "rr_depth": whole(1, _LARGEST_DEPTH),
        "hide_emitters": boolean,
    },
    "direct": {
        "shading_samples": whole(1, 1024),
        "emitter_samples": whole(0, 1024),
        "bsdf_samples": whole(0, 1024),
        "hide_emitters": boolean,
    },
}
SHAPES: dict[str, dict[str, Parser[Any]]] = {
    "sphere": {"center": vector(3), "radius": number(above=0.0), "flip_normals": boolean},
    "rectangle": {"flip_normals": boolean},
    "disk": {"flip_normals": boolean},
    "cylinder": {"p0": vector(3), "p1": vector(3), "radius": number(above=0.0), "flip_normals": boolean},
    "cube": {"flip_normals": boolean},
}


def parameters(table: Table[Any], known: Mapping[str, Parser[Any]]) -> dict[str, Any]:
    """The parameters a table gives, of those a plugin knows; the rest of the table is left for the caller."""
    given = {}
    for key, parser in known.items():
        if table.has(key):
            value = table.take(key, parser)
            given[key] = value.tolist() if isinstance(value, np.ndarray) else value
    return given


def bsdf(at: At, value: Any) -> Plugin:
    """A material table as a plugin; `twosided = true` on a one-sided one lets both its faces be seen."""
    table: Table[Any] = Table(at, value)
    kind = table.take("type", _one_of("material", BSDFS))
    both = table.take("twosided", boolean, False)
    plugin: dict[str, Any] = {"type": kind, **parameters(table, BSDFS[kind])}
    table.done()
    for key in _BSDF_NEEDS.get(kind, ()):
        if key not in plugin:
            raise at.wrong(f"needs the key {key!r}")
    plugin |= dict(zip(("bsdf_0", "bsdf_1"), plugin.pop("bsdfs", ()), strict=False))
    _check_pairs(at, kind, plugin)
    return {"type": "twosided", "bsdf": plugin} if both else plugin


def _check_pairs(at: At, kind: str, plugin: Mapping[str, Any]) -> None:
    """Parameters that belong together, and those that exclude each other."""
    for one, other in (("alpha_u", "alpha_v"), ("eta", "k")):
        if (one in plugin) != (other in plugin) and other in BSDFS[kind]:
            raise at.wrong(f"{one!r} and {other!r} go together; give both or neither")
    if {"material", "eta"} <= plugin.keys() or {"alpha", "alpha_u"} <= plugin.keys():
        raise at.wrong("says one thing twice: keep material or eta and k, alpha or alpha_u and alpha_v")


def emitter(at: At, value: Any) -> Plugin:
    """A light that is no object; spot, directional and envmap may be placed like objects."""
    table: Table[Any] = Table(at, value)
    kind = table.take("type", _one_of("light", EMITTERS))
    plugin: dict[str, Any] = {"type": kind, **parameters(table, EMITTERS[kind])}
    if kind in PLACED_EMITTERS and any(table.has(key) for key in KEYS):
        if "direction" in plugin:
            raise at.wrong("'direction' says where the light shines; drop it or the placing keys")
        plugin["to_world"] = placement(table)
    table.done()
    return _checked_emitter(at, kind, plugin)


def _checked_emitter(at: At, kind: str, plugin: dict[str, Any]) -> Plugin:
    for key in ("direction", "sun_direction"):
        if key in plugin and not np.linalg.norm(plugin[key]) > 1e-9:
            raise (at / key).wrong("must not be zero")
    if kind == "envmap":
        if "filename" not in plugin:
            raise at.wrong("needs the key 'filename'")
        upright = rotation(np.array([1.0, 0.0, 0.0]), 90.0)  # Mitsuba's maps have y up, our worlds z
        plugin["to_world"] = plugin.get("to_world", np.eye(4)) @ upright
        plugin["filename"] = str(plugin["filename"])
    if kind == "spot" and plugin.get("beam_width", 0.0) > plugin.get("cutoff_angle", 20.0):
        raise (at / "beam_width").wrong("must not be wider than cutoff_angle")
    return plugin


def area_emitter(at: At, value: Any) -> Plugin:
    """The light of an object that shines."""
    table: Table[Any] = Table(at, value)
    kind = table.take("type", _one_of("emitter of an object", AREA_EMITTERS), "area")
    plugin = {"type": kind, **parameters(table, AREA_EMITTERS[kind])}
    table.done()
    return plugin


def integrator(at: At, value: Any) -> Plugin:
    """How light is traced."""
    table: Table[Any] = Table(at, value)
    kind = table.take("type", _one_of("integrator", INTEGRATORS), "path")
    plugin = {"type": kind, **parameters(table, INTEGRATORS[kind])}
    table.done()
    return plugin


def _one_of(kind: str, known: Mapping[str, Any]) -> Parser[str]:
    def parse(at: At, value: Any) -> str:
        if text(at, value) not in known:
            raise at.unknown(kind, value, known)
        return str(value)

    return parse
