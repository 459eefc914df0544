"""Things with fine and slanted geometry: one table, and how a thing is added to a scene.

A thing is a `Piece` of closed parts and thin sheets with real sizes. In a scene it is one object with one id: its parts
are surfaces of one mesh. Copies of a thing share that mesh.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from twinlens.families import lighting
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng
from twinlens.families.furniture import Piece
from twinlens.families.materials import furniture_material
from twinlens.families.things import plants, seats, wheels
from twinlens.geometry import Float


@dataclass(frozen=True)
class Thing:
    """The range of a thing's largest extent in metres, where it may be, and how it is made.

    places : "table", "floor", "wall" (its back at +y touches the wall), "outdoors", "hangs" (from its highest point).
    """

    size: tuple[float, float]
    places: tuple[str, ...]
    make: Callable[[Rng], Piece]


THINGS: dict[str, Thing] = {
    "pot-plant": Thing((0.3, 1.4), ("table", "floor"), plants.pot_plant),
    "slatted-chair": Thing((0.78, 1.03), ("floor", "outdoors"), seats.slatted_chair),
    "spoked-wheel": Thing(
        (0.4, 0.7), ("table", "floor", "outdoors"), wheels.spoked_wheel
    ),
}


def things_for(place: str) -> tuple[str, ...]:
    """The names of all things that may be at a place."""
    return tuple(name for name, thing in THINGS.items() if place in thing.places)


def make_thing(name: str, rng: Rng) -> Piece:
    """A thing of the table. Its middle is above the origin, and it stands on z = 0 or hangs from it."""
    return THINGS[name].make(rng)


def add_thing(
    scene: Composition,
    piece: Piece,
    pose: Float,
    part: tuple[str | int, ...],
    copies: Sequence[Float] = (),
) -> None:
    """Add a piece at a pose (4, 4) as one object; parts of one material look alike.

    part : names the random streams of its materials.
    copies : poses (4, 4) of further copies, which share its mesh and its materials; each has its own id. Parts that
        shine are objects of their own, and a piece with such parts has no copies.
    """
    pixel = scene.pixel_at(pose[:3, 3], 0.3)
    shared = int(scene.rng("tone", *part).integers(1 << 30))
    surfaces = []
    for name, mesh, word in piece.parts:
        if word == "lit":
            tone = scene.rng("lit", *part).uniform(2.0, 4.0) * lighting.WARM
            lighting.emitter(scene, f"{piece.kind}-{name}", mesh, pose, tone, 0.4)
            continue
        look = furniture_material(scene, (*part, name), word, pixel, shared)
        surfaces.append((name, mesh, look))
    scene.add_surfaces(piece.kind, surfaces, (pose, *copies))
