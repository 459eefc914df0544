"""Where something lies, as a command's argument: a path, or a bucket's address. An empty one is always a mistake."""

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.errors import OutputError

if TYPE_CHECKING:
    from twinlens.dataset import Place


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


def check_free(output: Path, overwrite: bool) -> None:
    """Refuse a place that is taken, before any work is done. Raises OutputError."""
    if not overwrite and os.path.lexists(output):
        raise OutputError(f"{output}: is there already; choose another name, or add --overwrite")


def check_results(folder: Path, mark: str) -> None:
    """Refuse a folder that cannot be made, or that holds other things than results, before any work is done.

    Results have a file named `mark` among them, and may be written again. Raises OutputError.
    """
    if folder.is_dir():
        strangers = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))
        if strangers and not (folder / mark).is_file():
            raise OutputError(f"{folder}: holds {strangers[0]!r} and no {mark}; name a new folder, or an empty one")
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
