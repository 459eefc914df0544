"""A scene opens files below its own folder and nowhere else."""

from pathlib import Path

import pytest

from twinlens.errors import InputError
from twinlens.scenes.assets import asset
from twinlens.scenes.table import At, Source


@pytest.fixture
def place(tmp_path: Path) -> At:
    home = tmp_path / "home"
    (home / "deep").mkdir(parents=True)
    (home / "deep" / "in.png").write_text("x")
    (tmp_path / "out.png").write_text("x")
    (home / "link.png").symlink_to(tmp_path / "out.png")
    (home / "folder").symlink_to(tmp_path)
    (home / "inner.png").symlink_to(home / "deep" / "in.png")
    return At(Source(home / "scene.toml"), "file")


def test_files_below_the_folder_are_found_and_recorded(place: At) -> None:
    found = asset(place, "deep/in.png")
    assert found.read_text() == "x"
    assert asset(place, "inner.png") == found
    assert place.source.assets == [found, found]


@pytest.mark.parametrize(
    "name",
    [
        *("../out.png", "deep/../../out.png", "link.png", "folder/out.png", "/etc/passwd", "C:/x.png", "..\\out.png"),
        *("", ".", "deep", "a\0b", "missing.png", "deep/../deep/in.png"),
    ],
)
def test_everything_else_is_refused(place: At, name: str) -> None:
    with pytest.raises(InputError, match=r"scene\.toml: file: "):
        asset(place, name)
    assert place.source.assets == []
