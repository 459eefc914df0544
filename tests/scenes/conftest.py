"""A small scene on disk that tests modify."""

import pytest

from tests.scenes.scene_text import NOTHING, changed
from twinlens.scenes import load_scene


@pytest.fixture
def read_scene(tmp_path):
    """Loads the minimal scene with changes of `scene_text.changed`."""

    def load(text="", without=NOTHING):
        path = tmp_path / "scene.toml"
        path.write_text(changed(text, without))
        return load_scene(path)

    return load
