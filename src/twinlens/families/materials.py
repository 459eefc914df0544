"""Materials: a finish (matte, fabric, glossy, metal, ...) with a pattern at the resolution it is seen at.

All but glass, mirrors and lamps have the model "principled" with the same parameters, and every colour is a bitmap: the
renderer compiles a kernel for each new mix of models, so most scenes share one kernel.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import zoom

from twinlens.families.composition import Composition
from twinlens.families.draws import METALS, Palette, Rng, one_of, varied
from twinlens.families.patterns import half_size, noise, pattern
from twinlens.families.solids import Solid
from twinlens.geometry import Float
from twinlens.scenes.materials import Bitmap, Material, glass, metal
from twinlens.scenes.textures import Image

FINISHES = {
    "matte": (0.32, 0.44, 0.9), "fabric": (0.1, 0.7, 0.95), "satin": (0.22, 0.22, 0.4), "glossy": (0.14, 0.09, 0.21),
    "clearcoat": (0.1, 0.3, 0.6), "metal": (0.08, 0.28, 0.55), "glass": (0.03, 0.0, 0.0), "mirror": (0.01, 0.0, 0.0),
}  # fmt: skip
"""Probabilities among bodies that may have all finishes; least and largest `roughness`. Sources: docs/realism.md."""

PLAIN = 0.35  # probability that a body of a kind that may be plain has no pattern
_SHEEN, _COAT_GLOSS = (0.3, 1.0), (0.6, 0.9)
_ABSENT = 1e-4  # of sheen, clearcoat, metal: at 0 Mitsuba would compile another kernel
_MAX_TEXELS, _MIN_TEXELS = 512, 8
_USER_TEXTURES = (
    0.4  # probability of a user's texture on a surface, if the user has any
)


def material(rng: Rng, finish: str, color: Bitmap) -> Material:
    """A material of this finish; `color` is its reflectance, or a metal's tint."""
    if finish == "glass":
        return glass(ior=1.5)
    if finish == "mirror":
        return metal("Ag", tint=color)
    roughness = float(rng.uniform(*FINISHES[finish][1:]))
    sheen = float(rng.uniform(*_SHEEN)) if finish == "fabric" else _ABSENT
    coat_gloss = float(rng.uniform(*_COAT_GLOSS))
    return Material(
        model="principled",
        base_color=color,
        roughness=roughness,
        metallic=1.0 if finish == "metal" else _ABSENT,
        sheen=sheen,
        coat=1.0 if finish == "clearcoat" else _ABSENT,
        coat_roughness=1 - coat_gloss,
    )


def texels(length: float, pixel: float, most: int = _MAX_TEXELS) -> int:
    """Texels of a tile of `length` metres: a power of two, none smaller than a pixel of `pixel` metres."""
    return int(
        np.clip(1 << math.floor(math.log2(max(length / pixel, 1.0))), _MIN_TEXELS, most)
    )


def body_material(
    rng: Rng,
    solid: Solid,
    size: float,
    pixel: float,
    palette: Palette,
    finish: str,
    names: Sequence[str] | Image,
    plain_share: float = PLAIN,
) -> Material:
    """A material for a body `size` metres large, with one of the patterns `names` or a user's picture.

    plain_share : the probability that it has no pattern, where "plain" is among the names.
    """
    if isinstance(names, np.ndarray):
        tile = size * one_of(rng, [0.5, 1.0])
        pixels = resized(names, texels(tile, pixel))
    else:
        is_plain = "plain" in names and rng.random() < plain_share
        name = "plain" if is_plain else one_of(rng, names)
        tile = size * one_of(rng, [0.35, 0.5, 0.7, 1.0])
        tile = size if name in ("art", "wood", "marble", "cloudy") else tile
        n = texels(tile, pixel)
        if finish in ("metal", "mirror"):
            pixels = metal_pixels(rng, n, finish)
        else:
            pixels = pattern(
                name, n, rng, varied(rng, rng.permutation(palette.accents)), tile
            )
    u, v = (span * size / tile for span in solid.span)
    u, v = (float(max(1, round(u))), max(v, 0.25)) if solid.around else (u, v)
    return material(rng, finish, Bitmap(pixels, to_uv=np.diag([u, v, 1.0, 1.0])))


