"""Paths and addresses as arguments of commands, and checks of output folders before any work is done."""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.errors import InputError, OutputError

if TYPE_CHECKING:
    from twinlens.dataset import Manifest, Place


class AddressType(click.ParamType):  # type: ignore[type-arg]
    """A path or an address such as s3://bucket/set, as text; never empty."""

    name = "path or address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The text."""
        return _not_empty(value, self, param, ctx)


class PlaceType(AddressType):
    """A path or an address, as a Path or a RemotePath; whether it exists is checked when it is used."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> "Place":
        """The Path or RemotePath."""
        from twinlens.dataset import place

        return place(super().convert(value, param, ctx))


class PathType(click.Path):
    """A path on this machine, also as file://...; neither empty, which would be the current folder, nor a bucket."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The Path."""
        from twinlens.dataset import RemotePath, place

        text = os.fspath(_not_empty(value, self, param, ctx))
        if "://" in text:
            found = place(text)
            if isinstance(found, RemotePath):
                self.fail(f"{text!r} is a bucket's address; only a path on this machine is supported here", param, ctx)
            text = str(found)
        return super().convert(text, param, ctx)


PLACE, PATH, ADDRESS = PlaceType(), PathType(path_type=Path), AddressType()


def _not_empty(value: Any, kind: click.ParamType, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # type: ignore[type-arg]
    if value == "":
        kind.fail("the name is empty; is a shell variable unset?", param, ctx)
    return value


def missing_output() -> click.MissingParameter:
    """The error of click for a missing -o, for commands that need it in some cases only."""
    context = click.get_current_context()
    option = next(option for option in context.command.params if option.name == "output")
    return click.MissingParameter(ctx=context, param=option)


def check_free(output: Path, overwrite: bool) -> None:
    """Raise OutputError where the output exists, unless it is to be overwritten."""
    if not overwrite and os.path.lexists(output):
        raise OutputError(f"{output}: exists already; choose another name, or add --overwrite")


def check_results(folder: Path, mark: str) -> None:
    """Raise OutputError for a folder that cannot be created, and for one with files but without the file `mark`."""
    _check_creatable(folder)
    if folder.is_dir() and not (folder / mark).is_file():
        _refuse_others(folder, _entries(folder), mark)


def check_samples(output: "Place", names: Sequence[str], overwrite: bool) -> None:
    """Check that samples of these names can be written to the dataset `output`.

    The folder must be new, empty, or have a dataset.json. The folders of these samples are allowed without one: an
    earlier run may have been stopped before it wrote the list.

    Raises InputError for a repeated name, FileError for a damaged dataset.json, OutputError.
    """
    known = manifest_of(output)
    if known is not None and "made_with" in known.info:
        raise OutputError(f"{output}: is a dataset of `twinlens generate`; choose another folder")
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"two scenes are named {double!r}; a sample's folder is named after its scene")
    if isinstance(output, Path):
        _check_creatable(output)
    existing = next((name for name in names if (output / name).exists()), None)
    if existing is not None and not overwrite:
        raise OutputError(f"{output / existing}: exists already; choose another folder, or add --overwrite")
    for name in names:
        check_replaceable(output / name)
    if known is None and output.is_dir():
        _refuse_others(output, [entry for entry in _entries(output) if entry not in names], "dataset.json")


def check_replaceable(folder: "Place", mark: str = "sample.json", kind: str = "sample") -> None:
    """Raise OutputError for what must not be overwritten: a file, or a folder with files but without the file `mark`.

    Addresses of buckets are not checked.
    """
    if not isinstance(folder, Path) or not os.path.lexists(folder) or (folder / mark).is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise OutputError(f"{folder}: exists and is not a {kind}, so it is not overwritten; choose another name")


def manifest_of(output: "Place") -> "Manifest | None":
    """The content of dataset.json, None without one. Raises FileError where it is damaged."""
    from twinlens.dataset import read_manifest

    return read_manifest(output) if (output / "dataset.json").exists() else None


def _entries(folder: "Place") -> list[str]:
    return sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))


def _refuse_others(folder: "Place", entries: Sequence[str], mark: str) -> None:
    if entries:
        raise OutputError(f"{folder}: contains {entries[0]!r} and no {mark}; choose a new or an empty folder")


def _check_creatable(folder: Path) -> None:
    """Raise OutputError for a folder that cannot be created; it is created and removed again, with its parents."""
    if folder.is_dir():
        return
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        taken = isinstance(error, (FileExistsError, NotADirectoryError))
        why = "a file exists where a folder is needed" if taken else f"cannot be created; {error.strerror}"
        raise OutputError(f"{folder}: {why}") from error
    finally:
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()
