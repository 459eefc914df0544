"""The family "street": a street, a lane or a park path by day or night, seen by a walker, a car or a robot.

Everything stands beside a straight way along +y: kerbs and pavements, or lawns with relief. Rows of houses or garden
walls follow the way, and a row of houses across it is the farthest surface. Above it is the sky. Lengths are in metres.
"""

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twinlens.families import lighting
from twinlens.families.arrangement import Area, arrange, bodies_at_rest
from twinlens.families.composition import Composition, rasterize
from twinlens.families.draws import Rng, log_uniform, one_of, varied, weighted
from twinlens.families.houses import add_house
from twinlens.families.materials import furniture_material
from twinlens.families.surfaces import Sheet, surface, wall_colors
from twinlens.families.things import add_thing, make_thing, names_in_scenes, things_for
from twinlens.families.things.ground import (
    Ground,
    Layer,
    count_among_bodies,
    layers_of,
)
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.materials import Material
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh

NAMES = names_in_scenes() | {
    "road", "markings", "pavement", "lawn", "garden-wall", "house", "far-house", "house-facade", "house-frames",
    "house-panes", "house-door", "house-roof", "far-house-facade", "far-house-frames", "far-house-panes", "sun",
    "key-light", "street-lamp",
}  # fmt: skip
"""Names of what scenes have besides bodies, without numbers."""

_LAMP = np.full(2, 0.12)  # metres, the sides of what shines on a lamp post
_SMALL = ("carton", "carton", "block", "tin", "pebble", "pebble", "ball", "jar")
_BEHIND = -3.0  # where surfaces begin, behind the camera
_BESIDE_PATH = 2.0  # metres of level ground beside a path, where things stand
_INDOORS = ("hung-cloth",)
_MOST_THINGS = 8  # chairs, bicycles, fences and the like
_FACES_OF_TREES = 20_000  # on one side
_DETAIL = 0.7  # texels a pixel: the texels of long strips are several times as many as the pixels that see them
_WAYS = (("granite", 0.8), ("chips", 0.7), ("bricks", 1.1), ("speckled", 1.2))
_PAVINGS = (("tiles", 1.6), ("bricks", 1.0), ("granite", 0.9), ("mosaic", 1.4))
_LAWNS = (("granite", 0.9), ("speckled", 1.3), ("cloudy", 1.8))
_GARDEN_WALLS = (("bricks", 0.9), ("granite", 1.2), ("planks", 1.0), ("cloudy", 1.6))
_ASPHALT = np.array([[0.09, 0.09, 0.095], [0.13, 0.13, 0.13], [0.06, 0.06, 0.065]])
_PAVING = np.array([[0.32, 0.3, 0.27], [0.24, 0.23, 0.22], [0.4, 0.38, 0.35]])
_GRASS = np.array([[0.06, 0.11, 0.025], [0.09, 0.15, 0.035], [0.035, 0.07, 0.02]])
_GRAVEL = np.array([[0.24, 0.21, 0.17], [0.33, 0.3, 0.26], [0.15, 0.13, 0.11]])


@dataclass(frozen=True)
class _Way:
    """The way along +y: half its width, the width of the pavements and the height of their kerbs, 0 for a path."""

    half: float
    pavement: float
    kerb: float

    @property
    def border(self) -> float:
        """The distance from the middle of the way to the houses or lawns."""
        return self.half + self.pavement

    @property
    def verge(self) -> float:
        """The width of the level ground beside the way, where things stand."""
        return self.pavement or _BESIDE_PATH


@dataclass(frozen=True)
class _Side:
    """What borders the way on one side, -1 for the left one and 1 for the right one.

    set_back : metres of lawn before the houses or the wall, 0 for none.
    wall : the height of a garden wall, 0 for houses.
    """

    sign: int
    set_back: float
    wall: float


@dataclass(frozen=True)
class _Reach:
    """The nearest depth in the picture, where the things beside the way end, and where the ground ends along +y."""

    near: float
    last: float
    end: float


