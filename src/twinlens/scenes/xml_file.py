"""x"""

from pathlib import Path

from twinlens.scenes.scene import Scene


def read_scene_xml(path: Path) -> Scene:
    raise NotImplementedError
