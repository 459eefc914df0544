"""`run_benchmark`: methods x samples -> a `Board`, with resume. One failed match is one failed entry."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinlens.errors import FileError, InputError
from twinlens.scoring.board import Board, Entry, Failure
from twinlens.scoring.checks import Disparity, Mask
from twinlens.scoring.evaluate import RESERVED, evaluate, upsampled, upsampling
from twinlens.scoring.protocols import Protocol, find_protocol
from twinlens.scoring.regions import region_masks
from twinlens.scoring.resume import BoardWriter, exclusive, resumed
from twinlens.scoring.runners import Answer, LocalRunner, Method, MethodError, WorkerRunner
from twinlens.scoring.samples import Pair, Sample, fingerprint, load_pair
from twinlens.scoring.submission import Submission

WARM_UP_LIMIT_S = 120.0
WORKER_LIMIT_S = 600.0
"""Time limit of a match if only a memory limit was given."""


@dataclass(frozen=True)
class Step:
    """Argument of `progress` after each pair. total: number of pairs, None if the samples have no length."""

    done: int
    total: int | None
    method: str
    sample: str
    skipped: bool
    failure: Failure | None


def run_benchmark(
    samples: Iterable[Sample],
    methods: Sequence[Method | Submission],
    *,
    protocol: str | Sequence[str] = "middlebury-v3",
    regions: Sequence[str] = ("all", "nonocc"),
    progress: Callable[[Step], None] | None = None,
    time_limit: float | None = None,
    memory_limit: int | None = None,
    warm_up: bool = True,
    warm_up_limit: float = WARM_UP_LIMIT_S,
    save: str | os.PathLike[str] | None = None,
    board: Board | None = None,
    retry_failed: bool = False,
    on_map: Callable[[str, str, Disparity], None] | None = None,
    on_drop: Callable[[str, str], None] | None = None,
    title: str = "twinlens board",
) -> Board:
    """Run every method on every sample, score the maps, and return the board.

    Parameters
    ----------
    samples
        Objects as `samples.Sample` describes; each is held in memory only while it is scored.
    methods
        Objects with a unique `name` and `match(left, right, *, num_disparities, min_disparity)`; their `spec`, or else
        their name, must change whenever their results may change. Or `Submission`s.
    protocol
        One or several names of `PROTOCOLS`. Each map is computed once and scored by all. Protocols that need a
        calibration skip samples without one.
    regions
        Names of `REGIONS`. A region is skipped for samples that lack the data it needs.
    progress
        Called after every pair with a `Step`.
    time_limit
        Seconds per match. Runs methods in a worker process, which is killed at the limit (see `runners`).
    memory_limit
        Bytes of data the worker process may allocate. Implies a time limit of 600 s.
    warm_up, warm_up_limit
        Match a few rows before the first measured match of each method and number of disparities, so that compilation
        is not timed. In a worker process this may take `warm_up_limit` seconds. It is repeated in a new worker, unless
        it hung, or took longer than the time limit and did not help.
    save
        The board's JSON file: read first if it exists (resume), written every few seconds and at the end, and locked
        against other runs.
    board
        A board to resume instead. A pair is skipped if an entry agrees in method spec, sample fingerprint, protocol
        and regions. Entries that disagree are replaced, all others are kept.
    retry_failed
        Run failed pairs again instead of keeping their failures.
    on_map
        Called with (method name, sample name, disparity at the truth's size) for every computed map.
    on_drop
        Called with (method name, sample name) for every earlier map that is no longer valid.

    Raises
    ------
    InputError
        Unknown protocol or region, methods or samples that share a name, a sample that cannot be scored, a missing
        file or function of a method (raised before anything runs).
    FileError, OutputError
        `save` is not a board, cannot be written, or is locked by another run.
    """
    names = (protocol,) if isinstance(protocol, str) else tuple(protocol)
    if not names or not regions:
        raise InputError("nothing to score: name at least one protocol and one region")
    protocols = [find_protocol(name) for name in names]
    _check_names(methods)
    limited = time_limit is not None or memory_limit is not None
    limit = WORKER_LIMIT_S if time_limit is None else time_limit
    runner = WorkerRunner(limit, warm_up_limit, memory_limit) if limited else LocalRunner()
    lock = nullcontext() if save is None else exclusive(Path(save).absolute().parent, Path(save).name)
    with lock, runner:
        current = resumed(save, board, title)
        with BoardWriter(current, save) as writer:
            _check_requirements(methods, runner)
            run = _Run(runner, current, retry_failed, on_map, on_drop, warm_up)
            total = len(samples) * len(methods) if isinstance(samples, Sized) else None
            pairs = ((each, method) for each in _prepared(samples, protocols, regions) for method in methods)
            for done, (prepared, method) in enumerate(pairs, start=1):
                skipped, failure = run.pair(prepared, method)
                if not skipped:
                    writer.update(run.board)
                if progress is not None:
                    progress(Step(done, total, method.name, prepared.sample.name, skipped, failure))
            return writer.finish(run.board)


def spec_of(method: Method | Submission) -> str:
    """Everything that determines a method's results, as text: its `spec`, or else its name."""
    return str(getattr(method, "spec", method.name))


def _check_names(methods: Sequence[Method | Submission]) -> None:
    names = [method.name for method in methods]
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"two methods are named {double!r}: names on a board must be unique")
    if not names:
        raise InputError("no method to run")


