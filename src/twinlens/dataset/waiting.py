"""Samples that are made and wait to be listed in dataset.json, as shards and runs that were stopped leave them.

Beside them lies a row for each, DIR/.rows/NAME.json, which the next `twinlens generate` takes over into dataset.json.
"""

from collections.abc import Collection

from twinlens.dataset.files import files_below, read_bytes
from twinlens.dataset.record import decode_json
from twinlens.dataset.storage import Place, is_whole
from twinlens.dataset.stored import StoredSample
from twinlens.errors import FileError

ROWS = ".rows"
ROW_KIND, ROW_VERSION = "twinlens-row", 1


def waiting_samples(folder: Place, listed: Collection[str]) -> tuple[StoredSample, ...]:
    """Those with a row in `folder`, by name; `listed` are the names in dataset.json, which do not wait any more.

    A row that cannot be read leaves its sample without one: `generate` makes it from the sample's files again.
    """
    rows = folder / ROWS
    if not rows.is_dir():
        return ()
    names = [file.removesuffix(".json") for file in files_below(rows) if file.endswith(".json") and "/" not in file]
    # What could not be made has a row too, and no folder.
    waiting = [name for name in names if name not in listed and is_whole(folder / name)]
    return tuple(StoredSample(folder / name, name, _row(rows / f"{name}.json")) for name in waiting)


def _row(path: Place) -> dict[str, object]:
    """The files and their SHA-256s; empty where it cannot be read."""
    try:
        row = decode_json(read_bytes(path), str(path), ROW_KIND, ROW_VERSION).get("row")
    except FileError:
        return {}
    return {"files": row["files"]} if isinstance(row, dict) and isinstance(row.get("files"), dict) else {}
