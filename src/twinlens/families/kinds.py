"""Bodies of a scene: the 33 kinds, with their sizes, weights and patterns, or a user's mesh."""

from collections.abc import Callable
from dataclasses import dataclass

from twinlens.families import makers
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, log_uniform, weighted
from twinlens.families.materials import FINISHES, PLAIN, body_material, user_texture
from twinlens.families.solids import (
    Solid,
    box_mapped,
)
from twinlens.scenes.materials import Material


@dataclass(frozen=True)
class Kind:
    """The range of a body's largest extent in metres, its weight in draws, its patterns, and how it is made."""

    size: tuple[float, float]
    weight: float
    patterns: tuple[str, ...]
    make: Callable[[Rng], Solid]


_GLAZED = (
    "plain",
    "cloudy",
    "speckled",
    "stripes",
    "zigzag",
    "dots",
    "scales",
    "triangles",
    "marble",
)
_FRUIT = ("cloudy", "speckled", "plain")
_PRINTED = ("art", "stripes", "triangles", "dots", "plain", "camouflage", "checks")
_TOY = (
    "plain",
    "wood",
    "stripes",
    "dots",
    "triangles",
    "checks",
    "cloudy",
    "mosaic",
    "camouflage",
)
KINDS: dict[str, Kind] = {
    "vase": Kind((0.18, 0.36), 1.6, _GLAZED, makers.vase),
    "bottle": Kind(
        (0.2, 0.34), 1.3, ("plain", "cloudy", "stripes", "speckled"), makers.bottle
    ),
    "bowl": Kind((0.14, 0.28), 1.2, _GLAZED, makers.bowl),
    "cup": Kind((0.08, 0.13), 1.4, _GLAZED, makers.cup),
    "goblet": Kind((0.13, 0.2), 0.6, ("plain", "cloudy", "wood"), makers.goblet),
    "plate": Kind((0.18, 0.28), 0.7, _GLAZED, makers.plate),
    "jar": Kind((0.12, 0.24), 1.0, _GLAZED, makers.jar),
    "tin": Kind((0.08, 0.15), 1.0, _PRINTED, makers.tin),
    "candle": Kind(
        (0.07, 0.2), 0.8, ("plain", "cloudy", "stripes", "marble"), makers.candle
    ),
    "apple": Kind((0.075, 0.095), 1.4, _FRUIT, makers.apple),
    "pear": Kind((0.09, 0.12), 0.9, _FRUIT, makers.pear),
    "egg": Kind((0.06, 0.09), 0.6, _FRUIT, makers.egg),
    "pawn": Kind((0.09, 0.22), 0.8, ("wood", "plain", "marble"), makers.pawn),
    "cylinder": Kind((0.08, 0.22), 0.7, _TOY, makers.cylinder),
    "cone": Kind((0.1, 0.2), 0.6, _TOY, makers.cone),
    "capsule": Kind((0.08, 0.18), 0.5, _TOY, makers.capsule),
    "book": Kind(
        (0.18, 0.3),
        1.8,
        ("plain", "art", "stripes", "weave", "triangles", "cloudy", "scales"),
        makers.book,
    ),
    "carton": Kind((0.1, 0.28), 1.4, _PRINTED, makers.carton),
    "block": Kind((0.06, 0.16), 1.2, _TOY, makers.block),
    "ball": Kind(
        (0.07, 0.18),
        1.2,
        ("stripes", "plain", "dots", "cloudy", "marble", "triangles"),
        makers.ball,
    ),
    "ellipsoid": Kind((0.08, 0.18), 0.5, _TOY, makers.ellipsoid),
    "superquadric": Kind((0.1, 0.22), 1.0, _TOY, makers.superquadric),
    "pebble": Kind(
        (0.06, 0.2),
        1.1,
        ("marble", "granite", "speckled", "cloudy", "chips"),
        makers.pebble,
    ),
    "blob": Kind((0.1, 0.2), 0.9, _GLAZED, makers.blob),
    "ring": Kind((0.1, 0.24), 0.8, _TOY, makers.ring),
    "knot": Kind(
        (0.12, 0.26), 0.5, ("plain", "cloudy", "granite", "wood", "marble"), makers.knot
    ),
    "crystal": Kind(
        (0.08, 0.18),
        0.8,
        ("plain", "granite", "marble", "wood", "chips"),
        makers.crystal,
    ),
    "star": Kind((0.1, 0.2), 0.5, _TOY, makers.star),
    "gear": Kind((0.1, 0.24), 0.8, ("plain", "cloudy", "granite"), makers.gear),
    "flower": Kind((0.1, 0.2), 0.5, _TOY, makers.flower),
    "heart": Kind((0.08, 0.18), 0.4, ("plain", "cloudy", "wood", "dots"), makers.heart),
    "prism": Kind((0.08, 0.22), 0.6, _TOY, makers.prism),
    "nut": Kind((0.07, 0.16), 0.5, ("plain", "granite"), makers.nut),
}
METALLIC = (
    "gear",
    "nut",
    "knot",
    "ring",
    "vase",
    "goblet",
    "tin",
    "ball",
    "crystal",
    "bowl",
    "capsule",
    "blob",
)
SOFT = ("book", "block", "ball", "blob", "ring", "star", "flower", "heart")
GLASSY = ("vase", "bottle", "goblet", "ball", "cup", "crystal")
_KINDS_OF = {
    "metal": METALLIC,
    "mirror": METALLIC,
    "glass": GLASSY,
    "fabric": SOFT,
}
"""The kinds that may have a finish; all kinds may have the others."""