def metal_pixels(rng: Rng, n: int, finish: str) -> Image:
    """A metal's tint with faint wear; a mirror has none."""
    tint = one_of(rng, METALS) if finish == "metal" else np.full(3, 0.95)
    wear = 0.0 if finish == "mirror" else rng.uniform(0.15, 0.5)
    grey = 1 - wear * noise(n, rng, 3, octaves=7, gain=0.7).astype(np.float64)
    return (np.clip(tint * grey[..., None], 0, 0.97)).astype(np.float32)


def user_texture(scene: Composition, *part: str | int) -> Image | None:
    """One of the user's textures for a share of the surfaces; None for the others, and if no file can be read."""
    if (
        not scene.assets.textures
        or scene.rng(*part, "own texture").random() >= _USER_TEXTURES
    ):
        return None
    drawn = scene.assets.draw("textures", scene.rng(*part, "picture"))
    return None if drawn is None else drawn[1]


def resized(pixels: Image, side: int) -> Image:
    """A picture as a square of at most `side` texels: halved while it is twice as large, then linear interpolation."""
    while min(pixels.shape[:2]) >= 2 * side:
        pixels = half_size(pixels)
    factors = (
        min(side, _MAX_TEXELS) / pixels.shape[0],
        min(side, _MAX_TEXELS) / pixels.shape[1],
        1,
    )
    return np.ascontiguousarray(
        np.clip(
            zoom(pixels, factors, order=1, grid_mode=True, mode="grid-wrap"), 0, 0.95
        )
    )


FURNITURE = {  # patterns, tile in metres, finishes
    "wood": (("wood",), 0.6, ("satin", "satin", "clearcoat")),
    "fabric": (
        ("plain", "plain", "weave", "weave", "cloudy", "stripes"),
        0.22,
        ("fabric",),
    ),
    "pattern": (
        ("plain", "stripes", "zigzag", "dots", "gingham", "scales", "weave"),
        0.4,
        ("fabric",),
    ),
    "paint": (("plain",), 0.8, ("matte", "satin", "satin")),
    "white": (("plain",), 0.8, ("satin",)),
    "metal": (("plain",), 0.5, ("metal",)),
    "glaze": (("plain", "plain", "speckled", "cloudy", "stripes"), 0.5, ("glossy",)),
    "pane": (("plain",), 0.8, ("glossy",)),
    "facade": (("plain", "plain", "cloudy", "planks", "granite"), 1.4, ("matte",)),
    "masonry": (("bricks",), 1.1, ("matte",)),
    "lacquer": (("plain",), 0.8, ("clearcoat", "glossy")),
    "roof": (("scales", "tiles", "planks"), 0.9, ("matte",)),
    "leaf": (("cloudy",), 0.4, ("satin",)),
    "card": (("plain",), 0.6, ("matte",)),
    "bark": (("cloudy", "wood"), 0.3, ("matte",)),
    "soil": (("granite", "chips"), 0.2, ("matte",)),
    "rubber": (("plain",), 0.3, ("matte", "satin")),
    "rattan": (("weave", "cloudy"), 0.08, ("matte", "satin")),
    "paper": (("plain", "plain", "art"), 0.3, ("matte",)),
    "toy": (("plain",), 0.3, ("satin", "glossy")),
    "rug": (
        (
            "plain",
            "triangles",
            "zigzag",
            "stripes",
            "scales",
            "checks",
            "weave",
            "mosaic",
        ),
        0.9,
        ("fabric",),
    ),
    "picture": (
        ("art", "camouflage", "triangles", "marble", "cloudy", "cloudy"),
        1.0,
        ("matte", "clearcoat"),
    ),
}
"""Materials of the parts of furniture. The parts' (u, v) are in metres, those of pictures and spines in [0, 1]."""

