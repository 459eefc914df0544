"""`run_benchmark`: methods x samples -> a `Board`, resumable. A match is one method on one sample."""

import itertools
import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from twinlens.dataset.files import locked
from twinlens.errors import FileError, InputError
from twinlens.matching import Answer, parse_methods
from twinlens.matching.features import disparities_of_features
from twinlens.scoring.board import Board, Entry, MatchFailure
from twinlens.scoring.board_file import BoardWriter, read_board
from twinlens.scoring.consistency import check_views, mirrored
from twinlens.scoring.doubts import doubt_of_order, doubt_of_search
from twinlens.scoring.evaluate import (
    RESERVED,
    Scores,
    evaluate,
    upsampled,
    upsampling,
)
from twinlens.scoring.metrics import Disparity, Mask
from twinlens.scoring.protocols import (
    CONSISTENCY,
    PROTOCOLS,
    Protocol,
    find_protocol,
)
from twinlens.scoring.regions import region_masks
from twinlens.scoring.runners import (
    WARM_UP_LIMIT_S,
    Match,
    Method,
    MethodError,
    Runner,
)
from twinlens.scoring.samples import Pair, ScoredSample, fingerprint, load_pair
from twinlens.scoring.submission import Submission
from twinlens.scoring.tables import map_warnings

_FEW_CONFIRMED = 60.0
"""Percent of the pixels of a pair without truth; of rectified pairs of textured scenes, matchers confirm more."""


@dataclass(frozen=True)
class Step:
    """The argument of `progress`. done, total: numbers of matches; total is None if the samples have no length."""

    done: int
    total: int | None
    method: str
    sample: str
    skipped: bool
    failure: MatchFailure | None


def run_benchmark(
    samples: Iterable[ScoredSample],
    methods: Sequence[Method | Submission | str],
    *,
    protocol: str | Sequence[str] = "middlebury-v3",
    regions: Sequence[str] = ("all", "nonocc"),
    progress: Callable[[Step], None] | None = None,
    time_limit: float | None = None,
    memory_limit: float | None = None,
    warm_up: bool = True,
    warm_up_limit: float = WARM_UP_LIMIT_S,
    save: str | os.PathLike[str] | None = None,
    board: Board | None = None,
    retry_failed: bool = False,
    on_map: Callable[[str, str, Disparity], None] | None = None,
    on_right_map: Callable[[str, str, Disparity], None] | None = None,
    on_drop: Callable[[str, str], None] | None = None,
    title: str = "twinlens board",
) -> Board:
    """Run every method on every sample, score the maps, and return the board.

    Parameters
    ----------
    samples
        A `Dataset`, or other objects like `samples.ScoredSample`. A sample is in memory only while it is scored.
    methods
        Texts such as "zncc:block_size=15", as for `matching.parse_methods`, objects as `runners.Method` describes, or
        `Submission`s, with unique names. Their `spec`, or else their name, must change whenever results may change.
    protocol, regions
        Names of `PROTOCOLS` and `REGIONS`. Each map is computed once and scored by all; those that need a calibration
        or data that a sample does not have are skipped. A sample without truth is measured by "consistency", for which
        every method also computes the right view's map, from the mirrored images.
    time_limit, memory_limit, warm_up, warm_up_limit
        Limits of a match and its warm-up, see `runners.Runner`.
    save, board, retry_failed
        The board's JSON file: read first if it exists, written every few seconds and at the end, and locked against
        other runs. `board` is resumed instead of the file. A match is skipped if the board has its entries for the
        same method spec, sample fingerprint, protocol and regions, unless they are failures and `retry_failed` is set.
    progress, on_map, on_right_map, on_drop
        Called after every match; for every computed map, with the names of method and sample and the disparity at the
        left image's size; for every map of a right view, likewise; and with both names for every earlier map that is no
        longer valid.

    Gives one `MapWarning` for each method whose maps look wrong in scale, sign or orientation (`Scores.doubt`).

    Raises InputError for unknown protocols and regions, names that are not unique, a sample that cannot be scored or
    differs from the board's, and, before anything runs, a missing file or function of a method; FileError or
    OutputError if `save` is not a board, cannot be written, or is locked by another run.
    """
    names = (protocol,) if isinstance(protocol, str) else tuple(protocol)
    if not names or not regions:
        raise InputError("nothing to score: name at least one protocol and one region")
    protocols = [find_protocol(name) for name in names]
    runs = _named_runs([methods] if isinstance(methods, str) else methods)
    total = len(samples) * len(runs) if isinstance(samples, Sized) else None
    runner = Runner(time_limit, memory_limit, warm_up, warm_up_limit)
    report = progress or _ignore
    with _locked(save), closing(runner):
        board = _resumed(save) if board is None else board
        with BoardWriter(replace(board, title=title), save) as writer:
            for method in runs:
                runner.check_parts(method)
            numbers = itertools.count(1)
            for sample in _uniquely_named(samples):
                run = replace(
                    _Run.of(sample, runner, writer, protocols, regions),
                    retry_failed=retry_failed,
                    on_map=on_map or _ignore,
                    on_right_map=on_right_map or _ignore,
                    on_drop=on_drop or _ignore,
                )
                for method in runs:
                    outcome = run.match(method)
                    done = next(numbers)
                    report(Step(done, total, method.name, sample.name, *outcome))
        for line in map_warnings(writer.board, [method.name for method in runs]):
            warnings.warn(line, MapWarning, stacklevel=2)
        return writer.board


