"""TGA and TIFF pictures: textures of scenes and of .mtl files. TGA is written here, after its specification."""

import struct
import warnings
from io import BytesIO

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from twinlens.errors import FileError, TwinlensError
from twinlens.scenes import load_scene
from twinlens.scenes.assets import SceneContext, read_picture
from twinlens.scenes.model_files import read_model
from twinlens.scenes.scene import SceneWarning
from twinlens.scenes.xml_file import read_scene_xml

RNG = np.random.default_rng(5)
COLORS = RNG.integers(0, 256, (4, 5, 3), dtype=np.uint8)
GREY = RNG.integers(0, 256, (4, 5), dtype=np.uint8)
DEEP = RNG.integers(0, 65536, (4, 5), dtype=np.uint16)
TOP_DOWN = 0x20
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"


def tga(texels, top_down=False, run_length=False, comment=b""):
    """A .tga file of grey (H, W), BGR or BGRA. Source: Truevision TGA specification 2.0."""
    height, width = texels.shape[:2]
    is_grey = texels.ndim == 2
    kind = (3 if is_grey else 2) + (8 if run_length else 0)
    bits = 8 if is_grey else 8 * texels.shape[2]
    placed = TOP_DOWN if top_down else 0
    alpha_bits = 8 if bits == 32 else 0
    flags = placed | alpha_bits
    sizes = 0, 0, width, height
    header = struct.pack("<BBB5xHHHHBB", len(comment), 0, kind, *sizes, bits, flags)
    rows = texels if top_down else texels[::-1]
    if not run_length:
        return header + comment + rows.tobytes()
    # Each pixel is a run of one.
    pixels = rows.reshape(height * width, -1)
    return header + comment + b"".join(b"\x80" + pixel.tobytes() for pixel in pixels)


def as_tiff(texels, **options):
    stream = BytesIO()
    kind = "rgb" if texels.shape[-1] == 3 else "minisblack"
    tifffile.imwrite(stream, texels, **{"photometric": kind, **options})
    return stream.getvalue()


BGR = COLORS[..., ::-1]
OPAQUE = np.dstack([BGR, np.full_like(GREY, 255)])
PICTURES = {
    "bottom-up.tga": (tga(BGR), COLORS / 255),
    "top-down.tga": (tga(BGR, top_down=True), COLORS / 255),
    "runs.tga": (tga(BGR, run_length=True), COLORS / 255),
    "alpha.tga": (tga(OPAQUE, comment=b"by hand"), COLORS / 255),
    "grey.tga": (tga(GREY), np.dstack([GREY] * 3) / 255),
    "OTHER.TGA": (tga(BGR, top_down=True, comment=b"a"), COLORS / 255),
    "cv2.tif": (cv2.imencode(".tif", BGR)[1].tobytes(), COLORS / 255),
    "big-endian.tiff": (as_tiff(COLORS, byteorder=">"), COLORS / 255),
    "tiles.tif": (as_tiff(COLORS, tile=(16, 16)), COLORS / 255),
    "zip.tif": (as_tiff(COLORS, compression="zlib"), COLORS / 255),
    "deep.tif": (as_tiff(DEEP), np.dstack([DEEP] * 3) / 65535),
    "deep-mm.tif": (as_tiff(DEEP, byteorder=">"), np.dstack([DEEP] * 3) / 65535),
    "deep-negative.tif": (
        as_tiff(65535 - DEEP, photometric="miniswhite"),
        np.dstack([DEEP] * 3) / 65535,
    ),
    "planes.tif": (as_tiff(np.moveaxis(COLORS, 2, 0), photometric="rgb", planarconfig="separate"), COLORS / 255),
}  # fmt: skip


@pytest.mark.parametrize("name", PICTURES)
def test_a_texture_has_the_stored_values(tmp_path, name):
    data, right = PICTURES[name]
    (tmp_path / name).write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pixels = read_picture(tmp_path / name, raw=True)
    np.testing.assert_allclose(pixels, right, atol=1e-7)


