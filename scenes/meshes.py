"""Writes the meshes of the bundled scenes, scenes/<name>/*.glb: things of random scenes, each drawn once.

python scenes/meshes.py                  # all of them
python scenes/meshes.py corner

The files are what the scenes consist of. A later version of the generators may draw other things from the same seeds.
Axes are those of a scene: z points up, things face -y and stand on z = 0. (u, v) are in metres.
"""

import sys
from pathlib import Path

import numpy as np
import trimesh

from twinlens.families.things import make_thing
from twinlens.scenes import bundled_folder
from twinlens.scenes.scene import Mesh

MESHES: dict[str, dict[str, tuple[str, int, str]]] = {
    "corner": {
        "plant": ("pot-plant", 1, "pot soil stems leaves"),
        "chair": ("slatted-chair", 3, "frame slats seat"),
        "grille": ("grille", 5, "bars frame"),
        "wheel": ("spoked-wheel", 1, "tire rim hub stand"),
        "lamp": ("desk-lamp", 1, "stand shade cable"),
        "basket": ("basket", 1, "weave rim"),
    },
    "yard": {
        "bush": ("pot-plant", 4, "pot soil stems leaves"),
        "bicycle": ("bicycle", 2, "frame metal tires saddle"),
        "trellis": ("grille", 5, "bars frame"),
        "steps": ("steps", 1, "strings rails"),
    },
}
"""Scene -> name in the scene -> thing, seed, and its parts that are files."""


def write_glb(path: Path, mesh: Mesh) -> None:
    """Write positions, normals and (u, v) as float32."""
    visual = trimesh.visual.TextureVisuals(uv=mesh.uv)
    made = trimesh.Trimesh(
        mesh.vertices,
        mesh.faces,
        vertex_normals=mesh.normals,
        visual=visual,
        process=False,
    )
    made.export(str(path), include_normals=True)


def main(names: list[str]) -> None:
    """Write the meshes of the named scenes, or of all scenes."""
    for scene in names or MESHES:
        for name, (thing, seed, parts) in MESHES[scene].items():
            piece = make_thing(thing, np.random.default_rng(seed))
            meshes = {part: mesh for part, mesh, _ in piece.parts}
            for part in parts.split():
                path = bundled_folder() / scene / f"{name}-{part}.glb"
                write_glb(path, meshes[part])
                print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
