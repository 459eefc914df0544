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
`shared light` is the same for a view of `tl.render_light_field` with {SPP} samples: 1/{VIEWS**2} of its cost, and
the error of a corner view, the middle one and one between them.

| scene | `Dual` | `Quad` | `Grid({VIEWS})` | light field | denoised | shared light |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
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


def alone(rig: tl.Rig, view: int) -> tl.Rig:
    return tl.Rig([rig.cameras[view]], [rig.world_from_cams[view]])


def cost_at_equal_error(
    scene: tl.Scene,
    rig: tl.Rig,
    views: Sequence[int],
    job: Callable[[int], Sequence[Any]],
    share: float,
    rounds: int,
) -> float:
    """Processor time of `share` of a job(seed), which makes images of `views`, relative to a raw view of equal error.

    The error is the mean squared one. The mean product of the differences from two independent references has no error
    of the references. The cost of the raw view is interpolated between those of `RAW` samples.
    """

    def raw(spp: int, *chosen: int) -> Callable[[int], list[Any]]:
        return lambda seed: [
            tl.render(scene, alone(rig, v), tl.Pinhole(), spp, seed)[0] for v in chosen
        ]

    references = [
        np.array(raw(REFERENCE, *views)(seed), np.float64) for seed in (1000, 1001)
    ]

    def error(images: Sequence[Any]) -> float:
        return float(((images - references[0]) * (images - references[1])).mean())

    own, *errors = (
        np.mean([error(np.array(each(seed), np.float64)) for seed in range(4)])
        for each in (job, *(raw(spp, *views) for spp in RAW))
    )
    cost, *costs = seconds([job, *(raw(spp, views[-1]) for spp in RAW)], rounds)
    return float(
        share
        * cost
        / np.exp(np.interp(np.log(own), np.log(errors[::-1]), np.log(costs[::-1])))
    )


def row(name: str, rounds: int) -> str:
    scene, camera = tl.load_scene(name), tl.Camera.from_fov(*SIZE, FOV)
    near, far = scene.depth_range
    lens, whole_rig = (
        tl.ThinLens(APERTURE, 2 / (1 / near + 1 / far)),
        tl.Rig([camera], [scene.world_from_left]),
    )

    def image(parts: Any = None, spp: int = SPP) -> Callable[[int], Any]:
        return lambda seed: tl.render(scene, whole_rig, lens, spp, seed, parts=parts)[0]

    grid = tl.Grid(VIEWS)
    whole, dual, quad, cells = seconds(
        [image(), image(tl.Dual()), image(tl.Quad()), image(grid)], rounds
    )
    views = tl.light_field_rig(camera, lens, VIEWS, scene.world_from_left)
    middle = VIEWS**2 // 2
    single = alone(views, middle)

    def view(seed: int) -> Any:
        return tl.render(scene, single, tl.Pinhole(), SPP, seed)

    def denoised(seed: int) -> Any:
        return tl.render(scene, single, tl.Pinhole(), DENOISED, seed, denoise=True)

    def shared(seed: int) -> Any:
        images = tl.render_light_field(scene, views, SPP, seed)
        return [images[v] for v in (0, middle // 2, middle)]

    light = grid.light(lens.aperture)[0]
    inside = light > 0.99 * light.max()
    noise = variance(image(grid))[inside] / light[inside] ** 2
    (alone_seconds,) = seconds([view], rounds)
    cost = cells * noise.mean() / (VIEWS**2 * alone_seconds * variance(view).mean())
    ratios = [dual / whole, quad / whole, cells / whole, cost]
    ratios.append(cost_at_equal_error(scene, views, [middle], denoised, 1, rounds))
    ratios.append(
        cost_at_equal_error(
            scene, views, [0, middle // 2, middle], shared, 1 / VIEWS**2, rounds
        )
    )
    return f"| {name} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scenes", default="cards,staircase", help="Names of bundled scenes."
    )
    parser.add_argument("--rounds", type=int, default=5, help="Runs of each job.")
    parser.add_argument(
        "--write", action="store_true", help="Write the table to benchmarks/parts.md."
    )
    options = parser.parse_args()
    lines = []
    for name in options.scenes.split(","):
        lines.append(row(name, options.rounds))
        print(lines[-1], flush=True)
    if options.write:
        PAGE.write_text(HEAD + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
