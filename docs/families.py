"""Render docs/families_NAME.jpg, a contact sheet of each family, and docs/families.png, the first scenes of all.

python docs/families.py                                 # 24 scenes a family, 25 minutes of processor time
python docs/families.py --count 12 --tiles tiles        # keeps the images in a folder, and goes on where it stopped
python docs/families.py --families room --seed 500      # the sheet of one family, other scenes

The scenes are those of `python benchmarks/bench_scene_statistics.py --pictures` with the same first seed: consecutive
seeds, the families by turns.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.families import FAMILIES, random_scene
from twinlens.rendering import forget_kernels, share_kernels

HERE = Path(__file__).parent
WIDTH, HEIGHT, SPP = 640, 480, 8
COLUMNS = 6
TILE = 208, 156
OVERVIEW = 12  # scenes of each family


def picture(family: str, seed: int) -> Image.Image:
    """The left image of a scene at automatic exposure."""
    scene = random_scene(family, seed, width=WIDTH)
    rig = default_rig(scene, WIDTH, HEIGHT)
    left = tl.Rig(rig.cameras[:1], rig.world_from_cams[:1])
    radiance = tl.render(scene, left, tl.Pinhole(), spp=SPP, seed=seed, denoise=True)
    (photo,) = tl.Sensor().expose_rig(radiance, rig=left, lens=tl.Pinhole(), seed=seed)
    forget_kernels()
    return Image.fromarray(np.asarray(photo.image))


def pictures(
    family: str, first: int, count: int, folder: Path | None
) -> list[Image.Image]:
    """The images of a contact sheet; those that are in the folder are not rendered again."""
    made = []
    place = list(FAMILIES).index(family)
    for number in range(count):
        seed = first + number * len(FAMILIES) + place
        kept = folder / f"{family}-{seed}.png" if folder else None
        if kept and kept.exists():
            made.append(Image.open(kept).convert("RGB"))
            continue
        made.append(picture(family, seed))
        print(f"{family} {seed}", flush=True)
        if kept:
            made[-1].save(kept)
    return made


def arranged(images: list[Image.Image]) -> NDArray[np.uint8]:
    """Images in rows; the last row may end in black."""
    tiles = [np.asarray(image.resize(TILE, Image.Resampling.BOX)) for image in images]
    missing = -len(tiles) % COLUMNS
    tiles += [np.zeros_like(tiles[0])] * missing
    rows = [
        np.hstack(tiles[start : start + COLUMNS])
        for start in range(0, len(tiles), COLUMNS)
    ]
    return np.vstack(rows)


def main() -> None:
    """Write the contact sheets and, if all families were asked for, the overview."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", default=list(FAMILIES))
    parser.add_argument("--count", type=int, default=24, help="scenes of each family")
    parser.add_argument("--seed", type=int, default=30_000, help="the first one")
    parser.add_argument("--tiles", type=Path, help="a folder that keeps the images")
    options = parser.parse_args()
    if options.tiles:
        options.tiles.mkdir(parents=True, exist_ok=True)
    share_kernels()
    overview = []
    for family in options.families:
        images = pictures(family, options.seed, options.count, options.tiles)
        sheet = Image.fromarray(arranged(images))
        sheet.save(HERE / f"families_{family}.jpg", quality=82)
        overview.append(arranged(images[:OVERVIEW]))
    if set(options.families) == set(FAMILIES):
        whole = Image.fromarray(np.vstack(overview))
        dithered = whole.quantize(256, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG)
        dithered.save(HERE / "families.png", optimize=True)


if __name__ == "__main__":
    main()
