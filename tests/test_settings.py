"""Every declared setting refuses what its declaration excludes: in Python, in a table, and in a text."""

import dataclasses
import json
import math
from typing import Annotated, Literal

import numpy as np
import pydantic
import pytest

from twinlens import camera, sensor
from twinlens.errors import InputError
from twinlens.geometry import motion
from twinlens.schema import read, table_of
from twinlens.settings import Setting, Settings, fields_of, parse_pairs

DECLARED = {
    camera.Annulus: {"inner": 0.5},
    camera.BareAperture: {"diameter": 1e-3, "film_distance": 0.05},
    camera.BrownConrady: {},
    camera.Camera: {"width": 8, "height": 6, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 3.0},
    camera.KannalaBrandt: {},
    camera.Misalignment: {},
    camera.Polygon: {"blades": 6},
    camera.ThinLens: {"aperture_diameter": 0.01, "focus_distance": 2.0},
    motion.Keyframe: {"time": 0.5},
    motion.Motion: {"velocity": (1.0, 0.0, 0.0)},
    motion.Turn: {"axis": (1.0, 0.0, 0.0), "deg": 90.0},
    sensor.Exposure: {"time": 0.01},
    sensor.Mismatch: {},
    sensor.Sensor: {},
}  # fmt: skip
"""Classes of settings, and values of their required fields."""


def plain_fields(cls):
    return [field for field in fields_of(cls).values() if field.is_plain]


def table_type(cls):
    """The table with the plain fields of a class."""
    others = {
        name: (pydantic.SkipValidation[object], None)
        for name, field in fields_of(cls).items()
        if not field.is_plain
    }
    return table_of(cls, **others)


def refused(field):
    """Values that the declaration of a field excludes."""
    setting = field.setting
    wrong_type = {bool: 1, str: 3, int: 2.5, float: "a"}.get(field.kind, "a")
    values = [wrong_type, None] if not field.optional else [wrong_type]
    if field.kind in (float, int):
        values += [True, math.nan, "1", [1.0]]
        limits = (
            (setting.least, -1),
            (setting.above, 0),
            (setting.most, 1),
            (setting.below, 0),
        )
        for limit, step in limits:
            if math.isfinite(limit) and not (setting.or_zero and limit <= 1e-6):
                values.append(limit + step * max(1, abs(limit)))
        if not setting.infinite:
            values += [math.inf, -math.inf]
    if setting.choices:
        values += [str(next(iter(setting.choices))) + "x", ""]
    if field.length:
        values += [(1.0,), (math.nan,) * field.length, (1.0,) * (field.length + 1)]
    return values


@pytest.mark.parametrize("cls", DECLARED, ids=lambda cls: cls.__name__)
def test_excluded_values_are_refused_in_python_tables_and_texts(cls):
    valid, table = DECLARED[cls], pydantic.TypeAdapter(table_type(cls))
    assert plain_fields(cls)
    for field in plain_fields(cls):
        for value in refused(field):
            message = f"{field.name} must be {field.allowed}, got "
            with pytest.raises(InputError) as in_python:
                cls(**{**valid, field.name: value})
            assert str(in_python.value).startswith(f"{cls.noun} {message}")
            assert "\n" not in str(in_python.value)
            with pytest.raises(InputError) as in_table:
                read(table, {**valid, field.name: value}, "f.toml", "part")
            message = f"f.toml: part.{field.name}: must be {field.allowed}, got "
            assert str(in_table.value).startswith(message)


@pytest.mark.parametrize("cls", DECLARED, ids=lambda cls: cls.__name__)
def test_a_text_is_refused_as_its_value_is(cls):
    valid, table = DECLARED[cls], pydantic.TypeAdapter(table_type(cls))
    for field in plain_fields(cls):
        for value in refused(field):
            text = f"{value:g}" if isinstance(value, float) else str(value)
            if isinstance(value, (list, tuple, bool)) or text in ("", "1", "None", "3"):
                continue  # no text, or a text of another, valid value
            pairs = parse_pairs(f"{field.name}={text}", fields_of(cls))
            with pytest.raises(InputError, match=f"{field.name}: must be"):
                read(table, valid | pairs, "--option")


