"""How hard random scenes are beside real ones: the statistics of their geometry and light, over many seeds.

    python benchmarks/bench_scene_statistics.py                     # 64 scenes of all families, truth alone
    python benchmarks/bench_scene_statistics.py --pictures          # also dark, bright and plain parts
    python benchmarks/bench_scene_statistics.py 16 --families room cards --seed 500
    python benchmarks/bench_scene_statistics.py 120 --pictures --tiles tiles  # keeps left views for docs/families.py

Each scene is composed for 640x480 pixels and its truth traced; no light is needed for that. With `--pictures` the left
view is rendered with 8 denoised samples and exposed by the default sensor.

A line says `yes` where the median lies within a third of the real 10 % to 90 % range from the real median, and where
the range of the scenes covers two thirds of the real one.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene
from twinlens.rendering import forget_kernels, share_kernels
from twinlens.scoring.pair_statistics import STATISTICS
from twinlens.scoring.scene_statistics import geometry_statistics, image_statistics

WIDTH, HEIGHT, SPP = 640, 480, 8
GEOMETRY = ("edges", "thin", "slant", "slant_high", "range", "occluded", "unknown")
LIGHT = ("dark", "bright", "plain_areas")


def measured(family, seed, pictures, tiles):
    """The statistics of one scene by name, float; its left view is kept in the folder `tiles`."""
    scene = random_scene(family, seed, width=WIDTH)
    rig = default_rig(scene, WIDTH, HEIGHT)
    truth = tl.ground_truth(scene, rig)[0]
    numbers = geometry_statistics(truth.disparity)
    known = np.isfinite(truth.disparity)
    numbers["occluded"] = float(1 - truth.visible[known].mean())
    if pictures:
        left = tl.Rig(rig.cameras[:1], rig.world_from_cams[:1])
        lens = tl.Pinhole()
        radiance = tl.render(scene, left, lens, spp=SPP, seed=seed, denoise=True)
        (photo,) = tl.Sensor().expose_rig(radiance, rig=left, lens=lens, seed=seed)
        grey = photo.image @ np.array([0.299, 0.587, 0.114])
        numbers |= image_statistics(grey)
        if tiles:
            Image.fromarray(np.asarray(photo.image)).save(
                tiles / f"{family}-{seed}.png"
            )
        forget_kernels()
    return numbers


def table(rows, names):
    """Lines that compare the quantiles of the scenes with those of real pairs."""
    yield "| statistic | scenes: 10 / 50 / 90 % | real: 10 / 50 / 90 % | median near | range covered |"
    yield "| --- | --- | --- | --- | --- |"
    for name in names:
        low, middle, high = np.quantile([row[name] for row in rows], (0.1, 0.5, 0.9))
        real_middle, real_low, real_high = STATISTICS[name].real
        real_range = real_high - real_low
        is_near = abs(middle - real_middle) <= real_range / 3
        common = min(high, real_high) - max(low, real_low)
        covers = common >= 2 / 3 * real_range
        yield (
            f"| `{name}` | {low:.3g} / {middle:.3g} / {high:.3g} | {real_low:g} / {real_middle:g} / {real_high:g} "
            f"| {'yes' if is_near else 'no'} | {'yes' if covers else 'no'}, {common / real_range:.2f} |"
        )


def main():
    """Measure the scenes of consecutive seeds, the families by turns, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=64)
    parser.add_argument("--families", nargs="+", default=list(FAMILIES))
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--pictures", action="store_true")
    parser.add_argument("--tiles", type=Path, help="folder for the left views")
    options = parser.parse_args()
    share_kernels()
    if options.tiles:
        options.tiles.mkdir(parents=True, exist_ok=True)
    names = GEOMETRY + LIGHT if options.pictures else GEOMETRY
    rows = []
    for index in range(options.count):
        family = options.families[index % len(options.families)]
        numbers = measured(
            family, options.seed + index, options.pictures, options.tiles
        )
        rows.append({"family": family, **numbers})
        values = " ".join(f"{name} {numbers[name]:.3g}" for name in names)
        print(f"{family} {options.seed + index}: {values}", flush=True)
    for family in options.families:
        print(f"\n{family}\n")
        chosen = [row for row in rows if row["family"] == family]
        print("\n".join(table(chosen, names)))
    print("\nall\n")
    print("\n".join(table(rows, names)))


if __name__ == "__main__":
    main()
