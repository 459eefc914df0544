"""What a grid of lenses costs from one set of light paths, beside its cells one by one: errors and times per cell.

    python benchmarks/bench_lens_grid.py [--run tabletop:240:64 ...] [--rounds 8] [--direct 2] [--write]

6 apertures one stop apart x 4 focus distances; a run is scene:width:samples. Each round renders the whole grid once,
and the first rounds every cell once directly, with the same sampler and other seeds. Times are CPU seconds of all
threads, which a busy machine disturbs less than a clock's, medians over the rounds; the wall's stand beside them in the
summary. Both ways are unbiased (the tests hold that), so a cell's error is its variance between rounds: of single
pixels, meaned over the image, and of the means of 8x8 pixels, which tells whether neighbours err alike.

All pixels of a grid share one pattern of samples, so that its errors need more rounds than direct images, whose pixels
err independently: behind +- stand standard errors of the ratio, by the jackknife over the grid's rounds and from the
scatter over the blocks of the direct images.

Errors of stratified samples fall as n^-1 to n^-1.5, so the cost at equal error is taken from its dear end: time x r
where the grid has r > 1 times the error, and time x r^(2/3) where r < 1. `--write` puts the tables into
benchmarks/lens_grid.md.
"""

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.rendering.backends import backend

PAGE = Path(__file__).with_name("lens_grid.md")
RUNS = ("cards:240:64", "tabletop:240:64", "room:240:32", "tabletop:640:16")
BLOCK = 8
STOPS = 6
FOCUSES = (0.25, 0.5, 0.75, 1.0)  # where between the near and the far end of the scene, in 1/m
WIDEST = 0.02  # of the nearest depth: the largest aperture's diameter
COLUMNS = (
    "aperture mm",
    "focus m",
    "direct s",
    "direct MSE",
    "grid MSE",
    "MSE ratio",
    "cost",
    "block ratio",
    "block cost",
)


def lenses_for(scene: tl.Scene) -> list[tl.ThinLens]:
    """The grid, apertures from wide to narrow, each at all focus distances."""
    near, far = scene.depth_range
    diameters = [WIDEST * near / 2 ** (0.5 * stop) for stop in range(STOPS)]
    focuses = [1 / ((1 - t) / near + t / far) for t in FOCUSES]
    return [tl.ThinLens(diameter, focus) for diameter in diameters for focus in focuses]


def timed(run: Callable[[], object]) -> tuple[np.ndarray, object]:
    """(CPU, wall) seconds, and the result."""
    start = time.process_time(), time.perf_counter()
    result = run()
    return np.array([time.process_time() - start[0], time.perf_counter() - start[1]]), result


def measure(scene: tl.Scene, rig: tl.Rig, lenses: list, spp: int, rounds: int, direct: int) -> dict[str, np.ndarray]:
    """Seconds (cells, 2) and images (rounds, cells, H, W, 3) of the direct way; seconds (2,) and images of the grid."""
    tl.render(scene, rig, lenses[0], spp=spp)
    tl.render_lens_grid(scene, rig, lenses, spp=spp)
    found: dict[str, list] = {"grid_s": [], "direct_s": [], "grid": [], "direct": []}
    for seed in range(2, 2 + rounds):
        took, grid = timed(lambda seed=seed: tl.render_lens_grid(scene, rig, lenses, spp=spp, seed=seed))
        found["grid_s"].append(took)
        found["grid"].append([images[0] for images in grid])
        if seed < 2 + direct:
            rows = [
                timed(lambda lens=lens, i=i, seed=seed: tl.render(scene, rig, lens, spp=spp, seed=1000 * seed + i))
                for i, lens in enumerate(lenses)
            ]
            found["direct_s"].append([row[0] for row in rows])
            found["direct"].append([row[1][0] for row in rows])
    seconds = {name: np.median(found[name], axis=0) for name in ("grid_s", "direct_s")}
    return seconds | {name: np.asarray(found[name]) for name in ("grid", "direct")}


