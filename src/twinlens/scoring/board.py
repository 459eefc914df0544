"""The leaderboard as data: one `Entry` for every method x sample x protocol, and means over samples. Prints nothing."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

from twinlens.errors import InputError, unknown
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.protocols import PROTOCOLS

FAILURES: Mapping[str, str] = MappingProxyType(
    {
        "crash": "it raised an exception, or its process died",
        "memory": "it asked for more memory than there is, or than it may have",
        "time-limit": "it did not answer within the time limit",
        "wrong-type": "it answered something that is no array of disparities",
        "wrong-shape": "its map has another size than the left image",
        "not-a-number": "its map holds NaN or -inf",
        "missing": "a submission has no map of this sample",
        "refused": "a submission's map is damaged or of the wrong size",
    }
)
"""Why a method can fail on a pair: kind -> what it means."""


@dataclass(frozen=True)
class Failure:
    """Why there are no scores: one of `FAILURES`, and what was seen, in one line."""

    kind: str
    message: str

    def __post_init__(self) -> None:
        if self.kind not in FAILURES:
            raise unknown("failure", self.kind, FAILURES)


@dataclass(frozen=True)
class Entry:
    """One method on one sample by one protocol: scores by region, or the failure.

    spec: everything that decides the method's answer. sample_sha256: of the images, truth, mask and search, which was
    of `ndisp` disparities from `min_disparity`. seconds: wall time of the call, None where it did not end or was not
    measured.
    """

    method: str
    spec: str
    sample: str
    sample_sha256: str
    protocol: str
    width: int
    height: int
    ndisp: int
    seconds: float | None
    failure: Failure | None
    regions: Mapping[str, RegionScores] = field(default_factory=dict)
    min_disparity: int = 0

    @property
    def key(self) -> tuple[str, str, str]:
        """What no two entries of a board share."""
        return self.method, self.sample, self.protocol

    @property
    def ok(self) -> bool:
        """Whether there are scores."""
        return self.failure is None

    def evaluated(self, region: str) -> int:
        """How many pixels of the region were scored; 0 where it is not there."""
        return self.regions[region].evaluated if region in self.regions else 0

    def times(self) -> dict[str, float]:
        """time in s; time/MP in s per 10^6 pixels; time/GD in s per 10^9 pixels x ndisp. NaN where not measured."""
        seconds = math.nan if self.seconds is None else self.seconds
        pixels = self.width * self.height
        return {"time": seconds, "time/MP": seconds / pixels * 1e6, "time/GD": seconds / (pixels * self.ndisp) * 1e9}

    def value(self, region: str, metric: str) -> float:
        """One number of this entry; NaN where it does not exist."""
        times = self.times()
        if metric in times:
            return times[metric]
        scores = self.regions.get(region)
        return math.nan if scores is None else scores.get(metric, math.nan)


@dataclass(frozen=True)
class Mean:
    """A method's mean over samples in one region: `metrics`, over `counted` samples; the others are named.

    failed: it was run and gave nothing to score. missing: it was not run, and the board has the sample by another
    method. If there is one of either, every mean is NaN: a mean over the easier rest would beat honest ones.
    """

    method: str
    metrics: Mapping[str, float]
    counted: int
    failed: tuple[str, ...]
    missing: tuple[str, ...] = ()

    @property
    def total(self) -> int:
        """How many samples there are to count."""
        return self.counted + len(self.failed) + len(self.missing)


@dataclass(frozen=True)
class Board:
    """All entries, in the order they were made, and what made them (`meta`: versions, machine)."""

    title: str = "twinlens board"
    entries: tuple[Entry, ...] = ()
    meta: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        seen: set[tuple[str, str, str]] = set()
        for entry in self.entries:
            if entry.key in seen:
                raise InputError(f"the board has two entries for {' / '.join(entry.key)}: names must be unique")
            if entry.protocol not in PROTOCOLS:
                raise unknown("protocol", entry.protocol, PROTOCOLS)
            seen.add(entry.key)

    @property
    def methods(self) -> tuple[str, ...]:
        """Method names, by first appearance."""
        return _unique(entry.method for entry in self.entries)

    @property
    def samples(self) -> tuple[str, ...]:
        """Sample names, by first appearance."""
        return _unique(entry.sample for entry in self.entries)

    @property
    def protocols(self) -> tuple[str, ...]:
        """Protocol names, by first appearance."""
        return _unique(entry.protocol for entry in self.entries)

    @property
    def regions(self) -> tuple[str, ...]:
        """Region names, by first appearance."""
        return _unique(name for entry in self.entries for name in entry.regions)

    def find(self, method: str, sample: str, protocol: str) -> Entry | None:
        """The entry of that key, or None."""
        wanted = (method, sample, protocol)
        return next((entry for entry in self.entries if entry.key == wanted), None)

    def having(self, entry: Entry) -> "Board":
        """A board with `entry` in place of the one of its key, or at the end."""
        if all(old.key != entry.key for old in self.entries):
            return replace(self, entries=(*self.entries, entry))
        return replace(self, entries=tuple(entry if old.key == entry.key else old for old in self.entries))

    def without(self, unwanted: Callable[[Entry], bool]) -> "Board":
        """A board with no entry of which `unwanted` is true."""
        return replace(self, entries=tuple(entry for entry in self.entries if not unwanted(entry)))

    def mean(self, method: str, protocol: str, region: str, weights: Mapping[str, float] | None = None) -> Mean:
        """The weighted mean over samples, sum(w x) / sum(w); every weight is 1 where none is given.

        A sample that has no pixel in the region (or not the region at all) by any method counts for none. One that the
        board has, and this method was not run on, is missing.

        Raises
        ------
        InputError
            A weight for an unknown sample, or a negative one.
        """
        _check_weights(weights or {}, self.samples)
        mine = [e for e in self._scored_by(protocol) if e.method == method]
        failed = tuple(e.sample for e in mine if not e.ok)
        there = [e for e in mine if e.evaluated(region)]
        had = {*failed, *(e.sample for e in there)}
        missing = tuple(name for name in self._counting(protocol, region) if name not in had)
        names = (*PROTOCOLS[protocol].metrics, "time", "time/MP", "time/GD")
        factors = [(weights or {}).get(e.sample, 1.0) for e in there]
        partly = bool(failed or missing)
        means = {n: math.nan if partly else _mean([e.value(region, n) for e in there], factors) for n in names}
        return Mean(method, means, len(there), failed, missing)

    def _scored_by(self, protocol: str) -> list[Entry]:
        return self._by_protocol.get(protocol, [])

    @cached_property
    def _by_protocol(self) -> dict[str, list[Entry]]:
        """A page asks for the means of every method, protocol and region: each time through all would be slow."""
        found: dict[str, list[Entry]] = {}
        for entry in self.entries:
            found.setdefault(entry.protocol, []).append(entry)
        return found

    def _counting(self, protocol: str, region: str) -> tuple[str, ...]:
        """The samples that count: some method has pixels there, or none has an answer that could say."""
        mine = self._scored_by(protocol)
        answered = {e.sample for e in mine if e.ok}
        return _unique(e.sample for e in mine if e.evaluated(region) or e.sample not in answered)


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _check_weights(weights: Mapping[str, float], samples: tuple[str, ...]) -> None:
    for name, weight in weights.items():
        if name not in samples:
            raise unknown("sample", name, samples)
        if not (math.isfinite(weight) and weight >= 0):
            raise InputError(f"the weight of {name!r} is {weight}: expected a finite number, 0 or more")


def _mean(values: list[float], weights: list[float]) -> float:
    counted = [(v, w) for v, w in zip(values, weights, strict=True) if w > 0]
    total = math.fsum(w for _, w in counted)
    return math.fsum(v * w for v, w in counted) / total if total else math.nan
