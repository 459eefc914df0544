"""Making a dataset: every sample of a recipe that is not in the folder yet. A run may be stopped and resumed.

recipe -> Ledger (what the folder holds) -> engine -> (index, entry) -> Ledger -> dataset.json, preview.png, card
"""

import contextlib
import importlib
import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from twinlens.dataset import Place, Row, Sample, StoredSample, describe
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import locked, remove_unfinished, write_file
from twinlens.dataset.pictures import colourise, contact_sheet, tile
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.storage import Where, place
from twinlens.errors import FileError, InputError, NotUsedWarning
from twinlens.factory.doubts import warn_of_lone_patterns
from twinlens.factory.ledger import Failure, Ledger, repairable, whole_samples
from twinlens.factory.produce import check_draws, sample_or_failure
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import made_with
from twinlens.factory.workers import Engine, Report, Work, in_process, reported
from twinlens.families import Assets

MOST = 48
"""Samples on preview.png."""

_WRITE_EVERY_S = 5.0


@dataclass(frozen=True)
class Outcome:
    """The state of a dataset after a run.

    count : samples of the recipe.
    made : samples that this run made.
    before, there : samples in the folder before and after, those of other shards included.
    failures : samples all of whose draws were rejected.
    rejections : rejected draws by reason.
    complete : whether every sample is made or failed.
    left : samples of this shard that are still to be made.
    """

    count: int
    made: int
    before: int
    there: int
    failures: tuple[Failure, ...]
    rejections: dict[str, int]
    complete: bool
    left: int = 0


def generate(
    recipe: Recipe,
    folder: Where,
    *,
    limit: int | None = None,
    shard: tuple[int, int] = (1, 1),
    engine: Engine = in_process,
    report: Report = lambda fraction, now: None,
) -> Outcome:
    """Make every sample of `recipe` that is not in `folder` yet. After any stop the same call resumes.

    If all draws of every sample are rejected, nothing stays of the dataset.

    limit : make at most so many samples.
    shard : (i, n): make only every n-th sample, starting with the i-th (1 to n). n such runs make the whole dataset, at
        the same time and on several machines if they share the folder. The last one to finish writes dataset.json.
    engine : `in_process`, `worker_processes(count)` or `dask_cluster(address)`.
    report : called with the fraction done and a text.

    Raises InputError where `folder` holds another dataset, FileError where a sample there lacks a file, OutputError
    where it cannot be written or another run writes there. Before anything is written, raises BackendError where no
    backend works on this machine, and InputError where all draws of the first sample are impossible.
    """
    _check_part(limit, shard)
    warn_of_lone_patterns(recipe)
    root, shared = place(folder), shard != (1, 1)
    tools = _checked_tools(recipe, root)
    if shard[0] <= recipe.count:
        check_draws(recipe, shard[0] - 1)
    with locked(root, shared, remedy="wait for it, or split the work with --shard"):
        ledger = Ledger(root, recipe, tools)
        was_begun = ledger.has_file
        _resume(ledger, shared)
        before = len(ledger.rows)
        todo = [index for index in ledger.missing() if _is_in(shard, index)]
        made = _run(ledger, engine, todo[:limit], report, exclusive=not shared)
        if shared:
            ledger.recover()
        elif not ledger.missing():
            finish(ledger)
    missing = ledger.missing()
    if shared and not missing:
        # Several shards may find at the same time that everything is made.
        with locked(root, wait=True):
            finish(ledger)
    if was_begun and not missing and not ledger.rows:
        _remove_empty(root)
    return Outcome(
        count=recipe.count,
        made=made,
        before=before,
        there=len(ledger.rows),
        failures=tuple(ledger.failures),
        rejections=ledger.rejections,
        complete=not missing,
        left=sum(_is_in(shard, index) for index in missing),
    )


def _check_part(limit: int | None, shard: tuple[int, int]) -> None:
    if limit is not None and limit < 1:
        raise InputError(f"limit must be 1 or more, got {limit}")
    i, n = shard
    if not 1 <= i <= n:
        raise InputError(f"a shard is i/n with i from 1 to n, got {i}/{n}")


