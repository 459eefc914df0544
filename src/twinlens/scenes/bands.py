"""A scene as it is in the near infrared (NIR), 800 to 900 nm: grey reflectances, and each light's share of this band.

The colours of a scene do not determine it. The rules here are typical; the key `nir` of a material, a light or a sky
replaces them. docs/bands.md has their sources and limits.
"""

import math
import weakref
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.scenes.assets import read_picture
from twinlens.scenes.materials import (
    AnyMaterial,
    Bitmap,
    Color,
    ComplexIndex,
    Material,
    Plugin,
    VertexColor,
)
from twinlens.scenes.scene import Mesh, Scene, SceneObject, Sky

NIR_SHARES = {"daylight": 0.22, "tungsten": 0.91, "led": 0.0}
"""Power at 800 to 900 nm over that at 400 to 700 nm, by the kind of a light."""

_DYED = (
    0.6  # reflectance of what dyes and most pigments colour, where they do not absorb
)
_GREY = (
    0.02  # of the largest channel: differences as small as this do not count as colour
)
_SUN, _SKY = 0.234, 0.124  # shares of the direct and the diffuse part of daylight
_T_RANGE = (2000.0, 25000.0)  # colour temperatures, K
_PLANCK_NM_K = 1.438777e7  # h c / k
_XYZ_FROM_RGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)

_MAIN = {
    "diffuse": "reflectance",
    "plastic": "diffuse_reflectance",
    "roughplastic": "diffuse_reflectance",
}
_MAIN |= dict.fromkeys(("principled", "principledthin"), "base_color")
_MAIN |= dict.fromkeys(
    ("dielectric", "thindielectric", "roughdielectric"), "specular_transmittance"
)
"""The parameter that the `nir` of a material sets, by its type."""

_REFLECTANCES = {*_MAIN.values(), "specular_reflectance"}
_EMISSIONS = {"point": "intensity", "spot": "intensity", "directional": "irradiance"}
# Refractive indices eta + i k at 850 nm, of Mitsuba's data; where these end before, their last values.
_METALS = {
    "a-C": (2.27, 0.771), "Ag": (0.151, 5.68), "Al": (2.61, 8.23), "AlAs": (3, 0), "AlSb": (4.01, 0.006),
    "Au": (0.196, 5.59), "Be": (3.38, 3.49), "Cr": (4.31, 4.32), "CsI": (1.76, 0), "Cu": (0.276, 5.45),
    "Cu2O": (2.66, 0.053), "CuO": (2.81, 0.04), "d-C": (2.41, 0), "Hg": (3.14, 6.4), "HgTe": (3.69, 0.638),
    "Ir": (2.68, 5.53), "K": (0.0404, 2.52), "Li": (0.265, 3.55), "MgO": (1.73, 0), "Mo": (3.38, 3.34),
    "Na_palik": (0.0527, 3.67), "Nb": (1.97, 3.65), "Ni_palik": (2.58, 4.54), "Rh": (2.87, 7.11), "Se": (3.32, 0.11),
    "SiC": (2.6, 0), "SnTe": (4.73, 0), "Ta": (1.07, 3.9), "Te": (5.67, 0.748), "ThF4": (1.52, 0), "TiC": (3.51, 3.07),
    "TiN": (1.82, 3.81), "TiO2": (2.78, 0), "VC": (3.37, 2.88), "V_palik": (3.45, 3.2), "VN": (2.73, 2.92),
    "W": (3.4, 2.84),
}  # fmt: skip


def nir_reflectance(rgb: NDArray[Any]) -> NDArray[Any]:
    """Near infrared reflectance (...) of a colour (..., 3): the largest channel m, raised towards 0.6 if it is no grey.

        m + s max(0.6 - m, 0),    s = (m - least channel) / (m + 0.02)

    Dyes, most pigments and leaves absorb in parts of the visible range only; greys are black by carbon or white by
    scattering, in both bands.

    >>> nir_reflectance(np.array([[0.05, 0.1, 0.03], [0.04, 0.04, 0.04]])).round(2).tolist()
    [0.39, 0.04]
    """
    most, least = rgb.max(axis=-1), rgb.min(axis=-1)
    return np.asarray(
        most + (most - least) / (most + _GREY) * np.maximum(_DYED - most, 0)
    )


