"""Validation errors of file schemas are one line with file, key, allowed value and the nearest key."""

from dataclasses import dataclass
from typing import Annotated, Literal

import pydantic
import pytest

from twinlens.errors import InputError, check_number
from twinlens.schema import StrictModel, read, table_of, tagged


class Disk(StrictModel):
    kind: Literal["disk"]
    diameter: float = pydantic.Field(gt=0)


class Blades(StrictModel):
    kind: Literal["blades"]
    count: int = pydantic.Field(ge=3, le=20)


class Lens(StrictModel):
    name: str = ""
    aperture: Annotated[Disk | Blades, pydantic.Field(discriminator="kind")]


@dataclass(frozen=True)
class Gain:
    low: float

    def __post_init__(self):
        check_number("gain low", self.low, "from 0 to 9", least=0, most=9)


class File(StrictModel):
    lenses: list[Lens] = pydantic.Field(min_length=1)
    named: dict[str, Disk] = pydantic.Field(default_factory=dict)
    scale: float | list[float] = 1.0
    sharp: bool = False
    gain: table_of(Gain) | None = None

    @pydantic.model_validator(mode="after")
    def _check(self):
        if len(self.lenses) > 2:
            raise ValueError("at most two lenses")
        return self


DISK = {"kind": "disk", "diameter": 1.0}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            {"lenses": []},
            "f.toml: rig.lenses: must be a list of at least 1 value, got []",
        ),
        ({}, "f.toml: rig: missing key 'lenses'"),
        (
            {"lenses": [{"aperture": DISK}], "shrap": True},
            "f.toml: rig: unknown key 'shrap'; did you mean 'sharp'?",
        ),
        (
            {"lenses": [{"aperture": DISK}], "sharp": 1},
            "f.toml: rig.sharp: must be true or false, got 1",
        ),
        (
            {"lenses": [{"aperture": {**DISK, "diamter": 2}}]},
            "f.toml: rig.lenses[0].aperture: unknown key 'diamter'; did you mean 'diameter'? (known: diameter, kind)",
        ),
        (
            {"lenses": [{"aperture": {**DISK, "diameter": -2.0}}]},
            "f.toml: rig.lenses[0].aperture.diameter: must be > 0, got -2.0",
        ),
        (
            {"lenses": [{"aperture": {"kind": "blades", "count": 2.5}}]},
            "f.toml: rig.lenses[0].aperture.count: must be a whole number, got 2.5",
        ),
        (
            {"lenses": [{"aperture": {"kind": "disc"}}]},
            "f.toml: rig.lenses[0].aperture.kind: must be one of",
        ),
        (
            {"lenses": [{"aperture": DISK}], "named": {"a": {**DISK, "b": 1}}},
            "f.toml: rig.named.a: unknown key 'b'",
        ),
        (
            {"lenses": [{"aperture": {"diameter": 1.0}}]},
            "f.toml: rig.lenses[0].aperture: missing key 'kind'",
        ),
        (
            {"lenses": [{"aperture": 3}]},
            "f.toml: rig.lenses[0].aperture: must be a table of keys and values, got 3",
        ),
        (
            {"lenses": [{"aperture": DISK}], "scale": "x"},
            "f.toml: rig.scale: must be a number or a list, got 'x'",
        ),
        (
            {"lenses": [{"aperture": DISK}], "scale": [1, "x"]},
            "f.toml: rig.scale[1]: must be a number, got 'x'",
        ),
        ({"lenses": [{"aperture": DISK}] * 3}, "f.toml: rig: at most two lenses"),
        (
            {"lenses": [{"aperture": DISK}], "gain": {"low": -1}},
            "f.toml: rig.gain.low: must be from 0 to 9, got -1.0",
        ),
        (
            {"lenses": [{"aperture": {**DISK, "diameter": float("nan")}}]},
            "must be a finite number, got nan",
        ),
    ],
)
def test_errors_are_one_line(data, message):
    with pytest.raises(InputError) as caught:
        read(File, data, "f.toml", "rig")
    text = str(caught.value)
    assert message in text
    assert "\n" not in text


def test_valid_data_becomes_the_model():
    file = read(File, {"lenses": [{"aperture": DISK}], "sharp": True}, "f.toml")
    assert file.lenses[0].aperture == Disk(kind="disk", diameter=1.0)
    assert file.sharp


def test_a_type_adapter_reads_as_a_model_does():
    lens = pydantic.TypeAdapter(tagged("Lens", "kind", [Disk, Blades], "disk"))
    assert read(lens, {"diameter": 2.0}, "f.toml") == Disk(kind="disk", diameter=2.0)
    with pytest.raises(InputError, match=r"f.toml: rig: unknown key 'count'"):
        read(lens, {"count": 2}, "f.toml", "rig")


def test_tables_nested_beyond_the_stack_are_refused():
    adapter: pydantic.TypeAdapter[object]

    def validate(value):
        return adapter.validate_python(value["a"]) if isinstance(value, dict) else value

    adapter = pydantic.TypeAdapter(Annotated[object, pydantic.PlainValidator(validate)])
    table: object = 1
    for _ in range(5000):
        table = {"a": table}
    with pytest.raises(InputError, match=r"f.toml: rig: nested too deep"):
        read(adapter, table, "f.toml", "rig")


def test_limits_are_shown_with_all_digits():
    with pytest.raises(InputError, match=r"must be <= 9223372036854775807, got"):
        read(
            pydantic.TypeAdapter(Annotated[int, pydantic.Field(le=2**63 - 1)]),
            2**63,
            "f.toml",
        )