def test_floats_are_linear(tmp_path):
    values = RNG.random((4, 5), dtype=np.float32) * 3
    (tmp_path / "h.tif").write_bytes(as_tiff(values))
    pixels = read_picture(tmp_path / "h.tif")
    np.testing.assert_array_equal(pixels, np.dstack([values] * 3))


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (as_tiff(RNG.integers(0, 65536, (4, 5, 3), dtype=np.uint16)), r"16 bits per channel \(8\)"),
        (as_tiff(np.stack([COLORS, COLORS])), "pages after the first"),
    ],
)  # fmt: skip
def test_what_is_not_read_of_a_tiff_picture_is_named(tmp_path, data, named):
    (tmp_path / "t.tif").write_bytes(data)
    with pytest.warns(SceneWarning, match=rf"t\.tif: not used: {named}$"):
        read_picture(tmp_path / "t.tif")


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("t.tif", as_tiff(COLORS.astype(np.float64)), r"t\.tif: cannot be read as a \.tif picture"),
        ("t.tif", as_tiff(GREY.astype(np.int32)), r"t\.tif: cannot be read .*\(it has integers of 32 bits; save"),
        ("t.tga", as_tiff(COLORS), r"t\.tga: is not a TGA picture; it is a TIFF picture: rename it"),
        ("t.tif", tga(BGR), r"t\.tif: is not a TIFF picture; it is a TGA picture: rename it"),
        ("t.tga", tga(BGR)[:30], r"t\.tga: cannot be read as a \.tga picture"),
        ("t.tga", b"", r"t\.tga: is not a TGA picture$"),
    ],
)  # fmt: skip
def test_other_pictures_are_refused_in_one_line(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FileError, match=message) as refused:
        read_picture(tmp_path / name)
    assert "\n" not in str(refused.value)


def as_obj(folder, name, data):
    """A triangle with a texture, in the files of Wavefront."""
    (folder / name).write_bytes(data)
    (folder / "m.mtl").write_text(f"newmtl a\nKd 1 1 1\nmap_Kd {name}\n")
    (folder / "m.obj").write_text(f"mtllib m.mtl\n{TRIANGLE}usemtl a\nf 1/1 2/2 3/3\n")
    return folder / "m.obj"


@pytest.mark.parametrize("name", [name for name in PICTURES if "deep" not in name])
def test_an_mtl_file_names_the_same_pictures(tmp_path, name):
    data, right = PICTURES[name]
    path = as_obj(tmp_path, name, data)
    [material] = read_model(path, SceneContext(tmp_path)).materials.values()
    stored = np.round(right * 255).astype(int)
    linear = np.array([linear_of(value) for value in range(256)])
    np.testing.assert_allclose(material.base_color.pixels, linear[stored], atol=1e-6)


def linear_of(value):
    """IEC 61966-2-1."""
    v = value / 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def test_floats_of_an_mtl_file_are_refused(tmp_path):
    path = as_obj(tmp_path, "t.tif", as_tiff(np.float32(GREY)))
    with pytest.raises(FileError, match="has floats; save it with 8 or 16 bits"):
        read_model(path, SceneContext(tmp_path))


LIT = """
[camera]
position = [0, 0, 3]
look_at = [0, 0, 0]
up = [0, 1, 0]
depth_range = [1, 5]
[materials.grey]
type = "diffuse"
reflectance = 0.5
[objects.floor]
shape = "cube"
material = "grey"
[lights.sky]
type = "envmap"
filename = "t{}"
"""
XML = """<scene version="3.0.0"><sensor type="perspective"/>
<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="t{}"/></texture></bsdf></shape></scene>"""


@pytest.mark.parametrize("ending", [".tif", ".tiff", ".webp", ".tga"])
@pytest.mark.parametrize("form", ["toml", "xml"])
def test_pictures_that_mitsuba_opens_are_of_its_kinds(tmp_path, ending, form):
    """Environment maps, and textures of Mitsuba's own files."""
    Image.fromarray(COLORS).save(tmp_path / f"t{ending}")
    path = tmp_path / f"scene.{form}"
    path.write_text((LIT if form == "toml" else XML).format(ending))
    read = load_scene if form == "toml" else read_scene_xml
    if ending == ".tga":
        read(path)
        return
    message = rf"t{ending}: Mitsuba opens this file by itself, and only .*\.tga; conv"
    with pytest.raises(TwinlensError, match=message):
        read(path)