def nir_share(rgb: NDArray[Any]) -> float:
    """The near infrared share of a light of colour (3,): that of a black body of its colour temperature.

    Source: McCamy, Color Research and Application 17, 1992, for the temperature.

    >>> round(nir_share(np.ones(3)), 2), round(nir_share(np.array([1.0, 0.45, 0.13])), 1)
    (0.17, 0.9)
    """
    x, y, z = _XYZ_FROM_RGB @ rgb
    if not x + y + z > 0:
        return 0.0
    n = (x / (x + y + z) - 0.3320) / (0.1858 - y / (x + y + z))
    kelvin = float(np.clip(((449 * n + 3525) * n + 6823.3) * n + 5520.33, *_T_RANGE))

    def power(low: float, high: float) -> float:
        nm = np.linspace(low, high, 101)
        return float(np.trapezoid(nm**-5 / np.expm1(_PLANCK_NM_K / (nm * kelvin)), nm))

    return power(800, 900) / power(400, 700)


_near_infrared: "weakref.WeakKeyDictionary[Scene, Scene]" = weakref.WeakKeyDictionary()


def in_band(scene: Scene, band: str) -> Scene:
    """The scene in the band "rgb" or "nir", cached as long as the Scene exists."""
    if band == "rgb":
        return scene
    if scene not in _near_infrared:
        _near_infrared[scene] = near_infrared(scene)
    return _near_infrared[scene]


def near_infrared(scene: Scene) -> Scene:
    """The scene in the near infrared: the same geometry, grey reflectances, lights scaled to their share of this band.

    Lights of other than one colour keep their colours: the mean of the channels of an image is the band's radiance.
    Raises InputError for a Mitsuba file.
    """
    if scene.xml is not None:
        remedy = "use a scene.toml, or cameras with band = 'rgb'"
        raise InputError(
            f"{scene.xml}: near infrared images of Mitsuba files are not supported; {remedy}"
        )
    converter = _Converter()
    materials = {
        name: converter.material(material) for name, material in scene.materials.items()
    }
    lights = {
        name: lamp
        for name, light in scene.lights.items()
        if (lamp := converter.light(light)) is not None
    }
    objects = tuple(converter.scene_object(item) for item in scene.objects)
    sky = None if scene.sky is None else _sky(scene.sky)
    return replace(scene, objects=objects, materials=materials, lights=lights, sky=sky)


class _Converter:
    """Converts plugins; a Bitmap that is used twice is converted once."""

    def __init__(self) -> None:
        self.bitmaps: dict[int, Bitmap] = {}

    def scene_object(self, item: SceneObject) -> SceneObject:
        emitter = None if item.emitter is None else self.light(item.emitter)
        shape = item.shape
        if isinstance(shape, Mesh) and shape.attributes:
            attributes = {
                name: _grey_vertices(values)
                for name, values in shape.attributes.items()
            }
            shape = replace(shape, attributes=attributes)
        return replace(item, shape=shape, emitter=emitter)

    def material(self, material: AnyMaterial) -> AnyMaterial:
        """The material with grey reflectances."""
        if not isinstance(material, Material):
            return self.plugin(material)
        emission = material.emission
        if emission is not None:
            emission = _scaled(emission, nir_share(_mean(emission)))
        return replace(
            material,
            specular_color=self.grey(material.specular_color),
            emission=emission,
            nir=None,
            **self.base(material),
        )

    def base(self, material: Material) -> dict[str, Any]:
        """The base colour in this band, and the index of a metal; of an index given as a colour, that of red."""
        if material.nir is not None:
            base_color = self.grey(material.nir)
            # The reflectance is known, so that of the metal itself does not count.
            unknown = "none" if material.model == "metal" else None
            return {"base_color": base_color, "conductor": unknown}
        base_color = self.grey(material.base_color)
        conductor = material.conductor
        if isinstance(conductor, ComplexIndex):
            conductor = ComplexIndex(_red(conductor.eta), _red(conductor.k))
        elif conductor in _METALS:
            eta, k = _METALS[conductor]
            conductor = ComplexIndex(Color((eta,) * 3), Color((k,) * 3))
        return {"base_color": base_color, "conductor": conductor}

    def plugin(self, plugin: Plugin, nir: Any = None) -> dict[str, Any]:
        """A BSDF with grey reflectances; `nir` is that of a BSDF around it."""
        nir = plugin.get("nir", nir)
        made = {
            key: self.part(key, value, nir)
            for key, value in plugin.items()
            if key != "nir"
        }
        if "conductor" in plugin["type"]:
            return self.metal(made, nir)
        if nir is not None and plugin["type"] in _MAIN:
            made[_MAIN[plugin["type"]]] = self.grey(nir)
        return made

    def metal(self, plugin: dict[str, Any], nir: Any) -> dict[str, Any]:
        """A conductor with its refractive index in this band; of an index given as a colour, that of red."""
        index = {
            key: plugin.pop(key) for key in ("eta", "k", "material") if key in plugin
        }
        if nir is not None:
            return plugin | {
                "material": "none",
                "specular_reflectance": self.grey(nir),
            }
        if index.get("material") in _METALS:
            eta, k = _METALS[index["material"]]
            return plugin | {"eta": Color((eta,) * 3), "k": Color((k,) * 3)}
        return plugin | {key: _red(value) for key, value in index.items()}

    def part(self, key: str, value: Any, nir: Any) -> Any:
        if key in _REFLECTANCES:
            return self.grey(value)
        if key.startswith("bsdf") and isinstance(value, Mapping):
            return self.plugin(value, nir)
        return value

    def grey(self, value: Any) -> Any:
        """A reflectance: a number, a colour, a texture, or a plugin with some of them.

        Of colours of vertices times a texture both are converted: no rule for their product is simpler.
        """
        if isinstance(value, Color):
            return Color((float(nir_reflectance(np.array(value.rgb))),) * 3)
        if isinstance(value, VertexColor):
            return replace(value, factor=self.grey(value.factor))
        if isinstance(value, Bitmap):
            if value.pixels.ndim == 2:
                return value
            if id(value) not in self.bitmaps:
                self.bitmaps[id(value)] = replace(
                    value, pixels=nir_reflectance(value.pixels).astype(np.float32)
                )
            return self.bitmaps[id(value)]
        if isinstance(value, Mapping):
            if value.get("type") == "rgb" and np.ndim(value["value"]):
                return {
                    **value,
                    "value": float(
                        nir_reflectance(np.asarray(value["value"], dtype=np.float64))
                    ),
                }
            return {key: self.grey(part) for key, part in value.items()}
        return value

    def light(self, plugin: Plugin) -> dict[str, Any] | None:
        """The light scaled to its share; None if it has none."""
        made = {key: value for key, value in plugin.items() if key != "nir"}
        nir = plugin.get("nir")
        if isinstance(nir, str):
            nir = NIR_SHARES[nir]
        if nir == 0:
            return None
        if plugin["type"] == "sunsky":
            sun, sky = (_SUN, _SKY) if nir is None else (nir, nir)
            return made | {
                "sun_scale": sun * made.get("sun_scale", 1.0),
                "sky_scale": sky * made.get("sky_scale", 1.0),
            }
        if plugin["type"] == "envmap":
            share = _mean_share(_panorama(made)) if nir is None else nir
            return made | {"scale": share * made.get("scale", 1.0)}
        key = _EMISSIONS.get(plugin["type"], "radiance")
        share = nir_share(_mean(made.get(key, 1.0))) if nir is None else nir
        return made | {key: _scaled(made.get(key, 1.0), share)}


