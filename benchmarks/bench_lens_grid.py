"""Cost of a grid of lenses from one set of light paths against direct renders of its cells: errors and times.

    python benchmarks/bench_lens_grid.py [--run tabletop:240:64 ...] [--rounds 8] [--direct 2] [--write]

The grid has 6 apertures one stop apart and 4 focus distances; a run is scene:width:samples. Each round renders the
whole grid once; the first rounds also render every cell directly, with the same sampler and other seeds. Times are
medians over the rounds of the CPU seconds of all threads, which are more robust than wall time on a busy machine; the
summary also has wall times. Both estimators are unbiased (tested), so the error of a cell is its variance between
rounds: of single pixels, averaged over the image, and of means over 8x8 pixels, which shows correlated errors.

All pixels of a grid share one sample pattern, so its errors need more rounds than direct renders, whose pixels are
independent. Values after +- are standard errors of the ratio, from the jackknife over the grid's rounds and the
variance over blocks of the direct renders.

Errors of stratified samples fall as n^-1 to n^-1.5. The cost at equal error is the larger estimate: time x r if the
grid has r > 1 times the error, and time x r^(2/3) if r < 1. `--write` writes the tables to benchmarks/lens_grid.md.
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
LEGEND = """\
A row is one lens. MSE ratio: grid / direct. Cost: CPU time of the grid, for the error of direct renders, over that
of all direct renders. Block ratio and block cost: the same for means over 8x8 pixels."""
RUNS = ("cards:240:64", "tabletop:240:64", "room:240:32", "tabletop:640:16")
BLOCK = 8
STOPS = 6
FOCUSES = (
    0.25,
    0.5,
    0.75,
    1.0,
)  # positions in 1/z from the near end (0) to the far end (1)
WIDEST = 0.02  # diameter of the largest aperture over the nearest depth
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
    """The lenses of the grid: apertures from wide to narrow, each with all focus distances."""
    near, far = scene.depth_range
    diameters = [WIDEST * near / 2 ** (0.5 * stop) for stop in range(STOPS)]
    focuses = [1 / ((1 - t) / near + t / far) for t in FOCUSES]
    return [tl.ThinLens(diameter, focus) for diameter in diameters for focus in focuses]


def timed(run: Callable[[], object]) -> tuple[np.ndarray, object]:
    """(CPU, wall) seconds and the result."""
    start = time.process_time(), time.perf_counter()
    result = run()
    return np.array(
        [time.process_time() - start[0], time.perf_counter() - start[1]]
    ), result


def measure(
    scene: tl.Scene, rig: tl.Rig, lenses: list, spp: int, rounds: int, direct: int
) -> dict[str, np.ndarray]:
    """Seconds (cells, 2) and images (rounds, cells, H, W, 3) of direct renders; seconds (2,) and images of the grid."""
    tl.render(scene, rig, lenses[0], spp=spp)
    tl.render_lens_grid(scene, rig, lenses, spp=spp)
    found: dict[str, list] = {"grid_s": [], "direct_s": [], "grid": [], "direct": []}
    for seed in range(2, 2 + rounds):
        took, grid = timed(
            lambda seed=seed: tl.render_lens_grid(
                scene, rig, lenses, spp=spp, seed=seed
            )
        )
        found["grid_s"].append(took)
        found["grid"].append([images[0] for images in grid])
        if seed < 2 + direct:
            rows = [
                timed(
                    lambda lens=lens, i=i, seed=seed: tl.render(
                        scene, rig, lens, spp=spp, seed=1000 * seed + i
                    )
                )
                for i, lens in enumerate(lenses)
            ]
            found["direct_s"].append([row[0] for row in rows])
            found["direct"].append([row[1][0] for row in rows])
    seconds = {name: np.median(found[name], axis=0) for name in ("grid_s", "direct_s")}
    return seconds | {name: np.asarray(found[name]) for name in ("grid", "direct")}


def squares(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances between rounds of pixels and of block means, averaged over channels: two maps over blocks."""
    n, height, width, _ = images.shape
    rows, columns = height // BLOCK, width // BLOCK
    cut = (
        images[:, : rows * BLOCK, : columns * BLOCK]
        .astype(np.float64)
        .reshape(n, rows, BLOCK, columns, BLOCK, 3)
    )
    pixels = cut.var(axis=0, ddof=1).mean(axis=(1, 3, 4))
    return pixels, cut.mean(axis=(2, 4)).var(axis=0, ddof=1).mean(axis=-1)


