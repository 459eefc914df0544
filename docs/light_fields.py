"""Makes docs/light_fields.png: a raw plenoptic image, an epipolar plane image, two foci, and dual pixels.

python docs/light_fields.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import twinlens as tl
from twinlens.dataset import write_png
from twinlens.report import colourise

WIDTH, HEIGHT, N, SPP = 320, 240, 9, 16
CORNER, ROW = (
    (105, 100),
    120,
)  # of the enlarged microlenses; of the epipolar plane image
FRONT, BACK = (150, 55), (20, 160)  # pixels in focus, row and column


def developed(image: NDArray[np.floating], white: float) -> NDArray[np.uint8]:
    """The linear image, gamma-encoded, uint8."""
    return (np.clip(white * image, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)


def main() -> None:
    """Write docs/light_fields.png."""
    scene = tl.load_scene("cards")
    near, far = scene.depth_range
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=scene.fov_x_deg)
    lens = tl.ThinLens(0.04, focus_distance=2 / (1 / near + 1 / far))
    rig = tl.light_field_rig(camera, lens, N, scene.world_from_left)
    views = np.stack(tl.render_light_field(scene, rig, spp=SPP))
    raw = (
        views.reshape(N, N, HEIGHT, WIDTH, 3)
        .transpose(2, 0, 3, 1, 4)
        .reshape(HEIGHT * N, WIDTH * N, 3)
    )
    top, left = CORNER[1] * N, CORNER[0] * N
    slopes = np.repeat(
        views[N * (N // 2) : N * (N // 2) + N, ROW], HEIGHT // N + 1, axis=0
    )[:HEIGHT]
    alone = tl.Rig([camera], [scene.world_from_left])
    truth = tl.ground_truth(scene, alone)[0]
    foci = [
        tl.refocus(views, rig, lens.replace(focus_distance=truth.depth[place]))
        for place in (FRONT, BACK)
    ]
    halves = tl.render(scene, alone, lens, spp=16, denoise=True, parts=tl.Dual())[0]
    disparity = tl.dual_pixel_disparity(truth, camera, lens)
    limit = float(np.abs(disparity[np.isfinite(disparity)]).max())

    white = 1.0 / float(np.percentile(views, 97))
    first, second = (
        developed(2 * half, white).mean(axis=-1).astype(np.uint8) for half in halves
    )
    above = [
        developed(image, white)
        for image in (raw[top : top + HEIGHT, left : left + WIDTH], *foci)
    ]
    below = [
        developed(slopes, white),
        np.stack([first, second, second], axis=-1),
        colourise(disparity, -limit, limit),
    ]
    write_png(
        Path(__file__).with_suffix(".png"),
        np.vstack([np.hstack(above), np.hstack(below)]),
    )


if __name__ == "__main__":
    main()
