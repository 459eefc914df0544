"""Groups of a board's samples by a recorded value, and how the methods' means differ between two groups.

Samples of one scene are not independent, so intervals are over scenes. Where two groups are of the same scenes, such as
two lenses of each sample, their difference is taken within each scene, and what scenes differ in cancels.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twinlens.errors import InputError, check_known, counted
from twinlens.scoring.board import Board, Recorded
from twinlens.scoring.intervals import (
    MIN_UNITS,
    Interval,
    difference_of_means,
    mean_of_units,
)

Groups = Mapping[str, Collection[str]]
"""Title -> names of the samples of a group."""
SCENE = "scene"
NOT_RECORDED = "not recorded"
MAX_GROUPS = 12
_MOST_NUMBERS, _RANGES = 6, 3
"""Numbers of more than so many values, or with fewer than three samples each, are grouped in so many ranges."""
_MOST_DIGITS = 17
"""With so many significant digits any two float64 numbers differ."""
_LEAST_SHARED = 2
"""A difference within fewer scenes has no interval."""
DIFFERENCES = (
    "differences: each group minus the first one; negative is better for errors; with 95 % intervals by the bootstrap "
    f"over scenes, with fewer than {MIN_UNITS} "
    "scenes their range; paired: the mean over the scenes that both groups have, which differs from the difference of "
    "the two columns where scenes are left out (k of n scenes) or have unequal numbers of samples"
)
"""What is written below a table of differences."""


def recorded_value(board: Board, sample: str, name: str) -> Recorded | None:
    """What is recorded of a sample under a name, and its scene under "scene"; None where nothing is."""
    if name == SCENE:
        return board.scene(sample)
    return board.recorded.get(sample, {}).get(name)


def recorded_names(board: Board, further: Iterable[str] = ()) -> tuple[str, ...]:
    """All names of recorded values, in order of appearance, and "scene"; further: samples without an entry."""
    samples = dict.fromkeys([*board.samples, *further])
    names = [name for sample in samples for name in board.recorded.get(sample, {})]
    return tuple(dict.fromkeys([*names, SCENE]))


def groups_by(
    board: Board, name: str, further: Iterable[str] = ()
) -> dict[str, tuple[str, ...]]:
    """Group -> its samples, for a recorded value: one group for each text, in order of appearance, or number.

    Numbers that hardly any samples share are grouped in three ranges of about as many samples. Samples without the
    value come last. further: samples that have no entry yet.

    Raises InputError for an unknown name, and unless there are 2 to `MAX_GROUPS` groups.
    """
    check_known("recorded value", name, recorded_names(board, further))
    samples = dict.fromkeys([*board.samples, *further])
    values = {sample: recorded_value(board, sample, name) for sample in samples}
    titles = _titles(values)
    groups: dict[str, list[str]] = {title: [] for title in titles.values()}
    for sample, value in values.items():
        groups[NOT_RECORDED if value is None else titles[value]].append(sample)
    if not 2 <= len(groups) <= MAX_GROUPS:
        count = f"{len(groups)} groups" if len(groups) > 1 else "one group"
        listed = ", ".join([*groups][:3])
        raise InputError(
            f"{name}: makes {count} of the samples ({listed}): expected 2 to {MAX_GROUPS}"
        )
    return {title: tuple(samples) for title, samples in groups.items()}


def _titles(values: Mapping[str, Recorded | None]) -> dict[Recorded | None, str]:
    """The title of the group of each value, in the order of the groups."""
    present = [value for value in values.values() if value is not None]
    texts = [value for value in present if isinstance(value, str)]
    # Also integers, and numbers of NumPy.
    numbers = [float(value) for value in present if not isinstance(value, str)]
    titles: dict[Recorded | None, str] = {
        **{text: text for text in texts},
        **dict(_titles_of_numbers(numbers)),
    }
    if None in values.values():
        titles[None] = NOT_RECORDED
    return titles


def _titles_of_numbers(numbers: Sequence[float]) -> list[tuple[float, str]]:
    """(number, title of its group), in ascending order."""
    distinct = sorted(set(numbers))
    are_shared = len(distinct) <= _MOST_NUMBERS and 2 * len(distinct) < len(numbers)
    if len(distinct) <= _RANGES or are_shared:
        return [*_distinct_texts(distinct, digits=6).items()]
    shares = np.arange(1, _RANGES) / _RANGES
    limits = np.quantile(numbers, shares)
    ranges: dict[int, list[float]] = {}
    for number in distinct:
        ranges.setdefault(int(np.searchsorted(limits, number)), []).append(number)
    ends = [end for members in ranges.values() for end in (members[0], members[-1])]
    texts = _distinct_texts(ends, digits=3)
    titles = []
    for members in ranges.values():
        title = f"{texts[members[0]]} to {texts[members[-1]]}"
        titles += [(number, title) for number in members]
    return titles


def _distinct_texts(numbers: Sequence[float], digits: int) -> dict[float, str]:
    """Number -> its text, with the fewest significant digits, at least `digits`, by which all of them differ."""
    texts: dict[float, str] = {}
    for count in range(digits, _MOST_DIGITS + 1):
        texts = {number: f"{number:.{count}g}" for number in numbers}
        if len(set(texts.values())) == len(texts):
            break
    return texts


def groups_of_protocol(
    board: Board, protocol: str, groups: Mapping[str, Collection[str]]
) -> dict[str, tuple[str, ...]]:
    """The groups with only those samples that have entries of the protocol; none if fewer than two groups are left."""
    samples = board.samples_of(protocol)
    shared = {
        title: tuple(name for name in names if name in samples)
        for title, names in groups.items()
    }
    filled = {title: names for title, names in shared.items() if names}
    return filled if len(filled) > 1 else {}


def groupings(board: Board) -> dict[str, dict[str, tuple[str, ...]]]:
    """The groups by every recorded value that makes 2 to `MAX_GROUPS`; of values that make the same, the first."""
    seen: list[set[tuple[str, ...]]] = []
    chosen = {}
    for name in recorded_names(board):
        try:
            groups = groups_by(board, name)
        except InputError:
            continue
        if set(groups.values()) not in seen:
            seen.append(set(groups.values()))
            chosen[name] = groups
    return chosen


@dataclass(frozen=True)
class Difference:
    """A method's mean over one group of samples minus that over another.

    interval : 95 %, over scenes; all NaN where the method has no mean.
    paired : whether the difference is the mean of those within the scenes that both groups have.
    scenes : how many scenes the two groups have together.
    """

    interval: Interval
    paired: bool
    scenes: int

    @property
    def basis(self) -> str:
        """What the interval rests on, as text, such as "paired, 3 of 5 scenes"."""
        count = self.interval.units
        if not self.paired:
            return f"unpaired, {counted(count, 'scene')}"
        if count < self.scenes:
            return f"paired, {count} of {self.scenes} scenes"
        return f"paired, {counted(count, 'scene')}"


SceneValues = Mapping[str, Sequence[float]]
"""Scene -> the values of a method on its samples; empty where it has no mean over them."""


def difference(values: SceneValues, reference: SceneValues) -> Difference:
    """The mean of the values minus that of the reference's.

    It is paired if both sides have the same scenes, or share at least two, which are at least half of those of the side
    with fewer. A paired difference is the mean over the shared scenes of the difference within each, and the interval
    resamples these scenes. Otherwise the interval resamples the scenes of both sides. With fewer than two scenes it is
    NaN.
    """
    shared = [scene for scene in values if scene in reference]
    count = len({*values, *reference})
    are_half = 2 * len(shared) >= min(len(values), len(reference))
    are_same = 0 < len(shared) == count
    if not are_same and not (are_half and len(shared) >= _LEAST_SHARED):
        interval = difference_of_means([*values.values()], [*reference.values()])
        return Difference(interval, False, count)
    within = [[np.mean(values[scene]) - np.mean(reference[scene])] for scene in shared]
    return Difference(mean_of_units(within), True, count)


def _scene_values(
    part: Board, means: Mapping[str, float], protocol: str, region: str, metric: str
) -> dict[str, SceneValues]:
    """Method -> its values by scene, of a group's board and the methods' means over it."""
    values: dict[str, dict[str, list[float]]] = {method: {} for method in means}
    for entry in part.entries:
        is_scored = entry.protocol == protocol and entry.evaluated(region)
        if is_scored and np.isfinite(means[entry.method]):
            of_scene = values[entry.method].setdefault(part.scene(entry.sample), [])
            of_scene.append(entry.value(region, metric))
    return dict(values)


@dataclass(frozen=True)
class Comparison:
    """The methods' means over groups of samples, and their differences from the first group.

    means : group -> method -> mean.
    differences : group -> method -> difference; of all groups but the first.
    """

    metric: str
    means: Mapping[str, Mapping[str, float]]
    differences: Mapping[str, Mapping[str, Difference]]

    def basis(self, group: str) -> str:
        """What most intervals of a group's differences rest on, as text; empty if no method has one."""
        texts = [
            difference.basis
            for difference in self.differences[group].values()
            if difference.interval.units
        ]
        # The first method's of those that are equally many.
        return max(dict.fromkeys(texts), key=texts.count, default="")


def compare_groups(
    board: Board, protocol: str, region: str, groups: Groups, metric: str | None = None
) -> Comparison:
    """The comparison of groups by a metric, the protocol's headline by default. Raises InputError as `Board.rules`."""
    _, chosen = board.rules(protocol, region, metric)
    name = chosen.name
    means, values = {}, {}
    for title, samples in groups.items():
        part = board.subset(samples)
        of_methods = part.means(protocol, region, methods=board.methods)
        means[title] = {
            method: mean.metrics[name] for method, mean in of_methods.items()
        }
        values[title] = _scene_values(part, means[title], protocol, region, name)
    reference, *others = groups
    differences = {}
    for title in others:
        differences[title] = {
            method: difference(values[title][method], values[reference][method])
            for method in board.methods
        }
    return Comparison(name, means, differences)