_USER_SIZE = (0.14, 0.34)
_USER_PATTERNS = ("cloudy", "speckled", "granite", "stripes")


@dataclass(frozen=True, eq=False)
class Body:
    """A body whose largest extent is `size` metres; `kind` is "" for a user's mesh."""

    name: str
    kind: str
    solid: Solid
    size: float
    scene: Composition
    part: tuple[str | int, ...]

    def material(self, pixel: float) -> Material:
        """Its material where a pixel covers `pixel` metres: no texel is smaller than that."""
        scene, part = self.scene, self.part
        finishes = [
            name for name in FINISHES if self.kind in _KINDS_OF.get(name, (self.kind,))
        ]
        shares = [FINISHES[name][0] for name in finishes]
        finish = weighted(scene.rng(*part, "finish"), finishes, shares)
        picture = None
        if finish not in ("metal", "glass", "mirror"):
            picture = user_texture(scene, *part)
        patterns = KINDS[self.kind].patterns if self.kind else _USER_PATTERNS
        return body_material(
            scene.rng(*part, "texture"),
            self.solid,
            self.size,
            pixel,
            scene.palette,
            finish,
            patterns if picture is None else picture,
            scene.plain_share(PLAIN),
        )


def draw_body(
    scene: Composition,
    part: tuple[str | int, ...],
    among: tuple[str, ...] | None = None,
) -> Body:
    """The body of one part of a scene, of one of the kinds `among`. Without `among`: of any kind, or a user's mesh."""
    if among is None and _is_of_user(scene, part):
        body = _draw_user_body(scene, part)
        if body is not None:
            return body
    names = among or tuple(KINDS)
    weights = [KINDS[kind].weight for kind in names]
    name = weighted(scene.rng(*part, "kind"), names, weights)
    size = log_uniform(scene.rng(*part, "size"), *KINDS[name].size)
    solid = KINDS[name].make(scene.rng(*part, "shape"))
    return Body(name, name, solid, size, scene, part)


def _is_of_user(scene: Composition, part: tuple[str | int, ...]) -> bool:
    assets = scene.assets
    if not assets.meshes:
        return False
    return bool(scene.rng(*part, "own").random() < assets.mesh_share)


def _draw_user_body(scene: Composition, part: tuple[str | int, ...]) -> Body | None:
    """A body that is one of the user's meshes; None if no file can be used."""
    drawn = scene.assets.draw("meshes", scene.rng(*part, "mesh"))
    if drawn is None:
        return None
    name, mesh = drawn
    size = mesh.size
    if not scene.assets.keep_scale:
        size = float(scene.rng(*part, "shape").uniform(*_USER_SIZE))
    if not mesh.materials and (mesh.normals is None or mesh.uv is None):
        mesh = box_mapped(mesh.vertices, mesh.faces, 30.0)
    return Body(name, "", Solid(mesh, True), size, scene, part)