def errors_of_direct(images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean squared errors (2,) of pixels and blocks, and their relative standard errors over independent blocks."""
    both = np.array(squares(images))
    return both.mean(axis=(1, 2)), both.std(axis=(1, 2)) / np.sqrt(
        both[0].size
    ) / both.mean(axis=(1, 2))


def errors_of_grid(images: np.ndarray) -> np.ndarray:
    """Mean squared errors (1 + rounds, 2) of pixels and blocks: for all rounds, and leaving out each round."""
    parts = [
        images,
        *(
            np.delete(images, i, axis=0)
            for i in range(len(images) if len(images) > 2 else 0)
        ),
    ]
    return np.array([[part.mean() for part in squares(of)] for of in parts])


def jackknife(values: np.ndarray) -> np.ndarray:
    """The jackknife standard error from leave-one-out estimates along axis 0."""
    return (
        np.sqrt((len(values) - 1) * values.var(axis=0))
        if len(values)
        else np.full(values.shape[1:], np.nan)
    )


def at_equal_error(ratio: np.ndarray) -> np.ndarray:
    """The factor in time at which the grid has the error of direct renders."""
    return np.maximum(ratio, ratio ** (2 / 3))


def table(lenses: list, found: dict[str, np.ndarray]) -> str:
    (total, total_wall), (grid_s, grid_wall) = (
        found["direct_s"].sum(axis=0),
        found["grid_s"],
    )
    told = [errors_of_direct(found["direct"][:, i]) for i in range(len(lenses))]
    direct, doubt = (np.array(part) for part in zip(*told, strict=True))
    grid = np.array(
        [errors_of_grid(found["grid"][:, i]) for i in range(len(lenses))]
    ).swapaxes(0, 1)
    ratios = grid / direct
    ratio, spread = ratios[0], np.hypot(jackknife(ratios[1:]), ratios[0] * doubt)
    cost = grid_s / total * at_equal_error(ratio)
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for i, lens in enumerate(lenses):
        size = (
            f"{1e3 * lens.aperture_diameter:.2f}",
            f"{lens.focus_distance:.2f}",
            f"{found['direct_s'][i, 0]:.3f}",
        )
        mse = f"{direct[i, 0]:.3g}", f"{grid[0, i, 0]:.3g}"
        pairs = [
            (f"{ratio[i, k]:.2f} +- {spread[i, k]:.2f}", f"{cost[i, k]:.3f}")
            for k in (0, 1)
        ]
        rows.append((*size, *mse, *pairs[0], *pairs[1]))
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.append(
        f"\nAll cells rendered directly: {total:.2f} s CPU, {total_wall:.2f} s wall. The grid: {grid_s:.2f} s CPU,"
    )
    lines.append(
        f"{grid_wall:.2f} s wall: {grid_s / total:.3f} of the CPU time, {grid_wall / total_wall:.3f} of the wall time."
    )
    means, sums = ratios.mean(axis=1), grid[0].sum(axis=0) / direct.sum(axis=0)
    for k, name in ((0, "Single pixels"), (1, "Means of 8x8")):
        r, c = ratio[:, k], cost[:, k]
        factors = f"mean {c.mean():.3f}, worst cell {c.max():.3f}"
        summed = grid_s / total * at_equal_error(sums[k])
        lines.append(
            f"\n{name}: mean MSE ratio over cells {means[0, k]:.2f} +- {jackknife(means[1:])[k]:.2f}, "
            f"worst cell {r.max():.2f}, ratio of summed errors {sums[k]:.2f}.\n"
            f"**Cost at equal error: {factors}, from summed errors {summed:.3f}.**"
        )
    return "\n".join(lines) + "\n(Required: at most 0.2 for single pixels.)"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", action="append", help="scene:width:samples")
    parser.add_argument(
        "--rounds", type=int, default=8, help="rounds of the grid, at least 2"
    )
    parser.add_argument(
        "--direct", type=int, default=2, help="rounds of direct renders, at least 2"
    )
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rounds, direct = max(2, options.rounds, options.direct), max(2, options.direct)
    setting = (
        f"{backend().name}, {platform.machine()}, multijitter; "
        f"{rounds} rounds of the grid, {direct} of direct renders."
    )
    parts = [
        "# Lens grids from one set of light paths",
        f"`python benchmarks/bench_lens_grid.py --write`: {setting}",
    ]
    parts.append(LEGEND)
    for run in options.run or RUNS:
        name, width, spp = run.split(":")[0], *map(int, run.split(":")[1:])
        scene = tl.load_scene(name)
        rig = tl.Rig(
            [tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=40)],
            [scene.world_from_left],
        )
        lenses = lenses_for(scene)
        found = measure(scene, rig, lenses, spp, rounds, direct)
        parts += [
            f"## {name}, {width}x{width * 3 // 4}, {spp} samples per pixel",
            table(lenses, found),
        ]
        print("\n\n".join(parts[-2:]), flush=True)
    if options.write:
        PAGE.write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    main()
