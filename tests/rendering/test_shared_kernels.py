"""Scenes of all families share kernels, and their images are those of kernels of their own."""

import json
import os
import subprocess
import sys

import pytest

SCENES = [
    ["tabletop", 0],
    ["tabletop", 1],
    ["cards", 4],
    ["street", 0],
]  # other numbers of objects, types of materials and skies
RENDER = """
import hashlib, json, os, sys
from pathlib import Path
import twinlens as tl
from twinlens.families import random_scene
from twinlens.rendering import forget_kernels, share_kernels
from twinlens.rendering.framing import built_for
if sys.argv[1] == "shared":
    share_kernels()
cache, rows = Path(os.environ["DRJIT_CACHE_DIR"]), []
for family, seed in json.loads(sys.argv[2]):
    scene = random_scene(family, seed, width=64)
    rig = tl.Rig([tl.Camera.from_fov(32, 24, fov_x_deg=50)], [scene.world_from_left])
    built_for(scene, rig)
    before = set(cache.glob("*.bin"))
    images = tl.render(scene, rig, tl.ThinLens(0.02, 2.0), spp=1)
    large = [file for file in set(cache.glob("*.bin")) - before if file.stat().st_size > 20_000]
    rows.append([len(large), hashlib.sha256(images[0].tobytes()).hexdigest()])
    del scene
    forget_kernels()
print(json.dumps(rows))
"""


def rows(which, scenes, folder):
    """[path tracing kernels compiled, digest of the image] of each scene."""
    environment = {
        **os.environ,
        "DRJIT_CACHE_DIR": str(folder),
        "TWINLENS_BACKEND": "llvm",
    }
    command = [sys.executable, "-c", RENDER, which, json.dumps(scenes)]
    child = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300
    )
    assert child.returncode == 0, child.stderr
    return json.loads(child.stdout)


@pytest.mark.slow
def test_scenes_of_families_share_a_kernel_and_keep_their_images(tmp_path):
    shared = rows("shared", SCENES, tmp_path / "shared")
    apart = rows("own", SCENES, tmp_path / "own")
    assert [kernels for kernels, _ in shared] == [1, 0, 0, 0]
    assert [kernels for kernels, _ in apart] == [1, 1, 1, 1]
    assert [digest for _, digest in shared] == [digest for _, digest in apart]


@pytest.mark.slow
def test_the_order_of_scenes_changes_neither_kernels_nor_images(tmp_path):
    forward = rows("shared", SCENES, tmp_path)
    backward = rows("shared", SCENES[::-1], tmp_path)
    assert [digest for _, digest in forward] == [digest for _, digest in backward[::-1]]
    assert sum(kernels for kernels, _ in backward) == 0
