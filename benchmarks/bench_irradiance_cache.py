"""What the irradiance cache saves: noise, processor time and brightness of images with it and without, not denoised.

    python benchmarks/bench_irradiance_cache.py [--scenes room,cards] [--write]

Left views of 320x240 pixels through a pinhole, 8 images of 32 samples with a cache of their own, and 8 of Mitsuba's
`path`. Noise is the standard deviation between images, of pixels and of means over windows of 9x9 pixels, in percent of
the light there, in the median over pixels. Brightness is the ratio of the means of all images, and its standard error.
`--write` replaces the table in benchmarks/irradiance_cache.md.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

import twinlens as tl
from bench_noise import SCENES, view
from twinlens.rendering import use_threads
from twinlens.rendering.build import build
from twinlens.rendering.integrators import for_denoising
from twinlens.rendering.sensors import make_sensor

PAGE = Path(__file__).with_name("irradiance_cache.md")
HEAD = (
    "| scene | cache, s | image, s | without cache, s | noise, % | without cache, % | noise of 9x9, % |"
    " without cache, % | brightness |"
)
IMAGES, SPP, WINDOW = 8, 32, 9


def images(
    scene: tl.Scene, rig: tl.Rig, cached: bool
) -> tuple[np.ndarray, float, float]:
    """Images (N, H, W, 3), and seconds of processor time of a cache and of an image."""
    found, seconds = [], []
    for seed in range(-1, IMAGES):  # the first one compiles
        start = time.process_time()
        built = build(scene)
        if cached:
            built = for_denoising(built, rig, "rgb", seed + 1)
        middle = time.process_time()
        sensor = make_sensor(
            rig.cameras[0], rig.world_from_cams[0], tl.Pinhole(), SPP, "multijitter"
        )
        stream = 2 * (seed + 1) + cached
        found.append(
            np.asarray(
                built.integrator.render(built.mi_scene, sensor, seed=stream, spp=SPP),
                np.float64,
            )[..., :3]
        )
        seconds.append((middle - start, time.process_time() - middle))
    return np.array(found[1:]), *np.median(seconds[1:], axis=0)


def noise(found: np.ndarray, window: int) -> float:
    """The median standard deviation of means over windows, in percent of the mean of 9x9 pixels."""
    light = np.maximum(uniform_filter(found.mean(axis=0), (WINDOW, WINDOW, 1)), 1e-3)
    means = np.array([uniform_filter(image, (window, window, 1)) for image in found])
    return 100 * float(np.median(means.std(axis=0, ddof=1) / light))


def brightness(ours: np.ndarray, theirs: np.ndarray) -> str:
    """The ratio of the means and its standard error."""
    means = [images.mean(axis=(1, 2, 3)) for images in (ours, theirs)]
    error = np.sqrt(sum((of.std(ddof=1) / of.mean()) ** 2 / IMAGES for of in means))
    return f"{means[0].mean() / means[1].mean():.4f} +- {error:.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument(
        "--write",
        action="store_true",
        help=f"replace the table in {PAGE.name}, with all scenes",
    )
    options = parser.parse_args()
    use_threads(1)
    lines = [HEAD, "|" + " --- |" * HEAD.count(" |")]
    print("\n".join(lines), flush=True)
    for name in options.scenes.split(","):
        scene, rig, _ = view(name, "pinhole")
        (ours, cache, image), (theirs, _, before) = (
            images(scene, rig, cached) for cached in (True, False)
        )
        numbers = [
            f"{noise(of, window):.2f}"
            for window in (1, WINDOW)
            for of in (ours, theirs)
        ]
        cells = [
            f"{cache:.2f}",
            f"{image:.2f}",
            f"{before:.2f}",
            *numbers,
            brightness(ours, theirs),
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    if options.write and options.scenes == ",".join(SCENES):
        text, _, rest = PAGE.read_text().partition(HEAD)
        PAGE.write_text(
            text
            + "\n".join(lines)
            + (rest[rest.index("\n\n") :] if "\n\n" in rest else "\n")
        )


if __name__ == "__main__":
    main()