def _is_in(shard: tuple[int, int], index: int) -> bool:
    i, n = shard
    return index % n == i - 1


def _resume(ledger: Ledger, shared: bool) -> None:
    """Give the ledger the samples that the folder has; a new dataset.json is begun."""
    if not shared:
        remove_unfinished(ledger.folder)
    if ledger.is_of_another_recipe:
        # Rows of that recipe's failures would be taken for those of this one.
        ledger.remove_rows()
    ledger.recover()
    ledger.check_files()
    if not ledger.has_file or ledger.is_of_another_recipe:
        ledger.write()


def _remove_empty(folder: Place) -> None:
    """Remove a local folder that an earlier run may have made, if nothing is in it."""
    if isinstance(folder, Path):
        with contextlib.suppress(OSError):
            folder.rmdir()


def _checked_tools(recipe: Recipe, root: Place) -> dict[str, Any]:
    """`made_with`, once the recipe's files and this machine can make samples in `root`.

    These are the errors that can be known before anything is written: an output among the recipe's files, files that
    cannot be read, and a missing backend.
    """
    if isinstance(root, Path):
        recipe.sources.check_output(root)
    _ = recipe.sources.digests  # reads every file
    # A resumed run has read the contents of the files before its first sample.
    if not whole_samples(root):
        recipe.sources.check_contents()
    return made_with()


def _run(
    ledger: Ledger,
    engine: Engine,
    todo: Sequence[int],
    report: Report,
    exclusive: bool,
) -> int:
    """Make the samples `todo` with an engine and add them to the ledger; the number of samples made.

    exclusive : keep dataset.json and the preview current, and leave no unfinished sample. Runs that share the folder
        must not, because such a sample may be another run's.
    """
    # The preview needs it. An import that an interrupt stops cannot be repeated, so it is done before the first sample.
    importlib.import_module("matplotlib")
    tried, count = len(ledger.entries), ledger.recipe.count

    def progress(part: float, now: str) -> None:
        report(part, f"{tried + round(part * len(todo))}/{count} {now}".strip())

    work = Work(ledger.recipe, ledger.folder, ledger.made_with)
    overview, made = _Overview(ledger), 0
    try:
        with contextlib.closing(engine(work, todo, progress)) as results:
            for index, entry in results:
                ledger.entries[index] = entry
                made += isinstance(entry, Row)
                if exclusive:
                    overview.write_if_due()
    finally:
        if exclusive:
            remove_unfinished(ledger.folder)
            overview.write()
    return made


class _Overview:
    """The dataset.json and preview.png of a run that adds samples."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger = ledger
        self.tiles: dict[str, Image.Image] = {}
        self.due = time.monotonic() + _WRITE_EVERY_S

    def write(self) -> None:
        self.ledger.write()
        write_preview(self.ledger, self.tiles)

    def write_if_due(self) -> None:
        start = time.monotonic()
        if start >= self.due:
            self.write()
            # The files grow: writing them takes at most 2 % of the time.
            seconds = time.monotonic() - start
            self.due = start + max(_WRITE_EVERY_S, 50 * seconds)


def finish(ledger: Ledger) -> None:
    """Write the final dataset.json, preview, card and metadata; remove the files that only unfinished datasets need.

    If all samples failed, nothing stays, so that the same command works again once the recipe is changed.
    """
    if not ledger.rows:
        ledger.remove()
        return
    broken = _unusable_assets(ledger.recipe)
    ledger.write(**({"skipped_assets": broken} if ledger.recipe.sources.assets else {}))
    write_preview(ledger, {})
    describe(ledger.folder)
    ledger.clear()


def _unusable_assets(recipe: Recipe) -> list[dict[str, str]]:
    """The files in the recipe's asset folders that cannot be used, and why; each is read."""
    unusable = []
    for kind, files in recipe.sources.asset_files.items():
        for name, path in files.items():
            keep = {
                "keep_material": recipe.sources.keep_material,
                "folder": recipe.sources.folder,
            }
            single: dict[str, Any] = {kind: (path,), **keep}
            # Samples have given the warnings of the files that they use.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotUsedWarning)
                checked = Assets(**single).check()
            for broken, reason in checked.broken:
                unusable.append(
                    {
                        "kind": kind,
                        "file": name,
                        "reason": reason.replace(str(broken), name),
                    }
                )
    return unusable


