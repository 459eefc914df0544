"""What sample.json records of how a sample was made, as names and plain values, by which a board groups its samples.

Names: lens, lens_number; lens.KEY of the recipe's table of the lens; family, split, sensor, mismatch, exposure_time_s,
gain, baseline; and every other drawn value under its key in the recipe, such as rig.baseline.
"""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from twinlens.dataset import StoredSample
from twinlens.dataset.record import plain
from twinlens.scoring.board import Recorded
from twinlens.sensor import PRESETS, Sensor

_LONGEST_TEXT, _LONGEST_LIST, _MOST_VALUES = 100, 8, 100
"""Longer texts and lists, such as the cells of a mask, group no samples."""


def recorded_values(sample: StoredSample, lens: int = 0) -> dict[str, Recorded]:
    """The recorded values of a sample and one of its lenses; empty without a sample.json that twinlens wrote."""
    if not sample.has("sample.json"):
        return {}
    file = sample.record
    record = _table(file.get("record"))
    origin = _table(record.get("rectified_from"))
    spec = _table(record.get("spec") or origin.get("spec"))
    values: dict[str, Any] = {"lens": sample.lens(lens).label}
    if sample.num_lenses > 1:
        values["lens_number"] = lens
    if spec.get("kind") == "family":
        values["family"] = spec.get("scene")
    values["split"] = _split_of(sample, spec)
    values["sensor"] = _sensor_name(_table(record.get("sensor")))
    values["mismatch"] = _mismatch_level(_table(record.get("sensor")))
    exposure = _first_exposure(sample.lens(lens).record)
    values["exposure_time_s"] = exposure.get("time_s")
    values["gain"] = exposure.get("gain")
    values["baseline"] = _table(file.get("pair")).get("baseline")
    values |= _drawn_values(_table(spec.get("drawn")), lens)
    listed = [*scalars(values)]
    return dict(listed[:_MOST_VALUES])


def _split_of(sample: StoredSample, spec: Mapping[str, Any]) -> Any:
    """The split of a sample: that of dataset.json, which `twinlens subset` may have changed, or else of sample.json."""
    info = _table(sample.row.get("info"))
    return info["split"] if "split" in info else spec.get("split")


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def scalars(values: Mapping[str, Any]) -> Iterator[tuple[str, Recorded]]:
    """The values that are finite numbers, as float, short texts, or truth values, as texts; others group no samples."""
    for name, value in values.items():
        if isinstance(value, bool | np.bool_):
            yield name, str(value).lower()
        elif isinstance(value, int | float | np.number) and math.isfinite(value):
            yield name, float(value)
        elif isinstance(value, str) and len(value) <= _LONGEST_TEXT:
            yield name, value


def _drawn_values(drawn: Mapping[str, Any], lens: int) -> dict[str, Any]:
    """The values of a recipe's keys that were drawn for a sample, of its lenses those of one."""
    values: dict[str, Any] = {}
    for key, value in drawn.items():
        if key != "lenses":
            values.update(_flat(key, value))
    tables = drawn.get("lenses")
    if isinstance(tables, Sequence) and lens < len(tables):
        values.update(_flat("lens", tables[lens]))
    return values


def _flat(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The leaves of a table by their paths, such as rig.baseline and translate[0]."""
    if isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _flat(f"{key}.{name}", entry)
    elif isinstance(value, list) and len(value) <= _LONGEST_LIST:
        for number, entry in enumerate(value):
            yield from _flat(f"{key}[{number}]", entry)
    else:
        yield key, value


def _first_exposure(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """How the first camera exposed the image of a lens."""
    exposures = record.get("exposures")
    return _table(exposures[0]) if isinstance(exposures, list) and exposures else {}


def _mismatch_level(sensor: Mapping[str, Any]) -> Any:
    """The level of the mismatch of the second camera."""
    mismatch = sensor.get("mismatch")
    if isinstance(mismatch, list):
        mismatch = mismatch[0] if mismatch else None
    return _table(mismatch).get("level")


def _sensor_name(sensor: Mapping[str, Any]) -> str | None:
    """The preset that has the values of a recorded sensor; "other" if none has, None without a sensor."""
    if not sensor:
        return None
    for name, values in _presets().items():
        if all(sensor.get(key) == value for key, value in values.items()):
            return name
    return "other"


@functools.cache
def _presets() -> dict[str, dict[str, Any]]:
    """The values of each preset as a record has them, without the mismatch, the bits and the band of a camera."""
    presets = {}
    for name in PRESETS:
        values = plain(asdict(Sensor.preset(name)))
        presets[name] = {
            key: value
            for key, value in values.items()
            if key not in ("mismatch", "bits", "nir")
        }
    return presets
