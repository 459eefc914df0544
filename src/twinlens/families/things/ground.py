"""Things that stand on level ground: no two overlap, none is in front of the lens.

What a thing fills is described by layers: between two heights, the convex outline of all triangles that reach into
them. So a book may lie below the crown of a plant, and a chair's seat below a table's top.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from twinlens.families.composition import Composition, similarity
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.furniture import Piece
from twinlens.families.things import add_thing, make_thing
from twinlens.geometry import Float
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import gap, outline

_LAYERS = 8  # of a thing
_LIFT = 1e-4  # metres above the ground: no two surfaces coincide
_TRIES = 40  # random places of a thing before it is left out
_WITHOUT = 0.35  # share of the scenes that have no things
_THICKETS = 0.2  # share of the scenes that have as many as there may be
_ALIKE = 5.0  # at most, copies of one model on average
_MOST_FACES = 55_000  # of the things on one ground
PLANTS = ("hedge", "hedge", "pot-plant")

Footprint = Callable[[Rng, float], Float]
"""A place (2,) on the ground for a thing of a size in metres."""


@dataclass(frozen=True, eq=False)
class Layer:
    """What is filled between two heights: the convex outline (N, 2) of it, counter-clockwise."""

    low: float
    high: float
    outline: Float

    @cached_property
    def bounds(self) -> tuple[Float, Float]:
        """The least and the largest x and y, (2,) each."""
        return self.outline.min(axis=0), self.outline.max(axis=0)

    def moved(self, pose: Float) -> "Layer":
        """The layer at a pose (4, 4) that turns about the vertical, scales evenly and moves."""
        scale, lift = float(pose[2, 2]), float(pose[2, 3])
        moved = self.outline @ pose[:2, :2].T + pose[:2, 3]
        return Layer(scale * self.low + lift, scale * self.high + lift, moved)

    def is_clear_of(self, neighbour: "Layer", spacing: float) -> bool:
        """Whether the two are above one another, or `spacing` metres apart."""
        if self.low >= neighbour.high or neighbour.low >= self.high:
            return True
        # Rectangles around both are compared first, as that is fast.
        (least, most), (least_there, most_there) = self.bounds, neighbour.bounds
        apart = np.maximum(least - most_there, least_there - most)
        if apart.max() > spacing:
            return True
        return gap(self.outline, neighbour.outline) > spacing


def layers_of(meshes: Iterable[Mesh], count: int = _LAYERS) -> list[Layer]:
    """The layers of equal height of meshes; empty ones are left out."""
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    lowest, highest = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    edges = np.linspace(lowest.min(), highest.max(), count + 1)
    layers = []
    for low, high in pairwise(edges):
        reaching = corners[(lowest < high) & (highest > low)]
        if len(reaching):
            points = reaching[..., :2].reshape(-1, 2)
            layers.append(Layer(float(low), float(high), outline(points)))
    return layers


@dataclass(eq=False)
class Ground:
    """Level ground at a height in metres, and the layers that things on it fill, `spacing` metres apart.

    holds : whether the ground, and the free space above it, reaches below and around a footprint (N, 2).
    nearest : the least depth of a thing in the camera's frame, metres.
    count : of the things on it.
    """

    scene: Composition
    height: float
    spacing: float
    nearest: float
    holds: Callable[[Float], bool] = lambda _: True
    filled: list[Layer] = field(default_factory=list)
    count: int = 0
    faces: int = 0

    def is_free(self, layers: Sequence[Layer]) -> bool:
        """Whether layers lie on the ground, beyond the nearest depth, and clear of all that is there."""
        for layer in layers:
            if not self.holds(layer.outline) or self._depth(layer) < self.nearest:
                return False
        return all(
            layer.is_clear_of(neighbour, self.spacing)
            for layer, neighbour in product(layers, self.filled)
        )

    def _depth(self, layer: Layer) -> float:
        ends = np.repeat([layer.low, layer.high], len(layer.outline))
        points = np.column_stack([np.tile(layer.outline, (2, 1)), ends])
        return float(self.scene.view.depth(points).min())

    def scatter(
        self,
        part: str,
        names: Sequence[str],
        count: int,
        place: Footprint,
        sizes: tuple[float, float] | None = None,
    ) -> None:
        """Add at most `count` things at random places, several copies of each model.

        sizes : the range of their largest extents in metres, to which they are scaled; None keeps their real size.
        """
        rng = self.scene.rng(part, "models")
        if self.scene.is_overgrown:
            names = [name for name in PLANTS if name in names] or names
        models = math.ceil(count / log_uniform(rng, 1.0, _ALIKE)) if count else 0
        for model in range(models):
            name = one_of(rng, names)
            piece = make_thing(name, self.scene.rng(part, "shape", model))
            copies = count // models + (model < count % models)
            faces = sum(len(mesh.faces) for _, mesh, _ in piece.parts)
            copies = min(copies, (_MOST_FACES - self.faces) // faces)
            while copies and not self.scene.has_room_for(copies * faces):
                copies -= 1
            poses = self._poses(part, model, piece, copies, place, sizes)
            if poses:
                add_thing(self.scene, piece, poses, (part, model))
            self.count += len(poses)
            self.faces += len(poses) * faces

    def _size(self, rng: Rng, sizes: tuple[float, float]) -> float:
        """A largest extent in metres; in a scene full of plants one of the larger ones."""
        low, high = sizes
        if self.scene.is_overgrown:
            low = math.sqrt(low * high)
        return log_uniform(rng, low, high)

    def _poses(
        self,
        part: str,
        model: int,
        piece: Piece,
        copies: int,
        place: Footprint,
        sizes: tuple[float, float] | None,
    ) -> list[Float]:
        """Free poses (4, 4) of copies of a piece, whose layers are filled from then on."""
        layers = layers_of(mesh for _, mesh, _ in piece.parts)
        largest = max(*piece.floor, piece.height)
        poses = []
        for copy in range(copies):
            rng = self.scene.rng(part, "place", model, copy)
            for _ in range(_TRIES):
                size = largest if sizes is None else self._size(rng, sizes)
                turn = rotation([0, 0, 1], float(rng.uniform(0, 360)))[:3, :3]
                at = np.append(place(rng, size), self.height + _LIFT)
                pose = similarity(turn, at, size / largest)
                moved = [layer.moved(pose) for layer in layers]
                if self.is_free(moved):
                    self.filled += moved
                    poses.append(pose)
                    break
        return poses


def spread_count(scene: Composition, part: str, most: int) -> int:
    """How many things a part of a scene has: none in many scenes, `most` in some, else of a uniform logarithm."""
    rng = scene.rng(part, "count")
    kind = rng.random()
    if most < 1:
        return 0
    if kind > 1 - _THICKETS or scene.is_overgrown:
        return most
    if kind < _WITHOUT:
        return 0
    return min(most, int(log_uniform(rng, 1.0, most + 1.0)))


def count_among_bodies(scene: Composition, part: str, most: int) -> int:
    """How many of at most `most` bodies are things; the share that the user's meshes have is left to them."""
    return spread_count(scene, part, round(scene.assets.share_of_ours * most))
