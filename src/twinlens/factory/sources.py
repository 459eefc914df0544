"""The files that a recipe uses: scenes, assets, aperture masks. Their contents are part of the dataset's identity.

Each file is hashed before the first sample is made. It is hashed again only if its size or modification time differ,
so that a file edited during a run is detected at little cost.
"""

import hashlib
import itertools
import os
import warnings
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from twinlens.dataset.files import read_bytes
from twinlens.errors import FileError, InputError, NotUsedWarning, located
from twinlens.families import Assets
from twinlens.families.assets import MESH_SHARE, named_by_mesh
from twinlens.scenes import Scene, bundled_folder, bundled_scenes, load_scene
from twinlens.scenes.assets import MESH_FILES, SceneContext, read_mesh, read_sky
from twinlens.scenes.model_files import HAVE_MATERIALS_ALONE, read_model

_SCENES_KEPT = 8
_NAMED = 3
_READ_AT_FIRST = 64 << 20  # bytes; meshes take about a second per MiB


@dataclass(frozen=True, eq=False)
class Sources:
    """The files that a recipe names, relative to `folder`.

    scenes : bundled names, scene files, or folders with a scene.toml.
    assets : folders or files by kind (meshes, textures, hdris).
    named : other files, such as images of apertures and meshes of objects; whether each is a mesh with own materials.
    skies : environment maps, or folders of them.
    keep_scale, keep_material, mesh_share : of `Assets`.
    """

    folder: Path = Path()
    scenes: tuple[str, ...] = ()
    assets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    named: Mapping[str, bool] = field(default_factory=dict)
    skies: tuple[str, ...] = ()
    keep_scale: bool = False
    keep_material: bool = False
    mesh_share: float = MESH_SHARE
    _checked: dict[Path, tuple[tuple[int, int, int], str]] = field(
        default_factory=dict, init=False, repr=False
    )
    _loaded: dict[str, Scene] = field(default_factory=dict, init=False, repr=False)
    _meshes: dict[str, list[str]] = field(default_factory=dict, init=False, repr=False)
    _skies: dict[Path, Any] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def files(self) -> dict[str, Path]:
        """Every file by its name relative to the recipe, sorted. Raises InputError for unreadable scenes."""
        files = {Path(name).as_posix(): self.folder / name for name in self.named}
        for name in self.scenes:
            home = (
                bundled_folder() / name
                if name in bundled_scenes()
                else self.folder / name
            )
            shown = Path(name)
            if not home.is_dir():
                home, shown = home.parent, shown.parent
            below = _names_below(home, self.scene(name).files)
            files |= {(shown / file).as_posix(): path for file, path in below.items()}
        for several in (
            *self.asset_files.values(),
            *self.sky_files.values(),
            self._named_by_meshes(),
        ):
            files |= several
        return dict(sorted(files.items()))

    @cached_property
    def digests(self) -> dict[str, str]:
        """SHA-256 of every file by its name relative to the recipe, sorted. Raises InputError for unreadable files."""
        return {name: self.unchanged(path) for name, path in self.files.items()}

    @property
    def bundled(self) -> list[str]:
        """The names of bundled scenes among `scenes`."""
        return sorted({*self.scenes} & {*bundled_scenes()})

    @property
    def digest(self) -> str:
        """The SHA-256 of all files: of the output of `sha256sum` for the sorted names."""
        listed = "".join(f"{digest}  {name}\n" for name, digest in self.digests.items())
        return hashlib.sha256(listed.encode()).hexdigest()

    def scene(self, name: str) -> Scene:
        """The scene of that name; the last few scenes are cached.

        Raises FileError if its files have changed. Rendering opens a Mitsuba .xml again; call this again after it.
        """
        scene = self._loaded.get(name) or load_scene(
            name if name in bundled_scenes() else self.folder / name
        )
        self.check_files(scene)
        self._loaded[name] = scene
        if len(self._loaded) > _SCENES_KEPT:
            del self._loaded[next(iter(self._loaded))]
        return scene

    def check_files(self, scene: Scene) -> None:
        """Raise FileError if a file of the scene has changed."""
        _digests[scene] = {
            file: self.unchanged(path)
            for file, path in _names_below(None, scene.files).items()
        }

    def meshes(self, name: str) -> list[str]:
        """The mesh files of a folder, as `meshes_in`; listed once."""
        if name not in self._meshes:
            self._meshes[name] = meshes_in(self.folder, name)
        return self._meshes[name]

    def file(self, name: str) -> Path:
        """The path of a file that the recipe names. Raises FileError if it has changed."""
        self.unchanged(self.folder / name)
        return self.folder / name

    @cached_property
    def asset_files(self) -> dict[str, dict[str, Path]]:
        """The files of each kind of assets by name. Raises InputError for a folder without any."""
        files: dict[str, dict[str, Path]] = {kind: {} for kind in self.assets}
        for kind, names in self.assets.items():
            for name in names:
                files[kind] |= listed(kind, name, self.folder)
        return files

    def _named_by_meshes(self) -> dict[str, Path]:
        """The files that the mesh files of the assets name, such as pictures, by name."""
        files: dict[str, Path] = {}
        for name, mesh in self.asset_files.get("meshes", {}).items():
            for path in named_by_mesh(mesh, self.keep_material, self.folder):
                from_mesh = os.path.relpath(path, mesh.parent.resolve())
                from_recipe = os.path.normpath(Path(name).parent / from_mesh)
                files[Path(from_recipe).as_posix()] = path
        return files

    @cached_property
    def sky_files(self) -> dict[str, dict[str, Path]]:
        """The files of each entry of `skies`, by name. Raises InputError for a folder without any."""
        return {name: listed("hdris", name, self.folder) for name in self.skies}

    def sky(self, name: str, rng: Any) -> tuple[str, Any]:
        """Name and pixels of a random file of the folder `name`, or of the file `name`.

        Raises FileError if it has changed, or cannot be used.
        """
        files = list(self.sky_files[name].items())
        chosen, path = files[int(rng.integers(len(files)))]
        self.unchanged(path)
        if path not in self._skies:
            pixels = _read_sky(path)
            self._skies.clear()  # one may have a hundred megabytes
            self._skies[path] = pixels
        return chosen, self._skies[path]

    def check_contents(self) -> None:
        """Read the skies and the meshes of objects, the first 64 MiB of them, before any sample is made of them.

        A file that is found damaged later cannot be replaced: it belongs to the identity of the samples that are made.
        Raises FileError.
        """
        meshes = {
            self.folder / name: has_materials
            for name, has_materials in self.named.items()
            if Path(name).suffix.lower() in MESH_FILES
        }
        skies = set[Path]().union(
            *(files.values() for files in self.sky_files.values())
        )
        left = _READ_AT_FIRST
        for path in [*sorted(skies), *meshes]:
            left -= path.stat().st_size
            if left < 0:
                return
            # Samples give the warnings of the files that they use.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotUsedWarning)
                if path in skies:
                    with located("sky.file"):
                        _read_sky(path)
                elif meshes[path] or path.suffix.lower() in HAVE_MATERIALS_ALONE:
                    context = SceneContext(self.folder)
                    read_model(path, context, with_materials=meshes[path])
                else:
                    read_mesh(path)

    def check_output(self, output: Path) -> None:
        """Raise InputError for an output folder below one whose files the recipe draws from."""
        folders = itertools.chain.from_iterable(self.assets.values())
        for name in (*folders, *self.skies):
            folder = (self.folder / name).resolve()
            if folder.is_dir() and output.resolve().is_relative_to(folder):
                remedy = "its images would become the recipe's files; name a folder elsewhere"
                raise InputError(
                    f"{output}: is below {name!r}, from which the recipe draws files; {remedy}"
                )

    @cached_property
    def families_assets(self) -> Assets:
        """The assets as families use them."""
        listed: dict[str, Any] = {
            kind: tuple(sorted(set(files.values())))
            for kind, files in self.asset_files.items()
        }
        listed |= {
            "keep_scale": self.keep_scale,
            "keep_material": self.keep_material,
            "mesh_share": self.mesh_share,
        }
        return Assets(**listed, folder=self.folder, before_reading=self.unchanged)

    def unchanged(self, path: Path) -> str:
        """The file's SHA-256. Raises FileError if it differs from the first call's."""
        earlier = self._checked.get(path)
        try:
            status = path.stat()
            stamp = status.st_size, status.st_mtime_ns, status.st_ctime_ns
            if earlier is not None and earlier[0] == stamp:
                return earlier[1]
            # A file that was restored from a backup has another time, but the same bytes.
            with path.open("rb") as file:
                now = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise FileError(f"{path}: cannot be read ({error.strerror})") from error
        if earlier is not None and now != earlier[1]:
            raise FileError(
                f"{path}: has changed while samples were made from it; restore it and run the same command"
            )
        self._checked[path] = (stamp, now)
        return now


