"""Scene files to `Scene`: what is photographed, as plain data. Never imports the renderer."""

from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin, Scene, SceneObject

__all__ = ["Bitmap", "Color", "Mesh", "Plugin", "Scene", "SceneObject"]
