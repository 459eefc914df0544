"""Cards with cut-outs, and a ray caster for them in NumPy: planes in closed form, its own lookup of texels.

A card is a unit square in the plane z = 0 of its pose, with the texture coordinates of its corners.
"""

from dataclasses import dataclass, field

import numpy as np

from twinlens import geometry
from twinlens.scenes import Mesh, SceneObject
from twinlens.scenes.materials import Bitmap, lambert

CORNERS = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
UV = np.array([[0.0, 0.0], [1, 0], [1, 1], [0, 1]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


@dataclass
class Card:
    """`alpha` (H, W), row 0 at the top; texels are there where their interpolated alpha is `cut` or more."""

    name: str
    world_from_card: np.ndarray
    alpha: np.ndarray
    cut: float = 0.5
    mode: str = "MASK"
    filter: str = "bilinear"
    wrap: str | tuple = "repeat"
    to_uv: np.ndarray = field(default_factory=lambda: np.eye(3))

    def material(self, color=0.8):
        to_uv = np.eye(4)
        to_uv[np.ix_([0, 1, 3], [0, 1, 3])] = self.to_uv
        pixels = np.asarray(self.alpha, dtype=np.float32)
        opacity = Bitmap(pixels, self.filter, self.wrap, to_uv)
        cutoff = self.cut if self.mode == "MASK" else None
        return lambert(color, opacity=opacity, alpha_cutoff=cutoff, two_sided=True)

    def scene_object(self, material):
        mesh = Mesh(CORNERS, FACES.astype(np.uint32), None, UV)
        return SceneObject(self.name, mesh, material, self.world_from_card)

    def cross(self, origin, direction):
        """Distances (N,) to the plane along rays (N, 3), +inf beside the square, and alpha there."""
        card_from_world = np.linalg.inv(self.world_from_card)
        start = origin @ card_from_world[:3, :3].T + card_from_world[:3, 3]
        along = direction @ card_from_world[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -start[:, 2] / along[:, 2]
            at = (start + t[:, None] * along)[:, :2]
        inside = (np.abs(at) <= 0.5).all(axis=1) & (t > 0)
        u, v = np.where(inside[:, None], at, 0.0).T + 0.5
        return np.where(inside, t, np.inf), self.lookup(u, v)

    def lookup(self, u, v):
        """Alpha at texture coordinates, v up."""
        u, v = (self.to_uv @ np.stack([u, v, np.ones_like(u)]))[:2]
        height, width = self.alpha.shape
        column, row = u * width - 0.5, (1 - v) * height - 0.5
        if self.filter == "nearest":
            return self.texel(np.round(row).astype(int), np.round(column).astype(int))
        left, top = np.floor(column).astype(int), np.floor(row).astype(int)
        x, y = column - left, row - top
        upper = (1 - x) * self.texel(top, left) + x * self.texel(top, left + 1)
        lower = (1 - x) * self.texel(top + 1, left) + x * self.texel(top + 1, left + 1)
        return (1 - y) * upper + y * lower

    def texel(self, row, column):
        height, width = self.alpha.shape
        both = isinstance(self.wrap, str)
        along_u, along_v = (self.wrap, self.wrap) if both else self.wrap
        return self.alpha[wrapped(row, height, along_v), wrapped(column, width, along_u)]  # fmt: skip


def wrapped(index, size, wrap):
    """Indices of texels inside a texture, by the wrapping of glTF."""
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    period = np.mod(index, 2 * size if wrap == "mirror" else size)
    return np.where(period < size, period, 2 * size - 1 - period)


def cast(cards, origin, direction):
    """The first opaque card on each ray: (its number or -1, its distance or +inf, the alpha nearest to a cut).

    The last is the least |alpha - cut| of the interpolated cards up to there: where it is 0, rounding decides.
    """
    count = len(direction)
    first, distance = np.full(count, -1), np.full(count, np.inf)
    crossings = [card.cross(origin, direction) for card in cards]
    for number, (card, (t, alpha)) in enumerate(zip(cards, crossings, strict=True)):
        nearer = (alpha >= card.cut) & (t < distance)
        first[nearer], distance[nearer] = number, t[nearer]
    margin = np.full(count, np.inf)
    for card, (t, alpha) in zip(cards, crossings, strict=True):
        near = (t <= distance) & (card.filter != "nearest")
        margin[near] = np.minimum(margin, np.abs(alpha - card.cut))[near]
    return first, distance, margin


def facing(at, size=1.0, turn=0.0, towards=(0, 0, -1)):
    """The pose of a card at `at`, its front towards `towards`, its sides `size` (m), turned by `turn` (rad)."""
    pose = geometry.look_at(np.zeros(3), np.asarray(towards, float), (0.01, -1, 0.02))
    c, s = np.cos(turn), np.sin(turn)
    spin = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    placed = np.eye(4)
    placed[:3, :3] = size * pose[:3, :3] @ spin
    placed[:3, 3] = at
    return placed


def blobs(height, width, seed, period=3):
    """A smooth alpha (H, W) between 0 and 1, of 8 bits."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(width) / width, np.arange(height) / height)
    waves = [
        np.cos(2 * np.pi * (a * x + b * y) + phase)
        for a, b, phase in rng.uniform(-period, period, (5, 3))
    ]
    return np.round(255 * (0.5 + 0.1 * np.sum(waves, axis=0))) / 255
