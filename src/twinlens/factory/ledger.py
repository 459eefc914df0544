"""What is done of a dataset, on the disk: so that any run, after any stop, goes on where the last one ended.

    DIR/dataset.json           the recipe and the samples known when it was last written; it is written again and again,
                               and at the end holds nothing that depends on how often a run was stopped
    DIR/.rows/0000007.json     one sample's row (or why there is none), written right after its folder appears; many
                               processes may write there at once. Gone when the dataset is complete
    DIR/.lock                  held while a run writes there; gone when it ends, but for shards before the last

A sample whose folder is there and whose row is not, because the process was killed in between, gets its row from its
files.
"""

import contextlib
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from twinlens.dataset import Manifest, Row, read_manifest, remove_unfinished, row_of, write_manifest
from twinlens.dataset.files import files_below, read_bytes, write_file
from twinlens.dataset.manifest import NAME
from twinlens.dataset.record import decode_json, encode_json, plain, read_json
from twinlens.dataset.sample import KIND as SAMPLE_KIND
from twinlens.dataset.sample import VERSION as SAMPLE_VERSION
from twinlens.dataset.storage import MARK, Place, RemotePath, remove_objects
from twinlens.dataset.waiting import ROW_KIND, ROW_VERSION, ROWS
from twinlens.errors import FileError, InputError
from twinlens.factory.entries import Entries, Entry, Failure
from twinlens.factory.plan import plan, sample_name
from twinlens.factory.recipe import Recipe, differences
from twinlens.factory.sources import changed_files


class Ledger:
    """The entries of a dataset at `folder`, by the index of their samples.

    Raises InputError where another recipe, other versions, or other files beside the recipe have begun a dataset there.
    """

    def __init__(self, folder: Place, recipe: Recipe, made_with: Mapping[str, Any]) -> None:
        self.folder, self.recipe = folder, recipe
        self.made_with = plain(made_with)
        self.entries = Entries()
        self.has_file = (folder / NAME).is_file()
        known = read_manifest(folder) if self.has_file else None
        if known is not None and self._is_begun(known):
            self._take_over(known)
        elif known is None:
            self._refuse_strangers()

    def recover(self) -> None:
        """Take in every row and every whole sample that earlier runs left."""
        there = whole_samples(self.folder)
        for index, name in zip(self.entries.made, [row.name for row in self.entries.rows], strict=True):
            if name not in there:
                self.entries.pop(index)
        for index, entry in self._kept_rows() if self.has_file else ():  # without it, they may be another recipe's
            if isinstance(entry, Failure) or entry.name in there:
                self.entries[index] = entry
        known = {sample_name(index) for index in self.entries}
        for name in sorted(there - known):
            if name.isdecimal() and sample_name(int(name)) == name and int(name) < self.recipe.count:
                self.entries[int(name)] = recovered_row(self.folder, self.recipe, int(name), self.made_with)

    def refuse_damaged(self) -> None:
        """Raise FileError where a file that a sample's row lists is gone. What is in them is for `verify` to read."""
        listed = set(self.folder.files()) if isinstance(self.folder, RemotePath) else None
        for row in self.entries.rows:
            if lost := _lost(self.folder, row, listed):
                more = f" (nor are {len(lost) - 1} more)" if len(lost) > 1 else ""
                sample = self.folder / row.name
                raise FileError(f"{sample / lost[0]}: is not there any more{more}; {remedy(sample)}")

    def missing(self) -> list[int]:
        """The indices of the samples that are still to be made."""
        return [index for index in range(self.recipe.count) if index not in self.entries]

    @property
    def is_complete(self) -> bool:
        """Whether every sample is made, or known to be impossible."""
        return not self.missing()

    def write(self, **info: Any) -> None:
        """Write dataset.json as things stand; `info` is more to say there."""
        rows = self.entries.rows
        counts = Counter(row.info.get("split") for row in rows)
        splits = {name: counts[name] for name in self.recipe.splits}
        said = {
            "made_with": self.made_with,
            "sources": self.recipe.sources.digests,
            "complete": self.is_complete,
            "rejections": self.entries.rejections(),
            "failed": [failure.plain() for failure in self.entries.failures],
            **({"splits": splits} if splits else {}),
            **info,
        }
        write_manifest(self.folder, Manifest(rows, self.recipe.written, self.recipe.seed, said))
        self.has_file = True

    def clear(self) -> None:
        """Remove what only unfinished datasets need. Nobody else may be writing there."""
        remove_unfinished(self.folder)
        rows = self.folder / ROWS
        if isinstance(rows, RemotePath):
            remove_objects(rows, rows.files())
        elif rows.is_dir():
            for path in rows.iterdir():
                path.unlink()
            rows.rmdir()

    def _is_begun(self, known: Manifest) -> bool:
        """Whether anything was made. Where nothing was, another recipe takes nothing from anybody."""
        made = known.rows or known.info.get("failed") or "made_with" not in known.info
        return bool(made or whole_samples(self.folder))

    def _take_over(self, known: Manifest) -> None:
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
            raise FileError(f"{self.folder / NAME}: is not as `twinlens generate` writes it ({error})") from None
        if more := sum(index >= self.recipe.count for index in self.entries):
            raise InputError(
                f"{self.folder}: holds {more} sample(s) beyond the recipe's count of {self.recipe.count}; a count may "
                "grow, not shrink: raise it again, or name another folder"
            )

    def _check_sources(self, known: Any) -> None:
        if known is None and self.recipe.sources.digests:
            raise InputError(
                f"{self.folder}: was begun by a twinlens that did not record what the files beside a recipe hold; name "
                "another folder"
            )
        if not isinstance(known, Mapping | None):
            raise FileError(f'{self.folder / NAME}: "sources" must be an object')
        if changed := changed_files(known or {}, self.recipe.sources.digests):
            raise InputError(
                f"{self.folder}: was begun when the files beside the recipe held something else ({changed}); put them "
                "back as they were, or name another folder"
            )

    def _refuse_strangers(self) -> None:
        """A folder without dataset.json may hold what a run of before has left, and nothing else."""
        if not self.folder.is_dir():
            return
        there = [entry.name for entry in self.folder.iterdir()]
        for name in there:
            if not (name.startswith(".") or name.isdecimal() or name == "preview.png"):
                lost = any(name.isdecimal() for name in there)
                way = "or, where dataset.json was lost, move that away and go on" if lost else "or an empty one"
                raise InputError(f"{self.folder}: is no dataset and holds {name!r}; name a new folder, {way}")

    def _kept_rows(self) -> Iterator[tuple[int, Entry]]:
        """Of samples that are not known yet."""
        folder = self.folder / ROWS
        if not folder.is_dir():
            return
        for name in files_below(folder):
            index = int(name[:-5]) if name.endswith(".json") and name[:-5].isdecimal() else self.recipe.count
            if index < self.recipe.count and index not in self.entries:
                with contextlib.suppress(FileError):  # a row that cannot be read is made from the sample's files again
                    yield index, read_row(folder / name)


