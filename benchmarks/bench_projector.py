"""Cost of an active pair against a passive one, and decoded structured light against the truth of projection.

    python benchmarks/bench_projector.py [--width 200] [--spp 64] [--rounds 9] [--contrib FOLDER] [--write]

1. A near infrared pair with a projector of dots between its cameras, against the same pair without it. Both are
   rendered in turn in one process. Time is the processor time of all threads, the median over the rounds of the ratio
   in a round. Noise is the variance between rounds in each pixel, averaged over the pixels; its ratio times that of the
   time is the cost at equal noise, of equal radiance (same exposure), and relative to the square of the mean of the
   image, which is what an automatic exposure leaves.
2. A Gray code and a phase shift of 4 steps, projected by 256 x 192 pixels and seen by a camera of twice the width of 1,
   decoded and compared with the truth: at lit pixels at least 2 pixels away from edges of objects, of shadows and of
   the pattern. Once with direct light only, which shows what light that surfaces reflect at each other changes.
   `--contrib` is a folder with opencv-contrib-python-headless (pip install --target FOLDER), which decodes
   the same images, exposed to 8 bits.

`--write` writes the tables to benchmarks/projector.md.
"""

import argparse
import dataclasses
import platform
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import drjit
import numpy as np
from scipy.ndimage import minimum_filter

import twinlens as tl
from twinlens.geometry import rigid
from twinlens.rendering.backends import backend

PAGE = Path(__file__).with_name("projector.md")
DOTS = tl.Camera.from_fov(640, 480, fov_x_deg=60)
LIGHT = tl.Camera.from_fov(256, 192, fov_x_deg=60)
PERIOD = 16.0


def seconds_of(
    scene: tl.Scene, rig: tl.Rig, spp: int, seed: int
) -> tuple[float, np.ndarray]:
    start = time.process_time()
    images = tl.render(scene, rig, spp=spp, seed=seed)
    drjit.sync_thread()
    return time.process_time() - start, np.stack(
        [image[..., 0] for image in images]
    ).astype(np.float64)


def cost(name: str, power: float, width: int, spp: int, rounds: int) -> str:
    scene = tl.load_scene(name)
    camera = tl.Camera.from_fov(
        width, width * 3 // 4, fov_x_deg=scene.fov_x_deg
    ).replace(band="nir")
    pattern = tl.camera.patterns.dots(
        DOTS.width, DOTS.height, density=0.06, size=2, seed=1
    )
    baseline = 0.1
    dots = tl.Projector(rigid(np.eye(3), [baseline / 2, 0, 0]), DOTS, pattern, power)
    passive = tl.Rig.stereo(camera, baseline, scene.world_from_left)
    rigs = [passive, passive.with_projectors([dots])]
    for rig in rigs:
        seconds_of(scene, rig, spp, 0)  # compiles
    times: list[list[float]] = [[], []]
    images: list[list[np.ndarray]] = [[], []]
    for turn in range(rounds):
        for i in (0, 1) if turn % 2 else (1, 0):
            took, image = seconds_of(scene, rigs[i], spp, turn + 1)
            times[i].append(took)
            images[i].append(image)
    means = [np.mean(each) for each in images]
    noise = [np.var(each, axis=0, ddof=1).mean() for each in images]
    ratio = statistics.median(b / a for a, b in zip(*times, strict=True))
    same = ratio * noise[1] / noise[0]
    share = 1 - means[0] / means[1]
    exposed = same * (means[0] / means[1]) ** 2
    return f"| {name} | {power:g} | {100 * share:.0f} % | {ratio:.3f} | **{same:.2f}** | **{exposed:.2f}** |"


