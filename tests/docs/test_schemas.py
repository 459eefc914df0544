"""The JSON Schemas in docs/schemas/ are those of the models."""

import importlib.util
import json
import tomllib
from pathlib import Path

import pytest

from twinlens.scenes import bundled_folder, bundled_scenes

DOCS = Path(__file__).parents[2] / "docs"
SPEC = importlib.util.spec_from_file_location("docs_schemas", DOCS / "schemas.py")
SCHEMAS = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(SCHEMAS)


@pytest.mark.parametrize("name", SCHEMAS.MODELS)
def test_the_schema_file_is_current(name):
    stored = (SCHEMAS.FOLDER / f"{name}.json").read_text()
    assert json.loads(stored) == json.loads(SCHEMAS.schema(name)), (
        "run: python docs/schemas.py"
    )


def validator(name):
    """The validator of a schema file, which is itself checked against its metaschema."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((SCHEMAS.FOLDER / f"{name}.json").read_text())
    kind = jsonschema.validators.validator_for(schema)
    kind.check_schema(schema)
    return kind(schema)


def test_the_scene_schema_accepts_the_bundled_scenes():
    scene = validator("scene")
    for name in bundled_scenes():
        data = tomllib.loads((bundled_folder() / name / "scene.toml").read_text())
        scene.validate(data)
    assert not scene.is_valid(data | {"materials": {"m": {"type": "difuse"}}})


def test_the_rig_schema_needs_no_layout():
    rig = validator("rig")
    rig.validate({"baseline": 0.2, "cameras": [{}, {"fx": 700.0}]})
    assert not rig.is_valid({"layout": "arc", "count": 3})