@dataclass(eq=False)
class _Street:
    """A scene with its way, what is filled above the ground, and the places (3,) below the heads of lamp posts."""

    scene: Composition
    way: _Way
    reach: _Reach
    filled: list[Layer] = field(default_factory=list)
    lamps: list[Float] = field(default_factory=list)

    def ground(self, holds: Callable[[Float], bool] = lambda _: True) -> Ground:
        nearest = 1.05 * self.reach.near
        return Ground(
            self.scene, self.way.kerb, 0.12, nearest, holds, filled=self.filled
        )

    def _ends_before_row(self, outline: Float) -> bool:
        return bool(outline[:, 1].max() < self.reach.last)

    def places(self, rng: Rng, from_near: float = 1.15) -> Iterator[float]:
        """Random positions along the way, denser near the camera."""
        start = from_near * self.reach.near + 0.3
        while self.reach.last > start:
            yield log_uniform(rng, start, self.reach.last)

    def stand(
        self, piece_layers: Sequence[Layer], poses: Iterator[Float], most: int
    ) -> list[Float]:
        """Those of the poses (4, 4) that are free, at most so many, which are filled from then on."""
        ground, placed = self.ground(self._ends_before_row), list[Float]()
        for pose, _ in zip(poses, range(12 * most), strict=False):
            moved = [layer.moved(pose) for layer in piece_layers]
            if len(placed) < most and ground.is_free(moved):
                self.filled += moved
                placed.append(pose)
        return placed


def compose(scene: Composition) -> None:
    """Set the view, then add ground, houses, what stands beside the way, the row across it and the light."""
    ground_near = _set_view(scene)
    ratio = scene.depth_ratio(7.0, 32.0)
    way = _draw_way(scene, ground_near * ratio)
    sides = [_draw_side(scene, way, sign) for sign in (-1, 1)]
    _move_aside(scene, way)
    near = _nearest_depth(scene, way, sides)
    row = _FarRow.drawn(scene, near * ratio)
    # In an empty street the row is nearest; all else ends before it, so that it is the farthest of all.
    street = _Street(scene, way, _reach(near, ratio, row))
    _add_way(street)
    for side in sides:
        _add_side(street, side)
    _add_cars(street)
    _add_posts(street)
    _add_things(street)
    _add_bodies(street)
    measured, _ = scene.visible_range()
    row.add(measured * ratio)
    _add_light(street, measured * ratio)


def _set_view(scene: Composition) -> float:
    """Look along the way from 0.5 to 2.2 m; returns the nearest depth of flat ground in the picture."""
    rng = scene.rng("view")
    eye = np.array([0.0, 0.0, rng.uniform(0.5, 2.2)])
    turn_deg = rng.normal(0, 10)
    turn, tilt = np.radians([np.clip(turn_deg, -22, 22), rng.uniform(-9, 4)])
    aim = np.array([math.sin(turn), math.cos(turn), math.tan(tilt)])
    scene.look(eye, eye + aim, rng.uniform(42, 63))
    return _nearest(scene, [_level(0.0)])


def _level(height: float) -> Sheet:
    """Flat ground."""
    corner = np.array([-50.0, -5.0, height])
    return Sheet(corner, np.array([100.0, 0, 0]), np.array([0.0, 200, 0]))


def _nearest(scene: Composition, sheets: Sequence[Sheet]) -> float:
    """The least depth of rectangles in the picture."""
    meshes = [sheet.mesh() for sheet in sheets]
    triangles = [(mesh.vertices, mesh.faces) for mesh in meshes]
    return float(rasterize(scene.view, triangles, 160).min())


def _move_aside(scene: Composition, way: _Way) -> None:
    """Move the camera from the middle of the way, at most to its pavements."""
    x = scene.rng("aside").uniform(-1, 1) * (way.border - 0.6)
    pose = scene.view.world_from_cam.copy()
    pose[0, 3] = x
    scene.view = replace(scene.view, world_from_cam=pose)


