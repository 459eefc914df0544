"""What bodies are made of: a finish in set proportions, a pattern in the scene's colours, at the scale it is seen at.

Few Mitsuba plugins on purpose (`diffuse`, `roughplastic`, `roughconductor`, `conductor`, `dielectric`), every colour a
bitmap: the renderer compiles a kernel for each new mix of plugin types, and this way most scenes share one.
"""

import math
from dataclasses import dataclass

import numpy as np

from twinlens.families.brushes import Image, noise
from twinlens.families.palettes import METALS, Palette, varied
from twinlens.families.patterns import pattern
from twinlens.families.solids import Rng, Solid
from twinlens.geometry import Float
from twinlens.scenes.scene import Bitmap, Plugin

PROPORTIONS = {"matte": 0.44, "satin": 0.22, "glossy": 0.20, "metal": 0.09, "glass": 0.03, "mirror": 0.02}
"""Shares of the finishes where a body takes any; one that would look wrong in metal or glass is matte to glossy."""

_ROUGHNESS = {"satin": (0.18, 0.35), "glossy": (0.04, 0.12), "metal": (0.08, 0.3)}
_LARGEST = 512
_LEAST = 8


@dataclass(frozen=True, eq=False)
class Coat:
    """A finish and a pattern for one body, and how often the pattern repeats along its u and v."""

    finish: str
    pixels: Image
    repeat: tuple[float, float]
    roughness: float

    def plugin(self) -> Plugin:
        """The material."""
        to_uv = np.diag([self.repeat[0], self.repeat[1], 1.0, 1.0])
        return material(self.finish, Bitmap(self.pixels, to_uv=to_uv), self.roughness)


def material(finish: str, color: Bitmap, roughness: float = 0.2) -> Plugin:
    """A Mitsuba material of this finish: `color` is its reflectance, or a metal's tint."""
    if finish == "glass":
        return {"type": "dielectric", "int_ior": 1.5}
    if finish == "mirror":
        return {"type": "conductor", "material": "Ag", "specular_reflectance": color}
    if finish == "metal":
        return {"type": "roughconductor", "material": "none", "specular_reflectance": color, "alpha": roughness}
    if finish == "matte":
        return {"type": "diffuse", "reflectance": color}
    return {"type": "roughplastic", "diffuse_reflectance": color, "alpha": roughness}


def draw_finish(rng: Rng, metal: bool = True, glass: bool = True) -> str:
    """A finish by its proportion, without those a body cannot take."""
    names = [n for n in PROPORTIONS if (metal or n not in ("metal", "mirror")) and (glass or n != "glass")]
    weights = np.array([PROPORTIONS[name] for name in names])
    return names[int(rng.choice(len(names), p=weights / weights.sum()))]


def texels(length: float, pixel: float, most: int = _LARGEST) -> int:
    """How many texels a tile of `length` metres has, none smaller than a pixel covers there: a power of two.

    >>> texels(0.1, 0.0011)
    64
    """
    return int(np.clip(1 << math.floor(math.log2(max(length / pixel, 1.0))), _LEAST, most))


def coat(
    rng: Rng, solid: Solid, size: float, pixel: float, palette: Palette, finish: str, names: tuple[str, ...]
) -> Coat:
    """A pattern out of `names` for a body `size` metres large, seen where a pixel covers `pixel` metres."""
    name = names[int(rng.integers(len(names)))]
    tile = size * float(rng.choice([0.35, 0.5, 0.7, 1.0]))
    if name in ("art", "wood", "marble", "cloudy"):
        tile = size
    repeat = repeats(solid, size, tile)
    n = texels(tile, pixel)
    roughness = float(rng.uniform(*_ROUGHNESS.get(finish, (0.2, 0.2))))
    if finish in ("metal", "mirror"):
        return Coat(finish, metal_pixels(rng, n, finish), repeat, roughness)
    return Coat(finish, pattern(name, n, rng, body_colors(rng, palette)), repeat, roughness)


def repeats(solid: Solid, size: float, tile: float) -> tuple[float, float]:
    """How often a tile of `tile` metres repeats along u and v of a body; whole numbers where u closes on itself."""
    u, v = (span * size / tile for span in solid.span)
    return (float(max(1, round(u))), max(v, 0.25)) if solid.around else (u, v)


def body_colors(rng: Rng, palette: Palette) -> Float:
    """Five or more accents in a random order, each a little off."""
    return varied(rng, palette.accents[rng.permutation(len(palette.accents))])


def metal_pixels(rng: Rng, n: int, finish: str) -> Image:
    """A metal's tint with faint wear, brushed or blotched; a mirror is clean."""
    tint = METALS[int(rng.integers(len(METALS)))] if finish == "metal" else np.full(3, 0.95)
    wear = 0.0 if finish == "mirror" else rng.uniform(0.15, 0.5)
    grey = 1 - wear * noise(n, rng, 3, octaves=7, gain=0.7).astype(np.float64)
    return (np.clip(tint * grey[..., None], 0, 0.97)).astype(np.float32)
