"""Conditions on what is recorded of samples, such as lens.f_number < 2, by which a part of a dataset is chosen.

The names are those by which boards group their samples (`recorded_values`), with the scene, and figures of the truth.
"""

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twinlens.dataset import StoredSample
from twinlens.dataset.stored import ReadOnce
from twinlens.errors import InputError, format_value, unknown
from twinlens.scoring.board import Recorded
from twinlens.scoring.grouping import SCENE
from twinlens.scoring.recorded import recorded_values, scalars

FIGURES = (
    "width", "height", "cameras", "lenses", "disparity_min", "disparity_median", "disparity_max", "depth_min",
    "depth_median", "depth_max", "visible", "occluded", "unknown", "noise",
)  # fmt: skip
"""Names of what a sample's files say beside its settings: sizes, disparity (px) and depth (m) of the first view, shares
of its pixels, and renderer noise over sensor noise."""

_TEXT = re.compile(r"\s*([^<>=!\s]+)\s*(<=|>=|!=|==|=|<|>)\s*(.*\S)\s*")
_ORDERS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_EQUAL, _UNEQUAL = ("=", "=="), "!="


@dataclass(frozen=True)
class Condition:
    """`name` `sign` `text`: the sign is <, <=, >, >=, = or !=; the text is a number, or with = and != any text."""

    name: str
    sign: str
    text: str

    def holds(self, values: Mapping[str, Recorded]) -> bool:
        """Whether a sample's values satisfy it; not if it has no such value. Raises InputError for texts in order."""
        if self.name not in values:
            return False
        value = values[self.name]
        if self.sign in _ORDERS:
            if isinstance(value, str):
                raise InputError(
                    f"{self}: {self.name} is a text, such as {value!r}; compare it with = or !="
                )
            return _ORDERS[self.sign](value, float(self.text))
        is_equal = value == (self.text if isinstance(value, str) else self._number)
        return is_equal != (self.sign == _UNEQUAL)

    @property
    def _number(self) -> float:
        """The number in the text, or NaN."""
        try:
            return float(self.text)
        except ValueError:
            return math.nan

    def __str__(self) -> str:
        return f"{self.name} {self.sign} {self.text}"


def parse_condition(text: str) -> Condition:
    """The condition in a text. Raises InputError.

    >>> parse_condition("lens.f_number<2"), str(parse_condition("lens == f/1.4"))
    (Condition(name='lens.f_number', sign='<', text='2'), 'lens = f/1.4')
    """
    match = _TEXT.fullmatch(text)
    if match is None:
        raise InputError(
            f"a condition is NAME, one of < <= > >= = !=, and a value, such as 'lens.f_number < 2', "
            f"got {format_value(text)}"
        )
    name, sign, written = match.groups()
    condition = Condition(name, "=" if sign in _EQUAL else sign, written)
    if sign in _ORDERS and math.isnan(condition._number):
        raise InputError(f"{text}: {sign} needs a number, got {written!r}")
    return condition


def sample_values(sample: StoredSample, lens: int = 0) -> dict[str, Recorded]:
    """The scene of a sample, what is recorded of it and one of its lenses, and `FIGURES`; as far as they are known."""
    return {
        **dict(scalars({SCENE: _scene_of(sample) or None})),
        **recorded_values(sample, lens),
        **dict(scalars(dict(_figures(sample, lens)))),
    }


def _scene_of(sample: StoredSample) -> str:
    """The scene, by sample.json or else by dataset.json."""
    info = sample.row.get("info") or {}
    return sample.scene or str(info.get("scene") or "")


def _figures(sample: StoredSample, lens: int) -> Iterator[tuple[str, Any]]:
    """`FIGURES` of a sample and their values, None where sample.json has none."""
    if not sample.has("sample.json"):
        return
    statistics = sample.record.get("statistics")
    if isinstance(statistics, dict):
        size = statistics.get("size")
        if isinstance(size, list) and len(size) == 2:
            yield from zip(("width", "height"), size, strict=True)
        for name in ("cameras", "lenses", "visible", "occluded", "unknown"):
            yield name, statistics.get(name)
        for name in ("disparity", "depth"):
            levels = statistics.get(name)
            if isinstance(levels, list) and levels:
                yield f"{name}_min", levels[0]
                yield f"{name}_median", levels[len(levels) // 2]
                yield f"{name}_max", levels[-1]
    yield "noise", sample.lens(lens).renderer_noise


def chosen(
    datasets: Sequence[Sequence[StoredSample]],
    conditions: Sequence[Condition],
    report: Callable[[float, str], None] = lambda fraction, name: None,
) -> list[list[int]]:
    """For each dataset, the numbers of the samples that satisfy all conditions; of several lenses, one must.

    Each sample.json is read once. Raises InputError for a name that no sample of any dataset has a value of.
    """
    names: dict[str, None] = {}
    numbers: list[list[int]] = [[] for _ in datasets]
    total, done = sum(map(len, datasets)), 0
    for dataset, taken in zip(datasets, numbers, strict=True):
        for number, sample in enumerate(dataset):
            report(done / total, sample.name)
            done += 1
            lenses = _values_of_lenses(sample)
            for values in lenses:
                names |= dict.fromkeys(values)
            if any(_all_hold(conditions, values) for values in lenses):
                taken.append(number)
    for condition in conditions:
        if condition.name not in names:
            raise unknown("recorded value", condition.name, names)
    return numbers


def _values_of_lenses(sample: StoredSample) -> list[dict[str, Recorded]]:
    """The values of a sample with each of its lenses."""
    once = ReadOnce.of(sample)
    return [sample_values(once, lens) for lens in range(once.num_lenses)]


def _all_hold(conditions: Sequence[Condition], values: Mapping[str, Recorded]) -> bool:
    return all(condition.holds(values) for condition in conditions)
