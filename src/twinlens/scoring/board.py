"""The leaderboard as data: one `Entry` for each method, sample and protocol, and means over samples."""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from twinlens.errors import InputError, check_known
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.metrics import TIMES, Metric, find_metric
from twinlens.scoring.protocols import PROTOCOLS, Protocol

LENS_SEPARATOR = " · "
"""In the name of a sample that has several lenses, between its view and its lens."""
Recorded = str | float
"""A recorded value of a sample."""
FAILURES: Mapping[str, str] = {
    "crash": "the method raised an exception, or its process died",
    "memory": "the method ran out of memory, or exceeded its memory limit",
    "time-limit": "the method exceeded the time limit",
    "wrong-type": "the result is not an array of disparities",
    "wrong-shape": "the map's size differs from the left image's",
    "not-a-number": "the map contains NaN or -inf",
    "missing": "the submission has no map of this sample",
    "refused": "the submission's map is damaged or has the wrong size",
}


@dataclass(frozen=True)
class MatchFailure:
    """Why a method has no scores on a pair: a kind of `FAILURES`, and the details in one line.

    frames : where an exception came from, the last calls of its traceback, one line each.
    """

    kind: str
    message: str
    frames: tuple[str, ...] = ()


@dataclass(frozen=True)
class Entry:
    """One method on one sample by one protocol: scores by region, or the failure.

    spec: everything that determines the method's results. sample_sha256: see `samples.fingerprint`. ndisp: number of
    disparities from `min_disparity`. seconds: wall time of the match, None if it failed or was not measured. doubt:
    see `Scores.doubt`.
    """

    method: str
    spec: str
    sample: str
    sample_sha256: str
    protocol: str
    width: int
    height: int
    ndisp: int
    min_disparity: int = field(default=0, kw_only=True)
    seconds: float | None
    failure: MatchFailure | None
    regions: Mapping[str, RegionScores] = field(default_factory=dict)
    doubt: str = field(default="", kw_only=True)

    @property
    def key(self) -> tuple[str, str, str]:
        """Unique among the entries of a board."""
        return self.method, self.sample, self.protocol

    @property
    def ok(self) -> bool:
        """Whether the entry has scores."""
        return self.failure is None

    def evaluated(self, region: str) -> int:
        """Number of scored pixels of the region; 0 without that region."""
        return self.regions[region].evaluated if region in self.regions else 0

    def times(self) -> dict[str, float]:
        """time in s; time/MP in s per 10^6 pixels; time/GD in s per 10^9 pixels x ndisp. NaN if not measured."""
        seconds = math.nan if self.seconds is None else self.seconds
        pixels = self.width * self.height
        return {
            "time": seconds,
            "time/MP": seconds / pixels * 1e6,
            "time/GD": seconds / (pixels * self.ndisp) * 1e9,
        }

    def value(self, region: str, metric: str) -> float:
        """One metric or time of this entry; NaN if it is missing."""
        if metric in TIMES:
            return self.times()[metric]
        if region not in self.regions:
            return math.nan
        return self.regions[region].get(metric, math.nan)


@dataclass(frozen=True)
class Disagreement:
    """Two methods' maps of a sample: of the `compared` pixels, where both have an estimate, the percentage that differ
    by more than 1 px; NaN without such pixels."""

    sample: str
    first: str
    second: str
    compared: int
    apart: float


@dataclass(frozen=True)
class Mean:
    """A method's means of metrics over `counted` samples in one region.

    failed: samples on which the method failed. missing: samples on which only other methods were run. With any of
    these, every mean is NaN, because a mean over fewer, easier samples is not comparable.
    """

    method: str
    metrics: Mapping[str, float]
    counted: int
    failed: tuple[str, ...]
    missing: tuple[str, ...] = ()

    @property
    def total(self) -> int:
        """Number of samples that a complete mean covers."""
        return self.counted + len(self.failed) + len(self.missing)


