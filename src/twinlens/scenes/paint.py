"""Textures of a scene file: a pattern, its colours, and how often it repeats, made into a `Bitmap`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from twinlens.scenes import textures
from twinlens.scenes.assets import asset, read_picture
from twinlens.scenes.colors import color
from twinlens.scenes.scene import Bitmap
from twinlens.scenes.table import (
    At,
    Parser,
    Table,
    boolean,
    choice,
    listed,
    number,
    scalar_or_vector,
    text,
    whole,
)

Pixels = NDArray[np.float32]
_LARGEST_SIDE = 8192
_MOST_DEEP = 8


def _pair(item: Parser[Any]) -> Parser[tuple[Any, Any]]:
    """[a, b], or one value for both."""

    def parse(at: At, value: Any) -> tuple[Any, Any]:
        a, b = listed(item, 2, 2)(at, value) if isinstance(value, list) else [item(at, value)] * 2
        return a, b

    return parse


_CELLS = _pair(whole(1, 4096))
_AXIS = choice("u", "v")


@dataclass(frozen=True)
class Pattern:
    """A pattern's function (width, height, seed=, ...) and its keys: parser, and whether it must be given."""

    make: Callable[..., Pixels]
    keys: Mapping[str, Parser[Any]]
    needs: tuple[str, ...] = ()


PATTERNS: dict[str, Pattern] = {
    "value_noise": Pattern(
        textures.value_noise, {"cells": _CELLS, "interpolation": choice("smooth", "nearest")}, ("cells",)
    ),
    "fractal_noise": Pattern(
        textures.fractal_noise,
        {"cells": _CELLS, "octaves": whole(1, 14), "gain": number(0.05, 1.0), "contrast": number(above=0.0)},
        ("cells",),
    ),
    "random_dots": Pattern(
        textures.random_dots,
        {"count": whole(1, 200_000), "radius": _pair(number(0.0, 0.25, above=0.0))},
        ("count", "radius"),
    ),
    "checker": Pattern(textures.checker, {"cells": _CELLS}, ("cells",)),
    "stripes": Pattern(
        textures.stripes,
        {"count": whole(1, 4096), "duty": number(0.0, 1.0), "profile": choice("square", "sine"), "along": _AXIS},
        ("count",),
    ),
    "siemens_star": Pattern(
        textures.siemens_star, {"spokes": whole(1, 1024), "radius": number(0.0, 1.0, above=0.0)}, ("spokes",)
    ),
    "bricks": Pattern(
        textures.bricks,
        {"cells": _CELLS, "mortar": number(0.0, 0.9), "variation": number(0.0, 1.0)},
        ("cells",),
    ),
    "wood": Pattern(
        textures.wood, {"rings": whole(1, 1024), "waviness": number(0.0, 5.0), "grain": number(0.0, 1.0)}, ("rings",)
    ),
    "gradient": Pattern(textures.gradient, {"along": _AXIS}),
}
PICTURES = ("bitmap", "mix", "multiply")


def texture(at: At, value: Any) -> Bitmap:
    """A texture table, or the name of one in [textures], as a Bitmap.

    Every texture takes `size` = [width, height] in texels (512), `seed`, `colors` (two or more, spread evenly from the
    pattern's 0 to its 1), `range` = [lowest, highest] instead of colours, `warp` = {amount, cells, seed}, `repeat` =
    [along u, along v], `filter_type` and `wrap_mode`; a pattern adds its own keys.
    """
    if isinstance(value, str):
        return texture(at, _named(at, value))
    table: Table[Any] = Table(at, value)
    repeat = table.take("repeat", scalar_or_vector(2, number(above=0.0)), np.ones(2))
    filtering = table.take("filter_type", choice("bilinear", "nearest"), "bilinear")
    wrap = table.take("wrap_mode", choice("repeat", "mirror", "clamp"), "repeat")
    pixels = _pixels(table, (512, 512), 0)
    to_uv = np.diag([repeat[0], repeat[1], 1.0, 1.0])
    return Bitmap(np.ascontiguousarray(pixels, dtype=np.float32), filtering, wrap, to_uv)


def _named(at: At, name: str) -> Any:
    known = at.source.textures
    if name not in known:
        raise at.unknown("texture", name, known)
    return known[name]


