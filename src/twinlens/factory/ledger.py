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
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from twinlens.dataset import Manifest, Row, read_manifest, write_manifest
from twinlens.dataset.card import ASSETS, write_assets
from twinlens.dataset.dataset import MANIFEST, ROW_KIND, ROW_VERSION, ROWS, row_of
from twinlens.dataset.files import (
    files_below,
    is_hidden,
    read_bytes,
    remove_unfinished,
    write_file,
)
from twinlens.dataset.metadata import KEY as ABOUT
from twinlens.dataset.record import decode_json, encode_json, plain, read_json
from twinlens.dataset.sample import KIND as SAMPLE_KIND, VERSION as SAMPLE_VERSION
from twinlens.dataset.storage import MARK, Place, RemotePath, remove_objects
from twinlens.errors import FileError, InputError
from twinlens.factory.plan import plan, sample_name
from twinlens.factory.recipe import Recipe, differences
from twinlens.factory.sources import changed_files


@dataclass(frozen=True)
class Failure:
    """A sample all of whose draws were rejected; `remedy` names what to change in the recipe."""

    index: int
    remedy: str
    rejections: list[dict[str, Any]]


Entry = Row | Failure
"""The result of one sample."""


class Ledger:
    """The entries of the dataset in `folder`, by sample index.

    Raises InputError if the folder has a dataset of another recipe, of other versions, or of other source files.
    """

    def __init__(
        self, folder: Place, recipe: Recipe, made_with: Mapping[str, Any]
    ) -> None:
        self.folder, self.recipe = folder, recipe
        self.made_with = plain(made_with)
        self.entries: dict[int, Entry] = {}
        self.described: dict[str, Any] = {}
        self.has_file = (folder / MANIFEST).is_file()
        self.is_of_another_recipe = False
        if not self.has_file:
            for entry in folder.iterdir() if folder.is_dir() else ():
                if not (
                    is_hidden(entry.name)
                    or entry.name.isdecimal()
                    or entry.name in ("preview.png", ASSETS)
                ):
                    remedy = "name a new or empty folder; if dataset.json was lost, move that file away and run again"
                    raise InputError(
                        f"{folder}: is not a dataset and contains {entry.name!r}; {remedy}"
                    )
            return
        manifest = read_manifest(folder)
        is_empty = "made_with" in manifest.info and not manifest.rows
        # Where nothing was made yet, or every draw was rejected, another recipe may use the folder.
        if not is_empty or whole_samples(folder):
            self._load(manifest)
        else:
            sources = manifest.info.get("sources", {})
            edited = changed_files(sources, self.recipe.sources.digests)
            self.is_of_another_recipe = bool(self._changes(manifest) or edited)

    @property
    def rows(self) -> list[Row]:
        """The samples that are made, in order."""
        return [
            entry for _, entry in sorted(self.entries.items()) if isinstance(entry, Row)
        ]

    @property
    def failures(self) -> list[Failure]:
        """The failed samples, in order."""
        return [
            entry
            for _, entry in sorted(self.entries.items())
            if isinstance(entry, Failure)
        ]

    @property
    def rejections(self) -> dict[str, int]:
        """The number of rejected draws by reason."""
        counts = Counter[str]()
        for row in self.rows:
            counts.update(draw["reason"] for draw in row.info.get("rejections", ()))
        for failure in self.failures:
            counts.update(draw["reason"] for draw in failure.rejections)
        return dict(sorted(counts.items()))

    def recover(self) -> None:
        """Add every row and every whole sample that earlier runs left, and drop samples that are gone."""
        existing = whole_samples(self.folder)
        # Without dataset.json the pending rows may be another recipe's.
        is_ours = self.has_file and not self.is_of_another_recipe
        pending = dict(self._pending_rows()) if is_ours else {}
        entries = (self.entries | pending).items()
        self.entries = {
            i: entry
            for i, entry in entries
            if isinstance(entry, Failure) or entry.name in existing
        }
        for name in sorted(existing - {sample_name(index) for index in self.entries}):
            if (
                name.isdecimal()
                and sample_name(int(name)) == name
                and int(name) < self.recipe.count
            ):
                self.entries[int(name)] = recovered_row(
                    self.folder, self.recipe, int(name), self.made_with
                )

    def check_files(self) -> None:
        """Raise FileError where a file that a row lists is missing. `verify` checks their contents."""
        exists = _existence(self.folder)
        for row in self.rows:
            if lost := [name for name in row.files if not exists(f"{row.name}/{name}")]:
                more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
                sample = self.folder / row.name
                raise FileError(
                    f"{sample / lost[0]}: is missing{more}; {repair_hint(sample)}"
                )

    def missing(self) -> list[int]:
        """The indices of the samples that are still to be made."""
        return [
            index for index in range(self.recipe.count) if index not in self.entries
        ]

    def write(self, **info: Any) -> None:
        """Write dataset.json, to which `info` is added, and ASSETS.md."""
        record = {
            "made_with": self.made_with,
            "sources": self.recipe.sources.digests,
            "bundled": self.recipe.sources.bundled,
            "complete": not self.missing(),
            "rejections": self.rejections,
            "failed": [asdict(failure) for failure in self.failures],
        }
        if self.recipe.splits:
            counts = Counter(row.info.get("split") for row in self.rows)
            record["splits"] = {name: counts[name] for name in self.recipe.splits}
        info = record | self.described | info
        manifest = Manifest(self.rows, self.recipe.written, self.recipe.seed, info)
        write_manifest(self.folder, manifest)
        write_assets(self.folder, manifest)
        self.has_file, self.is_of_another_recipe = True, False

    def clear(self) -> None:
        """Remove the files that only unfinished datasets need. No other run may be writing there."""
        remove_unfinished(self.folder)
        self.remove_rows()

    def remove_rows(self) -> None:
        """Remove the rows that are not in dataset.json yet."""
        rows = self.folder / ROWS
        if isinstance(rows, RemotePath):
            remove_objects(rows, rows.files())
        elif rows.is_dir():
            shutil.rmtree(rows)

    def remove(self) -> None:
        """Remove dataset.json and all that belongs to it. No other run may be writing there."""
        # Rows go first: without dataset.json they would be taken for another recipe's.
        self.clear()
        names = (ASSETS, "preview.png", MANIFEST)
        if isinstance(self.folder, RemotePath):
            remove_objects(self.folder, names)
        else:
            for name in names:
                (self.folder / name).unlink(missing_ok=True)
        self.has_file = False

    def _load(self, manifest: Manifest) -> None:
        """Take the entries of dataset.json, if it is of this recipe, these versions and these source files."""
        sources = manifest.info.get("sources")
        is_generated = isinstance(manifest.info.get("made_with"), Mapping)
        if not is_generated or not isinstance(sources, Mapping):
            raise InputError(
                f"{self.folder}: holds a dataset that `twinlens generate` did not make; name a new folder"
            )
        if changed := self._changes(manifest):
            what = "; ".join(changed[:3])
            raise InputError(
                f"{self.folder}: holds another dataset ({what}); name another folder, or undo the change"
            )
        if edited := changed_files(sources, self.recipe.sources.digests):
            raise InputError(
                f"{self.folder}: has other source files ({edited}); restore them, or name another folder"
            )
        self.described = {
            key: manifest.info[key] for key in (ABOUT,) if key in manifest.info
        }
        try:
            self.entries |= {int(row.info["index"]): row for row in manifest.rows}
            self.entries |= {
                int(failed["index"]): Failure(**failed)
                for failed in manifest.info.get("failed", ())
            }
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(
                f"{self.folder / MANIFEST}: was not written by `twinlens generate` ({error})"
            ) from None
        if more := sum(index >= self.recipe.count for index in self.entries):
            raise InputError(
                f"{self.folder}: holds {more} sample(s) beyond the recipe's count of {self.recipe.count}; a count may "
                "grow but not shrink: raise it, or name another folder"
            )

    def _changes(self, manifest: Manifest) -> list[str]:
        """In what the recipe and the versions of dataset.json differ from this run's."""
        recipe = differences(manifest.recipe, plain(self.recipe.written))
        return recipe + differences(manifest.info["made_with"], self.made_with)

    def _pending_rows(self) -> Iterator[tuple[int, Entry]]:
        """Rows of samples that have no entry yet. A row that cannot be read is made from the sample's files again."""
        folder = self.folder / ROWS
        for name in files_below(folder) if folder.is_dir() else ():
            index = (
                int(name[:-5])
                if name.endswith(".json") and name[:-5].isdecimal()
                else self.recipe.count
            )
            if index < self.recipe.count and index not in self.entries:
                with contextlib.suppress(FileError, KeyError, TypeError):
                    record = decode_json(
                        read_bytes(folder / name), name, ROW_KIND, ROW_VERSION
                    )
                    yield (
                        index,
                        Failure(**record["failure"])
                        if "failure" in record
                        else Row(**record["row"]),
                    )


