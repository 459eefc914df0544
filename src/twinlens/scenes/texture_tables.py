"""Colours and textures as a scene file gives them. A texture table becomes a `Bitmap`.

A texture is a pattern made from a few numbers, a picture file, or other textures mixed or multiplied. Any value that
may be a colour may be a texture table or the name of an entry of [textures] instead.
"""

import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from scipy.ndimage import map_coordinates
from typing_extensions import TypeAliasType

from twinlens import schema
from twinlens.errors import InputError, check_known, format_value
from twinlens.scenes import textures
from twinlens.scenes.assets import Asset, linear_from_srgb, read_picture
from twinlens.scenes.scene import Bitmap, Color
from twinlens.scenes.textures import Image
from twinlens.schema import (
    Fraction,
    NonNegative,
    Positive,
    StrictModel,
    exactly,
    number,
    tagged,
    variants,
    whole,
)

_DEEPEST = 8
_HEX = re.compile(r"#[0-9a-fA-F]{6}")
_STRICT = pydantic.ConfigDict(strict=True, allow_inf_nan=False)
_RGB_LIST = Annotated[list[NonNegative], exactly(3, NonNegative, or_one=True)]
_RGB: pydantic.TypeAdapter[list[float]] = pydantic.TypeAdapter(
    _RGB_LIST, config=_STRICT
)
ColorText = str | _RGB_LIST
"""A colour in a file: "#rrggbb" in sRGB, one number for a grey, or [r, g, b] in linear sRGB."""


def read_color(value: Any) -> Color:
    """The colour of a `ColorText`."""
    if not isinstance(value, str):
        r, g, b = _RGB.validate_python(value)
        return Color((r, g, b))
    if not _HEX.fullmatch(value):
        raise InputError(
            f'must be a colour: "#rrggbb", [r, g, b] linear or a number, got {format_value(value)}'
        )
    encoded = np.array(list(bytes.fromhex(value[1:]))) / 255
    return Color(tuple(linear_from_srgb(encoded).astype(float).tolist()))


def is_texture(value: Any) -> bool:
    """Whether a value of a file is a texture table or a texture's name, not a colour or a number."""
    return isinstance(value, Mapping) or (
        isinstance(value, str) and not value.startswith("#")
    )


_COLOR = Annotated[
    Color, pydantic.PlainValidator(read_color, json_schema_input_type=ColorText)
]
_COUNT = Annotated[int, pydantic.Field(ge=1, le=4096)]
_TEXELS = Annotated[int, pydantic.Field(ge=1, le=8192)]
_RADIUS = Annotated[float, pydantic.Field(gt=0, le=0.25)]
_AXIS = Literal["u", "v"] | None
Cells = Annotated[list[_COUNT], exactly(2, _COUNT, or_one=True)]
Seed = Annotated[int, pydantic.Field(ge=0, le=2**31)]


class Warp(StrictModel):
    """Bends a texture by smooth noise: each texel is read from up to `amount` widths away, periodically."""

    amount: Fraction
    cells: Cells = pydantic.Field([4, 4])
    seed: Seed = 0

    def apply(self, pixels: Image) -> Image:
        """The bent picture, (H, W) or (H, W, C)."""
        height, width = pixels.shape[:2]
        cells = (self.cells[0], self.cells[1])
        noise = [
            textures.fractal_noise(width, height, cells, self.seed + i, 3, contrast=1.5)
            for i in (0, 1)
        ]
        dx, dy = (2 * self.amount * width * (shift - 0.5) for shift in noise)
        rows, columns = np.mgrid[:height, :width]
        where = np.stack([rows + dy, columns + dx])
        layers = pixels[..., None] if pixels.ndim == 2 else pixels
        bent = [
            map_coordinates(layers[..., c], where, order=1, mode="grid-wrap")
            for c in range(layers.shape[2])
        ]
        return np.stack(bent, axis=-1).astype(np.float32).reshape(pixels.shape)