@dataclass(frozen=True)
class Board:
    """All entries in order of measurement. meta: versions and machine. scenes: the scene of each sample.

    recorded: for each sample, what is recorded of how it was made, by name: see `scoring.recorded`.
    disagreements: of the methods on samples that are compared without truth; see `consistency.with_disagreements`.
    """

    title: str = "twinlens board"
    entries: tuple[Entry, ...] = ()
    meta: Mapping[str, str] = field(default_factory=dict)
    scenes: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, Mapping[str, Recorded]] = field(default_factory=dict)
    disagreements: tuple[Disagreement, ...] = ()

    def __post_init__(self) -> None:
        seen: set[tuple[str, str, str]] = set()
        for entry in self.entries:
            if entry.key in seen:
                raise InputError(
                    f"the board has two entries for {' / '.join(entry.key)}: names must be unique"
                )
            check_known("protocol", entry.protocol, PROTOCOLS)
            seen.add(entry.key)

    # Names in the order of their first entries.

    @property
    def methods(self) -> tuple[str, ...]:
        return _unique(entry.method for entry in self.entries)

    @property
    def samples(self) -> tuple[str, ...]:
        return _unique(entry.sample for entry in self.entries)

    @property
    def protocols(self) -> tuple[str, ...]:
        return _unique(entry.protocol for entry in self.entries)

    @property
    def regions(self) -> tuple[str, ...]:
        return _regions(self.entries)

    def rules(
        self,
        protocol: str,
        region: str,
        metric: str | None = None,
        where: str = "this board",
    ) -> tuple[Protocol, Metric]:
        """The protocol and the metric of these names; the metric is the protocol's headline by default.

        Raises InputError if the board has no such protocol or region, or the protocol no such metric.
        """
        check_known(f"protocol on {where}", protocol, self.protocols)
        check_known(f"region on {where}", region, self.regions)
        rules = PROTOCOLS[protocol]
        chosen = find_metric(metric or rules.headline)
        check_known("metric", chosen.name, (*rules.metrics, *TIMES))
        return rules, chosen

    def samples_of(self, protocol: str) -> tuple[str, ...]:
        """The samples with entries of a protocol: one that needs truth has none of a sample without truth."""
        return _unique(
            entry.sample for entry in self.entries if entry.protocol == protocol
        )

    def regions_of(self, protocol: str) -> tuple[str, ...]:
        """The regions that entries of a protocol have."""
        return _regions(entry for entry in self.entries if entry.protocol == protocol)

    @property
    def maps(self) -> set[tuple[str, str]]:
        """(method, sample) of each map, which has an entry for each protocol."""
        return {(entry.method, entry.sample) for entry in self.entries}

    def scene(self, sample: str) -> str:
        """The scene of a sample; on a board that has none, its view: the name without the lens."""
        return self.scenes.get(sample) or sample.partition(LENS_SEPARATOR)[0]

    def find(self, method: str, sample: str, protocol: str) -> Entry | None:
        """The entry with that key, or None."""
        for entry in self.entries:
            if entry.key == (method, sample, protocol):
                return entry
        return None

    def check_sample(self, name: str, sha256: str) -> None:
        """Raise InputError if this board's entries of the sample have another fingerprint (`samples.fingerprint`)."""
        hashes = {entry.sample_sha256 for entry in self.entries if entry.sample == name}
        if hashes - {sha256}:
            what = f"sample {name!r} is not the one that the board scores: its images, truth or search range differ"
            raise InputError(f"{what}; use the board's dataset, or another board")
        view = name.partition(LENS_SEPARATOR)[0] + LENS_SEPARATOR
        for entry in self.entries:
            is_same = entry.sample_sha256 == sha256 and entry.sample.startswith(view)
            if is_same and entry.sample != name and sha256:
                raise InputError(
                    f"sample {name!r} is on the board as {entry.sample!r}, the name that an earlier version gave it; "
                    "use another folder for the board"
                )

    def having(self, entry: Entry) -> "Board":
        """A board with `entry` in place of the one with its key, or appended."""
        entries = {old.key: old for old in self.entries} | {entry.key: entry}
        return replace(self, entries=tuple(entries.values()))

    def subset(self, samples: Collection[str]) -> "Board":
        """The board of these samples only."""
        return self.without(lambda entry: entry.sample not in samples)

    def without(self, unwanted: Callable[[Entry], bool]) -> "Board":
        """A board without the entries for which `unwanted` is True."""
        entries = tuple(entry for entry in self.entries if not unwanted(entry))
        maps = {(entry.method, entry.sample) for entry in entries}
        disagreements = tuple(
            pair
            for pair in self.disagreements
            if maps >= {(pair.first, pair.sample), (pair.second, pair.sample)}
        )
        return replace(self, entries=entries, disagreements=disagreements)

    def mean(
        self,
        method: str,
        protocol: str,
        region: str,
        weights: Mapping[str, float] | None = None,
    ) -> Mean:
        """The weighted mean over samples with pixels in the region, sum(w x) / sum(w), with weight 1 by default.

        Raises InputError for a weight of an unknown sample, or a negative weight.
        """
        return self.means(protocol, region, weights, [method])[method]

    def means(
        self,
        protocol: str,
        region: str,
        weights: Mapping[str, float] | None = None,
        methods: Sequence[str] | None = None,
    ) -> dict[str, Mean]:
        """Method -> its `mean`, of these methods or of all."""
        weights = weights or {}
        samples = self.samples if weights else ()
        for name, weight in weights.items():
            check_known("sample", name, samples)
            if not (math.isfinite(weight) and weight >= 0):
                raise InputError(
                    f"the weight of {name!r} is {weight}: expected a finite number >= 0"
                )
        entries = [entry for entry in self.entries if entry.protocol == protocol]
        expected = _expected_samples(entries, region)
        of_methods: dict[str, list[Entry]] = {
            name: [] for name in (self.methods if methods is None else methods)
        }
        for entry in entries:
            if entry.method in of_methods:
                of_methods[entry.method].append(entry)
        return {
            name: _mean(name, PROTOCOLS[protocol], region, of_method, expected, weights)
            for name, of_method in of_methods.items()
        }


