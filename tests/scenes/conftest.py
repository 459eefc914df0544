"""A small scene on disk that tests modify."""

from pathlib import Path

import pytest

from tests.scenes.scene_text import MINIMAL, Read
from twinlens.scenes import Scene, load_scene


@pytest.fixture
def read_scene(tmp_path: Path) -> Read:
    """Loads the minimal scene with text added to its end and (old, new) replacements made in it."""

    def load(extra: str = "", *changes: tuple[str, str]) -> Scene:
        written = MINIMAL
        for old, new in changes:
            assert old in written
            written = written.replace(old, new)
        path = tmp_path / "scene.toml"
        path.write_text(written + extra)
        return load_scene(path)

    return load
