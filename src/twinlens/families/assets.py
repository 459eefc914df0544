"""A user's own meshes, textures and environment maps for random scenes.

A folder is listed at once; a file is read when a scene first draws it. A file that cannot be used is skipped and listed
in `Assets.broken` with the reason.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import FileError, InputError, file_hint
from twinlens.families.draws import Rng
from twinlens.scenes.assets import (
    USD_FILES,
    SceneContext,
    read_mesh,
    read_picture,
    read_sky,
)
from twinlens.scenes.materials import Material
from twinlens.scenes.model_files import (
    HAVE_MATERIALS_ALONE,
    WITH_MATERIALS,
    Model,
    named_files,
    read_model,
)
from twinlens.scenes.scene import Mesh
from twinlens.scenes.textures import Image

SUFFIXES = {
    "meshes": (".glb", ".gltf", ".obj", ".ply", ".stl"),
    "textures": (".png", ".jpg", ".jpeg", ".exr", ".hdr"),
    "hdris": (".hdr", ".exr", ".png"),
}
MAX_TRIANGLES = 100_000
MESH_SHARE = 0.6
MAX_CACHED = 4
"""Files whose content stays in memory, the last ones read: a folder of environment maps may be larger than memory."""


@dataclass(frozen=True, eq=False)
class UserMesh(Mesh):
    """A user's mesh, centred and of extent 1, z up; its file, its `size` there in metres, and its materials there."""

    path: Path = Path()
    size: float = 1.0
    materials: Mapping[str, Material] = field(default_factory=dict)


@dataclass(eq=False)
class Assets:
    """Files to draw from, sorted by path. `before_reading` is called with the path of each file, and may raise.

    keep_scale : meshes keep the size of their file, in metres.
    keep_material : meshes of .glb, .gltf and .obj files keep the materials of their file.
    mesh_share : the probability that a body is one of the meshes, if there are any.
    folder : meshes below it may name files anywhere below it; other meshes, and all without it, those below their own
        folder.
    """

    meshes: tuple[Path, ...] = ()
    textures: tuple[Path, ...] = ()
    hdris: tuple[Path, ...] = ()
    before_reading: Callable[[Path], object] | None = None
    keep_scale: bool = False
    keep_material: bool = False
    mesh_share: float = MESH_SHARE
    folder: Path | None = None
    _failed: dict[tuple[str, Path], str] = field(default_factory=dict, repr=False)
    _read: dict[tuple[str, Path], Any] = field(default_factory=dict, repr=False)

    @classmethod
    def from_folders(
        cls,
        meshes: Iterable[str | Path] = (),
        textures: Iterable[str | Path] = (),
        hdris: Iterable[str | Path] = (),
        *,
        keep_scale: bool = False,
        keep_material: bool = False,
        mesh_share: float = MESH_SHARE,
        folder: str | Path | None = None,
    ) -> "Assets":
        """All files of known types in these folders and their subfolders; a path may also name one file.

        Raises InputError when a folder is missing, or contains no file of its type.
        """
        listed = (
            _listed("meshes", meshes),
            _listed("textures", textures),
            _listed("hdris", hdris),
        )
        below = None if folder is None else Path(folder)
        return cls(
            *listed,
            keep_scale=keep_scale,
            keep_material=keep_material,
            mesh_share=mesh_share,
            folder=below,
        )

    @property
    def broken(self) -> tuple[tuple[Path, str], ...]:
        """(path, reason) of every file that was drawn and could not be used."""
        return tuple(
            sorted({(path, reason) for (_, path), reason in self._failed.items()})
        )

    def check(self) -> "Assets":
        """Read every file now, so that `broken` lists all that cannot be used."""
        for kind in SUFFIXES:
            for path in getattr(self, kind):
                self._get(kind, path)
        return self

    @property
    def share_of_ours(self) -> float:
        """The share of the bodies that twinlens makes: all of them where the user has no meshes."""
        return 1 - self.mesh_share if self.meshes else 1.0

    def draw(self, kind: str, rng: Rng) -> tuple[str, Any] | None:
        """The name and content of the first usable file in a random order; None when no file can be used.

        `kind` is "meshes", "textures" or "hdris". A broken file changes only the scenes that drew it.
        """
        paths = getattr(self, kind)
        for index in rng.permutation(len(paths)):
            if (made := self._get(kind, paths[index])) is not None:
                return paths[index].stem, made
        return None

    def _named_by(self, kind: str, path: Path) -> Iterable[Path]:
        """The files that a mesh file names."""
        if kind != "meshes":
            return ()
        return named_by_mesh(path, self.keep_material, self.folder)

    def _get(self, kind: str, path: Path) -> Any:
        key = kind, path
        if key not in self._read and key not in self._failed:
            if self.before_reading is not None:
                self.before_reading(path)
                for file in self._named_by(kind, path):
                    self.before_reading(file)
            try:
                self._read[key] = (
                    _READERS[kind](path) if kind != "meshes" else self._read_mesh(path)
                )
            except (InputError, OSError) as error:
                self._failed[key] = str(error).removeprefix(f"{path}: ")
            if len(self._read) > MAX_CACHED:
                del self._read[next(iter(self._read))]
        return self._read.get(key)

    def _read_mesh(self, path: Path) -> UserMesh:
        context = SceneContext(_root(path, self.folder))
        suffix = path.suffix.lower()
        if suffix in HAVE_MATERIALS_ALONE or (
            self.keep_material and suffix in WITH_MATERIALS
        ):
            model = read_model(
                path,
                context,
                None if self.keep_material else 30.0,
                with_materials=self.keep_material,
            )
        else:
            model = Model(read_mesh(path), {})
        return _normalized(path, model)