def _check_requirements(methods: Sequence[Method | Submission], runner: LocalRunner | WorkerRunner) -> None:
    """Before anything runs: a missing file is the user's error, not a failure for the board."""
    for method in methods:
        if (missing := runner.missing_requirement(method)) is not None:
            raise InputError(missing)


@dataclass(frozen=True)
class _Prepared:
    """A sample with what all methods share: fingerprint, region masks, applicable protocols."""

    sample: Pair
    sha: str
    masks: dict[str, Mask]
    protocols: tuple[Protocol, ...]


def _prepared(samples: Iterable[Sample], protocols: Sequence[Protocol], regions: Sequence[str]) -> Iterator[_Prepared]:
    seen: set[str] = set()
    for sample in samples:
        if sample.name in seen:
            raise InputError(f"two samples are named {sample.name!r}: names on a board must be unique")
        seen.add(sample.name)
        pair = load_pair(sample)
        applicable = tuple(p for p in protocols if pair.calibration is not None or not p.needs_calibration)
        yield _Prepared(pair, fingerprint(pair), region_masks(pair, regions), applicable)


class _Run:
    """The growing board; one `pair` call for each method and sample."""

    def __init__(
        self,
        runner: LocalRunner | WorkerRunner,
        board: Board,
        retry_failed: bool,
        on_map: Callable[[str, str, Disparity], None] | None,
        on_drop: Callable[[str, str], None] | None,
        warm_up: bool,
    ) -> None:
        self.runner, self.board, self.retry_failed, self.warm_up = runner, board, retry_failed, warm_up
        self.on_map, self.on_drop = on_map, on_drop

    def pair(self, prepared: _Prepared, method: Method | Submission) -> tuple[bool, Failure | None]:
        """Match and score one pair unless the board has it: (skipped, failure)."""
        sample = prepared.sample
        self._drop_stale(sample.name, prepared.sha, method.name, spec_of(method))
        if self._is_done(method.name, prepared):
            return True, None
        answer, failure = self._answer(sample, method)
        entries = [_entry(prepared, method, rules, answer, failure) for rules in prepared.protocols]
        for entry in entries:
            self.board = self.board.having(entry)
        if answer is None:
            self._drop({(method.name, sample.name)})
        elif self.on_map is not None:
            scale = sample.disp0.shape[0] // answer.disp.shape[0]
            self.on_map(method.name, sample.name, upsampled(answer.disp, scale))
        return False, next((entry.failure for entry in entries if not entry.ok), None)

    def _drop_stale(self, sample: str, sha: str, method: str, spec: str) -> None:
        """Remove entries of another sample or another method with this name."""
        before = {(e.method, e.sample) for e in self.board.entries}
        self.board = self.board.without(
            lambda e: (e.sample == sample and e.sample_sha256 != sha) or (e.method == method and e.spec != spec)
        )
        self._drop(before - {(e.method, e.sample) for e in self.board.entries})

    def _drop(self, pairs: Iterable[tuple[str, str]]) -> None:
        if self.on_drop is not None:
            for method, sample in sorted(pairs):
                self.on_drop(method, sample)

    def _is_done(self, method: str, prepared: _Prepared) -> bool:
        found = [self.board.find(method, prepared.sample.name, rules.name) for rules in prepared.protocols]
        return all(
            e is not None and (set(prepared.masks) <= set(e.regions) if e.ok else not self.retry_failed) for e in found
        )

    def _answer(self, sample: Pair, method: Method | Submission) -> tuple[Answer | None, Failure | None]:
        if isinstance(method, Submission):
            return _submitted(sample, method)
        images = np.array(sample.im0), np.array(sample.im1)  # copies: a method may write into its arguments
        try:
            if self.warm_up:
                self.runner.warm_up(method, *images, sample.search)
            return self.runner.match(method, *images, sample.search), None
        except MethodError as error:
            return None, error.failure


def _submitted(sample: Pair, submission: Submission) -> tuple[Answer | None, Failure | None]:
    """The submission's map; it has no time."""
    try:
        submission.file_of(sample.name, sample.aliases)
    except FileError as error:
        return None, Failure("missing", str(error))
    height, width = sample.disp0.shape
    try:
        return Answer(submission.map_of(sample.name, (height, width), sample.aliases), None), None
    except FileError as error:
        return None, Failure("refused", str(error))


def _entry(
    prepared: _Prepared, method: Method | Submission, rules: Protocol, answer: Answer | None, failure: Failure | None
) -> Entry:
    sample = prepared.sample
    height, width = sample.disp0.shape
    entry = Entry(
        method.name,
        spec_of(method),
        sample.name,
        prepared.sha,
        rules.name,
        width,
        height,
        int(sample.ndisp),
        None if answer is None else answer.seconds,
        failure,
        min_disparity=int(sample.min_disparity),
    )
    if answer is None:
        return entry
    try:
        scale = upsampling(answer.disp.shape, sample.disp0.shape, rules)
    except InputError as error:
        return replace(entry, failure=Failure("refused", str(error)))
    scores = evaluate(
        answer.disp,
        sample.disp0,
        prepared.masks.get("nonocc"),
        sample.ndisp / scale,
        protocol=rules,
        regions={name: mask for name, mask in prepared.masks.items() if name not in RESERVED},
        min_disparity=sample.min_disparity / scale,
        calibration=sample.calibration,
    )
    return replace(entry, regions={name: scores.regions[name] for name in prepared.masks})
