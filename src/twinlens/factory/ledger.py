"""The state of a dataset on disk, from which any run resumes where the last one stopped.

    DIR/dataset.json           the recipe and the samples known when it was last written; the final one does not depend
                               on how often a run was stopped
    DIR/.rows/0000007.json     one sample's row or failure, written right after its folder appears; many processes may
                               write there at the same time. Removed when the dataset is complete
    DIR/.lock                  locked while a run writes there

A sample whose folder exists and whose row does not, because the process was killed in between, gets its row from its
files.
"""

import contextlib
import json
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload

from twinlens.dataset import Manifest, Row, read_manifest, remove_unfinished, row_of, write_manifest
from twinlens.dataset.files import files_below, read_bytes, write_file
from twinlens.dataset.manifest import NAME, ROW_KIND, ROW_VERSION, ROWS
from twinlens.dataset.record import decode_json, encode_json, plain, read_json
from twinlens.dataset.sample import KIND as SAMPLE_KIND
from twinlens.dataset.sample import VERSION as SAMPLE_VERSION
from twinlens.dataset.storage import MARK, Place, RemotePath, remove_objects
from twinlens.errors import FileError, InputError
from twinlens.factory.plan import plan, sample_name
from twinlens.factory.recipe import Recipe, differences
from twinlens.factory.sources import changed_files


@dataclass(frozen=True)
class Failure:
    """A sample all of whose draws were rejected; `remedy` names what to change in the recipe."""

    index: int
    rejections: list[dict[str, Any]]
    remedy: str

    def plain(self) -> dict[str, Any]:
        """The record in dataset.json."""
        return {"index": self.index, "remedy": self.remedy, "rejections": self.rejections}


Entry = Row | Failure
"""The result of one sample."""


class Entries:
    """Entries by sample index, compressed in memory; iterates over the indices in order."""

    def __init__(self) -> None:
        self._made: dict[int, bytes] = {}
        self._failed: dict[int, bytes] = {}

    def __len__(self) -> int:
        return len(self._made) + len(self._failed)

    def __contains__(self, index: int) -> bool:
        return index in self._made or index in self._failed

    def __iter__(self) -> Iterator[int]:
        return iter(sorted((*self._made, *self._failed)))

    def __getitem__(self, index: int) -> Entry:
        return _row(self._made[index]) if index in self._made else _failure(self._failed[index])

    def __setitem__(self, index: int, entry: Entry) -> None:
        self.pop(index)
        if isinstance(entry, Failure):
            self._failed[index] = _packed([entry.index, entry.rejections, entry.remedy])
        else:
            self._made[index] = _packed([entry.name, dict(entry.files), dict(entry.info)])

    def pop(self, index: int) -> None:
        """Remove an entry, if there is one."""
        self._made.pop(index, None)
        self._failed.pop(index, None)

    @property
    def made(self) -> list[int]:
        """The indices of the samples that are made, sorted."""
        return sorted(self._made)

    @property
    def rows(self) -> Sequence[Row]:
        """The samples that are made, in order; each row is decompressed on access."""
        return _Rows([self._made[index] for index in self.made])

    @property
    def failures(self) -> list[Failure]:
        """The failed samples, in order."""
        return [_failure(packed) for _, packed in sorted(self._failed.items())]

    def rejections(self) -> dict[str, int]:
        """The number of rejected draws by reason."""
        counts = Counter(rejected["reason"] for row in self.rows for rejected in row.info.get("rejections", ()))
        counts.update(rejected["reason"] for failure in self.failures for rejected in failure.rejections)
        return dict(sorted(counts.items()))


class _Rows(Sequence[Row]):
    """Compressed rows as a sequence of rows."""

    def __init__(self, packed: list[bytes]) -> None:
        self._packed = packed

    def __len__(self) -> int:
        return len(self._packed)

    @overload
    def __getitem__(self, i: int) -> Row: ...
    @overload
    def __getitem__(self, i: slice) -> Sequence[Row]: ...
    def __getitem__(self, i: int | slice) -> Row | Sequence[Row]:
        return _Rows(self._packed[i]) if isinstance(i, slice) else _row(self._packed[i])


def _packed(values: list[Any]) -> bytes:
    return zlib.compress(json.dumps(values).encode(), 1)


def _row(packed: bytes) -> Row:
    return Row(*json.loads(zlib.decompress(packed)))


def _failure(packed: bytes) -> Failure:
    return Failure(*json.loads(zlib.decompress(packed)))


