"""Samples that are made and wait to be listed in dataset.json, as shards and runs that were stopped leave them.

Beside them lies a row for each, DIR/.rows/NAME.json, which the next `twinlens generate` takes over into dataset.json.
"""

from collections.abc import Collection
from typing import Any

from twinlens.dataset.files import files_below, read_bytes
from twinlens.dataset.record import decode_json, relative_name
from twinlens.dataset.storage import Place, is_whole
from twinlens.dataset.stored import StoredSample
from twinlens.errors import FileError

ROWS = ".rows"
ROW_KIND, ROW_VERSION = "twinlens-row", 1


def waiting_samples(folder: Place, listed: Collection[str]) -> tuple[StoredSample, ...]:
    """Those with a row in `folder`, by name; `listed` are the names in dataset.json, which do not wait any more.

    A row that cannot be read leaves its sample without one: `generate` makes it from the sample's files again.
    """
    return tuple(kept_rows(folder, listed)[0])


def kept_rows(folder: Place, listed: Collection[str]) -> tuple[list[StoredSample], dict[str, str]]:
    """`waiting_samples`, and by name what is wrong with a row that cannot be read, in a line."""
    samples: list[StoredSample] = []
    unread: dict[str, str] = {}
    for name in _names(folder / ROWS):
        path, made, row = f"{ROWS}/{name}.json", False, {}
        try:
            # What could not be made has a row too, and no folder.
            made = name not in listed and is_whole(folder / relative_name(name, path))
            row = _row(folder, path) if made else {}
        except FileError as error:
            remedy = "; the next `twinlens generate` makes it again, from the sample's files" if made else ""
            unread[name] = str(error).removeprefix(f"{folder}/") + remedy
        if made:
            samples.append(StoredSample(folder / name, name, row))
    return samples, unread


def is_of_recipe(name: str, count: Any) -> bool:
    """Whether a folder is named as `twinlens generate` names one of the `count` samples of a recipe.

    >>> is_of_recipe("0000004", 5), is_of_recipe("0000005", 5), is_of_recipe("4", 5)
    (True, False, False)
    """
    return isinstance(count, int) and name.isdecimal() and int(name) < count and name == f"{int(name):07d}"


def _names(rows: Place) -> list[str]:
    files = files_below(rows) if rows.is_dir() else []
    return [file.removesuffix(".json") for file in files if file.endswith(".json") and "/" not in file]


def _row(folder: Place, path: str) -> dict[str, object]:
    """The files and their SHA-256s, and where these stand; empty where the row was taken over meanwhile."""
    try:
        data = read_bytes(folder / path)
    except FileError:
        if (folder / path).exists():
            raise
        return {}
    row = decode_json(data, path, ROW_KIND, ROW_VERSION).get("row")
    files = row.get("files") if isinstance(row, dict) else None
    if not isinstance(files, dict) or not all(isinstance(digest, str) for digest in files.values()):
        raise FileError(f'{path}: needs a "row" with "files" that map names to SHA-256 texts')
    return {"files": {relative_name(file, path): digest for file, digest in files.items()}, "stands_in": path}
