"""Makes docs/bands.png: a scene in colour, in the near infrared without and with dots, and without a filter.

python docs/bands.py
"""

from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.dataset import write_png
from twinlens.geometry import rigid

WIDTH, HEIGHT, SPP = 400, 300, 96


def main() -> None:
    """Write docs/bands.png."""
    scene = tl.load_scene("room")
    color = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=scene.fov_x_deg)
    light = tl.Camera.from_fov(640, 480, fov_x_deg=60)
    pattern = tl.camera.patterns.dots(640, 480, density=0.06, size=2, seed=1)
    dots = tl.Projector(rigid(np.eye(3), [0.03, 0.0, 0.0]), light, pattern, power=30.0)
    cameras = [color, color.replace(band="nir"), color.replace(band="rgb+nir")]
    rig = tl.Rig(cameras, [scene.world_from_left] * 3)
    passive = tl.render(scene, rig, spp=SPP, denoise=True)
    active = tl.render(scene, rig.with_projectors([dots]), spp=SPP, denoise=True)
    shown = [
        tl.Sensor().expose(image, camera=camera, lens=tl.Pinhole()).image
        for image, camera in (
            (active[0], cameras[0]),
            (passive[1], cameras[1]),
            (active[1], cameras[1]),
        )
    ]
    both = (
        tl.Sensor(filters="mono")
        .expose(active[2], camera=cameras[2], lens=tl.Pinhole())
        .image
    )
    tiles = [
        np.dstack([each] * 3) if each.ndim == 2 else each for each in (*shown, both)
    ]
    write_png(
        Path(__file__).with_suffix(".png"),
        np.vstack([np.hstack(tiles[:2]), np.hstack(tiles[2:])]),
    )


if __name__ == "__main__":
    main()
