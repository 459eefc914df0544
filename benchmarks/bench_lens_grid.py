"""What a grid of lenses costs from one set of light paths, beside its cells one by one: errors and times per cell.

    python benchmarks/bench_lens_grid.py [--scene tabletop] [--width 320] [--spp 64] [--rounds 5] [--write]

6 apertures one stop apart x 4 focus distances. Each round renders the whole grid once and every cell once directly,
with the same sampler and other seeds. Times are CPU seconds of all threads, which a busy machine disturbs less than a
clock's, medians over the rounds. A cell's error is its variance between rounds, meaned over the pixels: both ways are
unbiased (the tests hold that). The error of stratified samples falls as n^-1 to n^-1.5, so the cost at equal error is
taken from its dear end: time x r where the grid has r > 1 times the error, and time x r^(2/3) where r < 1.
`--write` puts the tables into benchmarks/lens_grid.md.
"""

import argparse
import platform
import resource
import statistics
import time
from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.rendering.backends import backend

PAGE = Path(__file__).with_name("lens_grid.md")
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


def timed(run) -> tuple[float, object]:
    start = time.process_time()
    result = run()
    return time.process_time() - start, result


def measure(scene: tl.Scene, rig: tl.Rig, lenses: list, spp: int, rounds: int) -> dict[str, np.ndarray]:
    """Seconds (cells,) and errors (cells,) of the direct way, seconds and errors of the grid."""
    for warm_up in (0, 1):
        tl.render(scene, rig, lenses[0], spp=spp, seed=warm_up)
        tl.render_lens_grid(scene, rig, lenses, spp=spp, seed=warm_up)
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
        "grid_s": np.array(statistics.median(grid_times)),
        "direct_s": np.median(times, axis=0),
        "grid_mse": np.array([variance([grid[i] for grid in grids]) for i in cells]),
        "direct_mse": np.array([variance([single[i] for single in singles]) for i in cells]),
    }


def variance(images: Images) -> float:
    """Variance between rounds, meaned over pixels and channels."""
    return float(np.var(np.asarray(images, dtype=np.float64), axis=0, ddof=1).mean())


def table(lenses: list, found: dict[str, np.ndarray]) -> str:
    ratio = found["grid_mse"] / found["direct_mse"]
    time_ratio = float(found["grid_s"] / found["direct_s"].sum())
    cost = time_ratio * np.maximum(ratio, ratio ** (2 / 3))
    rows = [
        ("aperture mm", "focus m", "direct s", "direct MSE", "grid MSE", "MSE ratio", "cost"),
        ("---",) * 7,
    ]
    for i, lens in enumerate(lenses):
        size = f"{1e3 * lens.aperture_diameter:.2f}", f"{lens.focus_distance:.2f}", f"{found['direct_s'][i]:.3f}"
        errors = f"{found['direct_mse'][i]:.3g}", f"{found['grid_mse'][i]:.3g}"
        rows.append((*size, *errors, f"{ratio[i]:.2f}", f"{cost[i]:.3f}"))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    total, grid = found["direct_s"].sum(), float(found["grid_s"])
    lines.append(f"\nAll cells directly: {total:.2f} s. The grid: {grid:.2f} s, {time_ratio:.3f} of that.")
    lines.append(f"MSE ratio: mean {ratio.mean():.2f}, worst {ratio.max():.2f}. **Cost at equal error:")
    lines.append(f"{cost.max():.3f} in the worst cell, {cost.mean():.3f} in the mean.**")
    lines.append("(The claim: at most 0.2.)")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", action="append")
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    width, height = options.width, options.width * 3 // 4
    setting = f"{backend().name}, {platform.machine()}, {width}x{height}, {options.spp} samples a pixel"
    parts = ["# Many lenses from one set of light paths", f"`python benchmarks/bench_lens_grid.py --write`: {setting},"]
    parts[-1] += f" multijitter; medians of {options.rounds} interleaved rounds."
    for name in options.scene or ["tabletop", "cards"]:
        scene = tl.load_scene(name)
        rig = tl.Rig([tl.Camera.from_fov(width, height, fov_x_deg=40)], [scene.world_from_left])
        lenses = lenses_for(scene)
        found = measure(scene, rig, lenses, options.spp, options.rounds)
        parts += [f"## {name}", table(lenses, found)]
        print("\n\n".join(parts[-2:]), flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    parts.append(f"Peak memory of the process: {peak:.2f} GB.")
    print(parts[-1])
    if options.write:
        PAGE.write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    main()