@pytest.mark.parametrize("cls", DECLARED, ids=lambda cls: cls.__name__)
def test_allowed_limits_are_accepted_everywhere(cls):
    valid, table = DECLARED[cls], pydantic.TypeAdapter(table_type(cls))
    made = cls(**valid)
    assert read(table, valid, "f.toml") == made
    for field in plain_fields(cls):
        value = getattr(made, field.name)
        if value is None:
            continue
        text = "/".join(map(str, value)) if field.length else str(value)
        pairs = parse_pairs(f"{field.name}={text}", fields_of(cls))
        assert read(table, valid | pairs, "--option") == made
        for limit in (field.setting.least, field.setting.most):
            if math.isfinite(limit):
                value = (limit,) * 3 if field.length else field.kind(limit)
                assert field.checked(value) == value


@pytest.mark.parametrize("cls", DECLARED, ids=lambda cls: cls.__name__)
def test_an_unknown_name_has_the_nearest(cls):
    name = plain_fields(cls)[0].name
    wrong = f"{name}s"
    for refusal in (
        lambda: cls(**DECLARED[cls]).replace(**{wrong: 1}),
        lambda: read(table_type(cls), {wrong: 1}, "f.toml"),
        lambda: parse_pairs(f"{wrong}=1", fields_of(cls)),
    ):
        with pytest.raises(InputError, match=f"'{wrong}'; did you mean '{name}'"):
            refusal()


def test_a_text_of_pairs_is_well_formed():
    fields = fields_of(sensor.Mismatch)
    assert parse_pairs("gain=1.1, level=typical", fields) == {
        "gain": 1.1,
        "level": "typical",
    }
    for text in ("gain", "gain=", "=1", "", "gain=1,,time=1"):
        with pytest.raises(InputError, match="must be NAME=VALUE,NAME=VALUE; got"):
            parse_pairs(text, fields)
    with pytest.raises(InputError, match="gain is given twice"):
        parse_pairs("gain=1,gain=1", fields)


@pytest.mark.parametrize(
    "number", [np.float32(0.25), np.float64(0.25), np.int16(1), 1], ids=type
)
def test_numbers_of_every_type_are_accepted_and_kept(number):
    assert sensor.Mismatch(gain=number).gain is number
    assert sensor.Sensor(white_balance=np.True_).white_balance is np.True_


@dataclasses.dataclass(frozen=True)
class Shutter(Settings, noun="shutter"):
    """A new class of settings, which nothing else names."""

    readout: Annotated[
        float,
        Setting("Time from the first row to the last.", "seconds", least=0, most=1),
    ] = 0.0
    mode: Annotated[
        str, Setting("Order of the rows.", choices=("global", "rolling"))
    ] = "global"
    rows: Annotated[int | None, Setting("Rows.", "pixels", above=0, odd=True)] = None
    open: Annotated[bool, Setting("Always open.")] = False


def test_a_new_setting_is_read_from_its_one_declaration():
    table = pydantic.TypeAdapter(
        table_of(Shutter, kind=(Literal["shutter"], "shutter"))
    )
    made = Shutter(readout=0.5, mode="rolling", rows=3, open=True)
    text = "readout=0.5,mode=rolling,rows=3,open=yes"
    assert (
        read(table, json.loads(json.dumps(dataclasses.asdict(made))), "f.json") == made
    )
    assert read(table, parse_pairs(text, fields_of(Shutter)), "--shutter") == made
    assert "readout : Time from the first row to the last." in Shutter.__doc__
    schema = table.json_schema()["properties"]
    assert schema["readout"] == {
        "default": 0.0,
        "description": "Time from the first row to the last. [seconds]",
        "maximum": 1,
        "minimum": 0,
        "title": "Readout",
        "type": "number",
    }
    assert schema["mode"]["enum"] == ["global", "rolling"]
    for change, message in (
        (
            {"readout": 2},
            "shutter readout must be a number of seconds from 0 to 1, got 2",
        ),
        (
            {"mode": "rollin"},
            "must be one of global, rolling, got 'rollin'; did you mean",
        ),
        ({"rows": 4}, "rows must be an odd whole number of pixels > 0, or none, got 4"),
    ):
        with pytest.raises(InputError, match=message):
            made.replace(**change)
