"""`run_benchmark`: methods x samples -> a `Board`, with resume. A method that fails on a pair fails there alone.

Calls other people's code (through `sandbox`) and writes the board's file; prints nothing and draws nothing.
"""

import os
from collections.abc import Callable, Iterable, Sequence, Sized
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinlens.errors import FileError, InputError
from twinlens.scoring.alone import alone
from twinlens.scoring.board import Board, Entry, Failure
from twinlens.scoring.calls import Answer, InProcess, Method, MethodError
from twinlens.scoring.checks import Disparity
from twinlens.scoring.evaluate import RESERVED, evaluate
from twinlens.scoring.pair import Pair, Sample
from twinlens.scoring.plan import Plan, Ready, plan_of, ready_samples
from twinlens.scoring.protocols import Protocol
from twinlens.scoring.resume import Keeper, resumed
from twinlens.scoring.sandbox import Child
from twinlens.scoring.submission import Submission

WARM_UP_LIMIT_S = 120.0
CHILD_LIMIT_S = 600.0
"""The time limit of a call where only a memory limit was asked for: both need a process of its own."""


@dataclass(frozen=True)
class Step:
    """What `progress` is told after each pair. total: pairs in all, None where the samples are a stream."""

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
    """Run every method on every sample, score it, and return the board.

    Parameters
    ----------
    samples
        Any iterable of objects as `pair.Sample` describes; each is held only while it is worked on.
    methods
        Objects with a `name`, callable as (left, right, ndisp=...). What decides their answers is taken from `spec`
        where they have it, else from `name`; two methods of one name are refused. Or `Submission`s, which are read.
        Only for a pair with negative disparities are they also given min_disparity=.
    protocol
        One name of `PROTOCOLS`, or several: a map is computed once and scored by each. A sample without calibration is
        left out by those that need one.
    regions
        Names of `REGIONS`. A region that a sample cannot tell is left out for it.
    progress
        Called after every pair with a `Step`.
    time_limit
        Seconds a call may take. With a limit methods run in one spawned process, which is killed at the limit, or
        may die, without harm to the rest (see `sandbox`). Without one they run here.
    memory_limit
        Bytes of data that this process may have; what asks for more fails alone. Implies a time limit of 600 s.
    warm_up, warm_up_limit
        Call each method once on a few rows before its first measured call of a range `ndisp` (our kernels are compiled
        for it) in a process, so that compiling is not timed; under a time limit that call has `warm_up_limit` seconds
        of its own. It is made again in the fresh process that follows a killed one, unless it hung, or took longer than
        the time limit and did not help.
    save
        The board's JSON file: read first if it exists (resume), written every few seconds and at the end. Only one run
        at a time writes it; a second is refused.
    board
        A board to resume from instead. A pair is skipped if an entry agrees in method spec, sample fingerprint,
        protocol and regions; entries that disagree are replaced, and all others stay.
    retry_failed
        Run failed pairs again; otherwise an agreeing failure is kept as it is.
    on_map
        Called with (method name, sample name, disparity) for every map that was computed.
    on_drop
        Called with (method name, sample name) where a map of before no longer holds: what made it has changed, or now
        fails.

    Raises
    ------
    InputError
        Unknown protocol or region, methods or samples that share a name, a sample that cannot be scored, a method made
        of files or functions that are not there (by its `check_parts`, if it has one): that before anything runs.
    FileError, OutputError
        `save` holds no board, or cannot be written, or another run is writing it.
    """
    plan = plan_of(protocol, regions, retry_failed)
    _check_names(methods)
    apart = time_limit is not None or memory_limit is not None
    limit = CHILD_LIMIT_S if time_limit is None else time_limit
    worker = Child(limit, warm_up_limit, memory_limit) if apart else InProcess()
    with _alone_there(save), worker:
        current = resumed(save, board, title)
        with Keeper(current, save) as keeper:
            _check_parts(methods, worker)
            run = _Run(plan, worker, current, on_map, on_drop, warm_up)
            total = len(samples) * len(methods) if isinstance(samples, Sized) else None
            turns = ((ready, method) for ready in ready_samples(samples, plan) for method in methods)
            for done, (ready, method) in enumerate(turns, start=1):
                skipped, failure = run.pair(ready, method)
                if not skipped:
                    keeper.keep(run.board)
                if progress is not None:
                    progress(Step(done, total, method.name, ready.sample.name, skipped, failure))
            return keeper.finished(run.board)


def _alone_there(save: str | os.PathLike[str] | None) -> AbstractContextManager[None]:
    """Nobody else writes that file meanwhile; without a file there is nobody to keep away."""
    return nullcontext() if save is None else alone(Path(save).absolute().parent, Path(save).name)


