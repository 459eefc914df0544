"""Scene files to `Scene`: what is photographed, as plain data. Never imports the renderer."""

from twinlens.scenes.load import bundled_folder, bundled_headings, bundled_scenes, load_scene
from twinlens.scenes.rigs import rig_from_table
from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin, Scene, SceneObject

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
    "rig_from_table",
]
