"""What a run of the benchmark goes through: the rules and regions asked for, and every sample made ready for them once.

Runs no method and scores nothing.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from twinlens.errors import InputError
from twinlens.scoring.checks import Mask
from twinlens.scoring.pair import Pair, Sample, fingerprint, load_pair
from twinlens.scoring.protocols import Protocol, find_protocol
from twinlens.scoring.region_sets import region_masks


@dataclass(frozen=True)
class Plan:
    """What stays the same for every pair of a run."""

    protocols: tuple[Protocol, ...]
    regions: tuple[str, ...]
    retry_failed: bool


def plan_of(protocol: str | Sequence[str], regions: Sequence[str], retry_failed: bool) -> Plan:
    """The plan of those names; InputError for an unknown protocol, or none, or no region."""
    names = (protocol,) if isinstance(protocol, str) else tuple(protocol)
    if not names or not regions:
        raise InputError("nothing to score: name at least one protocol and one region")
    return Plan(tuple(find_protocol(name) for name in names), tuple(regions), retry_failed)


@dataclass(frozen=True)
class Ready:
    """A sample, loaded and checked; its fingerprint, region masks and protocols, made once for all methods."""

    sample: Pair
    sha: str
    masks: dict[str, Mask]
    protocols: tuple[Protocol, ...]


def ready_samples(samples: Iterable[Sample], plan: Plan) -> Iterator[Ready]:
    """Each sample in turn, loaded when it is asked for; InputError where two share a name."""
    seen: set[str] = set()
    for sample in samples:
        if sample.name in seen:
            raise InputError(f"two samples are named {sample.name!r}: a board tells them apart by name")
        seen.add(sample.name)
        pair = load_pair(sample)
        protocols = tuple(p for p in plan.protocols if pair.calibration is not None or not p.needs_calibration)
        yield Ready(pair, fingerprint(pair), region_masks(pair, plan.regions), protocols)
