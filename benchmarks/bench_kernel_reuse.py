"""Kernels that random scenes share: how many each scene compiles, and the processor time of compiling them.

    python benchmarks/bench_kernel_reuse.py [--scenes 10] [--size 320x240] [--write]

Each family is rendered in processes of its own that start with an empty DRJIT_CACHE_DIR, once without and once with
`twinlens.rendering.share_kernels`; then all families in turn share kernels. Each scene's stereo pair and ground truth
are computed twice; the time of compiling, or of loading kernels from the cache, is the difference of the processor
times. The images must be the same bytes. Kernels are dropped from memory after each scene, as in `twinlens generate`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from twinlens.families import FAMILIES

PAGE = Path(__file__).with_name("kernel_reuse.md")
HEAD = "| family |"
RENDER = """
import hashlib, json, os, sys, time
from pathlib import Path
import twinlens as tl
from twinlens.families import random_scene
from twinlens.rendering import forget_kernels, share_kernels
from twinlens.rendering.build import build
families, count, width, height, placeholders = json.loads(sys.argv[1])
if placeholders:
    share_kernels()
cache = Path(os.environ["DRJIT_CACHE_DIR"])

def pair(scene):
    camera = tl.Camera.from_fov(width, height, fov_x_deg=50)
    rig = tl.Rig.stereo(camera, baseline=0.1, world_from_left=scene.world_from_left)
    start = time.process_time()
    images = tl.render(scene, rig, tl.ThinLens(0.02, 2.0), spp=1)
    tl.ground_truth(scene, rig)
    return images, time.process_time() - start

random_scene("cards", 0, width=64)
for seed in range(count):
    for family in families:
        scene = random_scene(family, seed, width=width)
        build(scene)
        before = len(list(cache.glob("*.bin")))
        (images, first), (_, second) = pair(scene), pair(scene)
        kernels = len(list(cache.glob("*.bin"))) - before
        digest = hashlib.sha256(b"".join(image.tobytes() for image in images)).hexdigest()
        print(json.dumps([family, kernels, first - second, second, digest]), flush=True)
        del scene
        forget_kernels()
"""


def rendered(
    families: list[str], count: int, size: tuple[int, int], placeholders: bool
) -> list[list]:
    """[family, kernels, seconds of compiling, seconds of rendering, digest] of each scene."""
    with tempfile.TemporaryDirectory() as cache:
        command = [
            sys.executable,
            "-c",
            RENDER,
            json.dumps([families, count, *size, placeholders]),
        ]
        environment = {
            **os.environ,
            "DRJIT_CACHE_DIR": cache,
            "TWINLENS_BACKEND": "llvm",
        }
        text = subprocess.check_output(command, env=environment, text=True)
    return [json.loads(line) for line in text.splitlines()]


def means(rows: list[list]) -> str:
    """Cells: kernels of a scene, scenes without a new kernel, seconds of compiling."""
    kernels, compiling = [row[1] for row in rows], [row[2] for row in rows]
    reused = sum(count == 0 for count in kernels)
    return f"{sum(kernels) / len(rows):.1f} | {reused} of {len(rows)} | {sum(compiling) / len(rows):.2f}"


def table(count: int, size: tuple[int, int]) -> list[str]:
    """Markdown rows: without and with `share_kernels`, for each family apart and for all in one process."""
    cells = "kernels per scene | scenes without a new one | s per scene"
    lines = [
        f"{HEAD} not shared: {cells} | shared: {cells} |",
        "| --- |" + " ---: |" * 6,
    ]
    own: list[list] = []
    for families in (*([name] for name in FAMILIES), list(FAMILIES)):
        alone = rendered(families, count, size, False) if len(families) == 1 else own
        shared = rendered(families, count, size, True)
        if {row[-1] for row in alone} != {row[-1] for row in shared}:
            raise SystemExit(f"{families}: images differ")
        own = [*own, *alone]
        name = families[0] if len(families) == 1 else "all in turn"
        lines.append(f"| {name} | {means(alone)} | {means(shared)} |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Print the table, and write the page with --write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=10, help="scenes of each family")
    parser.add_argument("--size", default="320x240", help="image size, WIDTHxHEIGHT")
    parser.add_argument(
        "--write", action="store_true", help=f"replace the table in {PAGE.name}"
    )
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    lines = table(options.scenes, (width, height))
    if options.write:
        before, _, rest = PAGE.read_text().partition(HEAD)
        after = "".join(
            line
            for line in rest.splitlines(keepends=True)[1:]
            if not line.startswith("|")
        )
        PAGE.write_text(before + "\n".join(lines) + "\n" + after)


if __name__ == "__main__":
    main()