class TextureBase(StrictModel):
    """Keys of every texture: `size` in texels, a `warp`, and how the finished picture is repeated and filtered."""

    size: Annotated[list[_TEXELS], exactly(2, _TEXELS, or_one=True)] | None = None
    warp: Warp | None = None
    repeat: Annotated[list[Positive], exactly(2, Positive, or_one=True)] = (
        pydantic.Field([1.0, 1.0])
    )
    filter_type: Literal["bilinear", "nearest"] = "bilinear"
    wrap_mode: Literal["repeat", "mirror", "clamp"] = "repeat"

    def bitmap(self, named: Mapping[str, "TextureBase"]) -> Bitmap:
        """The finished texture; `named` are those of [textures]."""
        pixels = np.ascontiguousarray(self.draw((512, 512), named, 0), dtype=np.float32)
        return Bitmap(
            pixels, self.filter_type, self.wrap_mode, np.diag([*self.repeat, 1.0, 1.0])
        )

    def draw(
        self, size: tuple[int, int], named: Mapping[str, "TextureBase"], depth: int
    ) -> Image:
        """Image (H, W) or (H, W, 3), of `size` = (width, height) unless the table has its own."""
        if depth > _DEEPEST:
            raise InputError(
                f"textures may be nested {_DEEPEST} deep; these are nested deeper or refer to each other"
            )
        width, height = self.size or size
        pixels = self._draw((width, height), named, depth)
        return pixels if self.warp is None else self.warp.apply(pixels)

    def _draw(
        self, size: tuple[int, int], named: Mapping[str, "TextureBase"], depth: int
    ) -> Image:
        raise NotImplementedError


class Pattern(TextureBase):
    """A grey pattern of `twinlens.scenes.textures`, mapped to `colors` spread evenly over [0, 1], or to a `range`."""

    seed: Seed = 0
    colors: (
        Annotated[list[_COLOR], pydantic.Field(min_length=2, max_length=64)] | None
    ) = None
    range: Annotated[list[NonNegative], exactly(2, NonNegative, or_one=True)] | None = (
        None
    )

    @pydantic.model_validator(mode="after")
    def _check(self) -> "Pattern":
        if self.colors is not None and self.range is not None:
            raise InputError("'colors' and 'range' exclude each other")
        return self

    def _draw(
        self, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
    ) -> Image:
        kind = self.type  # type: ignore[attr-defined]  # every pattern has one
        keys = self.model_fields_set - Pattern.model_fields.keys() - {"type"}
        parameters = {key: getattr(self, key) for key in keys}
        draw_pattern = getattr(textures, kind)
        return np.asarray(draw_pattern(*size, seed=self.seed, **parameters))

    def draw(
        self, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
    ) -> Image:
        pixels = super().draw(size, named, depth)
        if self.colors is None:
            low, high = self.range or (0.0, 1.0)
            return np.asarray(low + (high - low) * pixels, dtype=np.float32)
        return textures.ramp(pixels, np.array([color.rgb for color in self.colors]))


_ASCENDING = schema.satisfies(
    lambda radii: radii[0] <= radii[1], "must be [least, most]"
)
_RADII = Annotated[list[_RADIUS], exactly(2, _RADIUS, or_one=True), _ASCENDING]
PATTERNS: dict[str, dict[str, Any]] = {
    "value_noise": {
        "cells": Cells,
        "interpolation": Literal["smooth", "nearest"] | None,
    },
    "fractal_noise": {
        "cells": Cells,
        "octaves": whole(1, 14) | None,
        "gain": number(0.05, 1) | None,
        "contrast": Positive | None,
    },
    "random_dots": {"count": whole(1, 200_000), "radius": _RADII},
    "checker": {"cells": Cells},
    "stripes": {
        "count": _COUNT,
        "duty": Fraction | None,
        "profile": Literal["square", "sine"] | None,
        "along": _AXIS,
    },
    "siemens_star": {
        "spokes": whole(1, 1024),
        "radius": number(0, 1, above=True) | None,
    },
    "bricks": {
        "cells": Cells,
        "mortar": number(0, 0.9) | None,
        "variation": Fraction | None,
    },
    "wood": {
        "rings": whole(1, 1024),
        "waviness": number(0, 5) | None,
        "grain": Fraction | None,
    },
    "gradient": {"along": _AXIS},
}
"""The keys of each pattern: the parameters of its function in `twinlens.scenes.textures`."""


class Picture(TextureBase):
    """A picture file: integers, as in .png, are sRGB unless `raw`; .exr, .hdr are linear. `size` has no effect."""

    type: Literal["bitmap"]
    filename: Asset
    raw: bool = False

    def _draw(
        self, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
    ) -> Image:
        return read_picture(self.filename, self.raw)


