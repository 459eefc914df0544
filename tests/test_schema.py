"""Validation errors of file schemas are one line with file, key, allowed value and the nearest key."""

from typing import Annotated, Literal

import pydantic
import pytest

from twinlens.errors import InputError
from twinlens.schema import StrictModel, read


class Disk(StrictModel):
    kind: Literal["disk"]
    diameter: float = pydantic.Field(gt=0)


class Blades(StrictModel):
    kind: Literal["blades"]
    count: int = pydantic.Field(ge=3, le=20)


class Lens(StrictModel):
    name: str = ""
    aperture: Annotated[Disk | Blades, pydantic.Field(discriminator="kind")]


class File(StrictModel):
    lenses: list[Lens] = pydantic.Field(min_length=1)
    named: dict[str, Disk] = pydantic.Field(default_factory=dict)
    sharp: bool = False

    @pydantic.model_validator(mode="after")
    def _check(self):
        if len(self.lenses) > 2:
            raise ValueError("at most two lenses")
        return self


DISK = {"kind": "disk", "diameter": 1.0}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"lenses": []}, "f.toml: rig.lenses: must be a list of at least 1 values, got []"),
        ({}, "f.toml: rig: missing key 'lenses'"),
        ({"lenses": [{"aperture": DISK}], "shrap": True}, "f.toml: rig: unknown key 'shrap'; did you mean 'sharp'?"),
        ({"lenses": [{"aperture": DISK}], "sharp": 1}, "f.toml: rig.sharp: must be true or false, got 1"),
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
        ({"lenses": [{"aperture": {"kind": "disc"}}]}, "f.toml: rig.lenses[0].aperture.kind: must be one of"),
        ({"lenses": [{"aperture": DISK}], "named": {"a": {**DISK, "b": 1}}}, "f.toml: rig.named.a: unknown key 'b'"),
        ({"lenses": [{"aperture": DISK}] * 3}, "f.toml: rig: at most two lenses"),
        ({"lenses": [{"aperture": {**DISK, "diameter": float("nan")}}]}, "must be a finite number, got nan"),
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
