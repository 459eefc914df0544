"""Processor time of the images of an aperture's parts, and of light fields, relative to whole images.

    python benchmarks/bench_parts.py [--scenes cards,staircase] [--rounds 5] [--write]

Runs alternate; ratios are of medians over the rounds, after one run that compiles. Noise is measured on the difference
of two images with other seeds. `--write` writes the table to benchmarks/parts.md.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import twinlens as tl

SIZE, FOV, APERTURE, SPP, VIEWS = (160, 120), 50.0, 0.016, 64, 9
DENOISED, RAW, REFERENCE = 16, (16, 64, 256), 1024  # samples per pixel
PAGE = Path(__file__).with_name("parts.md")
HEAD = f"""# Cost of the parts of an aperture

`python benchmarks/bench_parts.py --write`. {SIZE[0]}x{SIZE[1]}, {SPP} samples per pixel, a lens of
{1e3 * APERTURE:g} mm focused in the middle of the scene; processor time relative to one whole image. `light field` is
the cost of {VIEWS}x{VIEWS} views by `parts=tl.Grid({VIEWS})`, at the noise of separate renders of each view, relative
to those renders: cells of the grid that are inside the aperture, {VIEWS**2} renders. `denoised` is the cost of a view
of {DENOISED} samples with `denoise=True`, relative to a raw view of the same rms error, the filter's bias included.

| scene | `Dual` | `Quad` | `Grid({VIEWS})` | light field | denoised |
| --- | ---: | ---: | ---: | ---: | ---: |
"""


def seconds(jobs: Sequence[Callable[[int], Any]], rounds: int) -> list[float]:
    """The median processor time of each job(seed); the first round is left out."""
    times = np.empty((rounds + 1, len(jobs)))
    for k in range(rounds + 1):
        for j, job in enumerate(jobs):
            start = time.process_time()
            job(k)
            times[k, j] = time.process_time() - start
    return list(np.median(times[1:], axis=0))


def variance(job: Callable[[int], Any]) -> np.ndarray:
    """The mean variance of each image (N, H, W, 3) that the job makes, from two seeds."""
    first, second = (np.asarray(job(seed), np.float64) for seed in (100, 101))
    return np.square(first - second).mean(axis=(1, 2, 3)) / 2


def denoised_cost(scene: tl.Scene, single: tl.Rig, rounds: int) -> float:
    """Processor time of a denoised view relative to a raw one of equal mean squared error.

    The mean product of the differences from two independent references has no error of the references. The cost of the
    raw view is interpolated between those of `RAW` samples.
    """

    def view(spp: int, denoise: bool = False) -> Callable[[int], Any]:
        return lambda seed: tl.render(scene, single, tl.Pinhole(), spp, seed, denoise=denoise)[0].astype(np.float64)

    references = [view(REFERENCE)(seed) for seed in (1000, 1001)]
    jobs = [view(DENOISED, denoise=True), *map(view, RAW)]
    errors = np.empty(len(jobs))
    for j, job in enumerate(jobs):
        images = np.stack([job(seed) for seed in range(4)])
        errors[j] = ((images - references[0]) * (images - references[1])).mean()
    costs = np.array(seconds(jobs, rounds))
    equal = np.interp(np.log(errors[0]), np.log(errors[:0:-1]), np.log(costs[:0:-1]))
    return float(costs[0] / np.exp(equal))


def row(name: str, rounds: int) -> str:
    scene, camera = tl.load_scene(name), tl.Camera.from_fov(*SIZE, FOV)
    near, far = scene.depth_range
    lens, alone = tl.ThinLens(APERTURE, 2 / (1 / near + 1 / far)), tl.Rig([camera], [scene.world_from_left])

    def image(parts: Any = None, spp: int = SPP) -> Callable[[int], Any]:
        return lambda seed: tl.render(scene, alone, lens, spp, seed, parts=parts)[0]

    grid = tl.Grid(VIEWS)
    whole, dual, quad, cells = seconds([image(), image(tl.Dual()), image(tl.Quad()), image(grid)], rounds)
    views = tl.light_field_rig(camera, lens, VIEWS, scene.world_from_left)
    middle = VIEWS**2 // 2
    single = tl.Rig([views.cameras[middle]], [views.world_from_cams[middle]])

    def view(seed: int) -> Any:
        return tl.render(scene, single, tl.Pinhole(), SPP, seed)

    light = grid.light(lens.aperture)[0]
    inside = light > 0.99 * light.max()
    noise = variance(image(grid))[inside] / light[inside] ** 2
    (alone_seconds,) = seconds([view], rounds)
    cost = cells * noise.mean() / (VIEWS**2 * alone_seconds * variance(view).mean())
    ratios = [dual / whole, quad / whole, cells / whole, cost, denoised_cost(scene, single, rounds)]
    return f"| {name} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="cards,staircase", help="Names of bundled scenes.")
    parser.add_argument("--rounds", type=int, default=5, help="Runs of each job.")
    parser.add_argument("--write", action="store_true", help="Write the table to benchmarks/parts.md.")
    options = parser.parse_args()
    lines = []
    for name in options.scenes.split(","):
        lines.append(row(name, options.rounds))
        print(lines[-1], flush=True)
    if options.write:
        PAGE.write_text(HEAD + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