def _pixels(table: Table[Any], size: tuple[int, int], depth: int) -> Pixels:
    """The finished pixels (H, W) or (H, W, 3) of a texture table; a mix gives its parts its own size."""
    if depth > _MOST_DEEP:
        raise table.at.wrong(f"textures may be mixed {_MOST_DEEP} deep; this one goes deeper or round in a circle")
    kind = table.take("type", choice(*PATTERNS, *PICTURES))
    width, height = table.take("size", _pair(whole(1, _LARGEST_SIDE)), size)
    if kind == "bitmap":
        pixels = _picture(table)
    elif kind in PICTURES:
        pixels = _combined(table, kind, (width, height), depth)
    else:
        pixels = _pattern(table, PATTERNS[kind], width, height)
    pixels = _warped(table, pixels)
    pixels = _coloured(table, pixels)
    table.done()
    return pixels


def _picture(table: Table[Any]) -> Pixels:
    raw = table.take("raw", boolean, False)
    path = table.take("filename", asset)
    return read_picture(path, raw)


def _pattern(table: Table[Any], pattern: Pattern, width: int, height: int) -> Pixels:
    seed = table.take("seed", whole(0, 2**31), 0)
    missing = object()
    given = {key: table.take(key, parser, missing) for key, parser in pattern.keys.items()}
    for key in pattern.needs:
        if given[key] is missing:
            raise table.at.wrong(f"needs the key {key!r}")
    if "radius" in given and isinstance(given["radius"], tuple) and given["radius"][0] > given["radius"][1]:
        raise table.at.wrong("radius must be [least, most]")
    return pattern.make(width, height, seed=seed, **{k: v for k, v in given.items() if v is not missing})


def _combined(table: Table[Any], kind: str, size: tuple[int, int], depth: int) -> Pixels:
    """mix: (1 - weight) low + weight high, pixel by pixel; multiply: the product of its factors."""

    def part(at: At, value: Any) -> Pixels:
        if isinstance(value, str) and not value.startswith("#"):
            value = _named(at, value)
        if not isinstance(value, Mapping):
            return np.array(color(at, value).rgb, dtype=np.float32)
        pixels = _pixels(Table(at, value), size, depth + 1)
        if pixels.shape[:2] != (size[1], size[0]):
            raise at.wrong(f"is {pixels.shape[1]}x{pixels.shape[0]} texels in a texture of {size[0]}x{size[1]}")
        return pixels if pixels.ndim == 3 else pixels[..., None]

    if kind == "multiply":
        result = np.ones((size[1], size[0], 3), dtype=np.float32)
        for factor in table.take("factors", listed(part, 1, 16)):
            result = result * factor
        return result
    low, high, weight = (table.take(key, part) for key in ("low", "high", "weight"))
    mixed = np.broadcast_to((1 - weight) * low + weight * high, (size[1], size[0], 3))
    return np.asarray(mixed, dtype=np.float32)


def _warped(table: Table[Any], pixels: Pixels) -> Pixels:
    """The picture bent by smooth noise: every texel looks up to `amount` of the width away, around the edges."""
    if not table.has("warp"):
        return pixels
    warp = table.take("warp", Table)
    amount, cells = warp.take("amount", number(0.0, 1.0)), warp.take("cells", _CELLS, (4, 4))
    seed = warp.take("seed", whole(0, 2**31), 0)
    warp.done()
    height, width = pixels.shape[:2]
    shifts = (textures.fractal_noise(width, height, cells, seed + i, octaves=3, contrast=1.5) - 0.5 for i in range(2))
    dx, dy = (2 * amount * width * shift for shift in shifts)
    rows, columns = np.mgrid[:height, :width]
    where = np.stack([rows + dy, columns + dx])
    layers = pixels[..., None] if pixels.ndim == 2 else pixels
    bent = [map_coordinates(layers[..., c], where, order=1, mode="grid-wrap") for c in range(layers.shape[2])]
    return np.stack(bent, axis=-1).astype(np.float32).reshape(pixels.shape)


def _coloured(table: Table[Any], pixels: Pixels) -> Pixels:
    """A grey pattern through its colours or its range."""
    if pixels.ndim == 3:
        return pixels
    if table.has("colors"):
        ramp = np.array([c.rgb for c in table.take("colors", listed(color, 2, 64))])
        stops = np.linspace(0, 1, len(ramp))
        return np.stack([np.interp(pixels, stops, ramp[:, c]) for c in range(3)], axis=-1).astype(np.float32)
    low, high = table.take("range", _pair(number(0.0)), (0.0, 1.0))
    return np.asarray(low + (high - low) * pixels, dtype=np.float32)


def read_textures(at: At, value: Any) -> dict[str, Any]:
    """The [textures] table: every entry must be a table with a type; they are read where they are used."""
    table: Table[Any] = Table(at, value)
    named = table.rest()
    for name, entry in named.items():
        Table(at / name, entry).take("type", text)
    return named