class Ledger:
    """The entries of the dataset in `folder`.

    Raises InputError if the folder has a dataset of another recipe, of other versions, or of other source files.
    """

    def __init__(self, folder: Place, recipe: Recipe, made_with: Mapping[str, Any]) -> None:
        self.folder, self.recipe = folder, recipe
        self.made_with = plain(made_with)
        self.entries = Entries()
        self.has_file = (folder / NAME).is_file()
        known = read_manifest(folder) if self.has_file else None
        if known is not None and self._has_samples(known):
            self._load(known)
        elif known is None:
            self._refuse_other_files()

    def recover(self) -> None:
        """Add every row and every whole sample that earlier runs left."""
        existing = whole_samples(self.folder)
        for index, name in zip(self.entries.made, [row.name for row in self.entries.rows], strict=True):
            if name not in existing:
                self.entries.pop(index)
        for index, entry in self._pending_rows() if self.has_file else ():  # else the rows may be another recipe's
            if isinstance(entry, Failure) or entry.name in existing:
                self.entries[index] = entry
        known = {sample_name(index) for index in self.entries}
        for name in sorted(existing - known):
            if name.isdecimal() and sample_name(int(name)) == name and int(name) < self.recipe.count:
                self.entries[int(name)] = recovered_row(self.folder, self.recipe, int(name), self.made_with)

    def check_files(self) -> None:
        """Raise FileError where a file that a row lists is missing. `verify` checks their contents."""
        listed = set(self.folder.files()) if isinstance(self.folder, RemotePath) else None
        for row in self.entries.rows:
            if lost := _missing_files(self.folder, row, listed):
                more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
                sample = self.folder / row.name
                raise FileError(f"{sample / lost[0]}: is missing{more}; {repair_hint(sample)}")

    def missing(self) -> list[int]:
        """The indices of the samples that are still to be made."""
        return [index for index in range(self.recipe.count) if index not in self.entries]

    @property
    def is_complete(self) -> bool:
        """Whether every sample is made or failed."""
        return not self.missing()

    def write(self, **info: Any) -> None:
        """Write dataset.json; `info` is added to it."""
        rows = self.entries.rows
        counts = Counter(row.info.get("split") for row in rows)
        splits = {name: counts[name] for name in self.recipe.splits}
        record = {
            "made_with": self.made_with,
            "sources": self.recipe.sources.digests,
            "complete": self.is_complete,
            "rejections": self.entries.rejections(),
            "failed": [failure.plain() for failure in self.entries.failures],
            **({"splits": splits} if splits else {}),
            **info,
        }
        write_manifest(self.folder, Manifest(rows, self.recipe.written, self.recipe.seed, record))
        self.has_file = True

    def clear(self) -> None:
        """Remove the files that only unfinished datasets need. No other run may be writing there."""
        remove_unfinished(self.folder)
        rows = self.folder / ROWS
        if isinstance(rows, RemotePath):
            remove_objects(rows, rows.files())
        elif rows.is_dir():
            for path in rows.iterdir():
                path.unlink()
            rows.rmdir()

    def _has_samples(self, known: Manifest) -> bool:
        """Whether anything was made; otherwise another recipe may use the folder."""
        made = known.rows or known.info.get("failed") or "made_with" not in known.info
        return bool(made or whole_samples(self.folder))

    def _load(self, known: Manifest) -> None:
        changed = differences(known.recipe, plain(self.recipe.written))
        made_with = known.info.get("made_with", {})
        if not isinstance(made_with, Mapping):
            raise FileError(f'{self.folder / NAME}: "made_with" must be an object')
        changed += differences(made_with, self.made_with) if made_with else []
        if changed or not made_with:
            what = "; ".join(changed[:3]) or "it was not made by `twinlens generate`"
            raise InputError(f"{self.folder}: holds another dataset ({what}); name another folder, or undo the change")
        self._check_sources(known.info.get("sources"))
        try:
            for row in known.rows:
                self.entries[int(row.info["index"])] = row
            for failed in known.info.get("failed", ()):
                self.entries[int(failed["index"])] = Failure(**failed)
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(f"{self.folder / NAME}: was not written by `twinlens generate` ({error})") from None
        if more := sum(index >= self.recipe.count for index in self.entries):
            raise InputError(
                f"{self.folder}: holds {more} sample(s) beyond the recipe's count of {self.recipe.count}; a count may "
                "grow but not shrink: raise it, or name another folder"
            )

    def _check_sources(self, known: Any) -> None:
        if known is None and self.recipe.sources.digests:
            raise InputError(
                f"{self.folder}: was started by a version of twinlens that did not record source files; "
                "name another folder"
            )
        if not isinstance(known, Mapping | None):
            raise FileError(f'{self.folder / NAME}: "sources" must be an object')
        if changed := changed_files(known or {}, self.recipe.sources.digests):
            raise InputError(
                f"{self.folder}: was started with other source files ({changed}); restore them, or name another folder"
            )

    def _refuse_other_files(self) -> None:
        """Raise InputError if a folder without dataset.json has files that no run of `twinlens generate` leaves."""
        if not self.folder.is_dir():
            return
        names = [entry.name for entry in self.folder.iterdir()]
        for name in names:
            if not (name.startswith(".") or name.isdecimal() or name == "preview.png"):
                lost = any(name.isdecimal() for name in names)
                other = "or, if dataset.json was lost, move that file away and run again" if lost else "or an empty one"
                raise InputError(f"{self.folder}: is no dataset and holds {name!r}; name a new folder, {other}")

    def _pending_rows(self) -> Iterator[tuple[int, Entry]]:
        """Rows of samples that have no entry yet. A row that cannot be read is made from the sample's files again."""
        folder = self.folder / ROWS
        if not folder.is_dir():
            return
        for name in files_below(folder):
            index = int(name[:-5]) if name.endswith(".json") and name[:-5].isdecimal() else self.recipe.count
            if index < self.recipe.count and index not in self.entries:
                with contextlib.suppress(FileError):
                    yield index, read_row(folder / name)


