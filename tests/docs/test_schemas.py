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


@pytest.mark.parametrize("name", bundled_scenes())
def test_the_scene_schema_accepts_the_bundled_scenes(name):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((SCHEMAS.FOLDER / "scene.json").read_text())
    data = tomllib.loads((bundled_folder() / name / "scene.toml").read_text())
    jsonschema.validate(data, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(data | {"materials": {"m": {"type": "difuse"}}}, schema)


def test_the_rig_schema_needs_no_layout():
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((SCHEMAS.FOLDER / "rig.json").read_text())
    jsonschema.validate({"baseline": 0.2, "cameras": [{}, {"fx": 700.0}]}, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"layout": "arc", "count": 3}, schema)
