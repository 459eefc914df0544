"""Makes docs/projectors.png: a scene lit by a pattern of dots, a Gray code's image, and the decoded columns.

python docs/projectors.py
"""

from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.dataset import write_png
from twinlens.geometry import rigid
from twinlens.report import colourise

WIDTH, HEIGHT, SPP = 320, 240, 16


def main() -> None:
    """Write docs/projectors.png."""
    scene = tl.load_scene("staircase")
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=scene.fov_x_deg)
    light = tl.Camera.from_fov(512, 384, fov_x_deg=60)
    beside = rigid(np.eye(3), [0.25, 0.0, 0.0])
    projector = tl.Projector(
        beside,
        light,
        tl.camera.patterns.dots(512, 384, density=0.04, size=3, seed=1),
        60.0,
        "rgb",
    )
    rig = tl.Rig([camera], [scene.world_from_left], projectors=[projector])
    code = tl.GrayCode(512, 384)

    def photograph(pattern: object, seed: int) -> np.ndarray:
        lit = rig.with_projectors([projector.with_pattern(pattern)])
        return tl.render(scene, lit, spp=SPP, seed=seed, denoise=True)[0]

    images = [photograph(pattern, seed) for seed, pattern in enumerate(code.patterns)]
    found = tl.decode(images, code).position
    truth = tl.projection(scene, rig)
    columns = np.where(
        truth.lit & np.isfinite(truth.pixels[..., 0]), truth.pixels[..., 0], np.inf
    )
    shown = [photograph(projector.pattern, len(images)), images[8]]
    white = 1.0 / np.percentile(shown, 97)
    top = [
        (np.clip(white * image, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)
        for image in shown
    ]
    below = [
        colourise(each.astype(np.float32), 0.0, 511.0) for each in (found, columns)
    ]
    write_png(
        Path(__file__).with_suffix(".png"),
        np.vstack([np.hstack(top), np.hstack(below)]),
    )


if __name__ == "__main__":
    main()
