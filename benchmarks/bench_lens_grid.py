"""What a grid of lenses costs from one set of light paths, beside its cells one by one: errors and times per cell.

    python benchmarks/bench_lens_grid.py [--run tabletop:240:64 ...] [--rounds 2] [--write]

6 apertures one stop apart x 4 focus distances; a run is scene:width:samples. Each round renders the whole grid once
and every cell once directly, with the same sampler and other seeds. Times are CPU seconds of all threads, which a busy
machine disturbs less than a clock's, medians over the rounds; the wall's stand beside them in the summary. Both ways
are unbiased (the tests hold that), so a cell's error is its variance between rounds: of single pixels, meaned over the
image, and of the means of 8x8 pixels, which tells whether neighbours err alike. Errors of stratified samples fall as
n^-1 to n^-1.5, so the cost at equal error is taken from its dear end: time x r where the grid has r > 1 times the
error, and time x r^(2/3) where r < 1. `--write` puts the tables into benchmarks/lens_grid.md.
"""

import argparse
import platform
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.rendering.backends import backend

PAGE = Path(__file__).with_name("lens_grid.md")
RUNS = ("tabletop:240:64", "cards:240:64", "room:240:32", "tabletop:640:16")
BLOCK = 8
STOPS = 6
FOCUSES = (0.25, 0.5, 0.75, 1.0)  # where between the near and the far end of the scene, in 1/m
WIDEST = 0.02  # of the nearest depth: the largest aperture's diameter
Images = list[np.ndarray]


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


def measure(scene: tl.Scene, rig: tl.Rig, lenses: list, spp: int, rounds: int) -> dict[str, np.ndarray]:
    """Seconds (cells, 2) and errors (cells, 2) of the direct way, seconds (2,) and errors (cells, 2) of the grid."""
    tl.render(scene, rig, lenses[0], spp=spp)
    tl.render_lens_grid(scene, rig, lenses, spp=spp)
    cells = range(len(lenses))
    grids: list[Images] = []
    singles: list[Images] = []
    grid_times, times = [], []
    for seed in range(2, 2 + rounds):
        took, grid = timed(lambda seed=seed: tl.render_lens_grid(scene, rig, lenses, spp=spp, seed=seed))
        grid_times.append(took)
        grids.append([grid[i][0] for i in cells])
        rows = [
            timed(lambda i=i, seed=seed: tl.render(scene, rig, lenses[i], spp=spp, seed=1000 * seed + i)) for i in cells
        ]
        times.append([row[0] for row in rows])
        singles.append([row[1][0] for row in rows])
    return {
        "grid_s": np.median(grid_times, axis=0),
        "direct_s": np.median(times, axis=0),
        "grid_mse": np.array([errors([grid[i] for grid in grids]) for i in cells]),
        "direct_mse": np.array([errors([single[i] for single in singles]) for i in cells]),
    }


def errors(images: Images) -> tuple[float, float]:
    """Variance between rounds of single pixels and of the means of blocks, meaned over the image and channels."""
    stack = np.asarray(images, dtype=np.float64)
    n, height, width, _ = stack.shape
    rows, columns = height // BLOCK, width // BLOCK
    cut = stack[:, : rows * BLOCK, : columns * BLOCK].reshape(n, rows, BLOCK, columns, BLOCK, 3).mean(axis=(2, 4))
    return float(stack.var(axis=0, ddof=1).mean()), float(cut.var(axis=0, ddof=1).mean())


def table(lenses: list, found: dict[str, np.ndarray]) -> str:
    ratio = found["grid_mse"] / found["direct_mse"]
    (total, total_wall), (grid, grid_wall) = found["direct_s"].sum(axis=0), found["grid_s"]
    cost = grid / total * np.maximum(ratio, ratio ** (2 / 3))
    rows = [
        (
            "aperture mm",
            "focus m",
            "direct s",
            "direct MSE",
            "grid MSE",
            "MSE ratio",
            "cost",
            "block ratio",
            "block cost",
        ),
        ("---",) * 9,
    ]
    for i, lens in enumerate(lenses):
        size = f"{1e3 * lens.aperture_diameter:.2f}", f"{lens.focus_distance:.2f}", f"{found['direct_s'][i, 0]:.3f}"
        mse = f"{found['direct_mse'][i, 0]:.3g}", f"{found['grid_mse'][i, 0]:.3g}"
        told = (f"{ratio[i, 0]:.2f}", f"{cost[i, 0]:.3f}", f"{ratio[i, 1]:.2f}", f"{cost[i, 1]:.3f}")
        rows.append((*size, *mse, *told))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.append(f"\nAll cells directly: {total:.2f} s CPU, {total_wall:.2f} s wall. The grid: {grid:.2f} s CPU,")
    lines.append(
        f"{grid_wall:.2f} s wall: {grid / total:.3f} of the CPU time, {grid_wall / total_wall:.3f} of the wall's."
    )
    lines.append(f"MSE ratio: mean {ratio[:, 0].mean():.2f}, worst {ratio[:, 0].max():.2f}. **Cost at equal error:")
    lines.append(
        f"{cost[:, 0].max():.3f} in the worst cell, {cost[:, 0].mean():.3f} in the mean.** (The claim: at most 0.2.)"
    )
    lines.append(f"Of 8x8 means: MSE ratio mean {ratio[:, 1].mean():.2f}, worst {ratio[:, 1].max():.2f}; cost")
    lines.append(f"{cost[:, 1].max():.3f} in the worst cell, {cost[:, 1].mean():.3f} in the mean.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="append", help="scene:width:samples")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    setting = f"{backend().name}, {platform.machine()}, multijitter; medians of {options.rounds} interleaved rounds."
    parts = ["# Many lenses from one set of light paths", f"`python benchmarks/bench_lens_grid.py --write`: {setting}"]
    for run in options.run or RUNS:
        name, width, spp = run.split(":")[0], *map(int, run.split(":")[1:])
        scene = tl.load_scene(name)
        rig = tl.Rig([tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=40)], [scene.world_from_left])
        lenses = lenses_for(scene)
        found = measure(scene, rig, lenses, spp, options.rounds)
        parts += [f"## {name}, {width}x{width * 3 // 4}, {spp} samples a pixel", table(lenses, found)]
        print("\n\n".join(parts[-2:]), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    parts.append(f"Peak memory of the process: {peak:.2f} GB.")
    print(parts[-1])
    if options.write:
        PAGE.write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    main()
