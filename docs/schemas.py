"""Writes the JSON Schemas of twinlens's files into docs/schemas/, from the pydantic models that read them.

python docs/schemas.py
"""

import json
from pathlib import Path

import pydantic

from twinlens.scoring.board_file import BoardModel

FOLDER = Path(__file__).parent / "schemas"
MODELS = {
    "board": BoardModel,
}
"""File name without extension -> model, or a pydantic TypeAdapter."""


def schema(name: str) -> str:
    """The text of one schema file."""
    model = MODELS[name]
    adapter = model if isinstance(model, pydantic.TypeAdapter) else pydantic.TypeAdapter(model)
    return json.dumps(adapter.json_schema(), indent=1) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in MODELS:
        (FOLDER / f"{name}.json").write_text(schema(name))
