"""What furniture is made of: a word (wood, fabric, paint, ...) becomes a material in the scene's colours.

Parts have (u, v) in metres, pictures and spines in [0, 1].
"""

from typing import Any

import numpy as np

from twinlens.errors import unknown
from twinlens.families.bodies import own_texture, shrunk
from twinlens.families.brushes import Image
from twinlens.families.family import Request
from twinlens.families.finishes import material, metal_pixels, texels
from twinlens.families.palettes import Palette, varied
from twinlens.families.patterns import pattern
from twinlens.scenes.scene import Bitmap

WORDS = {  # patterns, tile in metres, finish, roughness
    "wood": (("wood",), 0.6, "satin", 0.25),
    "fabric": (("weave", "weave", "weave", "cloudy", "stripes"), 0.22, "matte", 0.3),
    "pattern": (("stripes", "zigzag", "dots", "triangles", "gingham", "scales", "weave"), 0.4, "matte", 0.3),
    "paint": (("plain",), 0.8, "satin", 0.25),
    "white": (("plain",), 0.8, "satin", 0.2),
    "metal": (("plain",), 0.5, "metal", 0.2),
    "glaze": (("plain", "speckled", "cloudy", "stripes"), 0.5, "glossy", 0.08),
    "leaf": (("cloudy",), 0.4, "satin", 0.3),
    "card": (("cloudy",), 0.6, "matte", 0.3),
    "rug": (("zigzag", "triangles", "stripes", "scales", "checks", "weave", "mosaic"), 0.9, "matte", 0.3),
    "picture": (("art", "camouflage", "triangles", "marble", "stripes", "art"), 1.0, "matte", 0.3),
}
_LEAVES = np.array([[0.035, 0.11, 0.03], [0.09, 0.22, 0.05], [0.05, 0.16, 0.07]])
_CARD = np.array([[0.42, 0.29, 0.17], [0.36, 0.24, 0.14]])
_WHITE = np.array([[0.76, 0.75, 0.72]])


def dress(
    request: Request, part: tuple[str | int, ...], word: str, palette: Palette, pixel: float, shared: int
) -> dict[str, Any]:
    """The material of a part of a piece of furniture; parts with the same word and `shared` number are cut from one."""
    if word == "spines":
        return dict(material("satin", Bitmap(_spines(request, part, palette), filter="nearest"), 0.3))
    if word not in WORDS:
        raise unknown("material word", word, WORDS)
    names, tile, finish, roughness = WORDS[word]
    rng = request.rng("dress", *(part if word in ("pattern", "picture", "rug") else (word, shared)))
    n = texels(tile, pixel, 256)
    to_uv = np.diag([1 / tile, 1 / tile, 1.0, 1.0])
    own = own_texture(request, *part) if word in ("picture", "rug", "pattern", "fabric") else None
    if own is not None:
        return dict(material(finish, Bitmap(shrunk(own, n), to_uv=to_uv), roughness))
    if word == "metal":
        return dict(material(finish, Bitmap(metal_pixels(rng, n, "metal"), to_uv=to_uv), roughness))
    pixels = pattern(names[int(rng.integers(len(names)))], n, rng, _tones(rng, word, palette), 0.07)
    return dict(material(finish, Bitmap(pixels, to_uv=to_uv), roughness))


def _tones(rng: np.random.Generator, word: str, palette: Palette) -> Any:
    fixed = {"leaf": _LEAVES, "card": _CARD, "white": _WHITE}.get(word)
    if fixed is not None:
        return varied(rng, fixed, 0.12)
    tones = np.vstack([palette.accents, palette.grounds]) if word in ("fabric", "paint") else palette.accents
    return varied(rng, tones[rng.permutation(len(tones))], 0.1)


def _spines(request: Request, part: tuple[str | int, ...], palette: Palette) -> Image:
    """32 columns, a book each: its cloth, and bands and a label across the spine."""
    rng = request.rng("spines", *part)
    cloth = varied(rng, np.vstack([palette.accents, palette.accents, palette.grounds]), 0.15)
    columns = cloth[rng.integers(len(cloth), size=32)]
    pixels = np.repeat(columns[None], 64, axis=0)
    for book in range(32):
        ink = columns[rng.integers(32)]
        at, tall = int(rng.integers(8, 30)), int(rng.integers(3, 14))
        pixels[at : at + tall, book] = ink
        pixels[[50, 53], book] = ink if rng.random() < 0.5 else columns[book]
    return pixels.astype(np.float32)
