"""Drawing bodies for a scene: a solid of the catalogue or of the user's folder, its size, and what it is made of."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import zoom

from twinlens.families.brushes import Image, Rng
from twinlens.families.catalogue import GLASS_LIKES, KINDS, METAL_LIKES, draw_kind
from twinlens.families.family import Request
from twinlens.families.finishes import Coat, coat, draw_finish, repeats, texels
from twinlens.families.palettes import Palette
from twinlens.families.solids import Solid, box_mapped
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh, Plugin

_OWN_MESHES, _OWN_TEXTURES = 0.6, 0.4  # how often the user's files are taken where there are any
_OWN_SIZE = (0.14, 0.34)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A body with its largest extent in metres; `material` dresses it for the size of a pixel where it is seen."""

    name: str
    solid: Solid
    size: float
    request: Request
    part: tuple[str | int, ...]
    palette: Palette

    def material(self, pixel: float) -> Plugin:
        """What it is made of, its texture no finer than two pixels of `pixel` metres."""
        request, kind = self.request, self.solid.kind
        rng = request.rng(*self.part, "texture")
        known = KINDS.get(kind)
        finish = draw_finish(request.rng(*self.part, "finish"), kind in METAL_LIKES, kind in GLASS_LIKES)
        own = own_texture(request, *self.part)
        if own is not None and finish in ("matte", "satin", "glossy"):
            return own_coat(own, rng, self.solid, self.size, pixel, finish).plugin()
        patterns = known.patterns if known is not None else ("cloudy", "speckled", "granite", "stripes")
        return coat(rng, self.solid, self.size, pixel, self.palette, finish, patterns).plugin()


def draw_body(request: Request, part: tuple[str | int, ...], palette: Palette, among: tuple[str, ...] = ()) -> Drawn:
    """The body of one part of a scene; `among` names kinds to draw from, all if empty."""
    rng = request.rng(*part, "shape")
    if not among and request.assets.meshes and request.rng(*part, "own").random() < _OWN_MESHES:
        drawn = request.assets.mesh(request.rng(*part, "mesh"))
        if drawn is not None:
            return Drawn(drawn[0], own_solid(drawn[1]), float(rng.uniform(*_OWN_SIZE)), request, part, palette)
    name = draw_kind(request.rng(*part, "kind"), among)
    kind = KINDS[name]
    solid = kind.make(rng)
    size = math.exp(request.rng(*part, "size").uniform(math.log(kind.size[0]), math.log(kind.size[1])))
    return Drawn(name, Solid(name, solid.mesh, solid.upright, solid.span, solid.around), size, request, part, palette)


def own_solid(mesh: Mesh) -> Solid:
    """A user's mesh, with normals and texture coordinates if it has none."""
    if mesh.normals is None or mesh.uv is None:
        mesh = box_mapped(mesh.vertices, mesh.faces, 30.0)
    return Solid("own", mesh, True)


def own_texture(request: Request, *part: str | int) -> Image | None:
    """One of the user's pictures, now and then."""
    if not request.assets.textures or request.rng(*part, "own texture").random() >= _OWN_TEXTURES:
        return None
    drawn = request.assets.texture(request.rng(*part, "picture"))
    return None if drawn is None else drawn[1]


def own_coat(pixels: Image, rng: Rng, solid: Solid, size: float, pixel: float, finish: str) -> Coat:
    """A user's picture laid around a body once or twice, no finer than it can be seen."""
    tile = size * float(rng.choice([0.5, 1.0]))
    return Coat(finish, shrunk(pixels, texels(tile, pixel)), repeats(solid, size, tile), float(rng.uniform(0.05, 0.3)))


def shrunk(pixels: Image, side: int) -> Image:
    """A picture as a square of at most `side` texels: means over blocks, then linear between them."""
    while min(pixels.shape[:2]) >= 2 * side:
        h, w = (length // 2 * 2 for length in pixels.shape[:2])
        p = pixels[:h, :w]
        pixels = 0.25 * (p[::2, ::2] + p[1::2, ::2] + p[::2, 1::2] + p[1::2, 1::2])
    factors = (min(side, 512) / pixels.shape[0], min(side, 512) / pixels.shape[1], 1)
    return np.ascontiguousarray(np.clip(zoom(pixels, factors, order=1, grid_mode=True, mode="grid-wrap"), 0, 0.95))


def random_turn(rng: Rng) -> Float:
    """A rotation (3, 3), uniform. Source: Shoemake, Uniform Random Rotations, Graphics Gems III, 1992."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