def write_row(folder: Place, index: int, entry: Entry) -> None:
    """Keep what became of a sample, beside the dataset."""
    said = (
        entry.plain() if isinstance(entry, Failure) else {"name": entry.name, "files": entry.files, "info": entry.info}
    )
    kind = "failure" if isinstance(entry, Failure) else "row"
    record = {"format": ROW_KIND, "version": ROW_VERSION, kind: said}
    write_file(folder / ROWS / f"{sample_name(index)}.json", encode_json(record))


def read_row(path: Place) -> Entry:
    """What `write_row` kept. Raises FileError."""
    record = decode_json(read_bytes(path), str(path), ROW_KIND, ROW_VERSION)
    try:
        return Failure(**record["failure"]) if "failure" in record else Row(**record["row"])
    except (KeyError, TypeError) as error:
        raise FileError(f"{path}: is no row of a dataset ({error})") from None


def row_info(record: Mapping[str, Any]) -> dict[str, Any]:
    """What dataset.json says of a sample besides its files, from its own record."""
    spec = record["spec"]
    return {
        "index": spec["index"],
        spec["kind"]: spec["scene"],
        "split": spec["split"],
        "attempt": spec["attempt"],
        "rejections": record["rejections"],
    }


def recovered_row(folder: Place, recipe: Recipe, index: int, made_with: Mapping[str, Any]) -> Row:
    """The row of a whole sample, from its files. Raises InputError when another recipe, or other tools, made it."""
    name = sample_name(index)
    with advised(folder / name):
        record = read_json(folder / name / MARK, SAMPLE_KIND, SAMPLE_VERSION).get("record", {})
    try:
        expected = plain(plan(recipe, index, record["spec"]["attempt"]).plain())
        if record["spec"] != expected:
            changed = differences(record["spec"], expected)[:2]
            raise InputError(f"{folder / name}: another recipe made it ({'; '.join(changed)}); name another folder")
        if changed := differences({key: record[key] for key in made_with}, made_with)[:2]:
            raise InputError(f"{folder / name}: other tools made it ({'; '.join(changed)}); name another folder")
        if record["sources_sha256"] != recipe.sources.digest:
            raise InputError(
                f"{folder / name}: was made when the files beside the recipe (scenes, assets, masks) held something "
                "else; put them back as they were, or name another folder"
            )
        return row_of(folder, name, row_info(record))
    except (KeyError, TypeError) as error:
        raise FileError(f"{folder / name}: is there, and no recipe made it; name another folder") from error


def remedy(sample: Place) -> str:
    """What to do about a sample that is damaged."""
    return f"delete the folder {sample}; the same command makes it again"


@contextlib.contextmanager
def advised(sample: Place) -> Iterator[None]:
    """FileErrors about a file of this sample, with what to do about it."""
    try:
        yield
    except FileError as error:
        raise FileError(f"{error}; {remedy(sample)}") from error


def _lost(folder: Place, row: Row, listed: set[str] | None) -> list[str]:
    """The files of a sample that are gone; `listed` are all names in a bucket, where asking for each takes long."""
    if listed is not None:
        return [name for name in row.files if f"{row.name}/{name}" not in listed]
    sample = folder / row.name
    there = {entry.name for entry in sample.iterdir()}
    return [name for name in row.files if name not in there and not (sample / name).is_file()]


def whole_samples(folder: Place) -> set[str]:
    """The names of the samples that are there, whole."""
    if isinstance(folder, RemotePath):
        return {name.partition("/")[0] for name in folder.files() if name.endswith(f"/{MARK}") and name.count("/") == 1}
    if not folder.is_dir():
        return set()
    return {entry.name for entry in folder.iterdir() if not entry.name.startswith(".") and (entry / MARK).is_file()}