def _draw_way(scene: Composition, far: float) -> _Way:
    rng = scene.rng("way")
    is_street = rng.random() < 0.65
    half = rng.uniform(2.2, 4.2) if is_street else rng.uniform(1.2, 1.8)
    # A short scene is a narrow one: a yard or an alley.
    half = max(1.1, min(float(half), 0.25 * far))
    if not is_street:
        return _Way(half, 0.0, 0.0)
    return _Way(half, float(rng.uniform(1.4, 2.6)), float(rng.uniform(0.08, 0.15)))


def _draw_side(scene: Composition, way: _Way, sign: int) -> _Side:
    """Houses or a high wall at the pavement, or a lawn with houses or a low wall behind."""
    rng = scene.rng("side", sign)
    has_houses = bool(rng.random() < (0.7 if way.pavement else 0.4))
    has_lawn = not way.pavement or rng.random() < 0.4
    set_back = float(rng.uniform(3.5, 10.0)) if has_lawn else 0.0
    low, high = (0.5, 2.1) if has_lawn else (1.6, 3.0)
    return _Side(sign, set_back, 0.0 if has_houses else float(rng.uniform(low, high)))


def _nearest_depth(scene: Composition, way: _Way, sides: Sequence[_Side]) -> float:
    """The least depth in an empty street: of the ground, or of a wall beside it."""
    sheets = [_level(0.0), _level(way.kerb)]
    for side in sides:
        off = way.border + side.set_back
        sheets.append(_facing_way(side.sign, off, _BEHIND, 200.0, 3.0, 0.0))
    return _nearest(scene, sheets)


def _reach(near: float, ratio: float, row: "_FarRow") -> _Reach:
    far = near * ratio
    empty = row.distance(far)
    return _Reach(near, 0.92 * empty, 1.2 * far)


def _add_way(street: _Street) -> None:
    """Add the road with its markings, and pavements with kerbs, from behind the camera to the far houses."""
    scene, way = street.scene, street.way
    long = np.array([0.0, street.reach.end - _BEHIND, 0.0])
    corner = np.array([-way.half, _BEHIND, 0.0])
    rng = scene.rng("road")
    pattern = one_of(rng, _WAYS)
    tones = _ASPHALT if way.pavement else _PAVING
    road = Sheet(corner, np.array([2 * way.half, 0, 0]), long)
    _add_surface(scene, "road", road, pattern, varied(rng, tones))
    if not way.pavement:
        return
    paving = one_of(rng, _PAVINGS)
    tones = varied(rng, _PAVING)
    for left in (-way.border, way.half):
        corner = np.array([left, _BEHIND, way.kerb])
        sheet = Sheet(corner, np.array([way.pavement, 0, 0]), long)
        _add_surface(scene, "pavement", sheet, paving, tones, way.kerb + 0.1)
    if rng.random() < 0.6 and way.half > 2.5:
        _add_markings(street, rng)


def _add_markings(street: _Street, rng: Rng) -> None:
    """Paint a broken line in the middle of the road, and in half of the streets a line at each side."""
    way, end = street.way, street.reach.end
    dash, gap = rng.uniform(1.0, 3.0), rng.uniform(1.0, 4.0)
    lines = [(0.0, y, y + dash) for y in np.arange(0.5, end - dash, dash + gap)]
    if rng.random() < 0.5:
        lines += [(sign * (way.half - 0.35), _BEHIND, end) for sign in (-1, 1)]
    strips = []
    for x, start, stop in lines:
        corner = np.array([x - 0.06, start, 0.004])
        strip = Sheet(corner, np.array([0.12, 0, 0]), np.array([0, stop - start, 0]))
        strips.append(strip.mesh())
    look = furniture_material(street.scene, ("markings",), "white", 0.02)
    street.scene.add("markings", shapes.merged(strips), look)


def _add_surface(
    scene: Composition,
    name: str,
    sheet: Sheet,
    pattern: tuple[str, float],
    colors: Float,
    thickness: float = 0.0,
) -> None:
    """Add a rectangle with a pattern (name, tile) that is baked for the view."""
    rng = scene.rng("surface", name, len(scene.objects))
    fitted, look = _baked(scene, rng, sheet, pattern, colors)
    scene.add(name, fitted.mesh(thickness), look)