def _mean(
    method: str,
    protocol: Protocol,
    region: str,
    entries: Sequence[Entry],
    expected: Sequence[str],
    weights: Mapping[str, float],
) -> Mean:
    """The mean of a method with these entries by the protocol, over the expected samples."""
    scored = [entry for entry in entries if entry.evaluated(region)]
    failed = tuple(entry.sample for entry in entries if not entry.ok)
    covered = {*failed, *(entry.sample for entry in scored)}
    missing = tuple(name for name in expected if name not in covered)
    metrics = (*protocol.metrics, *TIMES)
    if failed or missing:
        unknown = dict.fromkeys(metrics, math.nan)
        return Mean(method, unknown, len(scored), failed, missing)
    weighted = [(entry, weights.get(entry.sample, 1.0)) for entry in scored]
    # A value may be infinite or NaN, which a weight of 0 would not remove from the sum.
    counted = [(entry, weight) for entry, weight in weighted if weight > 0]
    total = math.fsum(weight for _, weight in counted) or math.nan
    means = {}
    for name in metrics:
        terms = [entry.value(region, name) * weight for entry, weight in counted]
        means[name] = math.fsum(terms) / total
    return Mean(method, means, len(scored), ())


def _expected_samples(entries: Sequence[Entry], region: str) -> tuple[str, ...]:
    """The samples that a mean covers: with pixels in the region, or on which no method has a score."""
    succeeded = {entry.sample for entry in entries if entry.ok}
    return _unique(
        entry.sample
        for entry in entries
        if entry.evaluated(region) or entry.sample not in succeeded
    )


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _regions(entries: Iterable[Entry]) -> tuple[str, ...]:
    """The names of the regions of all entries, in order of appearance."""
    names: list[str] = []
    for entry in entries:
        names += entry.regions
    return _unique(names)