class Mix(TextureBase):
    """(1 - weight) low + weight high, texel by texel."""

    type: Literal["mix"]
    low: "Part"
    high: "Part"
    weight: "Part"

    def _draw(
        self, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
    ) -> Image:
        low, high, weight = (
            _draw_part(part, size, named, depth)
            for part in (self.low, self.high, self.weight)
        )
        return np.broadcast_to(
            (1 - weight) * low + weight * high, (size[1], size[0], 3)
        )


class Multiply(TextureBase):
    """The product of the factors, texel by texel."""

    type: Literal["multiply"]
    factors: Annotated[list["Part"], pydantic.Field(min_length=1, max_length=16)]

    def _draw(
        self, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
    ) -> Image:
        result = np.ones((size[1], size[0], 3), dtype=np.float32)
        for factor in self.factors:
            result = result * _draw_part(factor, size, named, depth)
        return result


_TEXTURE = tagged(
    "Texture", "type", [*variants(Pattern, "type", PATTERNS), Picture, Mix, Multiply]
)
_COLOR_OR_TEXTURE: Any = TypeAliasType("ColorOrTexture", _TEXTURE | ColorText)


def _read_part(value: Any, info: Any) -> Any:
    if isinstance(value, Mapping):
        return _ADAPTER.validate_python(value, context=info.context)
    return value if is_texture(value) else read_color(value)


Part = Annotated[
    Any, pydantic.PlainValidator(_read_part, json_schema_input_type=_COLOR_OR_TEXTURE)
]
Mix.model_rebuild()
Multiply.model_rebuild()
_ADAPTER: pydantic.TypeAdapter[TextureBase] = pydantic.TypeAdapter(_TEXTURE)
Texture = Annotated[TextureBase, schema.reads(_TEXTURE)]
"""A table of [textures]."""


def _draw_part(
    part: Any, size: tuple[int, int], named: Mapping[str, TextureBase], depth: int
) -> Image:
    """A part of a texture as pixels that broadcast against (H, W, 3)."""
    if isinstance(part, Color):
        return np.array(part.rgb, dtype=np.float32)
    table = _named(part, named) if isinstance(part, str) else part
    if unused := table.model_fields_set & {"repeat", "filter_type", "wrap_mode"}:
        raise InputError(
            f"{min(unused)!r} applies to a whole texture, not to a part of one"
        )
    pixels: Image = table.draw(size, named, depth + 1)
    if pixels.shape[:2] != (size[1], size[0]):
        raise InputError(
            f"a part of {pixels.shape[1]}x{pixels.shape[0]} texels in a texture of {size[0]}x{size[1]}"
        )
    return pixels if pixels.ndim == 3 else pixels[..., None]


def _named(name: str, named: Mapping[str, TextureBase]) -> TextureBase:
    check_known("texture", name, named)
    return named[name]


def read_texture(value: Any, info: Any) -> Bitmap:
    """A texture table, or the name of an entry of [textures], as a Bitmap."""
    named = info.context.textures
    table = (
        _named(value, named)
        if isinstance(value, str)
        else _ADAPTER.validate_python(value, context=info.context)
    )
    return table.bitmap(named)


def _or_texture(
    plain: Callable[[Any], Any], written: Any, low: float, high: float
) -> Any:
    """The type of what `plain` reads, or of a texture; values must lie in [low, high]."""

    def read(value: Any, info: Any) -> Any:
        result = read_texture(value, info) if is_texture(value) else plain(value)
        values = np.array(getattr(result, "pixels", getattr(result, "rgb", result)))
        for extreme in (values.max(), values.min()):
            if not low - 1e-6 <= extreme <= high + 1e-6:
                raise InputError(f"must lie in [{low:g}, {high:g}], got {extreme:g}")
        return result

    return Annotated[Any, pydantic.PlainValidator(read, json_schema_input_type=written)]


def spectrum(limit: float) -> Any:
    """The type of a colour or a texture that is nowhere above `limit`."""
    return _or_texture(read_color, _COLOR_OR_TEXTURE, 0.0, limit)


def number_or_texture(low: float, high: float) -> Any:
    """The type of a number in [low, high], or of a texture whose values are."""
    kind = number(low, high)
    return _or_texture(
        pydantic.TypeAdapter(kind, config=_STRICT).validate_python,
        _TEXTURE | str | kind,
        low,
        high,
    )


TextureMap = Annotated[
    Bitmap, pydantic.PlainValidator(read_texture, json_schema_input_type=_TEXTURE | str)
]
