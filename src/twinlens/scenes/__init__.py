"""Scene files to `Scene`: what is photographed, as plain data. Never imports the renderer."""

from twinlens.scenes.materials import (
    Bitmap as Bitmap,
    Color as Color,
    Material as Material,
    Plugin as Plugin,
    VertexColor as VertexColor,
)
from twinlens.scenes.rigs import rig_from_table as rig_from_table
from twinlens.scenes.scene import (
    Mesh as Mesh,
    Scene as Scene,
    SceneObject as SceneObject,
    Sky as Sky,
)
from twinlens.scenes.scene_file import (
    bundled_folder as bundled_folder,
    bundled_headings as bundled_headings,
    bundled_scenes as bundled_scenes,
    load_scene as load_scene,
    read_toml as read_toml,
    scene_with_rig as scene_with_rig,
)
