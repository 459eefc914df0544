"""The JSON Schemas in docs/schemas/ are those of the models."""

import importlib.util
import json
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
SPEC = importlib.util.spec_from_file_location("docs_schemas", DOCS / "schemas.py")
SCHEMAS = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(SCHEMAS)


@pytest.mark.parametrize("name", SCHEMAS.MODELS)
def test_the_schema_file_is_current(name):
    stored = (SCHEMAS.FOLDER / f"{name}.json").read_text()
    assert json.loads(stored) == json.loads(SCHEMAS.schema(name)), "run: python docs/schemas.py"
