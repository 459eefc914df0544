"""A new figure, lens or matcher option, declared once, is found in Python, recipes, records and on the command line."""

import json
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar

import click
import numpy as np
import pydantic
import pytest
from click.testing import CliRunner

from twinlens import matching
from twinlens.camera import Camera, Pinhole
from twinlens.cli.options import setting
from twinlens.dataset import record
from twinlens.errors import InputError
from twinlens.factory.camera_text import parse_sensor
from twinlens.factory.lenses import View, lens_table, lens_tables, parse_lens
from twinlens.factory.settings import sensor_table
from twinlens.matching.methods import Method
from twinlens.scenes import Scene
from twinlens.schema import read
from twinlens.sensor import Sensor
from twinlens.settings import Setting, Settings

VIEW = View(
    Scene("made", (), {}, np.eye(4), (2.0, 6.0)),
    Camera(64, 48, 1000.0, 1000.0, 31.5, 23.5),
    (),
)


@dataclass(frozen=True)
class WarmSensor(Sensor, noun="sensor"):
    """A sensor with a temperature."""

    temperature: Annotated[
        float, Setting("Temperature of the sensor.", "kelvin", least=200, most=400)
    ] = 300.0


@dataclass(frozen=True)
class Slit(Settings, noun="lens"):
    """A lens that no file of twinlens names."""

    name: ClassVar[str] = "slit"
    width: Annotated[float, Setting("Width of the slit.", "metres", above=0, most=1)]


def test_a_new_sensor_figure():
    made, table = (
        WarmSensor.preset("phone", temperature=350.0),
        sensor_table(WarmSensor),
    )
    assert (
        read(table, {"preset": "phone", "temperature": 350, "mismatch": "none"}, "f")
        == made
    )
    assert parse_sensor("phone:temperature=350", WarmSensor).temperature == 350.0
    assert WarmSensor.from_record(json.loads(json.dumps(asdict(made)))) == made
    schema = pydantic.TypeAdapter(table).json_schema()["properties"]["temperature"]
    assert (schema["minimum"], schema["maximum"]) == (200, 400)
    text = "temperature must be a number of kelvin from 200 to 400, got 100"
    with pytest.raises(InputError, match=f"^sensor {text}$"):
        made.replace(temperature=100)
    with pytest.raises(
        InputError, match=r"^--sensor .*: temperature: must be .* kelvin"
    ):
        parse_sensor("phone:temperature=100", WarmSensor)


def test_a_new_sensor_figure_as_an_option():
    @click.command()
    @setting(WarmSensor, "temperature", default=300.0)
    def command(temperature):
        click.echo(temperature)

    run = CliRunner().invoke
    assert run(command, ["--temperature", "250"]).output == "250.0\n"
    shown = " ".join(run(command, ["--help"]).output.split())
    assert "Temperature of the sensor. [kelvin, 200 to 400; default: 300.0]" in shown
    with pytest.raises(InputError, match=r"^--temperature must be a number of kelvin"):
        run(command, ["--temperature", "cold"], catch_exceptions=False)


def test_a_new_lens(monkeypatch):
    lenses = (Pinhole, Slit)
    table = pydantic.TypeAdapter(lens_table(lens_tables(lenses)))
    assert read(table, {"kind": "slit", "width": 0.5}, "f.toml") == Slit(0.5)
    assert parse_lens("slit:width=0.5", VIEW, lenses=lenses) == Slit(0.5)
    assert {"kind", "width"} <= set(
        table.json_schema()["$defs"]["SlitTable"]["properties"]
    )
    monkeypatch.setitem(record.TYPES, "Slit", Slit)
    stored = pydantic.TypeAdapter(record.annotation_of(Pinhole | Slit))
    assert record.read(stored, record.plain(Slit(0.5)), "sample.json") == Slit(0.5)
    for refusal in (
        lambda: Slit(2.0),
        lambda: read(table, {"kind": "slit", "width": 2.0}, "f.toml"),
        lambda: parse_lens("slit:width=2", VIEW, lenses=lenses),
        lambda: record.read(stored, {"type": "Slit", "width": 2.0}, "sample.json"),
    ):
        with pytest.raises(
            InputError, match=r"must be a number of metres > 0 and <= 1"
        ):
            refusal()


@dataclass(frozen=True)
class PatientMatcher(matching.StereoMatcher, noun="option"):
    """A matcher with an option of its own."""

    rounds: Annotated[int, Setting("Rounds of the search.", least=1, most=9)] = 1


def test_a_new_matcher_option(monkeypatch):
    patient = Method("patient", "searches again", {}, PatientMatcher)
    monkeypatch.setitem(matching.METHODS, "patient", patient)
    spec = matching.parse_method("patient:rounds=3")
    assert spec.matcher() == PatientMatcher(rounds=3)
    assert "rounds=3" in spec.spec  # what boards, which are JSON, store
    row = {"option": "rounds", "default": 1, "meaning": "Rounds of the search."}
    assert row in patient.reference()["options"]  # `twinlens methods`
    for refusal in (
        lambda: PatientMatcher(rounds=10),
        lambda: matching.parse_method("patient:rounds=10"),
    ):
        with pytest.raises(InputError, match="rounds must be a whole number from 1 to"):
            refusal()
