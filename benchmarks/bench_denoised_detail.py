"""Light and contrast of fine detail that denoised images keep, relative to converged ones.

    python benchmarks/bench_denoised_detail.py [SCENE ...] --spp 16

An image's detail is its difference to a Gaussian blur of 2 px. The contrast is the factor of the reference's detail in
the image's. The noise of one reference would lower it, so there are two with other seeds, whose noise has no share in
the products of both: sum(image (first + second) / 2) / sum(first second). Means and their standard errors are over
images of several seeds.
"""

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter

import twinlens as tl
from twinlens.scenes import Scene

WIDTH, HEIGHT = 160, 120


def detail(image: np.ndarray) -> np.ndarray:
    """(H - 16, W - 16): without what a blurred border changes."""
    return (image - gaussian_filter(image, 2))[8:-8, 8:-8]


def grey(
    scene: Scene, rig: tl.Rig, spp: int, seed: int, denoise: bool = False
) -> np.ndarray:
    """The image of the rig's one camera, the mean of its channels (H, W)."""
    (image,) = tl.render(scene, rig, spp=spp, seed=seed, denoise=denoise)
    return image.mean(axis=-1, dtype=np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=list(tl.bundled_scenes()))
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--reference-spp", type=int, default=1024)
    parser.add_argument("--seeds", type=int, default=6)
    options = parser.parse_args()
    for name in options.scenes:
        scene = tl.load_scene(name)
        camera = tl.Camera.from_fov(WIDTH, HEIGHT, scene.fov_x_deg)
        rig = tl.Rig([camera], [scene.world_from_left])

        first, second = (
            grey(scene, rig, options.reference_spp, seed) for seed in (1, 2)
        )
        reference = (first + second) / 2
        power = (detail(first) * detail(second)).sum()
        means, contrasts, errors = [], [], []
        for seed in range(3, 3 + options.seeds):
            image = grey(scene, rig, options.spp, seed, denoise=True)
            means.append(image.mean() / reference.mean() - 1)
            contrasts.append((detail(image) * detail(reference)).sum() / power)
            errors.append(np.sqrt(((image / reference - 1) ** 2).mean()))
        spread = np.sqrt(options.seeds)
        print(
            f"{name}: mean {np.mean(means):+.2%} (+-{np.std(means, ddof=1) / spread:.2%}), "
            f"contrast {np.mean(contrasts):.3f} (+-{np.std(contrasts, ddof=1) / spread:.3f}), "
            f"rms error {np.mean(errors):.2%}"
        )


if __name__ == "__main__":
    main()
