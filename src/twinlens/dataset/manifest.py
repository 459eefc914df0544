"""dataset.json: how a dataset was made, and the SHA-256 of every file in it; and the rows of samples not yet listed.

`twinlens generate` writes the row of a sample to DIR/.rows/NAME.json as soon as its folder appears, and moves the rows
to dataset.json later. Until then the samples are pending, as those of parallel shards and of interrupted runs are.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import pydantic

import twinlens
from twinlens.dataset.files import check_relative, files_below, is_hidden, read_bytes, write_pieces
from twinlens.dataset.record import FileModel, decode_json, encode_json_listing, plain, read
from twinlens.dataset.storage import Place, Where, is_whole, place
from twinlens.errors import FileError, InputError

KIND, VERSION, NAME = "twinlens-dataset", 1, "dataset.json"
ROW_KIND, ROW_VERSION, ROWS = "twinlens-row", 1, ".rows"

RelativeName = Annotated[str, pydantic.AfterValidator(check_relative)]


@dataclass(frozen=True)
class Row:
    """One sample.

    Parameters
    ----------
    name : str
        The folder, with / if nested.
    files : mapping
        Relative name -> SHA-256, hexadecimal.
    info : mapping
        Plain data, such as the split.
    """

    name: str
    files: Mapping[str, str]
    info: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """The content of a dataset.json: rows in order, recipe, seed, and plain data (versions, counts)."""

    rows: Sequence[Row]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


class RowEntry(FileModel):
    """A row in a file."""

    name: RelativeName
    files: dict[RelativeName, str] = pydantic.Field(description="relative name -> SHA-256, hexadecimal")
    info: dict[str, Any] = pydantic.Field(default={})


class DatasetFile(FileModel):
    """dataset.json."""

    format: Literal["twinlens-dataset"]
    version: Literal[1]
    twinlens: str = pydantic.Field(default="", description="version that wrote the file")
    seed: int | None = None
    recipe: dict[str, Any]
    info: dict[str, Any]
    samples: list[RowEntry]

    @pydantic.field_validator("samples")
    @classmethod
    def _check_unique(cls, samples: list[RowEntry]) -> list[RowEntry]:
        twice = [name for name, count in Counter(row.name for row in samples).items() if count > 1]
        if twice:
            raise InputError(f"lists the sample {twice[0]!r} twice")
        return samples


class RowFile(FileModel):
    """.rows/NAME.json of a sample that was made."""

    row: RowEntry


def write_manifest(folder: Where, manifest: Manifest) -> None:
    """Write `folder`/dataset.json atomically. The same manifest gives the same bytes. Raises OutputError."""
    record = {
        "format": KIND,
        "version": VERSION,
        "twinlens": twinlens.__version__,
        "seed": manifest.seed,
        "recipe": plain(manifest.recipe),
        "info": plain(manifest.info),
    }
    rows = ({"name": row.name, "files": row.files, "info": row.info} for row in manifest.rows)
    write_pieces(place(folder) / NAME, encode_json_listing(record, "samples", rows))


def read_manifest(folder: Where) -> Manifest:
    """Read `folder`/dataset.json. Raises FileError: file, key, what is allowed."""
    path = place(folder) / NAME
    file = read(DatasetFile, decode_json(read_bytes(path), str(path), KIND, VERSION), path)
    rows = tuple(Row(row.name, row.files, row.info) for row in file.samples)
    return Manifest(rows, file.recipe, file.seed, file.info)


def row_of(dataset: Where, name: str, info: Mapping[str, Any] | None = None) -> Row:
    """The row of the sample `dataset`/`name`, with its files hashed now. Raises FileError."""
    return Row(name, hash_files(place(dataset) / name), info or {})


def hash_files(folder: Where) -> dict[str, str]:
    """SHA-256 of every file below `folder`, relative name with / -> hexadecimal, sorted by name. Raises FileError."""
    folder = place(folder)
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    names = [name for name in files_below(folder) if not any(is_hidden(part) for part in name.split("/"))]
    return {name: hashlib.sha256(read_bytes(folder / name)).hexdigest() for name in names}


def pending_rows(folder: Place, listed: Collection[str]) -> tuple[dict[str, Row | None], dict[str, str]]:
    """The pending samples of `folder`: name -> row, None where it cannot be read; and name -> what is wrong with it.

    `listed` are the names in dataset.json. `twinlens generate` makes an unreadable row again from the sample's files.
    """
    rows: dict[str, Row | None] = {}
    errors: dict[str, str] = {}
    directory = folder / ROWS
    files = files_below(directory) if directory.is_dir() else []
    for name in [file.removesuffix(".json") for file in files if file.endswith(".json") and "/" not in file]:
        path = f"{ROWS}/{name}.json"
        try:
            if name in listed or not is_whole(folder / check_relative(name)):
                continue  # a sample that failed has a row too, and no folder
        except InputError as error:
            errors[name] = f"{path}: {error}"
            continue
        try:
            rows[name] = _read_row(folder, name, path)
        except FileError as error:
            rows[name] = None
            message = str(error).removeprefix(f"{folder}/")
            errors[name] = f"{message}; the next `twinlens generate` makes it again, from the sample's files"
    return rows, errors


def _read_row(folder: Place, name: str, path: str) -> Row | None:
    """The row in `folder`/`path`; None if it has been moved to dataset.json meanwhile."""
    try:
        data = read_bytes(folder / path)
    except FileError:
        if (folder / path).exists():
            raise
        return None
    row = read(RowFile, decode_json(data, path, ROW_KIND, ROW_VERSION), path).row
    return Row(name, row.files, row.info)