def _resumed(save: str | os.PathLike[str] | None) -> Board:
    """The board of a file, or an empty one if there is none."""
    if save is None or not Path(save).exists():
        return Board()
    return read_board(save)


def _uniquely_named(samples: Iterable[ScoredSample]) -> Iterator[ScoredSample]:
    """The samples. Raises InputError for a name that comes twice."""
    names: set[str] = set()
    for sample in samples:
        _check_unique("sample", sample.name, names)
        yield sample


class MapWarning(UserWarning):
    """A method's maps look right but for their scale, sign, orientation or mark of unknown pixels."""


def _named_runs(
    methods: Iterable[Method | Submission | str],
) -> list[Method | Submission]:
    """Texts as methods, and all with unique names."""
    runs: list[Method | Submission] = []
    for method in methods:
        runs += parse_methods([method]) if isinstance(method, str) else [method]
    if not runs:
        raise InputError("no method to run")
    names: set[str] = set()
    for run in runs:
        if not isinstance(getattr(run, "name", None), str):
            hint = "give it one, or name a method as text, such as 'zncc:block_size=15'"
            raise InputError(f"{type(run).__name__} has no name for the board: {hint}")
        _check_unique("method", run.name, names)
    return runs


def _locked(save: str | os.PathLike[str] | None) -> AbstractContextManager[object]:
    """Keeps other runs from writing the board's file."""
    if save is None:
        return nullcontext()
    return locked(Path(save).absolute().parent, file=Path(save).name)


def _ignore(*_: object) -> None:
    """For callbacks that are not given."""


def spec_of(method: Method | Submission) -> str:
    """A method's `spec`, the text that determines its results, or else its name."""
    return str(getattr(method, "spec", method.name))


def _check_unique(kind: str, name: str, names: set[str]) -> None:
    if name in names:
        raise InputError(
            f"two {kind}s are named {name!r}: names on a board must be unique"
        )
    names.add(name)


class _WrongSizeError(Exception):
    """A map has a size that the protocol does not accept."""


