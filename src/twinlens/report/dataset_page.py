"""A dataset as a page: thumbnails, histograms of recorded values, and the channels of a sample on a click.

    DIR/index.html                the page, with all values; needs no network and no server
    DIR/thumbnails/NAME.webp      left images, 160 pixels wide
    DIR/channels/NAME.webp        images and maps of a sample side by side, each 320 pixels wide

The browser loads only the pictures that are in sight, so that the page stays quick with many samples. The same call
resumes: pictures of samples that have not changed stay.
"""

import hashlib
import html
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinlens.dataset import Dataset, StoredSample
from twinlens.dataset.files import files_below, read_bytes, write_file
from twinlens.dataset.metadata import about
from twinlens.dataset.storage import RemotePath
from twinlens.dataset.stored import ReadOnce
from twinlens.errors import FileError, InputError
from twinlens.machine import processor_count
from twinlens.report.page import fill_page
from twinlens.report.sample_pictures import (
    encode_webp,
    strip,
    thumbnail,
    tiles_of,
)
from twinlens.scoring.board import Recorded
from twinlens.scoring.conditions import sample_values

THUMBNAILS, CHANNELS = "thumbnails", "channels"
INDEX = "pictures.json"
"""For which files the pictures were made, so that a later run keeps those that are right."""
_OWNER = {"": ["twinlens browse", []]}
"""What the index of a page has besides samples, whose names are not empty: other programs may have such files too."""
_MARK = '<meta name="generator" content="twinlens browse">'
_BATCH = 64
"""Samples whose pictures are made before the next ones are begun."""
_DIGITS = 6

Report = Callable[[float, str], None]


@dataclass
class Shown:
    """What the page says of a sample: its name, its values, and its tiles as (title, span, file of the sample).

    problem : why it has no pictures. digest : of the files that the pictures were made from.
    """

    name: str
    digest: str
    values: dict[str, Recorded] = field(default_factory=dict)
    tiles: list[tuple[str, str, str]] = field(default_factory=list)
    problem: str = ""


def write_dataset_page(
    dataset: Dataset, folder: Path, report: Report = lambda fraction, name: None
) -> list[Shown]:
    """Write the page of a dataset to `folder`; what it shows. Samples that cannot be read are on it with the reason.

    Raises OutputError.
    """
    earlier = _earlier(folder) | _OWNER
    # First, so that a later run knows the folder again if this one is interrupted.
    write_file(folder / INDEX, json.dumps(earlier).encode())
    shown: list[Shown] = []
    samples = [*dataset]
    try:
        with ThreadPoolExecutor(processor_count()) as pool:
            for start in range(0, len(samples), _BATCH):
                batch = samples[start : start + _BATCH]
                report(start / len(samples), batch[0].name)
                shown += pool.map(lambda sample: _show(sample, folder, earlier), batch)
    finally:
        made = {sample.name: [sample.digest, sample.tiles] for sample in shown}
        write_file(folder / INDEX, json.dumps(earlier | made).encode())
    _remove_others(folder, {f"{sample.name}.webp" for sample in shown})
    write_file(folder / "index.html", _page(dataset, folder, shown).encode())
    return shown


def is_page(folder: Path) -> bool:
    """Whether the folder holds such a page, complete or not."""
    return _OWNER.items() <= _earlier(folder).items()


def _earlier(folder: Path) -> dict[str, Any]:
    """The index of an earlier run; empty if there is none, or if it is damaged."""
    try:
        index = json.loads(read_bytes(folder / INDEX))
    except (FileError, ValueError):
        return {}
    return index if isinstance(index, dict) else {}


def _digest(sample: StoredSample) -> str:
    """A digest of the sample's files by dataset.json; empty without one."""
    files = sample.row.get("files")
    return hashlib.sha256(json.dumps(files).encode()).hexdigest() if files else ""


def _show(sample: StoredSample, folder: Path, earlier: dict[str, Any]) -> Shown:
    """Read the values of a sample, and write its pictures unless an earlier run has made them."""
    once = ReadOnce.of(sample)
    shown = Shown(sample.name, _digest(sample))
    small, large = (
        folder / kind / f"{sample.name}.webp" for kind in (THUMBNAILS, CHANNELS)
    )
    try:
        shown.values = sample_values(once)
        digest, tiles = earlier.get(sample.name, ("", []))
        if digest and digest == shown.digest and small.is_file() and large.is_file():
            shown.tiles = [tuple(tile) for tile in tiles]
            return shown
        pictures = tiles_of(once)
        write_file(small, encode_webp(thumbnail(pictures[0].pixels)), flush=False)
        write_file(large, encode_webp(strip(pictures)), flush=False)
        shown.tiles = [(tile.title, tile.span, tile.file) for tile in pictures]
    except InputError as error:
        shown.problem = str(error).removeprefix(f"{sample.folder}/")
    return shown


def _remove_others(folder: Path, names: set[str]) -> None:
    """Remove the pictures of samples that are not in the dataset any more."""
    for kind in (THUMBNAILS, CHANNELS):
        for name in files_below(folder / kind) if (folder / kind).is_dir() else ():
            if name not in names:
                (folder / kind / name).unlink()


def _page(dataset: Dataset, folder: Path, shown: Sequence[Shown]) -> str:
    """The page as text."""
    texts, _ = about(dataset)
    title = texts.name or dataset.path.resolve().name
    document = {
        "title": title,
        "about": {
            "description": texts.description,
            "licence": texts.license,
            "creator": texts.creator,
        },
        "names": [sample.name for sample in shown],
        "problems": {sample.name: sample.problem for sample in shown if sample.problem},
        "columns": [*_columns(shown)],
        "tiles": _tile_tables(shown),
        "root": _root(dataset, folder),
    }
    parts = {"title": html.escape(title), "mark": _MARK}
    styles = ["page.css", "dataset.css"]
    return fill_page(
        "dataset.html", parts, styles, ["dataset.js"], document, "'self' file:"
    )


def _root(dataset: Dataset, folder: Path) -> str:
    """The dataset's folder as seen from the page, to open files of samples; empty in a bucket."""
    if isinstance(dataset.path, RemotePath):
        return ""
    return Path(os.path.relpath(dataset.path.resolve(), folder.resolve())).as_posix()


def _columns(shown: Sequence[Shown]) -> Iterator[dict[str, Any]]:
    """The recorded values, one list a name, null where a sample has none; numbers with six digits."""
    names = dict.fromkeys(name for sample in shown for name in sample.values)
    for name in names:
        values = [sample.values.get(name) for sample in shown]
        is_number = all(not isinstance(value, str) for value in values)
        if is_number:
            values = [_rounded(value) for value in values]
        yield {"name": name, "number": is_number, "values": values}


def _rounded(value: Any) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{_DIGITS}g}")


def _tile_tables(shown: Sequence[Shown]) -> dict[str, Any]:
    """The tiles of every sample: lists of titles and files that samples share, and the span of each tile."""
    kinds: dict[tuple[tuple[str, str], ...], int] = {}
    of_sample, spans = [], []
    for sample in shown:
        kind = tuple((title, file) for title, _, file in sample.tiles)
        of_sample.append(kinds.setdefault(kind, len(kinds)))
        spans.append([span for _, span, _ in sample.tiles])
    return {"kinds": list(kinds), "of": of_sample, "spans": spans}
