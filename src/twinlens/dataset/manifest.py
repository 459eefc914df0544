"""dataset.json: how a dataset was made, and the SHA-256 of every file in it; and the rows of samples not yet listed.

`twinlens generate` writes the row of a sample to DIR/.rows/NAME.json as soon as its folder appears, and moves the rows
to dataset.json later. Until then the samples are pending, as those of parallel shards and of interrupted runs are.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import pydantic

import twinlens
from twinlens.dataset.files import check_relative, files_below, is_hidden, read_bytes, write_file
from twinlens.dataset.record import FileModel, decode_json, encode_json, read, read_json, read_part
from twinlens.dataset.storage import Place, Where, is_whole, place
from twinlens.errors import FileError, InputError

KIND, VERSION, NAME = "twinlens-dataset", 1, "dataset.json"
ROW_KIND, ROW_VERSION, ROWS = "twinlens-row", 1, ".rows"

RelativeName = Annotated[str, pydantic.AfterValidator(check_relative)]


@dataclass(frozen=True)
class Row:
    """One sample: its folder (with / if nested), its files, and plain data, such as the split."""

    __pydantic_config__ = pydantic.ConfigDict(strict=False)  # so that a mapping is read

    name: RelativeName
    files: Mapping[RelativeName, Annotated[str, pydantic.Field(description="SHA-256, hexadecimal")]]
    info: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """The content of a dataset.json: rows in order, recipe, seed, and plain data (versions, counts)."""

    rows: Sequence[Row]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


class DatasetFile(FileModel):
    """dataset.json."""

    format: Literal["twinlens-dataset"]
    version: Literal[1]
    twinlens: str = pydantic.Field(default="", description="version that wrote the file")
    seed: int | None = None
    recipe: dict[str, Any]
    info: dict[str, Any]
    samples: list[Row]

    @pydantic.field_validator("samples")
    @classmethod
    def _check_unique(cls, samples: list[Row]) -> list[Row]:
        twice = [name for name, count in Counter(row.name for row in samples).items() if count > 1]
        if twice:
            raise InputError(f"lists the sample {twice[0]!r} twice")
        return samples


_ROW = pydantic.TypeAdapter(Row)


def write_manifest(folder: Where, manifest: Manifest) -> None:
    """Write `folder`/dataset.json atomically. The same manifest gives the same bytes. Raises OutputError."""
    record: dict[str, Any] = {"format": KIND, "version": VERSION, "twinlens": twinlens.__version__}
    record |= {"seed": manifest.seed, "recipe": manifest.recipe, "info": manifest.info}
    record["samples"] = [{"name": row.name, "files": row.files, "info": row.info} for row in manifest.rows]
    write_file(place(folder) / NAME, encode_json(record))


def read_manifest(folder: Where) -> Manifest:
    """Read `folder`/dataset.json. Raises FileError: file, key, what is allowed."""
    path = place(folder) / NAME
    file = read(DatasetFile, read_json(path, KIND, VERSION), path)
    return Manifest(tuple(file.samples), file.recipe, file.seed, file.info)


def row_of(dataset: Where, name: str, info: Mapping[str, Any] | None = None) -> Row:
    """The row of the sample `dataset`/`name`, with its files hashed now. Raises FileError."""
    return Row(name, hash_files(place(dataset) / name), info or {})


def hash_files(folder: Where) -> dict[str, str]:
    """SHA-256 of every file below `folder`, relative name with / -> hexadecimal, sorted by name. Raises FileError."""
    folder = place(folder)
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    names = [name for name in files_below(folder) if not is_hidden(name)]
    return {name: hashlib.sha256(read_bytes(folder / name)).hexdigest() for name in names}


def pending_rows(folder: Place, listed: Collection[str]) -> tuple[dict[str, Row | None], dict[str, str]]:
    """The pending samples of `folder`: name -> row, None where it cannot be read; and name -> what is wrong with it.

    `listed` are the names in dataset.json. `twinlens generate` makes an unreadable row again from the sample's files.
    """
    rows: dict[str, Row | None] = {}
    errors: dict[str, str] = {}
    files = files_below(folder / ROWS) if (folder / ROWS).is_dir() else []
    for name in [file.removesuffix(".json") for file in files if file.endswith(".json") and "/" not in file]:
        path = f"{ROWS}/{name}.json"
        try:
            if name in listed or not is_whole(folder / check_relative(name)):
                continue  # a sample that failed has a row too, and no folder
            rows[name] = None
            record = decode_json(read_bytes(folder / path), path, ROW_KIND, ROW_VERSION)
            rows[name] = replace(read_part(_ROW, record, "row", path), name=name)
        except FileError as error:
            if (folder / path).exists():  # else it has been moved to dataset.json meanwhile
                message = str(error).removeprefix(f"{folder}/")
                errors[name] = f"{message}; the next `twinlens generate` makes it again, from the sample's files"
        except InputError as error:
            errors[name] = f"{path}: {error}"
    return rows, errors
