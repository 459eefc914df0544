"""Scene files to `Scene`: what is photographed, as plain data. Never imports the renderer."""

from twinlens.scenes.rigs import rig_from_table
from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin, Scene, SceneObject
from twinlens.scenes.scene_file import (
    bundled_folder,
    bundled_headings,
    bundled_scenes,
    load_scene,
    read_toml,
    scene_with_rig,
)

__all__ = [
    "Bitmap",
    "Color",
    "Mesh",
    "Plugin",
    "Scene",
    "SceneObject",
    "bundled_folder",
    "bundled_headings",
    "bundled_scenes",
    "load_scene",
    "read_toml",
    "rig_from_table",
    "scene_with_rig",
]