def decoded(
    name: str, ambient: float, depth: int, width: int, spp: int, contrib: Any
) -> list[str]:
    """Rows of the errors of all decoders in one scene, with light paths of up to `depth` segments; -1 is no limit."""
    scene = tl.load_scene(name).with_ambient(max(ambient, 1e-9))
    scene = dataclasses.replace(
        scene, integrator={**scene.integrator, "max_depth": depth}
    )
    camera = tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=scene.fov_x_deg)
    projector = tl.Projector(
        rigid(np.eye(3), [0.15, 0, 0]), LIGHT, "white", 200.0, "rgb"
    )
    rig = tl.Rig([camera], [scene.world_from_left], projectors=[projector])
    truth = tl.projection(scene, rig)
    ids = tl.ground_truth(scene, rig)[0].object_id
    inside = LIGHT.contains(truth.pixels + 2) & LIGHT.contains(truth.pixels - 2)
    away = minimum_filter(truth.lit & inside, 5) & (
        minimum_filter(ids, 5) == -minimum_filter(-ids, 5)
    )

    def shoot(patterns: Sequence[np.ndarray]) -> list[np.ndarray]:
        lit = [rig.with_projectors([projector.with_pattern(each)]) for each in patterns]
        return [
            tl.render(scene, each, spp=spp, seed=seed)[0].mean(axis=2)
            for seed, each in enumerate(lit)
        ]

    def row(what: str, found: np.ndarray, true: np.ndarray, allowed: float) -> str:
        error = np.abs(found - true)
        known = np.isfinite(error)
        within = f"{100 * (error[known] <= allowed).mean():.2f} % within {allowed} px"
        light = f"{'direct' if depth == 2 else 'all'} | {ambient:g}"
        unknown = f"{100 * (1 - known.mean()):.2f} %"
        return f"| {name} | {light} | {what} | {unknown} | {within} | {np.median(error[known]):.4f} |"

    codes = [tl.GrayCode(LIGHT.width, LIGHT.height, axis) for axis in "uv"]
    images = [shoot(code.patterns) for code in codes]
    gray = tl.decode(images[0], codes[0]).position
    fine = tl.PhaseShift(LIGHT.width, LIGHT.height, PERIOD, 4)
    phase = tl.decode(shoot(fine.patterns), fine, coarse=gray).position
    true = truth.pixels[away]
    rows = [
        row("Gray code", gray[away], true[:, 0], 0.5),
        row("phase shift", phase[away], true[:, 0], 0.05),
    ]
    if contrib is not None:
        peer = contrib.structured_light.GrayCodePattern.create(
            LIGHT.width, LIGHT.height
        )
        peer.setWhiteThreshold(1)
        white = np.percentile(images, 99)
        levels = [
            (255 * np.clip(image / white, 0, 1)).astype(np.uint8)
            for each in images
            for image in each
        ]
        pixels = [
            peer.getProjPixel(levels, int(u), int(v)) for v, u in np.argwhere(away)
        ]
        found = np.array([np.inf if failed else at[0] for failed, at in pixels])
        rows.insert(1, row("Gray code, by OpenCV, from 8 bits", found, true[:, 0], 0.5))
    return rows


def opencv_contrib(folder: str | None) -> Any:
    """OpenCV from a folder with its contributed modules, or None. Must be called before cv2 is imported."""
    if folder is None:
        return None
    sys.path.insert(0, folder)
    import cv2

    return cv2


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--width", type=int, default=200)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--contrib")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    contrib = opencv_contrib(options.contrib)
    size = f"{options.width}x{options.width * 3 // 4}, {options.spp} samples per pixel"
    page = [
        "# Projectors",
        "",
        "`python benchmarks/bench_projector.py --contrib FOLDER --write`:",
        f"{backend().name}, {platform.machine()}, {size}.",
        "",
        "## Cost of an active pair",
        "",
        f"Processor time times noise, over that of the passive pair, {options.rounds} rounds. Noise is the variance of",
        "radiance (same exposure), or relative to the square of the image's mean (automatic exposure).",
        "",
        "| scene | power W | light of the projector | time | cost, same exposure | cost, automatic exposure |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, power in (("room", 3.0), ("room", 30.0), ("staircase", 30.0)):
        page.append(cost(name, power, options.width, options.spp, options.rounds))
        print(page[-1], flush=True)
    page += [
        "",
        "Required: at most 1.3.",
        "",
        "## Decoded columns",
        "",
        f"Camera: {2 * options.width}x{2 * options.width * 3 // 4}. A projector of 256 x 192 pixels; the phase shift",
        f"has 4 steps and a period of {PERIOD:g} px. Errors are those of the decoded pixels; the others are unknown,",
        "as too little of the projector's light comes back from them.",
        "",
        "| scene | light of the projector | ambient | code | unknown | error | median px |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, ambient, depth in (
        ("room", 0.0, 2), ("room", 0.0, -1), ("room", 1.0, -1), ("staircase", 0.0, 2), ("staircase", 0.0, -1),
    ):  # fmt: skip
        page += decoded(name, ambient, depth, 2 * options.width, options.spp, contrib)
        print("\n".join(page[-3:]), flush=True)
    page += [
        "",
        "Required: at least 99 % of the pixels of a Gray code within 0.5 px, and of a phase shift within 0.05 px. The",
        "phase shift fails this where surfaces light each other, as it does in reality: their light has another phase.",
        "Rows of direct light show that nothing else does it. The noise of ambient light adds to this. OpenCV returns",
        "whole pixels, which is an error of 0.25 px in the median.",
    ]
    if options.write:
        PAGE.write_text("\n".join(page) + "\n")


if __name__ == "__main__":
    main()
