"""Where something lies, as a command's argument: a path, or a bucket's address. An empty one is always a mistake."""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.errors import InputError, OutputError

if TYPE_CHECKING:
    from twinlens.dataset import Manifest, Place


class PlaceType(click.ParamType):  # type: ignore[type-arg]
    """A path, or an address such as s3://bucket/set; what is wrong with it is found when it is used."""

    name = "path or address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> "Place":
        """The Path or RemotePath."""
        from twinlens.dataset import place

        return place(_filled(value, self, param, ctx))


class PathType(click.Path):
    """A path of this machine, also as file://...; none is empty, which would be the current folder, nor a bucket's."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The Path."""
        return super().convert(_local(_filled(value, self, param, ctx), self, param, ctx), param, ctx)


class AddressType(click.ParamType):  # type: ignore[type-arg]
    """A path or an address, as text; never an empty one."""

    name = "path or address"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The text."""
        return str(_filled(value, self, param, ctx))


PLACE, PATH, ADDRESS = PlaceType(), PathType(path_type=Path), AddressType()


def missing_output() -> click.MissingParameter:
    """The refusal of a command that needs its -o now, as click's own where it is always needed."""
    context = click.get_current_context()
    option = next(option for option in context.command.params if option.name == "output")
    return click.MissingParameter(ctx=context, param=option)


def check_free(output: Path, overwrite: bool) -> None:
    """Refuse a place that is taken, before any work is done. Raises OutputError."""
    if not overwrite and os.path.lexists(output):
        raise OutputError(f"{output}: is there already; choose another name, or add --overwrite")


def check_results(folder: Path, mark: str) -> None:
    """Refuse a folder that cannot be made, or that holds other things than results, before any work is done.

    Results have a file named `mark` among them, and may be written again. Raises OutputError.
    """
    _check_possible(folder)
    if folder.is_dir() and not (folder / mark).is_file():
        _refuse_strangers(folder, _entries(folder), mark)


def check_samples(output: "Place", names: Sequence[str], overwrite: bool) -> None:
    """Refuse a dataset's place where samples of these names cannot come, before any picture is taken.

    The folder is new, empty, or lists its samples. A run that was stopped before it could list its first sample left
    that alone: it may be made again.

    Raises InputError for a name that is there twice, FileError for a damaged list, OutputError.
    """
    known = manifest_of(output)
    if known is not None and "made_with" in known.info:
        raise OutputError(f"{output}: is a dataset that `twinlens generate` makes of its recipe; name another folder")
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"two scenes are named {double!r}; a sample's folder has its scene's name")
    if isinstance(output, Path):
        _check_possible(output)
    there = next((name for name in names if (output / name).exists()), None)
    if there is not None and not overwrite:
        raise OutputError(f"{output / there}: is there already; name another folder, or add --overwrite")
    for name in names:
        check_replaceable(output / name)
    if known is None and output.is_dir():
        _refuse_strangers(output, [entry for entry in _entries(output) if entry not in names], "dataset.json")


def check_replaceable(folder: "Place") -> None:
    """Refuse what would not be overwritten in the end, because it is no sample, before any work. Raises OutputError.

    In a bucket the end tells: a broken attempt there is written over.
    """
    if not isinstance(folder, Path) or not os.path.lexists(folder) or (folder / "sample.json").is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise OutputError(f"{folder}: is there and is no sample, so it is not overwritten; choose another name")


def manifest_of(output: "Place") -> "Manifest | None":
    """What dataset.json says, if there is one; FileError where it is damaged."""
    from twinlens.dataset import read_manifest

    return read_manifest(output) if (output / "dataset.json").exists() else None


def _entries(folder: "Place") -> list[str]:
    return sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))


def _refuse_strangers(folder: "Place", strangers: Sequence[str], mark: str) -> None:
    if strangers:
        raise OutputError(f"{folder}: holds {strangers[0]!r} and no {mark}; name a new folder, or an empty one")


def _check_possible(folder: Path) -> None:
    """Refuse a folder that is not there and cannot be made: it is made for a moment, with those above it."""
    if folder.is_dir():
        return
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        taken = isinstance(error, (FileExistsError, NotADirectoryError))
        why = "a file stands where a folder is needed" if taken else f"cannot be made; {error.strerror}"
        raise OutputError(f"{folder}: {why}") from error
    finally:
        for each in missing:
            with contextlib.suppress(OSError):
                each.rmdir()


def _local(value: Any, kind: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
    """The value, unless it is an address that fsspec opens: as a path it would be a folder named after it."""
    text = os.fspath(value)
    if "://" not in text:
        return value
    from twinlens.dataset import RemotePath, place

    found = place(text)
    if isinstance(found, RemotePath):
        kind.fail(f"{text!r} is a bucket's address, and this works with places of this machine alone", param, ctx)
    return str(found)


def _filled(value: Any, kind: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
    """The value, unless it is empty, as that of a shell's variable that was never set."""
    if value == "":
        kind.fail("the name is empty; is a variable of the shell not set?", param, ctx)
    return value