def write_row(folder: Place, index: int, entry: Entry) -> None:
    """Write the entry of a sample below DIR/.rows."""
    record = {"failure" if isinstance(entry, Failure) else "row": asdict(entry)}
    data = encode_json({"format": ROW_KIND, "version": ROW_VERSION, **record})
    write_file(folder / ROWS / f"{sample_name(index)}.json", data)


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


def recovered_row(
    folder: Place, recipe: Recipe, index: int, made_with: Mapping[str, Any]
) -> Row:
    """The row of a whole sample, from its files. Raises InputError if another recipe or other versions made it."""
    name = sample_name(index)
    sample = folder / name
    with repairable(sample):
        record = read_json(sample / MARK, SAMPLE_KIND, SAMPLE_VERSION).get("record", {})
    try:
        changed = differences(
            record["spec"],
            plain(asdict(plan(recipe, index, record["spec"]["attempt"]))),
        )[:2]
        if changed:
            raise InputError(
                f"{sample}: another recipe made it ({'; '.join(changed)}); name another folder"
            )
        if changed := differences({key: record[key] for key in made_with}, made_with)[
            :2
        ]:
            raise InputError(
                f"{sample}: other versions made it ({'; '.join(changed)}); name another folder"
            )
        if record["sources_sha256"] != recipe.sources.digest:
            files = "other source files (scenes, assets, masks)"
            raise InputError(
                f"{sample}: was made from {files}; restore them, or name another folder"
            )
        return row_of(folder, name, row_info(record))
    except (KeyError, TypeError, AttributeError) as error:
        raise FileError(
            f"{sample}: was not made from a recipe; name another folder"
        ) from error


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


def whole_samples(folder: Place) -> set[str]:
    """The names of the whole samples in a folder."""
    exists = _existence(folder)
    entries = folder.iterdir() if folder.is_dir() else ()
    return {
        entry.name
        for entry in entries
        if not is_hidden(entry.name) and exists(f"{entry.name}/{MARK}")
    }


def _existence(folder: Place) -> Callable[[str], bool]:
    """Whether a name is a file below `folder`. A bucket, where single queries are slow, is listed once."""
    if isinstance(folder, RemotePath):
        return set(folder.files()).__contains__
    return lambda name: (folder / name).is_file()
