"""`run_benchmark`: methods x samples -> a `Board`, with resume. One failed match is one failed entry."""

import os
from collections.abc import Callable, Iterable, Sequence, Sized
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinlens.errors import FileError, InputError
from twinlens.scoring.board import Board, Entry, Failure
from twinlens.scoring.board_file import BoardWriter, exclusive, read_board
from twinlens.scoring.evaluate import RESERVED, evaluate, upsampled, upsampling
from twinlens.scoring.metrics import Disparity, Mask
from twinlens.scoring.protocols import Protocol, find_protocol
from twinlens.scoring.regions import region_masks
from twinlens.scoring.runners import Answer, Method, MethodError, Runner
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
    time_limit, memory_limit
        Seconds per match, and bytes of data that a method may allocate. Either runs methods in a worker process, which
        is killed at the limit (see `runners.Runner`). A memory limit alone implies a time limit of 600 s.
    warm_up, warm_up_limit
        Match a few rows before the first measured match of each method and number of disparities, so that compilation
        is not timed. In a worker process this may take `warm_up_limit` seconds. It is repeated in a new worker, unless
        it hung, or took longer than the time limit and did not help.
    save, board
        The board's JSON file: read first if it exists (resume), written every few seconds and at the end, and locked
        against other runs. Or a board to resume instead. A pair is skipped if an entry agrees in method spec, sample
        fingerprint, protocol and regions. Entries that disagree are replaced, all others are kept.
    retry_failed
        Run failed pairs again instead of keeping their failures.
    on_map, on_drop
        Called with (method name, sample name, disparity at the truth's size) for every computed map, and with (method
        name, sample name) for every earlier map that is no longer valid.

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
    if not methods:
        raise InputError("no method to run")
    protocols = [find_protocol(name) for name in names]
    for i, method in enumerate(methods):
        if method.name in [other.name for other in methods[:i]]:
            raise _not_unique("method", method.name)
    if time_limit is None and memory_limit is not None:
        time_limit = WORKER_LIMIT_S
    runner = Runner(time_limit, warm_up_limit, memory_limit)
    lock = nullcontext() if save is None else exclusive(Path(save).absolute().parent, Path(save).name)
    with lock, runner:
        if board is None:
            board = read_board(save) if save is not None and Path(save).exists() else Board()
        with BoardWriter(replace(board, title=title), save) as writer:
            for method in methods:  # a missing file is the user's error, not a failure for the board
                if (missing := runner.missing_requirement(method)) is not None:
                    raise InputError(missing)
            run = _Run(runner, writer, retry_failed, on_map, on_drop, warm_up)
            total = len(samples) * len(methods) if isinstance(samples, Sized) else None
            done, seen = 0, set[str]()
            for sample in samples:
                if sample.name in seen:
                    raise _not_unique("sample", sample.name)
                seen.add(sample.name)
                prepared = _prepare(sample, protocols, regions)
                for method in methods:
                    skipped, failure = run.pair(prepared, method)
                    done += 1
                    if progress is not None:
                        progress(Step(done, total, method.name, sample.name, skipped, failure))
        return writer.board


def spec_of(method: Method | Submission) -> str:
    """Everything that determines a method's results, as text: its `spec`, or else its name."""
    return str(getattr(method, "spec", method.name))


def _not_unique(kind: str, name: str) -> InputError:
    return InputError(f"two {kind}s are named {name!r}: names on a board must be unique")


@dataclass(frozen=True)
class _Prepared:
    """A sample with what all methods share: fingerprint, region masks, applicable protocols."""

    sample: Pair
    sha: str
    masks: dict[str, Mask]
    protocols: tuple[Protocol, ...]


def _prepare(sample: Sample, protocols: Sequence[Protocol], regions: Sequence[str]) -> _Prepared:
    pair = load_pair(sample)
    applicable = tuple(p for p in protocols if pair.calibration is not None or not p.needs_calibration)
    return _Prepared(pair, fingerprint(pair), region_masks(pair, regions), applicable)


@dataclass(frozen=True)
class _Run:
    """Matches and scores pairs, and adds their entries to the board."""

    runner: Runner
    writer: BoardWriter
    retry_failed: bool
    on_map: Callable[[str, str, Disparity], None] | None
    on_drop: Callable[[str, str], None] | None
    warm_up: bool

    def pair(self, prepared: _Prepared, method: Method | Submission) -> tuple[bool, Failure | None]:
        """Match and score one pair unless the board has it: (skipped, failure)."""
        sample, board = prepared.sample, self._without_stale(prepared, method)
        found = [board.find(method.name, sample.name, rules.name) for rules in prepared.protocols]
        if all(entry is not None and self._is_kept(entry, prepared) for entry in found):
            return True, None
        answer, failure = self._answer(sample, method)
        entries = [_entry(prepared, method, rules, answer, failure) for rules in prepared.protocols]
        for entry in entries:
            board = board.having(entry)
        if answer is None:
            self._drop({(method.name, sample.name)})
        elif self.on_map is not None:
            scale = sample.disp0.shape[0] // answer.disp.shape[0]
            self.on_map(method.name, sample.name, upsampled(answer.disp, scale))
        self.writer.update(board)  # after the map, so that the board lists no map that is missing
        return False, next((entry.failure for entry in entries if not entry.ok), None)

    def _without_stale(self, prepared: _Prepared, method: Method | Submission) -> Board:
        """The board without entries of another sample or another method with this name."""
        board, name, spec = self.writer.board, prepared.sample.name, spec_of(method)
        kept = board.without(
            lambda e: (
                (e.sample == name and e.sample_sha256 != prepared.sha) or (e.method == method.name and e.spec != spec)
            )
        )
        if len(kept.entries) < len(board.entries):
            self.writer.update(kept)
            self._drop({(e.method, e.sample) for e in board.entries} - {(e.method, e.sample) for e in kept.entries})
        return kept

    def _drop(self, pairs: Iterable[tuple[str, str]]) -> None:
        if self.on_drop is not None:
            for method, sample in sorted(pairs):
                self.on_drop(method, sample)

    def _is_kept(self, entry: Entry, prepared: _Prepared) -> bool:
        return set(prepared.masks) <= set(entry.regions) if entry.ok else not self.retry_failed

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
    height, width = sample.disp0.shape
    kind = "missing"
    try:
        submission.file_of(sample.name, sample.aliases)
        kind = "refused"
        return Answer(submission.map_of(sample.name, (height, width), sample.aliases), None), None
    except FileError as error:
        return None, Failure(kind, str(error))


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
