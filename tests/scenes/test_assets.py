"""A scene opens files below its own folder only, as the format of their suffix, and of limited size."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import EpsImagePlugin, Image

from tests.scenes.scene_text import Read
from twinlens.errors import FileError, InputError
from twinlens.scenes import assets
from twinlens.scenes.assets import SceneContext, find_asset, read_picture


@pytest.fixture
def place(tmp_path: Path) -> SceneContext:
    home = tmp_path / "home"
    (home / "deep").mkdir(parents=True)
    (home / "deep" / "in.png").write_text("x")
    (tmp_path / "out.png").write_text("x")
    (home / "link.png").symlink_to(tmp_path / "out.png")
    (home / "folder").symlink_to(tmp_path)
    (home / "inner.png").symlink_to(home / "deep" / "in.png")
    return SceneContext(home)


def test_files_below_the_folder_are_found_and_recorded(place: SceneContext) -> None:
    found = find_asset("deep/in.png", place)
    assert found.read_text() == "x"
    assert find_asset("inner.png", place) == found
    assert place.files == [found, found]


@pytest.mark.parametrize(
    "name",
    [
        *(
            "../out.png",
            "deep/../../out.png",
            "link.png",
            "folder/out.png",
            "/etc/passwd",
            "C:/x.png",
            "..\\out.png",
        ),
        *("", ".", "deep", "a\0b", "missing.png"),
    ],
)
def test_other_asset_paths_are_errors(place: SceneContext, name: str) -> None:
    with pytest.raises(
        InputError, match=r"must be a file name relative|leads outside|no file"
    ):
        find_asset(name, place)
    assert place.files == []


def test_two_dots_are_refused_with_the_name_to_write(place: SceneContext) -> None:
    with pytest.raises(
        InputError, match=r"'\.\.' is not allowed; write 'deep/in\.png'"
    ):
        find_asset("deep/../deep/in.png", place)


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n0 0 moveto\nshowpage\n%%EOF\n"


@pytest.mark.parametrize("name", ["t.png", "t.jpg", "t.jpeg", "T.PNG"])
def test_postscript_named_as_a_picture_is_not_interpreted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    started: list[object] = []
    monkeypatch.setattr(
        EpsImagePlugin, "Ghostscript", lambda *given, **_: started.append(given)
    )
    (tmp_path / name).write_bytes(POSTSCRIPT)
    with Image.open(tmp_path / name) as image:
        assert image.format == "EPS", "Pillow itself would take the file for what it is"
    with pytest.raises(FileError, match=name):
        read_picture(tmp_path / name)
    assert started == []


def test_a_picture_with_the_wrong_suffix_is_an_error(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "t.jpg", format="PNG")
    with pytest.raises(FileError, match=r"t\.jpg"):
        read_picture(tmp_path / "t.jpg")


def write_exr(path: Path, *sizes: tuple[int, int]) -> None:
    """One part a size (width, height)."""
    parts = [
        OpenEXR.Part(
            {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION},
            {"RGB": np.ones((height, width, 3), np.float32)},
            f"p{i}",
        )
        for i, (width, height) in enumerate(sizes)
    ]
    OpenEXR.File(parts).write(str(path))


def test_pictures_of_too_many_pixels_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_exr(tmp_path / "t.exr", (8, 5))
    Image.new("RGB", (8, 5)).save(tmp_path / "t.png")
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 5 +X 8\n"
    (tmp_path / "t.hdr").write_bytes(head + bytes(8 * 5 * 4))
    for name in ("t.exr", "t.png", "t.hdr"):
        monkeypatch.setattr(assets, "_MOST_PIXELS", 40)
        assert read_picture(tmp_path / name).shape == (5, 8, 3)
        monkeypatch.setattr(assets, "_MOST_PIXELS", 39)
        with pytest.raises(
            FileError, match=rf"{name}: a picture may have 1 to 39 pixels, got 8x5"
        ):
            read_picture(tmp_path / name)


def test_an_exr_is_refused_from_its_header_alone(tmp_path: Path) -> None:
    """The header promises 2^40 pixels, the file has none of them."""
    write_exr(tmp_path / "t.exr", (8, 5))
    data = (tmp_path / "t.exr").read_bytes()
    small, huge = (
        np.array([0, 0, w - 1, h - 1], "<i4").tobytes()
        for w, h in ((8, 5), (1 << 20, 1 << 20))
    )
    assert data.count(small) == 2  # the data window and the display window
    (tmp_path / "t.exr").write_bytes(data.replace(small, huge))
    with pytest.raises(FileError, match="got 1048576x1048576"):
        read_picture(tmp_path / "t.exr")


def test_an_exr_of_many_parts_is_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "t.exr", (8, 5), (8, 5))
    with pytest.raises(FileError, match="needs one part, got 2"):
        read_picture(tmp_path / "t.exr")


SKY = (
    '[lights.sky]\ntype = "constant"\nradiance = 1.0',
    "[lights.sky]\ntype = 'envmap'\nfilename = '{}'",
)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("sky.exr", b"v/1\x01 damaged", "cannot be read"),
        ("sky.png", POSTSCRIPT, "cannot be read"),
        ("sky.ps", POSTSCRIPT, "pictures may be"),
        (
            "sky.hdr",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n",
            "a picture may have 1 to",
        ),
        (
            "sky.hdr",
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 4\n" + bytes(16),
            "needs 2x3 pixels or more",
        ),
    ],
)
def test_environment_maps_are_checked_before_mitsuba_reads_them(
    tmp_path: Path, read_scene: Read, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        InputError, match=rf"lights.sky.filename: .*{name}: .*{message}"
    ):
        read_scene("", (SKY[0], SKY[1].format(name)))
