"""A scene opens files below its own folder only, as the format of their suffix, and of limited size."""

import numpy as np
import OpenEXR
import pytest
from PIL import EpsImagePlugin, Image

from twinlens.errors import FileError, InputError
from twinlens.scenes import assets
from twinlens.scenes.assets import SceneContext, find_asset, read_mesh, read_picture


@pytest.fixture
def home(tmp_path):
    folder = tmp_path / "home"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "in.png").write_text("x")
    (tmp_path / "out.png").write_text("x")
    (folder / "link.png").symlink_to(tmp_path / "out.png")
    (folder / "folder").symlink_to(tmp_path)
    (folder / "inner.png").symlink_to(folder / "deep" / "in.png")
    return SceneContext(folder)


def test_files_below_the_folder_are_found_and_recorded(home):
    path = find_asset("deep/in.png", home)
    assert path.read_text() == "x"
    assert find_asset("inner.png", home) == path
    assert home.files == [path, path]


OUTSIDE = "../out.png deep/../../out.png link.png folder/out.png /etc/passwd C:/x.png ..\\out.png"
NO_FILE = ["", ".", "deep", "a\0b", "missing.png"]


@pytest.mark.parametrize("name", [*OUTSIDE.split(), *NO_FILE])
def test_other_asset_paths_are_errors(home, name):
    reasons = r"must be a file name relative|leads outside|no file"
    with pytest.raises(InputError, match=reasons):
        find_asset(name, home)
    assert home.files == []


def test_two_dots_are_refused_with_the_name_to_write(home):
    remedy = r"'\.\.' is not allowed; write 'deep/in\.png'"
    with pytest.raises(InputError, match=remedy):
        find_asset("deep/../deep/in.png", home)


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n0 0 moveto\nshowpage\n%%EOF\n"


@pytest.mark.parametrize("name", ["t.png", "t.jpg", "t.jpeg", "T.PNG"])
def test_postscript_named_as_a_picture_is_not_interpreted(tmp_path, monkeypatch, name):
    started = []
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *options, **_: started.append(options)
    )
    (tmp_path / name).write_bytes(POSTSCRIPT)
    with Image.open(tmp_path / name) as image:
        assert image.format == "EPS", "Pillow itself would take the file for what it is"
    with pytest.raises(FileError, match=name):
        read_picture(tmp_path / name)
    assert started == []


@pytest.mark.parametrize(
    ("name", "stored", "says"),
    [
        ("t.jpg", "PNG", "is not a JPEG picture; it is a PNG picture: rename it"),
        ("t.png", "WEBP", "is not a PNG picture; it is a WEBP picture: rename it"),
        ("t.webp", "BMP", "is not a WEBP picture; it is a BMP picture: rename it"),
        ("t.png", "GIF", "is not a PNG picture$"),
    ],
)
def test_a_picture_with_the_wrong_suffix_is_an_error(tmp_path, name, stored, says):
    Image.new("RGB", (4, 4)).save(tmp_path / name, format=stored)
    with pytest.raises(FileError, match=rf"{name}: {says}"):
        read_picture(tmp_path / name)


@pytest.mark.parametrize("kind", ["png", "bmp", "webp"])
def test_pictures_without_loss_have_their_values(tmp_path, kind):
    stored = np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    options = {"lossless": True} if kind == "webp" else {}
    Image.fromarray(stored).save(tmp_path / f"t.{kind}", **options)
    assert np.allclose(255 * read_picture(tmp_path / f"t.{kind}", raw=True), stored)


def binary_stl(count, present):
    facet = np.array([0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0], dtype="<f4").tobytes()
    head = b"made by a scanner".ljust(80) + count.to_bytes(4, "little")
    return head + present * (facet + b"\0\0")


@pytest.mark.parametrize(("count", "present"), [(2, 1), (5, 0), (1000, 999)])
def test_an_stl_that_ends_early_says_how_many_facets_it_has(tmp_path, count, present):
    path = tmp_path / "m.stl"
    path.write_bytes(binary_stl(count, present))
    says = f"has {present} of {count} facets; is the file complete"
    with pytest.raises(FileError, match=says):
        read_mesh(path)


def test_an_stl_of_either_kind_is_read_whole(tmp_path):
    path = tmp_path / "m.stl"
    path.write_bytes(binary_stl(3, 3).replace(b"made by", b"solid b"))
    assert len(read_mesh(path).faces) == 3
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    for text in (facet, facet.upper()):
        path.write_text(f"solid a\n{text}endsolid a\n")
        assert len(read_mesh(path).faces) == 1


def write_exr(path, count=1):
    """Parts of 8x5 pixels."""
    parts = []
    for i in range(count):
        header = {"type": OpenEXR.scanlineimage}
        pixels = np.ones((5, 8, 3), np.float32)
        parts.append(OpenEXR.Part(header, {"RGB": pixels}, f"p{i}"))
    OpenEXR.File(parts).write(str(path))


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n"


def test_pictures_of_too_many_pixels_are_refused(tmp_path, monkeypatch):
    write_exr(tmp_path / "t.exr")
    Image.new("RGB", (8, 5)).save(tmp_path / "t.png")
    (tmp_path / "t.hdr").write_bytes(HDR % (5, 8) + bytes(8 * 5 * 4))
    for name in ("t.exr", "t.png", "t.hdr"):
        monkeypatch.setattr(assets, "_MOST_PIXELS", 40)
        assert read_picture(tmp_path / name).shape == (5, 8, 3)
        monkeypatch.setattr(assets, "_MOST_PIXELS", 39)
        limit = rf"{name}: a picture may have 1 to 39 pixels, got 8x5"
        with pytest.raises(FileError, match=limit):
            read_picture(tmp_path / name)


def test_an_exr_is_refused_from_its_header_alone(tmp_path):
    """The header promises 2^40 pixels, the file has none of them."""
    path = tmp_path / "t.exr"
    write_exr(path)
    data = path.read_bytes()
    small = np.array([0, 0, 7, 4], "<i4").tobytes()
    huge = np.array([0, 0, (1 << 20) - 1, (1 << 20) - 1], "<i4").tobytes()
    assert data.count(small) == 2  # the data window and the display window
    path.write_bytes(data.replace(small, huge))
    with pytest.raises(FileError, match="got 1048576x1048576"):
        read_picture(path)


def test_an_exr_of_many_parts_is_refused(tmp_path):
    write_exr(tmp_path / "t.exr", count=2)
    with pytest.raises(FileError, match="needs one part, got 2"):
        read_picture(tmp_path / "t.exr")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("sky.exr", b"v/1\x01 damaged", "cannot be read"),
        ("sky.png", POSTSCRIPT, "is not a PNG picture"),
        ("sky.ps", POSTSCRIPT, "pictures may be"),
        ("sky.hdr", HDR % (99999, 99999), "a picture may have 1 to"),
        ("sky.hdr", HDR % (1, 4) + bytes(16), "needs 2x3 pixels or more"),
    ],
)
def test_environment_maps_are_checked_before_mitsuba_reads_them(
    tmp_path, read_scene, name, content, message
):
    (tmp_path / name).write_bytes(content)
    where = rf"lights.sky.filename: .*{name}: .*{message}"
    with pytest.raises(InputError, match=where):
        read_scene(
            f"lights.sky.type = 'envmap'\nlights.sky.filename = '{name}'",
            without="lights",
        )
