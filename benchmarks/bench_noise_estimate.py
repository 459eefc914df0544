"""Is the estimate of the remaining noise honest? Its ratio to the true error, on random scenes.

    python benchmarks/bench_noise_estimate.py [--count 12] [--seed 7000] [--spp 16]

Left views of 160x120 pixels with `--spp` denoised samples, of the four families in turn, through a pinhole for four
scenes and an f/1.4 lens on a 36 mm sensor for the next four. The true squared error is the mean product of differences
from two images of 128 raw samples, whose noise is independent. Both errors are medians over windows of 9x9 pixels.
"""

import argparse

import numpy as np
from scipy.ndimage import uniform_filter

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene
from twinlens.rendering.radiance import render_measured

WINDOW = 9


def median_error(squares: np.ndarray) -> float:
    """The median over windows of the root mean square."""
    return float(
        np.median(np.sqrt(np.maximum(uniform_filter(squares.mean(axis=-1), WINDOW), 0)))
    )


def ratio(family: str, seed: int, wide: bool, spp: int) -> float:
    """Estimated over true error."""
    scene = random_scene(family, seed, width=160)
    pair = default_rig(scene, 160, 120)
    rig = tl.Rig(pair.cameras[:1], pair.world_from_cams[:1])
    focus = tl.optics.middle_focus(*scene.depth_range)
    lens = (
        tl.ThinLens.from_f_number(1.4, focus, 0.036 / 160 * rig.cameras[0].fx)
        if wide
        else tl.Pinhole()
    )
    (view,), _ = render_measured(scene, rig, lens, spp, 5, denoise=True)
    a, b = (
        view.image - tl.render(scene, rig, lens, 128, other)[0].astype(np.float64)
        for other in (901, 902)
    )
    return median_error(view.error.astype(np.float64) ** 2) / median_error(a * b)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--spp", type=int, default=16)
    options = parser.parse_args()
    families, found = ("tabletop", "flying", "room", "cards"), []
    assert set(families) == set(FAMILIES)
    for i in range(options.count):
        wide = i // 4 % 2 == 1
        found.append(ratio(families[i % 4], options.seed + i, wide, options.spp))
        print(
            f"{families[i % 4]:9} {'f/1.4' if wide else 'pinhole':8} {found[-1]:.2f}",
            flush=True,
        )
    near = sum(abs(value - 1) <= 0.25 for value in found)
    print(
        f"{near} of {len(found)} within 25 %; from {min(found):.2f} to {max(found):.2f}, median {np.median(found):.2f}"
    )


if __name__ == "__main__":
    main()