def _read_sky(path: Path) -> Any:
    pixels = read_sky(path)
    # Checked here and not where the sky is made, where the error would only reject each draw.
    if not pixels.any():
        raise FileError(f"{path}: is black, and a sky needs some light")
    return pixels


def meshes_in(folder: Path, name: str) -> list[str]:
    """The mesh files of the folder `name` below `folder`, by their names relative to `folder`, sorted.

    Raises InputError if there is none, or if it is elsewhere.
    """
    with located("folder"):
        if not (folder / name).resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{name!r} leads outside the recipe's folder; copy the files below it"
            )
        return list(listed("meshes", name, folder))


def listed(kind: str, name: str, folder: Path) -> dict[str, Path]:
    """The files of a kind (meshes, textures, hdris) that `name` below `folder` is or contains, by their names, sorted.

    Raises InputError if there is none.
    """
    home = folder / name
    try:
        paths: tuple[Path, ...] = getattr(
            Assets.from_folders(**dict[str, Any]({kind: [home]})), kind
        )
    except InputError as error:
        message = (
            str(error).removeprefix(f"{kind}: ").replace(repr(str(home)), repr(name))
        )
        raise InputError(message) from None
    return {(Path(name) / path.relative_to(home)).as_posix(): path for path in paths}


_digests: "weakref.WeakKeyDictionary[Scene, dict[str, str]]" = (
    weakref.WeakKeyDictionary()
)


