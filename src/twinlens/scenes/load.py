"""Finding a scene: by the name of a bundled one, or by the path of a scene.toml or a Mitsuba .xml."""

from pathlib import Path

from twinlens.errors import FileError, InputError, unknown
from twinlens.scenes.scene import Scene
from twinlens.scenes.toml_file import Heading, read_heading, read_scene_toml
from twinlens.scenes.xml_file import read_scene_xml

_SCENE_FILE = "scene.toml"


def bundled_folder() -> Path:
    """Where the bundled scenes lie: inside the installed package, or in the checkout beside src/."""
    package = Path(__file__).parents[1]
    installed = package / "bundled_scenes"
    return installed if installed.is_dir() else package.parents[1] / "scenes"


def bundled_scenes() -> list[str]:
    """The names of the bundled scenes, sorted."""
    return sorted(path.parent.name for path in bundled_folder().glob(f"*/{_SCENE_FILE}"))


def bundled_headings() -> list[Heading]:
    """The headings of the bundled scenes, sorted by name."""
    return [read_heading(bundled_folder() / name / _SCENE_FILE, name) for name in bundled_scenes()]


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of a bundled name ("staircase"), of a scene.toml (or the folder that holds one), or of a Mitsuba .xml.

    Raises InputError: an unknown name comes back with the nearest known one, a mistake in a file with its key.
    """
    path = Path(name_or_path)
    if str(name_or_path) in bundled_scenes():
        return read_scene_toml(bundled_folder() / name_or_path / _SCENE_FILE, str(name_or_path))
    if path.is_dir():
        if not (path / _SCENE_FILE).is_file():
            known = ", ".join(bundled_scenes())
            raise FileError(f"{path}: is a folder without a {_SCENE_FILE}; name a scene's file, or one of {known}")
        path = path / _SCENE_FILE
    if path.suffix in (".toml", ".xml"):
        if not path.is_file():
            raise FileError(f"{path}: no such scene file")
        return read_scene_xml(path) if path.suffix == ".xml" else read_scene_toml(path, _name_of(path))
    if path.is_file():
        raise InputError(f"{path}: a scene is a .toml or a Mitsuba .xml file, got {path.suffix!r}")
    raise unknown("scene", str(name_or_path), bundled_scenes())


def _name_of(path: Path) -> str:
    """scene.toml is named after its folder, any other file after itself."""
    return path.resolve().parent.name if path.name == _SCENE_FILE else path.stem
