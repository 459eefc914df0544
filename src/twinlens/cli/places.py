"""Paths and addresses as arguments of commands, and checks of output folders before any work is done."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from twinlens.dataset import Place, RemotePath, place, read_manifest
from twinlens.dataset.files import (
    A_FILE,
    check_replaceable,
    existing_part,
    remove_abandoned,
)
from twinlens.errors import InputError, OutputError, format_value


class PlaceType(click.ParamType):  # type: ignore[type-arg]
    """A path on this machine, also as file://..., never empty. Whether it exists is checked when it is used.

    remote : an address such as s3://bucket/set is allowed too. suffixes : what the name must end in.
    """

    def __init__(self, remote: bool = False, suffixes: Sequence[str] = ()) -> None:
        self.remote, self.name, self.suffixes = (
            remote,
            "path or address" if remote else "path",
            suffixes,
        )

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Place:
        if value == "":
            self.fail("the name is empty; is a shell variable unset?", param, ctx)
        location = place(value)
        if isinstance(location, RemotePath) and not self.remote:
            self.fail(
                f"{value!r} is a bucket's address; only a path on this machine is supported here",
                param,
                ctx,
            )
        if isinstance(location, Path) and any(
            len(os.fsencode(part)) > 255 for part in location.parts
        ):
            self.fail(
                f"{format_value(value)} has a name of more than 255 bytes", param, ctx
            )
        if self.suffixes and not str(location).lower().endswith(tuple(self.suffixes)):
            self.fail(f"{value!r} must end in {' or '.join(self.suffixes)}", param, ctx)
        return location

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return [CompletionItem(incomplete, type="file")]


_EXISTS = "exists already; choose another name, or add --overwrite"
PATH, PLACE = PlaceType(), PlaceType(remote=True)
PNG_FILE = PlaceType(suffixes=(".png",))
FIGURE_FILE = PlaceType(suffixes=(".png", ".svg"))
TOML_FILE = PlaceType(suffixes=(".toml",))
HTML_FILE = PlaceType(suffixes=(".html", ".htm"))


def missing_output() -> click.MissingParameter:
    """The error of click for a missing -o, for commands that need it in some cases only."""
    context = click.get_current_context()
    option = next(
        option for option in context.command.params if option.name == "output"
    )
    return click.MissingParameter(ctx=context, param=option)


def check_new(
    output: Place, overwrite: bool, mark: str = "sample.json", kind: str = "a sample"
) -> None:
    """Raise OutputError where the output exists, unless it may be overwritten: an empty folder, or one with `mark`.

    Whether a bucket has files of other kinds is checked when it is written. What killed commands left beside the output
    is removed, or put back.
    """
    # First, because it may put back the output itself.
    remove_abandoned(output.parent)
    if not overwrite and (
        os.path.lexists(output) if isinstance(output, Path) else output.exists()
    ):
        raise OutputError(f"{output}: {_EXISTS}")
    check_replaceable(
        output, not isinstance(output, Path) or (output / mark).is_file(), kind
    )


def check_results(folder: Path, mark: str, overwrite: bool = True) -> None:
    """Raise OutputError for a folder that cannot be created, and for one with files but without the file `mark`.

    A folder with that file is refused too unless `overwrite` is set.
    """
    if not overwrite and (folder / mark).exists():
        raise OutputError(f"{folder}: {_EXISTS}")
    check_creatable(folder)
    refuse_others(folder, (), mark)


def check_samples(output: Place, names: Sequence[str], overwrite: bool) -> None:
    """Check that samples of these names can be written to the dataset `output`.

    The folder must be new, empty, or have a dataset.json. The folders of these samples are allowed without one: an
    earlier run may have been stopped before it wrote the list.

    Raises InputError for a repeated name, FileError for a damaged dataset.json, OutputError.
    """
    info = read_manifest(output).info if (output / "dataset.json").exists() else {}
    for key, command in (("made_with", "generate"), ("subset", "subset")):
        if key in info:
            raise OutputError(
                f"{output}: is a dataset of `twinlens {command}`; choose another folder"
            )
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two scenes are named {name!r}; a sample's folder is named after its scene"
            )
    if isinstance(output, Path):
        check_creatable(output)
    for name in names:
        check_new(output / name, overwrite)
    refuse_others(output, names, "dataset.json")


def refuse_others(folder: Place, names: Sequence[str], mark: str) -> None:
    """Raise OutputError if a folder without `mark` has files other than `names` and hidden ones."""
    present = (
        sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
    )
    for name in () if mark in present else present:
        if not name.startswith(".") and name not in names:
            raise OutputError(
                f"{folder}: contains {name!r} and no {mark}; choose a new or an empty folder"
            )


def check_creatable(folder: Path) -> None:
    """Raise OutputError for a folder that cannot be created."""
    existing = existing_part(folder)
    if not existing.is_dir():
        raise OutputError(f"{existing}: {A_FILE}")
    if existing != folder and not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(
            f"{folder}: cannot be created; no permission to write to {existing.absolute()}"
        )
