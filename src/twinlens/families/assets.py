"""A user's own meshes, textures and environment maps for random scenes.

A folder is listed at once; a file is read when a scene first draws it. A file that cannot be used is skipped and listed
in `Assets.broken` with the reason.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from twinlens.errors import FileError, InputError
from twinlens.families.draws import Rng
from twinlens.scenes.assets import read_mesh, read_picture, read_sky
from twinlens.scenes.scene import Mesh
from twinlens.scenes.textures import Image

T = TypeVar("T")
MESHES = (".glb", ".obj", ".ply", ".stl")
PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".hdr")
HDRIS = (".hdr", ".exr", ".png")
MAX_TRIANGLES = 100_000
MAX_CACHED = 4
"""Files whose content stays in memory, the last ones read: a folder of environment maps may be larger than memory."""


@dataclass(eq=False)
class Assets:
    """Files to draw from, sorted by path. `before_reading` is called with the path of each file, and may raise."""

    meshes: tuple[Path, ...] = ()
    textures: tuple[Path, ...] = ()
    hdris: tuple[Path, ...] = ()
    before_reading: Callable[[Path], object] | None = None
    _failed: dict[Path, str] = field(default_factory=dict, repr=False)
    _read: dict[Path, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def from_folders(
        cls, meshes: Iterable[str | Path] = (), textures: Iterable[str | Path] = (), hdris: Iterable[str | Path] = ()
    ) -> "Assets":
        """All files of known types in these folders and their subfolders; a path may also name one file.

        Raises InputError when a folder is missing, or contains no file of its type.
        """
        return cls(
            _listed("meshes", meshes, MESHES), _listed("textures", textures, PICTURES), _listed("hdris", hdris, HDRIS)
        )

    @property
    def broken(self) -> tuple[tuple[Path, str], ...]:
        """(path, reason) of every file that was drawn and could not be used."""
        return tuple(sorted(self._failed.items()))

    def check(self) -> "Assets":
        """Read every file now, so that `broken` lists all that cannot be used."""
        for paths, read in ((self.meshes, _mesh), (self.textures, _texture), (self.hdris, _hdri)):
            for path in paths:
                self._get(path, read)
        return self

    def mesh(self, rng: Rng) -> tuple[str, Mesh] | None:
        """A file's name and mesh, of largest extent 1 m, centred, z up; None when no file can be used."""
        return self._draw(rng, self.meshes, _mesh)

    def texture(self, rng: Rng) -> Image | None:
        """A picture (H, W, 3), linear, in [0, 0.95]; None when no file can be used."""
        return (self._draw(rng, self.textures, _texture) or (None, None))[1]

    def hdri(self, rng: Rng) -> Image | None:
        """An environment map (H, W, 3), linear; None when no file can be used."""
        return (self._draw(rng, self.hdris, _hdri) or (None, None))[1]

    def _draw(self, rng: Rng, paths: tuple[Path, ...], read: Callable[[Path], T]) -> tuple[str, T] | None:
        """The first usable file in a random order; a broken file changes only the scenes that drew it."""
        for index in rng.permutation(len(paths)):
            made = self._get(paths[index], read)
            if made is not None:
                return paths[index].stem, made
        return None

    def _get(self, path: Path, read: Callable[[Path], T]) -> T | None:
        if path not in self._read and path not in self._failed:
            if self.before_reading is not None:
                self.before_reading(path)
            try:
                self._read[path] = read(path)
            except (InputError, OSError) as error:
                self._failed[path] = str(error).removeprefix(f"{path}: ")
            if len(self._read) > MAX_CACHED:
                del self._read[next(iter(self._read))]
        return self._read.get(path)


def _listed(kind: str, folders: Iterable[str | Path], suffixes: tuple[str, ...]) -> tuple[Path, ...]:
    if isinstance(folders, (str, Path)):
        folders = (folders,)
    found: set[Path] = set()
    for folder in map(Path, folders):
        if not folder.exists():
            raise InputError(f"{kind}: no folder {str(folder)!r}")
        inside = {p for p in ([folder] if folder.is_file() else folder.rglob("*")) if p.suffix.lower() in suffixes}
        if not inside:
            raise InputError(f"{kind}: {str(folder)!r} contains no {', '.join(suffixes)} file")
        found |= {path for path in inside if path.is_file()}
    return tuple(sorted(found))


def _mesh(path: Path) -> Mesh:
    mesh = read_mesh(path)
    if len(mesh.faces) > MAX_TRIANGLES:
        raise FileError(f"{path}: {len(mesh.faces)} triangles, at most {MAX_TRIANGLES} are allowed; simplify the mesh")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    if not size > 0 or np.count_nonzero(high - low > 1e-6 * size) < 3:
        raise FileError(f"{path}: is flat; a mesh needs an extent in all three dimensions")
    turn = np.eye(3) if path.suffix.lower() in (".ply", ".stl") else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    vertices = (mesh.vertices - (low + high) / 2) @ turn.T / size
    return Mesh(vertices, mesh.faces, None if mesh.normals is None else mesh.normals @ turn.T, mesh.uv)


def _texture(path: Path) -> Image:
    pixels = np.clip(read_picture(path), 0.0, 0.95)
    if min(pixels.shape[:2]) < 2:
        raise FileError(f"{path}: a texture needs 2x2 pixels or more")
    return pixels


def _hdri(path: Path) -> Image:
    pixels = read_sky(path)
    if not pixels.max() > 0:
        raise FileError(f"{path}: is black")
    return pixels
