"""Sensor, exposure and camera shake as tables of a recipe: every field of the dataclass under its own name.

[sensor]
preset = "phone"               # machine_vision unless said
read_noise = 4.0               # any field of Sensor
mismatch = { gain = 1.1 }      # any field of Mismatch

[exposure]                     # automatic unless said
time = 0.01                    # seconds
gain = 2.0
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from twinlens.errors import InputError
from twinlens.geometry import Float, rigid
from twinlens.scenes.placement import rotation
from twinlens.scenes.table import At, Parser, Table, choice, number
from twinlens.sensor import PRESETS, Exposure, Mismatch, Sensor

T = TypeVar("T")
_DEFAULT = "machine_vision"


def sensor_from_table(table: Mapping[str, Any], at: At) -> Sensor:
    """The sensor that `table` describes. Raises InputError naming the key that is unknown or wrong."""
    keys: Table[Any] = Table(at, table)
    preset = keys.take("preset", choice(*PRESETS), _DEFAULT)
    mismatch = keys.take("mismatch", _mismatch, Mismatch())
    given = {name: keys.take(name, _value) for name in _names(Sensor) if name != "mismatch" and keys.has(name)}
    keys.done()
    return _told(at, lambda: Sensor.preset(preset, mismatch=mismatch, **given))


def exposure_from_table(table: Mapping[str, Any], at: At) -> Exposure:
    """The exposure that `table` describes; it needs at least the time. Raises InputError."""
    keys: Table[Any] = Table(at, table)
    time, gain = keys.take("time", number(above=0.0)), keys.take("gain", number(above=0.0), 1.0)
    keys.done()
    return Exposure(time, gain)


_STEPS = ("right", "down", "forward")
_TURNS = ("pitch_deg", "yaw_deg", "roll_deg")


def jitter_from_table(table: Mapping[str, Any], at: At) -> Float:
    """How far the rig stands from its scene's viewpoint, 4x4: metres right, down, forward; degrees about x, y, z.

    Multiplied from the right: ``world_from_left @ jitter``.
    """
    keys: Table[Any] = Table(at, table)
    step = np.array([keys.take(key, number(-1e6, 1e6), 0.0) for key in _STEPS])
    x, y, z = map(rotation, np.eye(3), [keys.take(key, number(-360.0, 360.0), 0.0) for key in _TURNS])
    keys.done()
    return rigid((y @ x @ z)[:3, :3], step)


def _mismatch(at: At, value: Any) -> Mismatch:
    keys: Table[Any] = Table(at, value)
    given = {name: keys.take(name, number()) for name in _names(Mismatch) if keys.has(name)}
    keys.done()
    return _told(at, lambda: Mismatch(**given))


def _value(at: At, value: Any) -> Any:
    """A plain value of a sensor's field: the dataclass judges it, once it is of a kind that it can judge."""
    name = at.path.rpartition(".")[2]
    wanted = type(getattr(Sensor(), name))
    if wanted is tuple:
        return _three(at, value)
    if wanted is float:
        return number()(at, value)
    if not isinstance(value, wanted) or (wanted is int and isinstance(value, bool)):
        raise at.unlike(wanted, _WORDS[wanted], value)
    return value


_WORDS: dict[type, str] = {bool: "true or false", int: "a whole number", str: "a text"}


def _three(at: At, value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != 3:
        raise at.unlike(list, "three numbers (red, green, blue)", value)
    read: Parser[float] = number()
    return tuple(read(at / i, entry) for i, entry in enumerate(value))


def _names(kind: type[Any]) -> list[str]:
    return [field.name for field in fields(kind)]


def _told(at: At, make: Callable[[], T]) -> T:
    """What `make` answers; what it refuses is told with its place, down to the field that the message names."""
    try:
        return make()
    except InputError as error:
        field = next((name for name in _names(Sensor) if f" {name} " in f"{error} "), None)
        raise (at / field if field else at).wrong(str(error)) from error