def write_row(folder: Place, index: int, entry: Entry) -> None:
    """Write the entry of a sample below DIR/.rows."""
    record: dict[str, Any] = {"format": ROW_KIND, "version": ROW_VERSION}
    if isinstance(entry, Failure):
        record["failure"] = entry.plain()
    else:
        record["row"] = {"name": entry.name, "files": entry.files, "info": entry.info}
    write_file(folder / ROWS / f"{sample_name(index)}.json", encode_json(record))


def read_row(path: Place) -> Entry:
    """Read what `write_row` wrote. Raises FileError."""
    record = decode_json(read_bytes(path), str(path), ROW_KIND, ROW_VERSION)
    try:
        return Failure(**record["failure"]) if "failure" in record else Row(**record["row"])
    except (KeyError, TypeError) as error:
        raise FileError(f"{path}: is not a row of a dataset ({error})") from None


def row_info(record: Mapping[str, Any]) -> dict[str, Any]:
    """The `info` of a sample's row in dataset.json, from the record in its sample.json."""
    spec = record["spec"]
    return {
        "index": spec["index"],
        spec["kind"]: spec["scene"],
        "split": spec["split"],
        "attempt": spec["attempt"],
        "rejections": record["rejections"],
    }


def recovered_row(folder: Place, recipe: Recipe, index: int, made_with: Mapping[str, Any]) -> Row:
    """The row of a whole sample, from its files. Raises InputError if another recipe or other versions made it."""
    name = sample_name(index)
    with repairable(folder / name):
        record = read_json(folder / name / MARK, SAMPLE_KIND, SAMPLE_VERSION).get("record", {})
    try:
        expected = plain(plan(recipe, index, record["spec"]["attempt"]).plain())
        if record["spec"] != expected:
            changed = differences(record["spec"], expected)[:2]
            raise InputError(f"{folder / name}: another recipe made it ({'; '.join(changed)}); name another folder")
        if changed := differences({key: record[key] for key in made_with}, made_with)[:2]:
            raise InputError(f"{folder / name}: other versions made it ({'; '.join(changed)}); name another folder")
        if record["sources_sha256"] != recipe.sources.digest:
            raise InputError(
                f"{folder / name}: was made from other source files (scenes, assets, masks); restore them, "
                "or name another folder"
            )
        return row_of(folder, name, row_info(record))
    except (KeyError, TypeError) as error:
        raise FileError(f"{folder / name}: was not made from a recipe; name another folder") from error


def repair_hint(sample: Place) -> str:
    """What to do about a damaged sample."""
    return f"delete the folder {sample} and run the same command again"


@contextlib.contextmanager
def repairable(sample: Place) -> Iterator[None]:
    """Add `repair_hint` to FileErrors about the files of a sample."""
    try:
        yield
    except FileError as error:
        raise FileError(f"{error}; {repair_hint(sample)}") from error


def _missing_files(folder: Place, row: Row, listed: set[str] | None) -> list[str]:
    """The files of a sample that are missing; `listed` are all names in a bucket, where single queries are slow."""
    if listed is not None:
        return [name for name in row.files if f"{row.name}/{name}" not in listed]
    sample = folder / row.name
    existing = {entry.name for entry in sample.iterdir()}
    return [name for name in row.files if name not in existing and not (sample / name).is_file()]


def whole_samples(folder: Place) -> set[str]:
    """The names of the whole samples in a folder."""
    if isinstance(folder, RemotePath):
        return {name.partition("/")[0] for name in folder.files() if name.endswith(f"/{MARK}") and name.count("/") == 1}
    if not folder.is_dir():
        return set()
    return {entry.name for entry in folder.iterdir() if not entry.name.startswith(".") and (entry / MARK).is_file()}
