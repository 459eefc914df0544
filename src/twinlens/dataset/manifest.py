"""dataset.json: what a dataset was made from, and the checksum of every file in it."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import twinlens
from twinlens.dataset.files import files_below, is_hidden, read_bytes, write_pieces
from twinlens.dataset.record import decode_json, encode_json_listing, plain, relative_name
from twinlens.dataset.storage import Where, place
from twinlens.errors import FileError

KIND, VERSION, NAME = "twinlens-dataset", 1, "dataset.json"


@dataclass(frozen=True)
class Row:
    """One sample: its name (the folder's, with / where nested), the SHA-256 of each file, and plain data about it."""

    name: str
    files: Mapping[str, str]
    info: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """A dataset's manifest: the recipe and seed it follows, its rows in order, and plain data (versions, counts)."""

    rows: Sequence[Row]
    recipe: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


def write_manifest(folder: Where, manifest: Manifest) -> None:
    """Write `folder`/dataset.json, whole or not at all. The same manifest gives the same bytes. Raises OutputError."""
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
    """The manifest in `folder`. Raises FileError naming the row that is not right."""
    path = place(folder) / NAME
    return decode_manifest(read_bytes(path), str(path))


def decode_manifest(data: bytes, path: str = NAME) -> Manifest:
    """The manifest in the bytes of a dataset.json. Raises FileError beginning with `path`."""
    record = decode_json(data, path, KIND, VERSION)
    samples, recipe, seed, info = (record.get(key) for key in ("samples", "recipe", "seed", "info"))
    if not isinstance(samples, list) or not isinstance(recipe, dict) or not isinstance(info, dict):
        raise FileError(f'{path}: needs "samples" (a list), "recipe" and "info" (objects)')
    if seed is not None and not isinstance(seed, int):
        raise FileError(f'{path}: "seed" must be a whole number or null')
    rows = tuple(_row(entry, f"{path}: samples[{i}]") for i, entry in enumerate(samples))
    names = [row.name for row in rows]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FileError(f"{path}: names the sample {twice!r} twice")
    return Manifest(rows, recipe, seed, info)


def row_of(dataset: Where, name: str, info: Mapping[str, Any] | None = None) -> Row:
    """The row of a sample that lies in `dataset`/`name`, its files hashed as they are now. Raises FileError."""
    return Row(name, checksums(place(dataset) / name), info or {})


def checksums(folder: Where) -> dict[str, str]:
    """SHA-256 of every file below `folder`, relative name with / -> hexadecimal, in the order of the names."""
    folder = place(folder)
    if not folder.is_dir():
        raise FileError(f"{folder}: no such folder")
    kept = [name for name in files_below(folder) if not any(is_hidden(part) for part in name.split("/"))]
    return {name: hashlib.sha256(read_bytes(folder / name)).hexdigest() for name in kept}


def _row(entry: Any, where: str) -> Row:
    if not isinstance(entry, dict) or not isinstance(entry.get("files"), dict):
        raise FileError(f'{where}: needs "name" and "files"')
    name = relative_name(entry.get("name"), where)
    files = {relative_name(file, where): digest for file, digest in entry["files"].items()}
    info = entry.get("info", {})
    if not all(isinstance(digest, str) for digest in files.values()) or not isinstance(info, dict):
        raise FileError(f'{where}: "files" must map names to SHA-256 texts, and "info" be an object')
    return Row(name, files, info)