def named_by_mesh(path: Path, keep_material: bool, folder: Path | None) -> list[Path]:
    """The files that a mesh file names and that are read with it: buffers of .gltf files, and those of materials.

    `folder` is that of `Assets`.
    """
    suffixes = WITH_MATERIALS if keep_material else (".gltf", *USD_FILES)
    return (
        named_files(path, SceneContext(_root(path, folder)))
        if path.suffix.lower() in suffixes
        else []
    )


def _root(path: Path, folder: Path | None) -> Path:
    """The folder below which the mesh file at `path` may name files."""
    return (
        folder
        if folder is not None and path.parent.resolve().is_relative_to(folder.resolve())
        else path.parent
    )


def _listed(kind: str, folders: Iterable[str | Path]) -> tuple[Path, ...]:
    if isinstance(folders, (str, Path)):
        folders = (folders,)
    paths: set[Path] = set()
    for folder in map(Path, folders):
        if not folder.exists():
            raise InputError(
                f"{kind}: no file or folder {str(folder)!r}{file_hint(folder)}"
            )
        listed = [folder] if folder.is_file() else folder.rglob("*")
        inside = {path for path in listed if path.suffix.lower() in SUFFIXES[kind]}
        if not inside:
            what = "is not a" if folder.is_file() else "contains no"
            raise InputError(
                f"{kind}: {str(folder)!r} {what} {', '.join(SUFFIXES[kind])} file"
            )
        paths |= {path for path in inside if path.is_file()}
    return tuple(sorted(paths))


def _normalized(path: Path, model: Model) -> UserMesh:
    """A mesh of largest extent 1 m, centred, z up."""
    mesh = model.mesh
    if len(mesh.faces) > MAX_TRIANGLES:
        raise FileError(
            f"{path}: {len(mesh.faces)} triangles, at most {MAX_TRIANGLES} are allowed; simplify the mesh"
        )
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float((high - low).max())
    if not size > 0 or np.count_nonzero(high - low > 1e-6 * size) < 3:
        raise FileError(
            f"{path}: is flat; a mesh needs an extent in all three dimensions"
        )
    has_z_up = path.suffix.lower() in (".ply", ".stl")
    turn = np.eye(3) if has_z_up else _Z_FROM_Y_UP
    values = {field.name: getattr(mesh, field.name) for field in fields(mesh)}
    values["vertices"] = (mesh.vertices - (low + high) / 2) @ turn.T / size
    values["normals"] = None if mesh.normals is None else mesh.normals @ turn.T
    return UserMesh(**values, path=path, size=size, materials=model.materials)


_Z_FROM_Y_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns the y axis of glTF and of most OBJ files upwards, to z."""


def _read_texture(path: Path) -> Image:
    """A picture (H, W, 3), linear, in [0, 0.95]."""
    pixels = np.clip(read_picture(path), 0.0, 0.95)
    if min(pixels.shape[:2]) < 2:
        raise FileError(f"{path}: a texture needs 2x2 pixels or more")
    return pixels


def _read_hdri(path: Path) -> Image:
    """An environment map (H, W, 3), linear."""
    pixels = read_sky(path)
    if not pixels.max() > 0:
        raise FileError(f"{path}: is black")
    return pixels


_READERS: dict[str, Callable[[Path], Any]] = {
    "textures": _read_texture,
    "hdris": _read_hdri,
}
