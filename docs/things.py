"""Render docs/things.png, a contact sheet of the things of random scenes, four seeds of each.

python docs/things.py
python docs/things.py pot-plant stool       # these alone, to look at
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.families import Assets
from twinlens.families.composition import Composition
from twinlens.families.furniture import Piece
from twinlens.families.lighting import key_and_fill
from twinlens.families.surfaces import Sheet, surface
from twinlens.families.things import THINGS, add_thing, make_thing
from twinlens.scenes.placement import rotation, translation

HERE = Path(__file__).parent
SIDE, SPP, SEEDS, COLUMNS = 160, 16, 4, 16
Picture = NDArray[np.uint8]


def scene_of(piece: Piece, seed: int) -> tl.Scene:
    """A piece on a plain floor before a wall, or hanging, seen slightly from above."""
    size = max(*piece.floor, piece.height)
    root = np.random.SeedSequence(seed)
    scene = Composition("thing", root, Assets(), None, (1, 1), 1.0, 2 * SIDE)
    hangs = min(mesh.vertices[:, 2].min() for _, mesh, _ in piece.parts) < -1e-6
    top = size * 1.1 if hangs else 0.0
    middle = np.array([0, 0, top - piece.height / 2 if hangs else piece.height / 2])
    eye = middle + size * np.array([0.6, -2.6, 0.9])
    scene.look(eye, middle, 32.0)
    grey = np.array([[0.5, 0.48, 0.45], [0.4, 0.4, 0.42]])
    wide = 12 * size
    corner = np.array([-wide / 2, -wide / 2, 0.0])
    ground = Sheet(corner, np.array([wide, 0, 0]), np.array([0, wide, 0]))
    fitted, look = surface(scene, scene.rng("floor"), ground, "plain", grey, size)
    scene.add("floor", fitted.mesh(), look)
    pose = translation([0, 0, top]) @ rotation([0, 0, 1], 25.0)
    add_thing(scene, piece, [pose], ("thing",))
    key_and_fill(scene, scene.rng("light"), middle, size, side=1.0)
    return scene.scene("a thing")


def picture(name: str, seed: int) -> Picture:
    """The image of a thing, uint8 (H, W, 3)."""
    scene = scene_of(make_thing(name, np.random.default_rng(seed)), seed)
    camera = tl.Camera.from_fov(SIDE, SIDE, fov_x_deg=scene.fov_x_deg)
    rig = tl.Rig((camera,), scene.world_from_left[None])
    radiance = tl.render(scene, rig, tl.Pinhole(), spp=SPP, seed=seed, denoise=True)
    (photo,) = tl.Sensor().expose_rig(radiance, rig=rig, lens=tl.Pinhole(), seed=seed)
    return np.asarray(photo.image)


def sheet(names: Sequence[str], columns: int) -> Picture:
    """All pictures side by side, in rows of `columns`."""
    tiles = [picture(name, seed) for name in names for seed in range(SEEDS)]
    blank = np.full((SIDE, SIDE, 3), 255, dtype=np.uint8)
    tiles += [blank] * (-len(tiles) % columns)
    rows = [tiles[k : k + columns] for k in range(0, len(tiles), columns)]
    return np.vstack([np.hstack(row) for row in rows])


def main(names: Sequence[str]) -> None:
    """Write the sheet of all things, or things-chosen.png of some."""
    if names:
        Image.fromarray(sheet(names, SEEDS)).save("things-chosen.png")
        return
    whole = Image.fromarray(sheet(list(THINGS), COLUMNS)).quantize(
        256, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG
    )
    whole.save(HERE / "things.png", optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