def _baked(
    scene: Composition,
    rng: Rng,
    sheet: Sheet,
    pattern: tuple[str, float],
    colors: Float,
) -> tuple[Sheet, Material]:
    """`surface`, for a picture with fewer pixels."""
    coarse = copy.copy(scene)
    coarse.view = replace(scene.view, width_px=round(_DETAIL * scene.view.width_px))
    return surface(coarse, rng, sheet, pattern[0], colors, pattern[1])


def _add_side(street: _Street, side: _Side) -> None:
    """Add what borders the way on one side, and trees."""
    scene, way, last = street.scene, street.way, street.reach.last
    off = way.border + side.set_back
    height = _add_lawn(street, side) if side.set_back else _level_at(way.kerb)
    if side.wall:
        rng = scene.rng("garden wall", side.sign)
        tall = side.wall + 0.3
        sheet = _facing_way(side.sign, off, _BEHIND, last, tall, way.kerb - 0.3)
        pattern = one_of(rng, _GARDEN_WALLS)
        colors = wall_colors(rng, scene.palette)
        _add_surface(scene, "garden-wall", sheet, pattern, colors, 0.2)
    else:
        _add_row(street, side.sign, off)
    _add_trees(street, side, height)


def _add_lawn(street: _Street, side: _Side) -> Callable[[float, float], float]:
    """Add grass, or gravel, that rises from the way in gentle waves; returns its height at (x, y)."""
    scene, way = street.scene, street.way
    rng = scene.rng("lawn", side.sign)
    wide = side.set_back
    if side.wall:
        wide = max(wide + 1.0, _seen_aside(scene, side.sign, street.reach.end))
    left = way.border if side.sign > 0 else -way.border - wide
    corner = np.array([left, _BEHIND, way.kerb])
    long = np.array([0, street.reach.end - _BEHIND, 0.0])
    tones = _GRASS if rng.random() < 0.8 else _GRAVEL
    pattern = one_of(rng, _LAWNS)
    sheet = Sheet(corner, np.array([wide, 0, 0]), long)
    fitted, look = _baked(scene, rng, sheet, pattern, varied(rng, tones))
    # Houses stand on ground that is nearly level.
    steep = rng.uniform(0.3, 1.5) if side.wall else 0.25
    raised = _with_relief(fitted, rng, way.border + way.verge, steep)
    scene.add("lawn", raised, look)
    x, y = raised.vertices[:, 0], raised.vertices[:, 1]
    rows = len(fitted.along.at)
    grid = raised.vertices[:, 2].reshape(rows, -1)
    columns_x, rows_y = x.reshape(rows, -1)[0], y.reshape(rows, -1)[:, 0]

    def height(at_x: float, at_y: float) -> float:
        in_rows = [np.interp(at_x, columns_x, row) for row in grid]
        return float(np.interp(at_y, rows_y, in_rows))

    return height


def _level_at(height: float) -> Callable[[float, float], float]:
    return lambda x, y: height


def _seen_aside(scene: Composition, sign: int, end: float) -> float:
    """How far to one side the picture reaches at the depth `end`."""
    corners = [scene.view.at(1.1 * x, y, end) for x in (-1, 1) for y in (-1, 1)]
    return float(max(sign * corner[0] for corner in corners))


def _with_relief(sheet: Sheet, rng: Rng, border: float, steep: float) -> Mesh:
    """A level sheet raised by waves of 6 to 25 m that grow with the distance from the border of level ground."""
    flat = sheet.mesh()
    x, y = flat.vertices[:, 0], flat.vertices[:, 1]
    rise = np.zeros(len(x))
    for _ in range(4):
        length, heading = log_uniform(rng, 6.0, 25.0), rng.uniform(0, math.pi)
        phase = (x * math.cos(heading) + y * math.sin(heading)) * 2 * math.pi / length
        rise += 0.01 * length * (1 + np.sin(phase + rng.uniform(0, 6)))
    away = np.clip((np.abs(x) - border) / 8.0, 0, 1)
    vertices = flat.vertices.copy()
    vertices[:, 2] += steep * rise * away**2
    return replace(flat, vertices=vertices, normals=_normals(vertices, flat.faces))


