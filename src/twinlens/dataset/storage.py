"""Where a dataset is: a local folder, or an fsspec address such as ``s3://bucket/set``.

Object stores cannot rename a folder, so a remote sample is complete when its `MARK` file exists: it is written last and
removed first. docs/decisions/storage.md says why universal-pathlib is not used.

Source: fsspec's specification, https://filesystem-spec.readthedocs.io/en/latest/api.html.
"""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union
from urllib.parse import unquote, urlsplit

from twinlens.errors import (
    FileError,
    InputError,
    MissingExtraError,
    OutputError,
    TwinlensError,
)

MARK = "sample.json"

EXISTS = "already exists; choose another name, or overwrite it (--overwrite)"


@dataclass(frozen=True, order=True)
class RemotePath:
    """A remote file or folder by its address, with methods of `pathlib.Path`; errors are FileError and OutputError.

    Can be pickled; credentials come from the environment, as in fsspec.
    """

    url: str

    def __truediv__(self, name: str | os.PathLike[str]) -> "RemotePath":
        part = Path(name).as_posix()
        return self if part == "." else RemotePath(f"{self.url.rstrip('/')}/{part}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def parent(self) -> "RemotePath":
        return RemotePath(self.url.rstrip("/").rpartition("/")[0])

    def resolve(self) -> "RemotePath":
        return self

    def exists(self, kinds: tuple[str, ...] = ("file", "directory")) -> bool:
        with self.store(FileError, "read") as (system, path):
            try:
                return system.info(path)["type"] in kinds
            except (FileNotFoundError, NotADirectoryError):
                return False

    def is_file(self) -> bool:
        return self.exists(("file",))

    def is_dir(self) -> bool:
        return self.exists(("directory",))

    def read_bytes(self) -> bytes:
        with self.store(FileError, "read") as (system, path):
            return bytes(system.cat_file(path))

    def write_bytes(self, data: bytes) -> None:
        write_objects(self.parent, {self.name: data})

    def iterdir(self) -> Iterator["RemotePath"]:
        with self.store(FileError, "listed") as (system, path):
            names = [
                entry["name"].rstrip("/").rpartition("/")[2]
                for entry in system.ls(path, detail=True)
            ]
        return (self / name for name in names if name)

    def files(self) -> list[str]:
        """Relative names, with /, of all files below, sorted; empty if nothing exists."""
        with self.store(FileError, "listed") as (system, path):
            return sorted(name.removeprefix(f"{path}/") for name in system.find(path))

    @contextlib.contextmanager
    def store(
        self, kind: type[TwinlensError], action: str
    ) -> Iterator[tuple[Any, str]]:
        """fsspec's file system, with an empty cache since other processes may write, and the path in it.

        Errors of the store's client become `kind`, except FileNotFoundError.
        """
        from fsspec.core import url_to_fs

        try:
            try:
                system, path = url_to_fs(self.url)
            except ImportError as error:
                raise MissingExtraError(
                    f"{self}: a package is missing ({error})"
                ) from None
            except ValueError as error:
                raise InputError(
                    f"{self}: not an address that fsspec knows ({error})"
                ) from None
            system.invalidate_cache()
            yield system, path.rstrip("/")
        except (TwinlensError, FileNotFoundError):
            raise
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise kind(f"{self}: cannot be {action} ({reason})") from error


Place = Union[Path, RemotePath]  # noqa: UP007
Where = Union[str, os.PathLike[str], RemotePath]  # noqa: UP007


def place(where: Where) -> Place:
    """The path of `where`: an address with ``://`` is remote; ``file://`` and everything else is local.

    >>> place("out"), place("s3://bucket/set") / "0001"
    (PosixPath('out'), RemotePath(url='s3://bucket/set/0001'))
    """
    if isinstance(where, RemotePath):
        return where
    text = os.fspath(where)
    if isinstance(where, Path) or "://" not in text:
        return Path(text)
    if text.startswith("file://"):
        return Path(unquote(urlsplit(text).path))
    return RemotePath(text)


def is_whole(folder: Where) -> bool:
    """Whether the folder holds a complete sample, as `write_sample` leaves it."""
    return (place(folder) / MARK).is_file()


def write_objects(folder: RemotePath, files: Mapping[str, bytes]) -> None:
    """Write `files` (relative name -> content) below `folder`, concurrently if the store can. Raises OutputError."""
    with folder.store(OutputError, "written") as (system, path):
        objects = {f"{path}/{name}": data for name, data in files.items()}
        try:
            system.pipe(objects)
        except FileNotFoundError:  # a store with real folders
            for parent in {name.rpartition("/")[0] for name in objects}:
                system.makedirs(parent, exist_ok=True)
            system.pipe(objects)


def fill_remote(
    folder: RemotePath,
    files: Mapping[str, bytes] | Iterable[tuple[str, bytes]],
    overwrite: bool,
) -> None:
    """Write `files` below `folder` and remove all others; on failure what was written is removed. Raises OutputError.

    An existing folder is rejected unless `overwrite` is set. A sample is a mapping with `MARK`. The files of an
    interrupted attempt, which has no mark, are overwritten; a folder without a mark and with files of other names is
    rejected. Files of an iterable are written one by one.
    """
    existing = set(folder.files())
    if isinstance(files, Mapping) and MARK in files:
        _fill_sample(folder, files, existing, overwrite)
        return
    if existing and not overwrite:
        raise OutputError(f"{folder}: {EXISTS}")
    named = files.items() if isinstance(files, Mapping) else files
    written: set[str] = set()
    with _removed_on_failure(folder, written):
        for name, data in named:
            written.add(name)
            write_objects(folder, {name: data})
    remove_objects(folder, sorted(existing - written))


def _fill_sample(
    folder: RemotePath, sample: Mapping[str, bytes], existing: set[str], overwrite: bool
) -> None:
    """Write the files of a sample, of which the mark is removed first and written last."""
    if MARK in existing and not overwrite:
        raise OutputError(f"{folder}: {EXISTS}")
    others = existing - set(sample)
    if MARK not in existing and others:
        raise OutputError(
            f"{folder}: exists and is not a sample, so it is not overwritten; choose another name"
        )
    marked = [MARK] if MARK in existing else []
    unmarked = {name: data for name, data in sample.items() if name != MARK}
    written: set[str] = set()
    with _removed_on_failure(folder, written):
        remove_objects(folder, [*marked, *sorted(others)])
        written.update(sample)
        write_objects(folder, unmarked)
        write_objects(folder, {MARK: sample[MARK]})


@contextlib.contextmanager
def _removed_on_failure(folder: RemotePath, written: set[str]) -> Iterator[None]:
    """Remove what was `written` until then if the block raises."""
    try:
        yield
    except BaseException:
        for name in sorted(written):
            with contextlib.suppress(OutputError):
                remove_objects(folder, [name])
        raise


def remove_objects(folder: RemotePath, names: Iterable[str]) -> None:
    """Remove those of the files below `folder` that exist, in the given order. Raises OutputError."""
    with folder.store(OutputError, "removed") as (system, path):
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                system.rm_file(f"{path}/{name}")
