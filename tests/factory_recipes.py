"""A tiny scene and recipes of it, quick to render: boxes before a wall, lit from everywhere."""

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.dataset.codecs.exr import encode_exr

PATIENCE_S = 300

SCENE = """
[camera]
position = [0, -3, 1]
look_at = [0, 0, 1]
depth_range = [1.5, 3.6]
baseline = 0.1

[textures.noise]
type = "value_noise"
size = 64
cells = 16

[materials.wall]
type = "diffuse"
reflectance = "noise"

[materials.box]
type = "diffuse"
reflectance = 0.4

[lights.sky]
type = "constant"
radiance = 1.0

[objects.wall]
shape = "box"
extents = [8, 0.2, 8]
translate = [0, 0.5, 1]
material = "wall"

[objects.near]
shape = "box"
extents = [0.4, 0.4, 0.4]
translate = [-0.4, -1, 1]
material = "box"
"""

RECIPE = """
seed = 11
count = {count}
scenes = ["tiny"]
width = 32
height = 24
spp = 1
denoise = false

[rig]
baseline = {{ uniform = [0.05, 0.2] }}

[[lenses]]
kind = "thin"
aperture_mm = {{ choice = [0, 2, 8] }}
focus = "object"

[sensor]
read_noise = {{ normal = [3, 1], clip = [0, 6] }}

[scene.jitter]
right = {{ uniform = [-0.1, 0.1] }}

[splits]
train = 0.7
test = 0.3
"""


def write_recipe(folder: Path, text: str = RECIPE, count: int = 4) -> Path:
    """The recipe as a file in `folder`, with the tiny scene next to it."""
    (folder / "tiny").mkdir(parents=True, exist_ok=True)
    (folder / "tiny" / "scene.toml").write_text(SCENE)
    path = folder / "recipe.toml"
    path.write_text(text.format(count=count))
    return path


def write_sky(path: Path, pixels: Any) -> None:
    """A panorama (H, W, 3) as an .exr file."""
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(
        encode_exr(
            {name: pixels[..., c].astype(np.float32) for c, name in enumerate("RGB")}
        )
    )


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder, dotted ones too, by its relative name."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(
            path.read_bytes()
        ).hexdigest()
        for path in files
    }


def start(
    recipe: Path, folder: Path, *options: str, **more: Any
) -> "subprocess.Popen[str]":
    """`twinlens generate` in a process of its own."""
    command = [
        sys.executable,
        "-m",
        "twinlens",
        "generate",
        str(recipe),
        "-o",
        str(folder),
        *options,
    ]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


def finish(process: "subprocess.Popen[str]") -> str:
    """What a process printed, once it has ended well."""
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    return out


def rows_in(folder: Path) -> int:
    """How many samples an unfinished dataset has."""
    rows = folder / ".rows"
    return len(list(rows.iterdir())) if rows.is_dir() else 0