def _normals(vertices: Float, faces: NDArray[np.uint32]) -> Float:
    """Unit normals (V, 3): means over the faces at a vertex, weighted by their areas."""
    total = np.zeros_like(vertices)
    cross = shapes.face_cross(vertices, faces)
    for corner in range(3):
        np.add.at(total, faces[:, corner], cross)
    return np.asarray(total / np.linalg.norm(total, axis=1, keepdims=True))


def _facing_way(
    sign: int, off: float, start: float, end: float, tall: float, low: float
) -> Sheet:
    """An upright rectangle along the way at x = sign * off, its front towards the middle."""
    along = np.array([0.0, end - start, 0.0])
    corner = np.array([sign * off, start, low])
    if sign > 0:
        corner, along = corner + along, -along
    return Sheet(corner, along, np.array([0, 0, tall]))


def _add_row(street: _Street, sign: int, off: float) -> None:
    """Add houses wall to wall, or with gaps where they stand back; at most seven."""
    scene, last = street.scene, street.reach.last
    rng = scene.rng("row", sign)
    gap = 0.0 if off <= street.way.border else float(rng.uniform(0.0, 4.0))
    # None is so much higher than the far row that it is seen above it.
    highest = min(9.5, 2.8 + 0.3 * last)
    start = _BEHIND
    for number in range(7):
        end = min(start + float(rng.uniform(5.0, 13.0)), last)
        end = last if number == 6 else end
        if end - start > 2.0:
            tall = float(rng.uniform(2.8, highest))
            sheet = _facing_way(sign, off, start, end, tall, -0.1)
            add_house(scene, rng, "house", sheet, 6.0)
        start = end + gap


