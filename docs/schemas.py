"""Writes the JSON Schemas of twinlens's files into docs/schemas/, from the pydantic models that read them.

python docs/schemas.py
"""

import json
from pathlib import Path
from typing import Any

import pydantic

from twinlens.dataset import DatasetFile, SampleFile
from twinlens.scenes.rigs import RigTable
from twinlens.scenes.scene_file import SceneFile
from twinlens.scoring.board_file import BoardModel

FOLDER = Path(__file__).parent / "schemas"
MODELS: dict[str, Any] = {
    "board": BoardModel,
    "dataset": DatasetFile,
    "rig": RigTable,
    "sample": SampleFile,
    "scene": SceneFile,
}
"""File name without extension -> the model or type that pydantic reads the file with."""


def schema(name: str) -> str:
    """The text of one schema file."""
    return json.dumps(pydantic.TypeAdapter(MODELS[name]).json_schema(), indent=1) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in MODELS:
        (FOLDER / f"{name}.json").write_text(schema(name))
