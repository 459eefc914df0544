"""Pieces in their frame: the middle above the origin, standing on z = 0 or hanging from it."""

from dataclasses import dataclass

import numpy as np

from twinlens.families.furniture import Piece, Shelf
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh with (u, v) in metres, and the word of its material: a key of `materials.FURNITURE`, or "lit"."""

    name: str
    mesh: Mesh
    word: str


def standing(kind: str, *parts: Part, shelves: tuple[Shelf, ...] = ()) -> Piece:
    """A piece whose lowest point is at z = 0; `shelves` are those of parts around x = y = 0."""
    low, high = _bounds(parts)
    return _piece(kind, parts, -np.append((low + high)[:2] / 2, low[2]), shelves)


def hanging(kind: str, *parts: Part) -> Piece:
    """A piece whose highest point is at z = 0."""
    low, high = _bounds(parts)
    return _piece(kind, parts, -np.append((low + high)[:2] / 2, high[2]), ())


def _bounds(parts: tuple[Part, ...]) -> tuple[Float, Float]:
    """The least and the largest (x, y, z) of all parts."""
    low = np.min([part.mesh.vertices.min(axis=0) for part in parts], axis=0)
    high = np.max([part.mesh.vertices.max(axis=0) for part in parts], axis=0)
    return low, high


def _piece(
    kind: str, parts: tuple[Part, ...], offset: Float, shelves: tuple[Shelf, ...]
) -> Piece:
    pose = translation(offset)
    placed = tuple(
        (part.name, shapes.transformed(part.mesh, pose), part.word) for part in parts
    )
    low, high = _bounds(parts)
    width, depth, height = map(float, high - low)
    return Piece(kind, placed, (width, depth), height, shelves)
