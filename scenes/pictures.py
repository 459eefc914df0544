"""Renders scenes/<name>/picture.png, the preview of each bundled scene.

python scenes/pictures.py                  # all of them
python scenes/pictures.py fence room
"""

import sys

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.scenes import bundled_folder

WIDTH, HEIGHT, SPP = 480, 360, 144
BRIGHT_PERCENT, BRIGHT_LEVEL = (
    97.0,
    0.85,
)  # this percentile of the values is mapped to this fraction of full scale


def picture(name: str, spp: int = SPP) -> NDArray[np.uint8]:
    """The default view of a bundled scene, exposed for its highlights and encoded as sRGB; uint8 (H, W, 3)."""
    scene = tl.load_scene(name)
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=scene.fov_x_deg)
    (radiance,) = tl.render(
        scene, tl.Rig([camera], [scene.world_from_left]), tl.Pinhole(), spp=spp, seed=0
    )
    linear = np.clip(
        radiance * (BRIGHT_LEVEL / np.percentile(radiance, BRIGHT_PERCENT)), 0, 1
    )
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
    )
    return (255 * encoded + 0.5).astype(np.uint8)


def main(names: list[str]) -> None:
    """Write the pictures of the named scenes, or of all scenes."""
    for name in names or tl.bundled_scenes():
        path = bundled_folder() / name / "picture.png"
        small = Image.fromarray(picture(name)).quantize(
            256, kmeans=2, dither=Image.Dither.FLOYDSTEINBERG
        )
        small.save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