_FIXED_COLORS = {
    "leaf": np.array([[0.035, 0.11, 0.03], [0.09, 0.22, 0.05], [0.05, 0.16, 0.07]]),
    "bark": np.array([[0.13, 0.09, 0.06], [0.22, 0.17, 0.12], [0.08, 0.06, 0.045]]),
    "soil": np.array(
        [[0.05, 0.035, 0.025], [0.09, 0.065, 0.045], [0.03, 0.022, 0.018]]
    ),
    "rubber": np.array([[0.025, 0.025, 0.027]]),
    "rattan": np.array([[0.42, 0.28, 0.14], [0.3, 0.19, 0.09], [0.55, 0.4, 0.22]]),
    "paper": np.array([[0.72, 0.71, 0.68], [0.55, 0.45, 0.33], [0.3, 0.32, 0.36]]),
    "card": np.array([[0.42, 0.29, 0.17], [0.36, 0.24, 0.14]]),
    "white": np.array([[0.76, 0.75, 0.72]]),
    "pane": np.array([[0.03, 0.035, 0.04]]),
    "masonry": np.array([[0.34, 0.14, 0.09], [0.5, 0.46, 0.4], [0.26, 0.11, 0.08]]),
    "roof": np.array([[0.3, 0.12, 0.07], [0.22, 0.1, 0.06], [0.16, 0.15, 0.16]]),
}


_LOOKS_ALONE = ("pattern", "picture", "rug", "toy")
"""Parts that look different from all others, also of the same piece."""
_OF_USER = ("picture", "rug", "pattern", "fabric")
"""Parts that may have a user's texture."""


def furniture_material(
    scene: Composition,
    part: tuple[str | int, ...],
    word: str,
    pixel: float,
    shared: int = 0,
) -> Material:
    """The material of one part of a piece of furniture; parts with the same `word` and `shared` look alike."""
    if word == "spines":
        spines = Bitmap(_spines(scene, part), filter="nearest")
        return material(scene.rng("spines", *part), "satin", spines)
    names, tile, finishes = FURNITURE[word]
    stream = part if word in _LOOKS_ALONE else (word, shared)
    rng = scene.rng("dress", *stream)
    n = texels(tile, pixel, 256)
    picture = user_texture(scene, *part) if word in _OF_USER else None
    if picture is not None:
        pixels = resized(picture, n)
    elif word == "metal":
        pixels = metal_pixels(rng, n, "metal")
    else:
        name = one_of(rng, names)
        colors = _furniture_colors(rng, scene.palette, word)
        pixels = pattern(name, n, rng, colors, tile)
    finish = one_of(rng, finishes)
    to_uv = np.diag([1 / tile, 1 / tile, 1.0, 1.0])
    return material(rng, finish, Bitmap(pixels, to_uv=to_uv))


def _furniture_colors(rng: Rng, palette: Palette, word: str) -> Float:
    """Colours (N, 3) of a part: fixed ones, or the accents of the palette, for cloth and paint also its grounds."""
    if word in _FIXED_COLORS:
        return varied(rng, _FIXED_COLORS[word])
    if word == "facade":
        plaster = varied(rng, rng.permutation(palette.grounds), 0.15)
        return np.asarray(0.7 * plaster[:1] + 0.3 * plaster)
    tones = palette.accents
    if word in ("fabric", "paint"):
        tones = np.vstack([palette.accents, palette.grounds])
    return varied(rng, rng.permutation(tones), 0.1)


def _spines(scene: Composition, part: tuple[str | int, ...]) -> Image:
    """The backs of 32 books side by side, one texel wide and 64 high: a label, and in half of them two bands."""
    rng, palette = scene.rng("spines", *part), scene.palette
    tones = np.vstack([palette.accents, palette.accents, palette.grounds])
    cloth = varied(rng, tones, 0.15)
    columns = cloth[rng.integers(len(cloth), size=32)]
    pixels = np.repeat(columns[None], 64, axis=0)
    for book in range(32):
        ink = columns[rng.integers(32)]
        top, height = int(rng.integers(8, 30)), int(rng.integers(3, 14))
        pixels[top : top + height, book] = ink
        pixels[[50, 53], book] = ink if rng.random() < 0.5 else columns[book]
    return pixels.astype(np.float32)
