"""Makes the pictures of README.md: `make pictures`.

One pair of the still life through a pinhole and through a wide-aperture lens, its exact disparity, and the result of
ZNCC for each.
"""

from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.dataset import write_png
from twinlens.factory import Shoot, default_rig, make_sample
from twinlens.optics import middle_focus
from twinlens.report import colourise

HERE = Path(__file__).parent
WIDTH, HEIGHT, SPP = 480, 360, 32
APERTURE = 0.04


def main() -> None:
    """Write docs/overview.png."""
    scene = tl.load_scene("tabletop")
    rig = default_rig(scene, WIDTH, HEIGHT)
    lenses = (tl.Pinhole(), tl.ThinLens(APERTURE, middle_focus(*scene.depth_range)))
    sample = make_sample(scene, rig, lenses, Shoot(spp=SPP, denoise=True))
    truth = sample.truths[0].disparity
    low, high = (
        float(truth[np.isfinite(truth)].min()),
        float(truth[np.isfinite(truth)].max()),
    )
    rows = []
    for shot in sample.shots:
        found = tl.match(
            *shot.images, method="zncc", block_size=9, num_disparities=int(high) + 2
        )
        rows.append(
            np.hstack(
                [
                    shot.images[0],
                    colourise(truth, low, high),
                    colourise(found, low, high),
                ]
            )
        )
    write_png(HERE / "overview.png", np.vstack(rows))


if __name__ == "__main__":
    main()
