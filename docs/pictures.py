"""Makes the picture of README.md: `make pictures`.

Two bundled scenes, a row each: the left image through a pinhole and through a wide-aperture lens, the exact disparity,
and the result of ZNCC for the pair of the pinhole.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import twinlens as tl
from twinlens.dataset import write_png
from twinlens.factory import Shoot, default_rig, make_sample
from twinlens.optics import middle_focus
from twinlens.report import colourise

HERE = Path(__file__).parent
SCENES = ("corner", "yard")
WIDTH, HEIGHT, SPP = 400, 300, 32
APERTURE_OVER_BASELINE = 0.5


def row(name: str) -> NDArray[np.uint8]:
    """The four pictures of a scene, uint8 (H, 4 W, 3)."""
    scene = tl.load_scene(name)
    rig = default_rig(scene, WIDTH, HEIGHT)
    aperture = APERTURE_OVER_BASELINE * rig.baseline()
    wide = tl.ThinLens(aperture, middle_focus(*scene.depth_range))
    sample = make_sample(scene, rig, (tl.Pinhole(), wide), Shoot(spp=SPP, denoise=True))
    sharp, blurred = (shot.images for shot in sample.shots)
    truth = sample.truths[0].disparity
    finite = truth[np.isfinite(truth)]
    low, high = float(finite.min()), float(finite.max())
    disparity = tl.match(
        *sharp, method="zncc", block_size=9, num_disparities=int(high) + 2
    )
    maps = [colourise(values, low, high) for values in (truth, disparity)]
    return np.hstack([sharp[0], blurred[0], *maps])


def main() -> None:
    """Write docs/overview.png."""
    write_png(HERE / "overview.png", np.vstack([row(name) for name in SCENES]))


if __name__ == "__main__":
    main()
