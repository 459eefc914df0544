"""Render docs/families.png, a contact sheet of 64 random scenes, 16 of each family.

python docs/families.py
python docs/families.py 100        # another first seed
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene

HERE = Path(__file__).parent
WIDTH, HEIGHT, SPP = 160, 120, 16
ROWS, COLUMNS = 2, 8


def picture(family: str, seed: int) -> NDArray[np.uint8]:
    """The left image of a scene at automatic exposure, uint8 (H, W, 3)."""
    scene = random_scene(family, seed, width=2 * WIDTH)
    rig = default_rig(scene, WIDTH, HEIGHT)
    left = tl.Rig(rig.cameras[:1], rig.world_from_cams[:1])
    radiance = tl.render(scene, left, tl.Pinhole(), spp=SPP, seed=seed, denoise=True)
    (photo,) = tl.Sensor().expose_rig(radiance, rig=left, lens=tl.Pinhole(), seed=seed)
    return np.asarray(photo.image)


def main(first: int) -> None:
    """Write the sheet, two rows per family."""
    rows = []
    for family in FAMILIES:
        tiles = [picture(family, first + k) for k in range(ROWS * COLUMNS)]
        rows += [
            np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)
        ]
    sheet = Image.fromarray(np.vstack(rows)).quantize(
        256, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG
    )
    sheet.save(HERE / "families.png", optimize=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
