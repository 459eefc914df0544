"""Texture tables: colours, ranges, mixes and files become the pixels they describe."""

from pathlib import Path

import numpy as np
import OpenEXR
import pydantic
import pytest
from PIL import Image

from tests.scenes.scene_text import required
from twinlens.errors import InputError
from twinlens.scenes.assets import SceneContext, read_picture
from twinlens.scenes.texture_tables import PATTERNS, Texture, TextureMap
from twinlens.schema import read

_TABLE = pydantic.TypeAdapter(Texture)
_MAP = pydantic.TypeAdapter(TextureMap)


def paint(table, folder=Path(), **named):
    context = SceneContext(folder)
    context.textures.update(
        {
            name: read(_TABLE, entry, "scene.toml", name, context)
            for name, entry in named.items()
        }
    )
    return read(_MAP, table, "scene.toml", "t", context)


def test_colors_are_spread_evenly_and_are_linear():
    made = paint(
        {
            "type": "stripes",
            "count": 1,
            "size": [4, 1],
            "colors": ["#000000", "#808080"],
        }
    ).pixels
    np.testing.assert_allclose(
        made[0, 0], 0.2158605, rtol=1e-5
    )  # sRGB 128/255, IEC 61966-2-1
    np.testing.assert_array_equal(made[0, 3], 0)
    ramp = paint(
        {"type": "gradient", "along": "u", "size": [5, 1], "colors": [0.0, 1.0, 0.0]}
    ).pixels
    np.testing.assert_allclose(ramp[0, :, 0], [0.2, 0.6, 1.0, 0.6, 0.2], atol=1e-6)


def test_range_repeat_and_wrap_are_kept():
    made = paint(
        {
            "type": "checker",
            "cells": 2,
            "size": 8,
            "range": [0.2, 0.7],
            "repeat": [3, 5],
            "wrap_mode": "mirror",
        }
    )
    assert made.pixels.shape == (8, 8)
    np.testing.assert_allclose(np.unique(made.pixels), [0.2, 0.7], rtol=1e-6)
    assert made.to_uv.diagonal().tolist() == [3, 5, 1, 1]
    assert made.wrap == "mirror"


def test_mix_and_multiply_follow_their_formulas():
    left, right = {"type": "stripes", "count": 1}, {"type": "gradient", "along": "u"}
    mixed = paint(
        {"type": "mix", "size": [8, 2], "low": 0.1, "high": 0.9, "weight": left}
    ).pixels
    np.testing.assert_allclose(mixed[0, :, 1], [0.9] * 4 + [0.1] * 4, rtol=1e-6)
    product = paint(
        {"type": "multiply", "size": [4, 1], "factors": [left, "ramp", 0.5]}, ramp=right
    ).pixels
    np.testing.assert_allclose(product[0, :, 2], [0.0625, 0.1875, 0, 0], atol=1e-7)


def test_a_warp_moves_texels_only():
    plain = {"type": "value_noise", "cells": 9, "size": 64, "seed": 2}
    straight = paint(plain).pixels
    np.testing.assert_allclose(
        paint({**plain, "warp": {"amount": 0}}).pixels, straight, atol=1e-6
    )
    bent = paint({**plain, "warp": {"amount": 0.2}}).pixels
    assert np.abs(bent - straight).max() > 0.1
    assert straight.min() - 1e-6 <= bent.min()
    assert bent.max() <= straight.max() + 1e-6


def test_circular_texture_references_are_an_error():
    with pytest.raises(InputError, match="deep"):
        paint(
            "a",
            a={"type": "multiply", "size": 4, "factors": ["b"]},
            b={"type": "multiply", "factors": ["a"]},
        )


@pytest.mark.parametrize("name", PATTERNS)
def test_every_pattern_rejects_unknown_and_missing_keys(name):
    needed = {"cells": 4, "count": 3, "radius": 0.1, "spokes": 5, "rings": 3}
    keys = {key: needed[key] for key in required(PATTERNS[name])}
    assert paint({"type": name, "size": 16, **keys}).pixels.shape == (16, 16)
    with pytest.raises(InputError, match="unknown key 'sede'; did you mean 'seed'"):
        paint({"type": name, "sede": 1, **keys})
    for key in keys:
        with pytest.raises(InputError, match=f"missing key '{key}'"):
            paint({"type": name, **{k: v for k, v in keys.items() if k != key}})


def test_pictures_are_read_with_their_own_encoding(tmp_path):
    grey = np.full((3, 5, 3), 128, np.uint8)
    Image.fromarray(grey).save(tmp_path / "a.png")
    made = paint({"type": "bitmap", "filename": "a.png"}, tmp_path)
    assert made.pixels.shape == (3, 5, 3)
    np.testing.assert_allclose(made.pixels, 0.2158605, rtol=1e-5)
    np.testing.assert_allclose(
        paint({"type": "bitmap", "filename": "a.png", "raw": True}, tmp_path).pixels,
        128 / 255,
        rtol=1e-6,
    )
    light = np.random.default_rng(1).random((4, 6, 3)).astype(np.float32) * 9
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": light}).write(
        str(tmp_path / "b.exr")
    )
    np.testing.assert_array_equal(read_picture(tmp_path / "b.exr"), light)


@pytest.mark.parametrize("width", [5, 40])
def test_radiance_pictures_match_opencv(tmp_path, width):
    cv2 = pytest.importorskip("cv2")
    light = np.random.default_rng(2).random((7, width, 3)).astype(np.float32) * 5
    light[2, 3:30] = 1.5
    cv2.imwrite(str(tmp_path / "a.hdr"), light)
    theirs = cv2.imread(str(tmp_path / "a.hdr"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_allclose(read_picture(tmp_path / "a.hdr"), theirs, rtol=1e-6)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.exr", "a.hdr", "a.tga"])
def test_a_damaged_picture_is_named(tmp_path, name):
    (tmp_path / name).write_bytes(b"#?RADIANCE\nnothing")
    with pytest.raises(InputError, match=name):
        paint({"type": "bitmap", "filename": name}, tmp_path)