def file_digests(scene: Scene) -> dict[str, str]:
    """SHA-256 of the files that a scene was read from, by their names below its folder.

    Each scene's files are read at the first call only. Raises FileError.
    """
    if scene not in _digests:
        named = _names_below(None, scene.files).items()
        _digests[scene] = {
            name: hashlib.sha256(read_bytes(path)).hexdigest() for name, path in named
        }
    return dict(_digests[scene])


def _names_below(home: Path | None, files: tuple[Path, ...]) -> dict[str, Path]:
    """Files by their names relative to `home`, or to the first one's folder; files elsewhere by their last part."""
    names = {}
    for path in files:
        folder = (home or files[0].parent).resolve()
        whole = path.resolve()
        is_below = whole.is_relative_to(folder)
        name = whole.relative_to(folder).as_posix() if is_below else path.name
        names[name] = path
    return names


def changed_files(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """The files that have changed, as text; empty if none has.

    >>> changed_files({"a.png": "00", "b.png": "11"}, {"a.png": "22", "c.png": "33"})
    'a.png has changed, b.png is gone, c.png is new'
    """
    changes = [
        f"{name} {'is new' if name not in before else 'is gone' if name not in now else 'has changed'}"
        for name in sorted({**before, **now})
        if before.get(name) != now.get(name)
    ]
    more = [f"and {len(changes) - _NAMED} more"] if len(changes) > _NAMED else []
    return ", ".join(changes[:_NAMED] + more)
