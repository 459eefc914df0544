"""Where a dataset lies: a folder of this machine, or a bucket's address such as ``s3://bucket/set`` (fsspec's).

`place` tells the two apart; both join with ``/`` and answer the few questions that the room asks, so that nothing else
in it knows which one it holds. A bucket cannot rename a folder. There a folder of files appears by its mark: the one
file that is written last and removed first, so that whoever finds the mark finds the rest.

Source: fsspec's specification, https://filesystem-spec.readthedocs.io/en/latest/api.html.
"""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union
from urllib.parse import unquote, urlsplit

from twinlens.errors import FileError, InputError, MissingExtraError, OutputError, TwinlensError

MARK = "sample.json"
"""A sample in a bucket is whole when this file is there: it is written last, and removed first."""


@dataclass(frozen=True, order=True)
class RemotePath:
    """A file or folder that fsspec reaches, by its address. Pickles; credentials are the environment's, as fsspec's."""

    url: str

    def __truediv__(self, name: str | os.PathLike[str]) -> "RemotePath":
        part = Path(name).as_posix()
        return self if part == "." else RemotePath(f"{self.url.rstrip('/')}/{part}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.url.rstrip("/").rpartition("/")[2]

    @property
    def suffix(self) -> str:
        """The name's ending, with its dot."""
        return Path(self.name).suffix

    @property
    def parent(self) -> "RemotePath":
        """What it lies in."""
        return RemotePath(self.url.rstrip("/").rpartition("/")[0])

    def resolve(self) -> "RemotePath":
        """Itself: an address has no links and no working folder."""
        return self

    def exists(self) -> bool:
        """Whether a file or a folder is there. Raises FileError when that cannot be told."""
        return self._kind() is not None

    def is_file(self) -> bool:
        """Whether a file is there."""
        return self._kind() == "file"

    def is_dir(self) -> bool:
        """Whether a folder, that is an address with files below it, is there."""
        return self._kind() == "directory"

    def read_bytes(self) -> bytes:
        """The whole file. Raises FileNotFoundError, and FileError when it cannot be read."""
        with _told(self, FileError, "read"):
            system, path = self._system()
            return bytes(system.cat_file(path))

    def write_bytes(self, data: bytes) -> None:
        """Write the whole file. Raises OutputError."""
        write_objects(self.parent, {self.name: data})

    def iterdir(self) -> Iterator["RemotePath"]:
        """The files and folders in it."""
        with _told(self, FileError, "listed"):
            system, path = self._system()
            system.invalidate_cache()
            names = [entry["name"].rstrip("/").rpartition("/")[2] for entry in system.ls(path, detail=True)]
        return (self / name for name in names if name)

    def files(self) -> list[str]:
        """The relative names, with /, of all files below it, sorted; none when nothing is there."""
        with _told(self, FileError, "listed"):
            system, path = self._system()
            system.invalidate_cache()
            return sorted(found.removeprefix(path.rstrip("/") + "/") for found in system.find(path))

    def _kind(self) -> str | None:
        with _told(self, FileError, "read"):
            system, path = self._system()
            system.invalidate_cache()  # others may be writing there
            try:
                return str(system.info(path)["type"])
            except (FileNotFoundError, NotADirectoryError):
                return None

    def _system(self) -> tuple[Any, str]:
        """fsspec's file system for the address, one a process, and the path in it."""
        from fsspec.core import url_to_fs

        try:
            system, path = url_to_fs(self.url)
        except ImportError as error:
            raise MissingExtraError(f"{self}: needs a package more ({error})") from None
        except ValueError as error:
            raise InputError(f"{self}: no address that fsspec knows ({error})") from None
        return system, path


Place = Union[Path, RemotePath]  # noqa: UP007
Where = Union[str, os.PathLike[str], RemotePath]  # noqa: UP007


def place(where: Where) -> Place:
    """The folder or file that `where` names: an address with ``://`` is fsspec's, ``file://`` and all else is local.

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
    """Whether a whole sample lies there, as `write_sample` leaves it."""
    return (place(folder) / MARK).is_file()


def write_objects(folder: RemotePath, files: Mapping[str, bytes]) -> None:
    """Put `files` (relative name -> content) below `folder`, at once where the store can. Raises OutputError."""
    with _told(folder, OutputError, "written"):
        system, path = folder._system()
        objects = {f"{path.rstrip('/')}/{name}": data for name, data in files.items()}
        try:
            system.pipe(objects)
        except FileNotFoundError:  # a store with real folders
            for parent in {name.rpartition("/")[0] for name in objects}:
                system.makedirs(parent, exist_ok=True)
            system.pipe(objects)


def write_marked(folder: RemotePath, files: Mapping[str, bytes], overwrite: bool) -> None:
    """`files` below `folder`, their mark last; what fails is removed. Raises OutputError.

    What a broken attempt left is written over. A folder with a mark is refused unless `overwrite`, one with files of
    other names and no mark always.
    """
    there = set(folder.files())
    if MARK in there and not overwrite:
        raise OutputError(f"{folder}: is there already; choose another name, or overwrite it (--overwrite)")
    if MARK not in there and there - set(files):
        raise OutputError(f"{folder}: is there and is no sample, so it is not overwritten; choose another name")
    remove_objects(folder, [name for name in (MARK, *sorted(there - set(files))) if name in there])
    with removed_on_failure(folder, files):
        write_objects(folder, {name: data for name, data in files.items() if name != MARK})
        write_objects(folder, {name: data for name, data in files.items() if name == MARK})


def remove_objects(folder: RemotePath, names: Iterable[str]) -> None:
    """Remove the files below `folder` that are there, one after the other in that order. Raises OutputError."""
    with _told(folder, OutputError, "removed"):
        system, path = folder._system()
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                system.rm_file(f"{path.rstrip('/')}/{name}")


@contextlib.contextmanager
def removed_on_failure(folder: RemotePath, names: Iterable[str]) -> Iterator[None]:
    """Remove the files `names` below `folder` that are there when what is done within fails."""
    try:
        yield
    except BaseException:
        for name in names:
            with contextlib.suppress(OutputError):
                remove_objects(folder, [name])
        raise


@contextlib.contextmanager
def _told(where: RemotePath, kind: type[TwinlensError], what: str) -> Iterator[None]:
    """Stores answer with whatever their client libraries raise: `kind` for each, but for what is missing."""
    try:
        yield
    except (TwinlensError, FileNotFoundError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise kind(f"{where}: cannot be {what} ({reason})") from error
