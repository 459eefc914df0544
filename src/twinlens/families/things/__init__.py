"""Things with fine and slanted geometry: one table, and how a thing is added to a scene.

A thing is a `Piece` of closed parts and thin sheets with real sizes. In a scene it is one object with one id: its parts
are surfaces of one mesh. Copies of a thing are objects with the same mesh and materials.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twinlens.families import lighting
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
from twinlens.families.materials import furniture_material
from twinlens.families.things import lattices, plants, seats, sheets, streets, wheels
from twinlens.geometry import Float


@dataclass(frozen=True)
class Thing:
    """The range of a thing's largest extent in metres, where it may be, and how it is made.

    places : "table", "floor", "wall" (its back at +y touches the wall), "outdoors", "street" (large, or fixed to the
        ground), "hangs" (from its highest point).
    parts : the names of its parts.
    """

    size: tuple[float, float]
    places: tuple[str, ...]
    parts: tuple[str, ...]
    make: Callable[[Rng], Piece]


THINGS: dict[str, Thing] = {
    "pot-plant": Thing(
        (0.3, 1.4),
        ("table", "floor"),
        ("pot", "soil", "stems", "leaves"),
        plants.pot_plant,
    ),
    "hedge": Thing(
        (0.4, 1.6),
        ("table", "floor", "outdoors"),
        ("planter", "soil", "twigs", "leaves"),
        plants.hedge,
    ),
    "slatted-chair": Thing(
        (0.78, 1.03),
        ("floor", "outdoors"),
        ("frame", "slats", "seat"),
        seats.slatted_chair,
    ),
    "spoked-wheel": Thing(
        (0.4, 0.7),
        ("table", "floor", "outdoors"),
        ("tire", "rim", "hub", "stand"),
        wheels.spoked_wheel,
    ),
    "stool": Thing((0.4, 0.8), ("floor",), ("legs", "ring", "seat"), seats.stool),
    "bicycle": Thing(
        (1.5, 1.9),
        ("floor", "outdoors"),
        ("frame", "metal", "tires", "saddle"),
        wheels.bicycle,
    ),
    "fence": Thing((1.5, 3.1), ("outdoors",), ("pickets", "posts"), lattices.fence),
    "grille": Thing(
        (0.5, 1.31), ("table", "floor", "outdoors"), ("bars", "frame"), lattices.grille
    ),
    "steps": Thing(
        (1.2, 3.6),
        ("floor", "outdoors"),
        ("treads", "strings", "rails"),
        lattices.steps,
    ),
    "tripod": Thing(
        (0.4, 1.65), ("floor", "outdoors"), ("legs", "braces", "head"), lattices.tripod
    ),
    "desk-lamp": Thing(
        (0.35, 0.95), ("table",), ("stand", "shade", "cable"), lattices.desk_lamp
    ),
    "basket": Thing((0.19, 0.5), ("table", "floor"), ("weave", "rim"), lattices.basket),
    "hung-cloth": Thing(
        (0.6, 1.5), ("floor", "outdoors"), ("cloth", "rod"), sheets.hung_cloth
    ),
    "leaning-books": Thing((0.19, 0.6), ("table",), ("book",), sheets.leaning_books),
    "toy-wagon": Thing(
        (0.12, 0.3), ("table", "floor"), ("bed", "wheels", "load"), sheets.toy_wagon
    ),
    "tree": Thing((3.3, 12.0), ("street",), ("wood", "leaves"), plants.tree),
    "car": Thing(
        (3.5, 4.9),
        ("street",),
        ("body", "panes", "bumpers", "lamps", "tires", "hubs"),
        streets.car,
    ),
    "bench": Thing((1.3, 1.9), ("street",), ("slats", "legs"), streets.bench),
    "lamp-post": Thing(
        (2.5, 7.0), ("street",), ("post", "head", "lantern"), streets.lamp_post
    ),
    "road-sign": Thing((2.0, 2.8), ("street",), ("plate", "pole"), streets.road_sign),
    "bollard": Thing((0.6, 1.3), ("street",), ("post",), streets.bollard),
    "litter-bin": Thing((0.7, 1.2), ("street",), ("body", "lid"), streets.litter_bin),
}


def things_for(place: str) -> tuple[str, ...]:
    """The names of all things that may be at a place."""
    return tuple(name for name, row in THINGS.items() if place in row.places)


def names_in_scenes() -> frozenset[str]:
    """The names of the objects and materials of all things, without the numbers that may follow."""
    of_parts = {f"{name}-{part}" for name, row in THINGS.items() for part in row.parts}
    return frozenset(of_parts | THINGS.keys())


def make_thing(name: str, rng: Rng) -> Piece:
    """A thing of the table. Its middle is above the origin, and it stands on z = 0 or hangs from it."""
    return THINGS[name].make(rng)


def add_thing(
    scene: Composition,
    piece: Piece,
    poses: Sequence[Float],
    part: tuple[str | int, ...],
) -> None:
    """Add copies of a piece at poses (4, 4) that may scale evenly; parts of one material look alike.

    The copies share a mesh and materials; each has its own id. Parts that shine are objects of their own, and a piece
    with such parts has one pose.

    part : names the random streams of its materials.
    """
    # A pixel of the nearest copy, in metres of the piece before it is scaled.
    pixel = min(
        scene.pixel_at(pose[:3, 3], 0.3) / float(np.linalg.norm(pose[:3, 0]))
        for pose in poses
    )
    shared = int(scene.rng("tone", *part).integers(1 << 30))
    surfaces = []
    for name, mesh, word in piece.parts:
        if word == "lit":
            tone = scene.rng("lit", *part).uniform(2.0, 4.0) * lighting.WARM
            label = f"{piece.kind}-{name}"
            lighting.emitter(scene, label, mesh, poses[0], tone, 0.4)
            continue
        look = furniture_material(scene, (*part, name), word, pixel, shared)
        surfaces.append((name, mesh, look))
    scene.add_surfaces(piece.kind, surfaces, poses)
