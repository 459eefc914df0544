"""Things of thin sheets and boards: cloth in folds, leaning books, toys of blocks."""

import math

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.things.pieces import Part, standing
from twinlens.families.things.sweeps import sheet, tube
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation


def hung_cloth(rng: Rng) -> Piece:
    """A cloth of 0.5 to 1.6 m that hangs from a rod between two posts, in folds that deepen downwards."""
    wide, tall = rng.uniform(0.5, 1.2), rng.uniform(0.6, 1.4)
    x, z = np.meshgrid(
        np.linspace(-wide / 2, wide / 2, 120), np.linspace(0.06, tall, 14)
    )
    folds, phase = wide * rng.uniform(5, 12), rng.uniform(0, 6)
    down = 1 - z / tall
    wave = np.sin(2 * math.pi * folds * x / wide + phase + 0.8 * np.sin(3 * down))
    y = (0.012 + rng.uniform(0.015, 0.045) * down) * wave
    cloth = sheet(np.stack([x, y, z], axis=-1), 0.0016)
    rod = tube([[-wide / 2 - 0.06, 0, tall], [wide / 2 + 0.06, 0, tall]], 0.012, 12)
    posts = []
    for side in (-1, 1):
        at = side * (wide / 2 + 0.06)
        posts.append(tube([[at, 0, 0], [at, 0, tall + 0.02]], 0.012, 12))
        posts.append(tube([[at, -0.18, 0.012], [at, 0.18, 0.012]], 0.012, 12))
    return standing(
        "hung-cloth",
        Part("cloth", cloth, one_of(rng, ["fabric", "pattern"])),
        Part("rod", shapes.merged([rod, *posts]), one_of(rng, ["wood", "metal"])),
    )


def leaning_books(rng: Rng) -> Piece:
    """Three to nine books: some upright, the others leaning on them, side by side."""
    x, made = 0.0, []
    upright, leaning = int(rng.integers(1, 4)), int(rng.integers(2, 7))
    for _ in range(upright):
        thick, tall = rng.uniform(0.02, 0.045), rng.uniform(0.2, 0.3)
        deep = rng.uniform(0.13, 0.2)
        made.append(board((thick, deep, tall), (-thick / 2 - x, 0, tall / 2), 0.002))
        x += thick + 0.0005
    angle, x = rng.uniform(8, 24), 0.0005
    for k in range(leaning):
        thick, tall = rng.uniform(0.015, 0.035), rng.uniform(0.15, 0.185)
        deep = rng.uniform(0.11, 0.17)
        # Turned about its lower outer edge; its upper edge touches what is on its left.
        lean = math.radians(angle)
        place = x + tall * math.sin(lean) if k == 0 else x
        pose = translation([place, 0, 0]) @ rotation([0, 1, 0], -angle)
        body = board((thick, deep, tall), (thick / 2, 0, tall / 2), 0.002)
        made.append(shapes.transformed(body, pose))
        x = place + (thick + 0.0005) / math.cos(lean)
    lifted = []
    for body in made:
        low = float(body.vertices[:, 2].min())
        lifted.append(shapes.transformed(body, translation([0, 0, -low])))
    parts = [
        Part(f"book-{k}", body, "toy" if k % 2 else "pattern")
        for k, body in enumerate(lifted)
    ]
    return standing("leaning-books", *parts)


def toy_wagon(rng: Rng) -> Piece:
    """A toy of blocks: a wagon with wheels, a tower or a row of rods, and a pulled string."""
    long, wide = rng.uniform(0.14, 0.26), rng.uniform(0.06, 0.1)
    radius = rng.uniform(0.016, 0.026)
    floor = 1.4 * radius
    bed = board((long, wide, 0.018), (0, 0, floor), 0.004)
    wheels = []
    for axle in (-0.33 * long, 0.33 * long):
        wheels.append(
            tube(
                [[axle, -wide / 2 - 0.02, radius], [axle, wide / 2 + 0.02, radius]],
                0.003,
                8,
            )
        )
        for side in (-1, 1):
            near, far = side * (wide / 2 + 0.004), side * (wide / 2 + 0.014)
            wheels.append(tube([[axle, near, radius], [axle, far, radius]], radius, 24))
    parts = [Part("bed", bed, "wood"), Part("wheels", shapes.merged(wheels), "toy")]
    count = int(rng.integers(3, 6))
    top = floor + 0.0092
    for k in range(count):
        x = ((k + 0.5) / count - 0.5) * 0.9 * long
        edge = 0.7 * long / count
        tall = rng.uniform(0.03, 0.11)
        if rng.random() < 0.5:
            body = tube([[x, 0, top], [x, 0, top + tall]], edge / 2, 20)
        else:
            body = board((edge, edge, tall), (x, 0, top + tall / 2), 0.003)
        parts.append(Part(f"load-{k}", body, "toy"))
    return standing("toy-wagon", *parts)