@dataclass(frozen=True)
class Estimate:
    """What a run would make, and what it would cost.

    count, before, todo : samples of the recipe, those made or failed before, and those to be made.
    next : the spec of the next sample; None if no sample is left.
    seconds_each, bytes_each : measured on that sample; NaN seconds if no sample is left.
    seconds, bytes : of all samples that are left.
    """

    count: int
    before: int
    todo: int
    next: dict[str, Any] | None
    seconds_each: float = math.nan
    bytes_each: int = 0
    seconds: float = 0.0
    bytes: int = 0


def estimate(
    recipe: Recipe, folder: Where, report: Report = lambda fraction, now: None
) -> Estimate:
    """Make the next sample of `recipe`, write nothing, and extrapolate its time and size.

    It is made twice and the second time is measured: the first compiles kernels that all samples share.

    report : called with the fraction done and a text.

    Raises InputError where all draws of the sample are rejected.
    """
    root = place(folder)
    ledger = Ledger(root, recipe, made_with())
    ledger.recover()
    ledger.check_files()
    missing = ledger.missing()
    before = recipe.count - len(missing)
    if not missing:
        return Estimate(recipe.count, before, 0, None)
    check_draws(recipe, missing[0])
    _made_or_error(recipe, missing[0], report, 0)
    start = time.perf_counter()
    made = _made_or_error(recipe, missing[0], report, 1)
    size = sum(map(len, sample_files(made).values()))
    seconds = time.perf_counter() - start
    todo = len(missing)
    return Estimate(
        recipe.count,
        before,
        todo,
        made.record["spec"],
        seconds,
        size,
        seconds * todo,
        size * todo,
    )


def _made_or_error(recipe: Recipe, index: int, report: Report, done: int) -> Sample:
    """The sample, of which `done` of two copies are made. Raises InputError if all its draws are rejected."""
    progress, note = reported(report, done, 2)
    made = sample_or_failure(recipe, index, progress, note)
    if isinstance(made, Failure):
        last = made.rejections[-1]["found"]
        raise InputError(
            f"{recipe.file}: sample {index} fails: {last}; change {made.remedy}"
        )
    return made


def write_preview(ledger: Ledger, tiles: dict[str, Image.Image]) -> None:
    """Write preview.png: left images and disparities of `chosen` samples of those that are made.

    `tiles` are those of the last preview, by the names of their samples, and are replaced by those of this one.
    """
    names = [row.name for row in ledger.rows]
    earlier = dict(tiles)
    tiles.clear()
    for name in (names[k] for k in chosen(len(names))):
        sample = ledger.folder / name
        with repairable(sample):
            tiles[name] = earlier.get(name) or sample_tile(StoredSample(sample, name))
    if tiles:
        write_file(
            ledger.folder / "preview.png",
            encode_png(np.asarray(contact_sheet(list(tiles.values())))),
        )


def chosen(count: int) -> list[int]:
    """Which of `count` samples are on preview.png: all of them, or `MOST` spread evenly.

    >>> chosen(3), chosen(1000)[:2]
    ([0, 1, 2], [0, 20])
    """
    shown = min(count, MOST)
    return [k * count // shown for k in range(shown)]


def sample_tile(sample: StoredSample) -> Image.Image:
    """The first image and, where there is one, the first disparity map below it."""
    parts = [np.asarray(tile(sample.im0))]
    with contextlib.suppress(FileError):  # a rig that is not rectified has no disparity
        parts.append(np.asarray(tile(colored(sample.disp0))))
    return Image.fromarray(np.concatenate(parts))


def colored(disparity: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Disparity in the colour map `turbo`, from its 1st to its 99th percentile; black where unknown."""
    finite = disparity[np.isfinite(disparity)]
    low, high = np.percentile(finite, (1, 99)) if finite.size else (0.0, 1.0)
    return colourise(
        disparity, low, max(high, low + 1e-6), "turbo", unknown_colour=(0, 0, 0)
    )
