"""Which bodies there are, how large they are in a room, and what they may be made of: one visible table."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinlens.families import prisms, solids, vessels
from twinlens.families.solids import Rng, Solid


@dataclass(frozen=True)
class Kind:
    """A maker of bodies, its largest extent in metres on a table, how often it is drawn, and patterns it likes."""

    make: Callable[[Rng], Solid]
    size: tuple[float, float]
    weight: float = 1.0
    patterns: tuple[str, ...] = ()


_GLAZED = ("plain", "cloudy", "speckled", "stripes", "zigzag", "dots", "scales", "triangles", "marble")
_FRUIT = ("cloudy", "speckled", "plain")
_STONE = ("marble", "granite", "speckled", "cloudy", "chips")
_PRINTED = ("art", "stripes", "triangles", "dots", "plain", "camouflage", "checks")
_TOY = ("plain", "wood", "stripes", "dots", "triangles", "checks", "cloudy", "mosaic", "camouflage")
_CAST = ("plain", "cloudy", "granite", "wood", "marble")

KINDS: dict[str, Kind] = {
    "vase": Kind(vessels.vase, (0.18, 0.36), 1.6, _GLAZED),
    "bottle": Kind(vessels.bottle, (0.2, 0.34), 1.3, ("plain", "cloudy", "stripes", "speckled")),
    "bowl": Kind(vessels.bowl, (0.14, 0.28), 1.2, _GLAZED),
    "cup": Kind(vessels.cup, (0.08, 0.13), 1.4, _GLAZED),
    "goblet": Kind(vessels.goblet, (0.13, 0.2), 0.6, ("plain", "cloudy", "wood")),
    "plate": Kind(vessels.plate, (0.18, 0.28), 0.7, _GLAZED),
    "jar": Kind(vessels.jar, (0.12, 0.24), 1.0, _GLAZED),
    "tin": Kind(vessels.tin, (0.08, 0.15), 1.0, _PRINTED),
    "candle": Kind(vessels.candle, (0.07, 0.2), 0.8, ("plain", "cloudy", "stripes", "marble")),
    "apple": Kind(vessels.apple, (0.075, 0.095), 1.4, _FRUIT),
    "pear": Kind(vessels.pear, (0.09, 0.12), 0.9, _FRUIT),
    "egg": Kind(vessels.egg, (0.06, 0.09), 0.6, _FRUIT),
    "pawn": Kind(vessels.pawn, (0.09, 0.22), 0.8, ("wood", "plain", "marble")),
    "cylinder": Kind(vessels.cylinder, (0.08, 0.22), 0.7, _TOY),
    "cone": Kind(vessels.cone, (0.1, 0.2), 0.6, _TOY),
    "capsule": Kind(vessels.capsule, (0.08, 0.18), 0.5, _TOY),
    "book": Kind(vessels.book, (0.18, 0.3), 1.8, ("plain", "art", "stripes", "weave", "triangles", "cloudy", "scales")),
    "carton": Kind(vessels.carton, (0.1, 0.28), 1.4, _PRINTED),
    "block": Kind(solids.block, (0.06, 0.16), 1.2, _TOY),
    "ball": Kind(solids.ball, (0.07, 0.18), 1.2, ("stripes", "plain", "dots", "cloudy", "marble", "triangles")),
    "ellipsoid": Kind(solids.ellipsoid, (0.08, 0.18), 0.5, _TOY),
    "superquadric": Kind(solids.superquadric, (0.1, 0.22), 1.0, _TOY),
    "pebble": Kind(solids.pebble, (0.06, 0.2), 1.1, _STONE),
    "blob": Kind(solids.blob, (0.1, 0.2), 0.9, _GLAZED),
    "ring": Kind(solids.ring, (0.1, 0.24), 0.8, _TOY),
    "knot": Kind(solids.knot, (0.12, 0.26), 0.5, _CAST),
    "crystal": Kind(prisms.crystal, (0.08, 0.18), 0.8, ("plain", "granite", "marble", "wood", "chips")),
    "star": Kind(prisms.star, (0.1, 0.2), 0.5, _TOY),
    "gear": Kind(prisms.gear, (0.1, 0.24), 0.8, ("plain", "cloudy", "granite")),
    "flower": Kind(prisms.flower, (0.1, 0.2), 0.5, _TOY),
    "heart": Kind(prisms.heart, (0.08, 0.18), 0.4, ("plain", "cloudy", "wood", "dots")),
    "prism": Kind(prisms.prism, (0.08, 0.22), 0.6, _TOY),
    "nut": Kind(prisms.nut, (0.07, 0.16), 0.5, ("plain", "granite")),
}
METAL_LIKES = ("gear", "nut", "knot", "ring", "vase", "goblet", "tin", "ball", "crystal", "bowl", "capsule", "blob")
GLASS_LIKES = ("vase", "bottle", "goblet", "ball", "cup", "crystal")


def draw_kind(rng: Rng, among: tuple[str, ...] = ()) -> str:
    """The name of a kind, by weight."""
    names = among or tuple(KINDS)
    weights = np.array([KINDS[name].weight for name in names])
    return names[int(rng.choice(len(names), p=weights / weights.sum()))]
