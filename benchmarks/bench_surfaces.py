"""Sharpness of floors, walls and table tops against distance: texels a pixel over random scenes.

    python benchmarks/bench_surfaces.py tabletop --draws 64

A line for each third of the depths of a picture, from near to far: the texels of a surface that a pixel covers, along
the direction in which they are fewest. Below 1, the surface looks out of focus.
"""

import argparse
import time

import numpy as np

from twinlens.families import random_scene, surfaces

WIDTH, ASPECT = 640, 16 / 9
COLUMNS, ROWS = 64, 36


def coordinate(share, knots, texels):
    """Texels from the start of a side to shares of it."""
    return texels * (share if knots is None else np.interp(share, knots.at, knots.uv))


def texels_per_pixel(sheet, view, baked):
    """Depths (N,) and texels a pixel (N,) on a grid over the picture, where the sheet is."""
    pixel = np.array([2 / WIDTH, 2 * ASPECT / WIDTH])
    x, y = np.meshgrid(
        (np.arange(COLUMNS) + 0.5) / COLUMNS * 2 - 1,
        (np.arange(ROWS) + 0.5) / ROWS * 2 - 1,
    )

    def texel_at(right, down):
        place = (
            np.stack([x + right * pixel[0], y + down * pixel[1]], axis=-1) * view.half
        )
        ahead = np.concatenate([place, np.ones((*x.shape, 1))], axis=-1)
        ray = ahead @ view.world_from_cam[:3, :3].T
        with np.errstate(all="ignore"):
            depth = ((sheet.corner - view.eye) @ sheet.normal) / (ray @ sheet.normal)
        point = view.eye + depth[..., None] * ray - sheet.corner
        s, t = (point @ side / (side @ side) for side in (sheet.u, sheet.v))
        inside = (depth > 0) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
        u = coordinate(s, getattr(sheet, "across", None), baked.shape[1])
        v = coordinate(t, getattr(sheet, "along", None), baked.shape[0])
        return np.stack([u, v], axis=-1), depth, inside

    middle, depth, inside = texel_at(0, 0)
    columns = [
        texel_at(right, down)[0] - middle for right, down in ((0.5, 0), (0, 0.5))
    ]
    jacobian = 2 * np.stack(columns, axis=-1)[inside]
    # The least singular value of d(texels)/d(pixels): of the direction with the fewest texels.
    return depth[inside], np.linalg.svd(jacobian, compute_uv=False)[:, -1]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("family", choices=["room", "tabletop"])
    parser.add_argument("--draws", type=int, default=64)
    options = parser.parse_args()
    baked = []
    bake = surfaces.bake

    def kept(image, tile, sheet, view):
        baked.append((sheet, view, bake(image, tile, sheet, view)))
        return baked[-1][2]

    surfaces.bake = kept
    thirds, seconds = [[], [], []], 0.0
    for seed in range(options.draws):
        baked.clear()
        start = time.process_time()
        random_scene(options.family, seed, width=WIDTH, aspect=ASPECT)
        seconds += time.process_time() - start
        parts = [texels_per_pixel(*one) for one in baked]
        depth, texels = (np.concatenate(values) for values in zip(*parts, strict=True))
        edges = np.quantile(depth, [0, 1 / 3, 2 / 3, 1])
        for third, low, high in zip(thirds, edges[:-1], edges[1:], strict=True):
            third.append(np.quantile(texels[(depth >= low) & (depth <= high)], 0.05))
    print(
        f"{options.family}: {options.draws} draws, {seconds / options.draws:.2f} s of processor time each"
    )
    for name, values in zip(("near", "middle", "far"), thirds, strict=True):
        print(
            f"{name}: {np.median(values):.2f} texels a pixel, worst draw {min(values):.2f}"
        )


if __name__ == "__main__":
    main()