def _check_names(methods: Sequence[Method | Submission]) -> None:
    names = [method.name for method in methods]
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"two methods are named {double!r}: a board tells them apart by name")
    if not names:
        raise InputError("no method to run")


def _check_parts(methods: Sequence[Method | Submission], worker: InProcess | Child) -> None:
    """What is missing is mended in a minute: it is no failure to keep on a board, nor one that ends what it holds."""
    for method in methods:
        if (missing := worker.lacks(method)) is not None:
            raise InputError(missing)


def spec_of(method: Method | Submission) -> str:
    """Everything that decides a method's answers, as text: its `spec`, or its name where it has none."""
    return str(getattr(method, "spec", method.name))


class _Run:
    """The board as it grows; one `pair` call a method and sample."""

    def __init__(
        self,
        plan: Plan,
        worker: InProcess | Child,
        board: Board,
        on_map: Callable[[str, str, Disparity], None] | None,
        on_drop: Callable[[str, str], None] | None,
        warm_up: bool,
    ) -> None:
        self.plan, self.worker, self.board, self.on_map, self.on_drop = plan, worker, board, on_map, on_drop
        self.warm_up = warm_up

    def pair(self, ready: Ready, method: Method | Submission) -> tuple[bool, Failure | None]:
        """Run and score one pair unless the board has it; (was it skipped, why did it fail)."""
        spec, sample = spec_of(method), ready.sample
        self._drop_stale(sample.name, ready.sha, method.name, spec)
        if self._is_done(method.name, ready):
            return True, None
        answer, failure = self._answer(sample, method)
        for rules in ready.protocols:
            entry = _entry(ready, method.name, spec, rules, answer, failure)
            self.board = self.board.having(self._scored(entry, ready, rules, answer))
        if answer is None:
            self._drop({(method.name, sample.name)})
        elif self.on_map is not None:
            self.on_map(method.name, sample.name, answer.disp)
        return False, failure

    def _drop_stale(self, sample: str, sha: str, method: str, spec: str) -> None:
        """What was measured on another sample of this name, or by another method of this name, is no longer true."""
        before = {(e.method, e.sample) for e in self.board.entries}
        self.board = self.board.without(
            lambda e: (e.sample == sample and e.sample_sha256 != sha) or (e.method == method and e.spec != spec)
        )
        self._drop(before - {(e.method, e.sample) for e in self.board.entries})

    def _drop(self, pairs: Iterable[tuple[str, str]]) -> None:
        if self.on_drop is not None:
            for method, sample in sorted(pairs):
                self.on_drop(method, sample)

    def _is_done(self, method: str, ready: Ready) -> bool:
        found = [self.board.find(method, ready.sample.name, rules.name) for rules in ready.protocols]
        return all(
            e is not None and (set(ready.masks) <= set(e.regions) if e.ok else not self.plan.retry_failed)
            for e in found
        )

    def _answer(self, sample: Pair, method: Method | Submission) -> tuple[Answer | None, Failure | None]:
        if isinstance(method, Submission):
            return _submitted(sample, method)
        images = np.array(sample.im0), np.array(sample.im1)  # copies: a method may scribble on its own
        try:
            if self.warm_up:
                self.worker.warm_up(method, *images, sample.search)
            return self.worker.call(method, *images, sample.search), None
        except MethodError as error:
            return None, error.failure

    def _scored(self, entry: Entry, ready: Ready, rules: Protocol, answer: Answer | None) -> Entry:
        if answer is None:
            return entry
        masks = ready.masks
        scores = evaluate(
            answer.disp,
            ready.sample.disp0,
            masks.get("nonocc"),
            ready.sample.ndisp,
            protocol=rules,
            regions={name: mask for name, mask in masks.items() if name not in RESERVED},
            min_disparity=ready.sample.min_disparity,
            calibration=ready.sample.calibration,
        )
        return replace(entry, regions={name: scores.regions[name] for name in masks})


def _submitted(sample: Pair, submission: Submission) -> tuple[Answer | None, Failure | None]:
    """The map as it lies there; a submission has no time."""
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
    ready: Ready, method: str, spec: str, rules: Protocol, answer: Answer | None, failure: Failure | None
) -> Entry:
    sample = ready.sample
    height, width = sample.disp0.shape
    return Entry(
        method,
        spec,
        sample.name,
        ready.sha,
        rules.name,
        width,
        height,
        int(sample.ndisp),
        None if answer is None else answer.seconds,
        failure,
        min_disparity=int(sample.min_disparity),
    )