def squares(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances between rounds of the pixels and of the means of blocks, meaned over channels: two maps of blocks."""
    n, height, width, _ = images.shape
    rows, columns = height // BLOCK, width // BLOCK
    cut = images[:, : rows * BLOCK, : columns * BLOCK].astype(np.float64).reshape(n, rows, BLOCK, columns, BLOCK, 3)
    pixels = cut.var(axis=0, ddof=1).mean(axis=(1, 3, 4))
    return pixels, cut.mean(axis=(2, 4)).var(axis=0, ddof=1).mean(axis=-1)


def errors_of_direct(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared errors (2,), of pixels and of blocks, and their relative standard errors: blocks are independent."""
    both = np.array(squares(images))
    return both.mean(axis=(1, 2)), both.std(axis=(1, 2)) / np.sqrt(both[0].size) / both.mean(axis=(1, 2))


def errors_of_grid(images: np.ndarray) -> np.ndarray:
    """Mean squared errors (1 + rounds, 2) of pixels and blocks: of all rounds, and without the first, the second..."""
    parts = [images, *(np.delete(images, i, axis=0) for i in range(len(images) if len(images) > 2 else 0))]
    return np.array([[part.mean() for part in squares(of)] for of in parts])


def jackknife(values: np.ndarray) -> np.ndarray:
    """The standard error of what was computed without the first, without the second... of n rounds, along axis 0."""
    return np.sqrt((len(values) - 1) * values.var(axis=0)) if len(values) else np.full(values.shape[1:], np.nan)


def at_equal_error(ratio: np.ndarray) -> np.ndarray:
    """How much more time the error of the direct way would take."""
    return np.maximum(ratio, ratio ** (2 / 3))


def table(lenses: list, found: dict[str, np.ndarray]) -> str:
    (total, total_wall), (grid_s, grid_wall) = found["direct_s"].sum(axis=0), found["grid_s"]
    told = [errors_of_direct(found["direct"][:, i]) for i in range(len(lenses))]
    direct, doubt = (np.array(part) for part in zip(*told, strict=True))
    grid = np.array([errors_of_grid(found["grid"][:, i]) for i in range(len(lenses))]).swapaxes(0, 1)
    ratios = grid / direct
    ratio, spread = ratios[0], np.hypot(jackknife(ratios[1:]), ratios[0] * doubt)
    cost = grid_s / total * at_equal_error(ratio)
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for i, lens in enumerate(lenses):
        size = f"{1e3 * lens.aperture_diameter:.2f}", f"{lens.focus_distance:.2f}", f"{found['direct_s'][i, 0]:.3f}"
        mse = f"{direct[i, 0]:.3g}", f"{grid[0, i, 0]:.3g}"
        pairs = [(f"{ratio[i, k]:.2f} +- {spread[i, k]:.2f}", f"{cost[i, k]:.3f}") for k in (0, 1)]
        rows.append((*size, *mse, *pairs[0], *pairs[1]))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.append(f"\nAll cells directly: {total:.2f} s CPU, {total_wall:.2f} s wall. The grid: {grid_s:.2f} s CPU,")
    lines.append(
        f"{grid_wall:.2f} s wall: {grid_s / total:.3f} of the CPU time, {grid_wall / total_wall:.3f} of the wall's."
    )
    means, sums = ratios.mean(axis=1), grid[0].sum(axis=0) / direct.sum(axis=0)
    for k, name in ((0, "Single pixels"), (1, "Means of 8x8")):
        r, c = ratio[:, k], cost[:, k]
        lines.append(
            f"\n{name}: MSE ratio {means[0, k]:.2f} +- {jackknife(means[1:])[k]:.2f} in the mean over cells, "
            f"{r.max():.2f} in the worst, {sums[k]:.2f} of the errors' sums.\n**Cost at equal error: {c.mean():.3f} in "
            f"the mean, {c.max():.3f} in the worst cell, {grid_s / total * at_equal_error(sums[k]):.3f} of the sums.**"
        )
    return "\n".join(lines) + "\n(The claim: single pixels at most 0.2.)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="append", help="scene:width:samples")
    parser.add_argument("--rounds", type=int, default=8, help="of the grid, at least 2")
    parser.add_argument("--direct", type=int, default=2, help="of the direct images, at least 2")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rounds, direct = max(2, options.rounds, options.direct), max(2, options.direct)
    setting = f"{backend().name}, {platform.machine()}, multijitter; {rounds} rounds, {direct} of the direct images."
    parts = ["# Many lenses from one set of light paths", f"`python benchmarks/bench_lens_grid.py --write`: {setting}"]
    for run in options.run or RUNS:
        name, width, spp = run.split(":")[0], *map(int, run.split(":")[1:])
        scene = tl.load_scene(name)
        rig = tl.Rig([tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=40)], [scene.world_from_left])
        lenses = lenses_for(scene)
        found = measure(scene, rig, lenses, spp, rounds, direct)
        parts += [f"## {name}, {width}x{width * 3 // 4}, {spp} samples a pixel", table(lenses, found)]
        print("\n\n".join(parts[-2:]), flush=True)
    if options.write:
        PAGE.write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    main()