@dataclass(frozen=True)
class _Run:
    """Runs and scores the matches of a sample by the applicable protocols, and adds their entries to the board."""

    sample: Pair
    sha: str
    masks: dict[str, Mask]
    protocols: Sequence[Protocol]
    runner: Runner
    writer: BoardWriter
    retry_failed: bool = False
    on_map: Callable[[str, str, Disparity], None] = _ignore
    on_right_map: Callable[[str, str, Disparity], None] = _ignore
    on_drop: Callable[[str, str], None] = _ignore

    @classmethod
    def of(
        cls,
        sample: ScoredSample,
        runner: Runner,
        writer: BoardWriter,
        protocols: Sequence[Protocol],
        regions: Sequence[str],
    ) -> "_Run":
        """The runs of a sample, whose origin is then on the board. Raises InputError if it differs from the board's."""
        pair = load_pair(sample)
        pair.warn_of_search()
        sha, masks = fingerprint(pair), region_masks(pair, regions)
        applicable = [rules for rules in protocols if rules.applies_to(pair)]
        if pair.disp0 is None:
            # No region that is asked for may exist without truth: the whole image always does.
            applicable = applicable or [PROTOCOLS[CONSISTENCY]]
            masks = masks or region_masks(pair, ["all"])
        writer.board.check_sample(pair.name, sha)
        scenes = {**writer.board.scenes, pair.name: pair.scene or pair.name}
        recorded = {**writer.board.recorded, pair.name: pair.recorded}
        writer.board = replace(writer.board, scenes=scenes, recorded=recorded)
        return cls(pair, sha, masks, applicable, runner, writer)

    def match(self, method: Method | Submission) -> tuple[bool, MatchFailure | None]:
        """Run and score a match unless the board has it: (skipped, failure)."""
        sample, board = self.sample, self._without_stale(method)
        earlier = [
            board.find(method.name, sample.name, rules.name) for rules in self.protocols
        ]
        if all(self._is_valid(entry) for entry in earlier):
            return True, None
        match = self._match(method)
        entries = [self._entry(method, rules, match) for rules in self.protocols]
        for entry in entries:
            board = board.having(entry)
        if isinstance(match, MatchFailure):
            self.on_drop(method.name, sample.name)
        else:
            self._report_maps(method.name, match)
        # After the map, so that the board lists no map that is missing.
        self.writer.update(board)
        failures = [entry.failure for entry in entries if not entry.ok]
        return False, failures[0] if failures else None

    def _report_maps(self, method: str, match: Match) -> None:
        """Call `on_map` and `on_right_map` with the maps of a match, at the left image's size."""
        disparity = match.answer.disparity
        scale = self.sample.shape[0] // disparity.shape[0]
        self.on_map(method, self.sample.name, upsampled(disparity, scale))
        if match.right is not None:
            self.on_right_map(method, self.sample.name, match.right)

    def _is_valid(self, entry: Entry | None) -> bool:
        """Whether an earlier entry makes the match unnecessary."""
        if entry is None:
            return False
        if not entry.ok:
            return not self.retry_failed
        if self.retry_failed and _failed_mirrored(entry):
            return False
        return entry.regions.keys() >= self.masks.keys()

    def _without_stale(self, method: Method | Submission) -> Board:
        """The board without entries of an earlier method with the same name but another spec."""
        spec = spec_of(method)
        before = self.writer.board
        kept = before.without(
            lambda entry: entry.method == method.name and entry.spec != spec
        )
        if len(kept.entries) < len(before.entries):
            self.writer.update(kept)
        dropped = before.maps - kept.maps
        for method_name, sample_name in sorted(dropped):
            self.on_drop(method_name, sample_name)
        return kept

    def _match(self, method: Method | Submission) -> Match | MatchFailure:
        """The map that the method computes, or that a submission contains; the latter has no run time."""
        sample = self.sample
        if isinstance(method, Submission):
            kind = (
                "missing"
                if method.find(sample.name, sample.aliases) is None
                else "refused"
            )
            try:
                disp = method.map_of(sample.name, sample.shape, sample.aliases)
                confidence = method.confidence_of(
                    sample.name, disp.shape, sample.aliases
                )
                return Match(Answer(disp, confidence), None)
            except FileError as error:
                return MatchFailure(kind, str(error))
        try:
            match = self.runner.match(method, sample)
        except MethodError as error:
            return error.failure
        if all(rules.needs_truth for rules in self.protocols):
            return match
        return self._with_right(method, match)

    def _with_right(self, method: Method, match: Match) -> Match:
        """The match with the map of the right view, from the mirrored images.

        Where the method fails on these, a warning says why and the match stays as it is, without left-right measures.
        """
        try:
            of_mirrored = self.runner.match(method, mirrored(self.sample))
        except MethodError as error:
            failure = error.failure
            warnings.warn(
                f"{method.name} on {self.sample.name!r}: no left-right measures, because it failed on the mirrored "
                f"images ({failure.kind}: {failure.message})",
                stacklevel=2,
            )
            return match
        # The time of a match is that of the left map.
        right = np.ascontiguousarray(of_mirrored.answer.disparity[:, ::-1])
        return replace(match, right=right)

    def _entry(
        self, method: Method | Submission, rules: Protocol, match: Match | MatchFailure
    ) -> Entry:
        sample, (height, width) = self.sample, self.sample.shape
        ndisp, first = int(sample.ndisp), int(sample.min_disparity)
        key = method.name, spec_of(method), sample.name, self.sha, rules.name
        if isinstance(match, MatchFailure):
            return Entry(*key, width, height, ndisp, None, match, min_disparity=first)
        entry = Entry(
            *key, width, height, ndisp, match.seconds, None, min_disparity=first
        )
        try:
            scores = self._scores(rules, match)
        except _WrongSizeError as error:
            return replace(entry, failure=MatchFailure("refused", str(error)))
        scored = {name: scores.regions[name] for name in self.masks}
        return replace(entry, regions=scored, doubt=scores.doubt)

    def _scores(self, rules: Protocol, match: Match) -> Scores:
        """The scores of a match by a protocol. Raises _WrongSizeError for a map of a size that it does not accept."""
        sample, (disparity, confidence) = self.sample, match.answer
        try:
            scale = upsampling(disparity.shape, sample.shape, rules)
        except InputError as error:
            raise _WrongSizeError(str(error)) from error
        if sample.disp0 is None or not rules.needs_truth:
            scores = check_views(
                disparity, sample.im0, sample.im1, match.right, self.masks
            )
            first = sample.min_disparity / scale
            last = (sample.min_disparity + sample.ndisp - 1) / scale
            doubt = doubt_of_search(disparity, first, last)
            if doubt or self._few_are_confirmed(scores):
                doubt = self._doubt_of_order or doubt
            return replace(scores, doubt=doubt)
        return evaluate(
            disparity,
            sample.disp0,
            self.masks.get("nonocc"),
            sample.ndisp / scale,
            protocol=rules,
            regions={
                name: mask for name, mask in self.masks.items() if name not in RESERVED
            },
            min_disparity=sample.min_disparity / scale,
            calibration=sample.calibration,
            confidence=confidence,
        )

    def _few_are_confirmed(self, scores: Scores) -> bool:
        """Whether the right map contradicts most of the left one in the largest region."""
        shares = [region["confirmed"] for region in scores.regions.values()]
        return max(shares, default=math.nan) < _FEW_CONFIRMED

    @cached_property
    def _doubt_of_order(self) -> str:
        """Whether the pair's images look exchanged; matching features takes longer than a fast method."""
        sample = self.sample
        disparities = disparities_of_features(sample.im0, sample.im1)
        return doubt_of_order(disparities, sample.min_disparity)


def _failed_mirrored(entry: Entry) -> bool:
    """Whether an entry lacks the measures of the right view: its match failed on the mirrored images."""
    if PROTOCOLS[entry.protocol].needs_truth:
        return False
    shares = [entry.value(region, "lr_consistent") for region in entry.regions]
    return all(map(math.isnan, shares))
