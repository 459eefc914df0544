"""Writes the JSON Schemas of twinlens's files into docs/schemas/, from the pydantic models that read them.

python docs/schemas.py
"""

import json
from pathlib import Path
from typing import Any, Union

import pydantic
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from twinlens.dataset.dataset import DatasetFile
from twinlens.dataset.stored import SampleFile
from twinlens.factory.draws import KINDS
from twinlens.factory.recipe import RecipeTable
from twinlens.factory.settings import RecipeSettings
from twinlens.scenes.rigs import RigTable
from twinlens.scenes.scene_file import SceneFile
from twinlens.scoring.board_file import BoardModel

FOLDER = Path(__file__).parent / "schemas"
MODELS: dict[str, Any] = {
    "board": BoardModel,
    "dataset": DatasetFile,
    "recipe": RecipeTable,
    "rig": RigTable,
    "sample": SampleFile,
    "scene": SceneFile,
}
"""File name without extension -> the model or type that pydantic reads the file with."""
TOML_FILES = ("recipe", "rig", "scene")


class TomlSchema(GenerateJsonSchema):
    """The schema of a TOML file, which has no null: optional keys are left out. Titles that repeat the key are too."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        return {
            key: value
            for key, value in made.items()
            if key != "default" or value is not None
        }

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema(name: str) -> str:
    """The text of one schema file."""
    generator = TomlSchema if name in TOML_FILES else GenerateJsonSchema
    found = pydantic.TypeAdapter(MODELS[name]).json_schema(schema_generator=generator)
    return (
        json.dumps(with_distributions(found) if name == "recipe" else found, indent=1)
        + "\n"
    )


def with_distributions(recipe: dict[str, Any]) -> dict[str, Any]:
    """The schema of a recipe whose drawn keys have their types, and accept a distribution in place of any value."""
    drawn = RecipeSettings.model_json_schema(schema_generator=TomlSchema)
    rig = pydantic.TypeAdapter(RigTable).json_schema(schema_generator=TomlSchema)
    tables = drawn.pop("$defs") | rig.pop("$defs")
    drawn["properties"]["rig"] = rig
    kinds = pydantic.TypeAdapter(Union[tuple(KINDS.values())]).json_schema()  # noqa: UP007
    recipe["properties"] |= drawable(drawn)["properties"]
    recipe["$defs"] |= {
        name: drawable(table) for name, table in tables.items()
    } | kinds.pop("$defs")
    recipe["$defs"]["Distribution"] = kinds
    return recipe


def drawable(node: Any) -> Any:
    """A schema in which each property and list entry, but the constants that choose a table, may be a distribution."""

    def either(value: Any) -> Any:
        if isinstance(value, dict) and "const" in value:
            return value
        return {"anyOf": [drawable(value), {"$ref": "#/$defs/Distribution"}]}

    if isinstance(node, list):
        return [drawable(entry) for entry in node]
    if not isinstance(node, dict):
        return node
    found = {
        key: value if key == "default" else drawable(value)
        for key, value in node.items()
    }
    if "properties" in node:
        found["properties"] = {
            key: either(value) for key, value in node["properties"].items()
        }
    if isinstance(node.get("items"), dict):
        found["items"] = either(node["items"])
    return found


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in MODELS:
        (FOLDER / f"{name}.json").write_text(schema(name))