def _grey_vertices(values: Float) -> Float:
    """Colours of vertices (V, 3), or with opacity (V, 4), as reflectances; other attributes are as they were."""
    if values.shape[1] not in (3, 4):
        return values
    grey = nir_reflectance(values[:, :3])
    return np.column_stack([grey, grey, grey, values[:, 3:]])


def _sky(sky: Sky) -> Sky | None:
    share = _mean_share(sky.pixels) if sky.nir is None else sky.nir
    return replace(sky, scale=share * sky.scale) if share else None


def _panorama(plugin: Plugin) -> NDArray[np.float32]:
    """The pixels of an environment map."""
    if "bitmap" in plugin:
        return np.asarray(plugin["bitmap"].pixels)
    return read_picture(Path(plugin["filename"]))


def _mean_share(pixels: NDArray[np.float32]) -> float:
    """The share of a panorama (H, W, 3), by its mean over all directions."""
    height = np.sin((np.arange(len(pixels)) + 0.5) / len(pixels) * math.pi)
    return nir_share(
        np.average(pixels.mean(axis=1, dtype=np.float64), axis=0, weights=height)
    )


def _mean(value: Any) -> Float:
    """The mean colour (3,) of a value of `Plugin`."""
    if isinstance(value, Mapping):
        value = value.get("value", 1.0)
    if isinstance(value, Bitmap):
        value = value.pixels.reshape(-1, *value.pixels.shape[2:]).mean(
            axis=0, dtype=np.float64
        )
    return np.broadcast_to(
        np.asarray(getattr(value, "rgb", value), dtype=np.float64), 3
    )


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, Bitmap):
        return replace(value, pixels=np.float32(factor) * value.pixels)
    return Color((factor * float(_mean(value).mean()),) * 3)


def _red(value: Any) -> Any:
    """The red channel of a colour or a texture."""
    if isinstance(value, Bitmap) and value.pixels.ndim == 3:
        return replace(value, pixels=value.pixels[..., 0])
    return Color((value.rgb[0],) * 3) if isinstance(value, Color) else value