def _add_trees(
    street: _Street, side: _Side, height: Callable[[float, float], float]
) -> None:
    """Plant up to eight trees of one kind on the lawn or at the kerb, at sizes that fit there."""
    scene, way = street.scene, street.way
    rng = scene.rng("trees", side.sign)
    count = int(rng.integers(0, 9))
    at_kerb = not side.set_back
    if not count or (at_kerb and rng.random() < 0.6):
        return
    piece = make_thing("tree", scene.rng("trees", "shape", side.sign))
    layers = layers_of(mesh for _, mesh, _ in piece.parts)
    faces = sum(len(mesh.faces) for _, mesh, _ in piece.parts)
    crown = max(piece.floor) / 2
    largest = min(1.0, _room_for_crowns(way, side) / crown / 1.2)

    def poses() -> Iterator[Float]:
        for y in street.places(rng):
            size = float(rng.uniform(0.7, 1.2)) * largest
            off = way.half + 0.45
            if not at_kerb:
                most = max(1.0, side.set_back - size * crown)
                off = way.border + float(rng.uniform(0.6, most))
            x = side.sign * off
            turn = rotation([0, 0, 1], float(rng.uniform(0, 360)))
            place = translation([x, y, height(x, y) - 0.03])
            yield place @ turn @ np.diag([size, size, size, 1.0])

    placed = street.stand(layers, poses(), min(count, _FACES_OF_TREES // faces))
    if placed:
        add_thing(scene, piece, placed, ("tree", side.sign))


def _room_for_crowns(way: _Way, side: _Side) -> float:
    """Metres from the trunks of trees to the houses, where the crowns end; behind a wall there is more room."""
    if not side.set_back:
        return way.pavement - 0.5
    free = side.set_back / 2
    return max(free, 4.5) if side.wall else free


def _add_cars(street: _Street) -> None:
    """Add up to eight cars of two shapes, at the kerbs or on the road, each painted by itself."""
    scene, way = street.scene, street.way
    rng = scene.rng("cars")
    count = int(rng.integers(0, 9))
    if not way.pavement or way.half < 2.4:
        return
    pieces = [make_thing("car", scene.rng("cars", "shape", k)) for k in range(2)]
    layers = [layers_of(mesh for _, mesh, _ in piece.parts) for piece in pieces]

    def poses() -> Iterator[Float]:
        for y in street.places(rng, 1.3):
            sign = one_of(rng, (-1, 1))
            x = way.half - 1.0 if rng.random() < 0.75 else 0.4 * way.half
            heading = one_of(rng, (-90.0, 90.0)) + rng.normal(0, 1.0)
            yield translation([sign * x, y + 2.0, 0.0]) @ rotation([0, 0, 1], heading)

    for index in range(count):
        shape = index % 2
        placed = street.stand(layers[shape], poses(), 1)
        if placed:
            add_thing(scene, pieces[shape], placed, ("car", index))


def _add_posts(street: _Street) -> None:
    """Add rows of lamp posts and bollards, and some signs, bins and benches, all at the edge of the way."""
    scene, way = street.scene, street.way
    rng = scene.rng("posts")
    inside = 0.4 if way.pavement else 0.3

    def pose(sign: int, y: float, off: float = inside) -> Float:
        # Fronts at -y are turned to the way.
        place = translation([sign * (way.half + off), y, way.kerb])
        return place @ rotation([0, 0, 1], -90.0 * sign)

    for name, low, high in (("lamp-post", 8.0, 25.0), ("bollard", 1.2, 3.0)):
        if rng.random() < 0.3:
            continue
        sign, step = one_of(rng, (-1, 1)), float(rng.uniform(low, high))
        start = 1.2 * street.reach.near + rng.uniform(0, step)
        stop = street.reach.last if low > 5 else start + step * rng.uniform(3, 12)
        row = np.arange(start, min(stop, street.reach.last), step)
        _add_copies(street, name, ("row", name), [pose(sign, y) for y in row])
    for index in range(int(rng.integers(0, 7))):
        name = one_of(rng, ("road-sign", "road-sign", "litter-bin", "bench"))
        off = 0.3 if name == "bench" else 0.0
        sign = one_of(rng, (-1, 1))
        places = (pose(sign, y, inside + off) for y in street.places(rng))
        _add_copies(street, name, ("single", index), places, 1)


def _add_copies(
    street: _Street,
    name: str,
    part: tuple[str | int, ...],
    poses: Sequence[Float] | Iterator[Float],
    most: int = 30,
) -> None:
    """Add a thing at those of the poses that are free."""
    piece = make_thing(name, street.scene.rng(*part, "shape"))
    layers = layers_of(mesh for _, mesh, _ in piece.parts)
    placed = street.stand(layers, iter(poses), most)
    if placed:
        add_thing(street.scene, piece, placed, part)
    for part_name, mesh, _ in piece.parts:
        if (name, part_name) == ("lamp-post", "head"):
            below = _below(mesh)
            street.lamps += [transform_points(pose, below) for pose in placed]


def _below(mesh: Mesh) -> Float:
    """The place (3,) just below the middle of a mesh."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    x, y, _ = 0.5 * (low + high)
    return np.array([x, y, low[2] - 0.005])


def _add_things(street: _Street) -> None:
    """Add chairs, bicycles, fences and the like on the level ground beside the way."""
    scene, way, reach = street.scene, street.way, street.reach
    least, most = way.half + 0.05, way.half + way.verge - 0.05

    def holds(outline: Float) -> bool:
        off = np.abs(outline[:, 0])
        return bool(off.min() > least and off.max() < most)

    def place(rng: Rng, size: float) -> Float:
        x = one_of(rng, (-1, 1)) * rng.uniform(least, most)
        return np.array([x, log_uniform(rng, reach.near, max(reach.last, reach.near))])

    names = [name for name in things_for("outdoors") if name not in _INDOORS]
    count = count_among_bodies(scene, "things", _MOST_THINGS)
    street.ground(holds).scatter("things", names, count, place)


def _add_bodies(street: _Street) -> None:
    """Rest the bodies on the level ground beside the way, in its half that is nearest to the camera."""
    scene, way, reach = street.scene, street.way, street.reach
    start = 1.15 * reach.near + 0.3
    halves = np.array([0.4 * way.verge, max(0.2, 0.25 * (reach.last - start))])
    for sign in (-1, 1):
        parts = [(sign, k) for k in range((scene.count + (sign > 0)) // 2)]
        resting = bodies_at_rest(scene, "litter", parts, _SMALL)
        middle = np.array([sign * (way.half + 0.5 * way.verge), start + halves[1]])
        area = Area(middle, halves, way.kerb, 0.02, 0.2, filled=street.filled)
        for placement in arrange(resting, area):
            body, pose = placement.body, placement.pose
            look = body.material(scene.pixel_at(pose[:3, 3], 0.5))
            scene.add(body.name, body.solid.mesh, look, pose)


@dataclass(frozen=True, eq=False)
class _FarRow:
    """Flat-roofed houses across the way: their edges along x, their heights, and the depth of each."""

    scene: Composition
    edges: Float
    heights: Float
    deep: float

    @staticmethod
    def drawn(scene: Composition, far: float) -> "_FarRow":
        rng = scene.rng("far houses")
        span = 1.8 * float(scene.view.covered(far)[0]) + 4.0
        count = int(rng.integers(2, 5))
        edges = np.linspace(-span, span, count + 1)
        edges[1:-1] += rng.uniform(-0.1, 0.1, count - 1) * span
        heights = rng.uniform(0.08, 0.3, count) * far + 2.7
        return _FarRow(scene, edges, heights, min(6.0, 0.1 * far))

    def sheets(self, distance: float) -> list[Sheet]:
        """The facades at y = `distance`."""
        fronts = []
        for k, tall in enumerate(self.heights):
            corner = np.array([self.edges[k], distance, -0.5])
            along = np.array([self.edges[k + 1] - self.edges[k], 0, 0])
            fronts.append(Sheet(corner, along, np.array([0, 0, tall])))
        return fronts

    def distance(self, far: float) -> float:
        """Where the row stands for `far` to be the largest depth in the picture."""

        def meshes(distance: float) -> list[Mesh]:
            # With their sides, which are seen above lower houses.
            return [sheet.mesh(self.deep) for sheet in self.sheets(distance)]

        return self.scene.backdrop_distance(meshes, far, far)

    def add(self, far: float) -> None:
        """Add the row at that distance."""
        rng = self.scene.rng("far houses", "facades")
        for sheet in self.sheets(self.distance(far)):
            add_house(self.scene, rng, "far-house", sheet, self.deep)


def _add_light(street: _Street, far: float) -> None:
    """The user's sky, a clear sky with a high or low sun, clouds without one, or lamps at night."""
    scene = street.scene
    rng = scene.rng("light")
    if scene.assets.hdris and lighting.user_environment(scene, rng):
        return
    side = one_of(rng, [-1.0, 1.0])
    if scene.is_night:
        _add_lamps(street, rng, side)
        return
    middle = np.array([0.0, far / 2, 0.0])
    kind = weighted(rng, ["clouds", "painted", "sun"], [0.25, 0.15, 0.6])
    if kind == "clouds":
        lighting.overcast(scene, rng, middle, far / 2, side)
    elif kind == "painted":
        # As high as the other skies: kernels depend on the height.
        sky = lighting.painted_sky(rng, 256)
        lighting.environment(scene, sky, float(rng.uniform(0, 360)))
    else:
        lighting.daylight(scene, rng, middle, far / 2, side)


def _add_lamps(street: _Street, rng: Rng, side: float) -> None:
    """Light the street by a lamp at the camera, and by its lamp posts."""
    scene, near = street.scene, street.reach.near
    lit = scene.view.at(0.0, 0.3, 2.0 * near)
    lighting.headlight(scene, rng, lit, near, side)
    tone = one_of(rng, [lighting.WARM, lighting.NEUTRAL])
    level = log_uniform(rng, 300.0, 3000.0)
    for place in street.lamps:
        below = place - [0.0, 0.0, 1.0]
        lighting.panel(scene, "street-lamp", place, below, _LAMP, level * tone, 0.5)
