"""Pictures of 16 bits per channel keep them, as heights, textures and in mesh files. OpenCV writes them."""

import struct
import warnings
import zlib

import cv2
import numpy as np
import pytest

from tests.scenes.gltf_files import exported, glb, picture, square, with_values
from twinlens.pictures import decode_sixteen_bits, has_sixteen_bits
from twinlens.scenes import load_scene
from twinlens.scenes.assets import SceneContext, read_picture
from twinlens.scenes.model_files import read_model
from twinlens.scenes.scene import SceneWarning

RNG = np.random.default_rng(7)


def stored(channels, opaque=True):
    """Values (5, 300, C); the fourth channel is 65535 if `opaque`."""
    values = RNG.integers(0, 65536, (5, 300, channels), dtype=np.uint16)
    if channels == 4 and opaque:
        values[..., 3] = 65535
    return values


def as_png(values):
    """The file that OpenCV writes of grey, RGB or RGBA."""
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[values.shape[2]]
    _, data = cv2.imencode(".png", np.ascontiguousarray(values[..., order]))
    return data.tobytes()


def grey_with_alpha(values):
    """A file of (H, W, 2), without filters. Source: PNG specification, chapter 11."""

    def chunk(kind, body):
        return (
            struct.pack(">I", len(body))
            + kind
            + body
            + struct.pack(">I", zlib.crc32(kind + body))
        )

    height, width = values.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    header = struct.pack(">IIBBBBB", width, height, 16, 4, 0, 0, 0)
    chunks = (
        chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    return b"\x89PNG\r\n\x1a\n" + chunks


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_all_bits_are_decoded(channels):
    values = stored(channels, opaque=False)
    data = grey_with_alpha(values) if channels == 2 else as_png(values)
    assert has_sixteen_bits(data)
    np.testing.assert_array_equal(decode_sixteen_bits(data), values)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_texture_has_all_bits(tmp_path, channels):
    values = stored(channels)
    (tmp_path / "t.png").write_bytes(as_png(values))
    pixels = read_picture(tmp_path / "t.png", raw=True)
    expected = values[..., :3] if channels > 1 else values.repeat(3, axis=2)
    np.testing.assert_allclose(pixels, expected / 65535, rtol=1e-6)


SCENE = """
[camera]
position = [0, 0, 3]
look_at = [0, 0, 0]
up = [0, 1, 0]
depth_range = [1, 5]
[materials.grey]
type = "diffuse"
reflectance = 0.5
[lights.sky]
type = "constant"
radiance = 1.0
[objects.field]
shape = "height_field"
extents = [2, 2]
amplitude = 0.5
grid = [300, 5]
height = { type = "bitmap", filename = "h.png", raw = true }
material = "grey"
"""


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_height_field_has_all_bits(tmp_path, channels):
    """A ramp within 5 % of the range, which 8 bits would make a stair of 13 steps."""
    ramp = np.linspace(30000, 33277, 300).round().astype(np.uint16)
    values = np.broadcast_to(ramp[None, :, None], (5, 300, channels)).copy()
    if channels == 4:
        values[..., 3] = 65535
    (tmp_path / "h.png").write_bytes(as_png(values))
    (tmp_path / "scene.toml").write_text(SCENE)
    heights = load_scene(tmp_path / "scene.toml").objects[0].shape.vertices[:, 2]
    np.testing.assert_allclose(
        heights.reshape(5, 300), [0.5 * ramp / 65535] * 5, atol=1e-7
    )


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_picture_in_a_mesh_file_has_all_bits(tmp_path, channels):
    values = stored(channels)
    header, binary = exported(
        square(metallicRoughnessTexture=picture(np.zeros((2, 2, 3))))
    )
    binary += bytes(-len(binary) % 4)
    data = as_png(values)
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)}
    changes = {
        "bufferViews": [*header["bufferViews"], view],
        "images": [{"bufferView": len(header["bufferViews"])}],
        "buffers": [{"byteLength": len(binary) + len(data)}],
        "materials/0/pbrMetallicRoughness/roughnessFactor": 1.0,
    }
    path = tmp_path / "m.glb"
    path.write_bytes(glb(with_values(header, changes), binary + data))
    [material] = read_model(path, SceneContext(tmp_path)).materials.values()
    green = values[..., 1 if channels > 1 else 0]
    np.testing.assert_allclose(material.roughness.pixels, green / 65535, rtol=1e-6)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("is_opaque", [True, False])
def test_an_alpha_channel_that_is_not_used_is_named(tmp_path, depth, is_opaque):
    values = np.full((4, 4, 4), np.iinfo(depth).max, dtype=depth)
    values[0, 0, 3] = values[0, 0, 3] if is_opaque else 0
    path = tmp_path / "t.png"
    path.write_bytes(as_png(values))
    if is_opaque:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read_picture(path)
        return
    with pytest.warns(SceneWarning, match=r"t\.png: not used: its alpha channel"):
        read_picture(path)
