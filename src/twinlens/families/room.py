"""The family "room": a furnished room seen from its open end, with furniture, windows, pictures and small objects."""

import itertools
import math
from dataclasses import dataclass, field, replace

import numpy as np

from twinlens.families import furniture, lighting
from twinlens.families.arrangement import Area, arrange, bodies_at_rest
from twinlens.families.composition import Composition, rasterize
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.furniture import Piece, Shelf, board
from twinlens.families.materials import furniture_material
from twinlens.families.solids import double_sided
from twinlens.families.surfaces import (
    FLOORS,
    WALLS,
    Sheet,
    surface,
    surface_colors,
    surface_pattern,
)
from twinlens.families.things import THINGS, add_thing, names_in_scenes, things_for
from twinlens.families.things.ground import (
    Ground,
    Layer,
    count_among_bodies,
    spread_count,
)
from twinlens.geometry import Float, inverse, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import gap

_SMALL = ("vase", "bottle", "bowl", "cup", "jar", "tin", "candle", "book", "book", "carton", "ball", "pebble", "knot",
          "plate", "blob", "superquadric", "goblet", "crystal", "ring")  # fmt: skip
_SIDES = ("back", "left", "right")
_MOST_ON_FLOOR, _MOST_ON_SHELF = 24, 6  # things
_BESIDE_WALL = 0.45  # share of the cameras
_OFF_WALLS = 0.25  # metres: in front of window sills and curtains
_LEAST_SIZE = 0.1  # metres, of a thing on a shelf


NAMES = names_in_scenes() | {
    "left-wall", "right-wall", "back-wall", "front-wall", "floor", "ceiling", "skirting", "window-frame", "window-pane",
    "curtains", "side-window", "ceiling-light", "rug", "picture", "picture-frame", "table-top", "table-legs",
    "stool-table-top", "stool-table-legs", "chair", "chair-seat", "sofa", "sofa-cushions", "sofa-feet", "sofa-pillow",
    "armchair-sofa", "armchair-cushions", "armchair-feet", "armchair-pillow", "bookcase", "bookcase-books", "sideboard",
    "sideboard-doors", "sideboard-knobs", "sideboard-feet", "pot", "leaves", "lamp", "shade", "box", "key-light",
}  # fmt: skip
"""Names of what scenes have besides bodies, without numbers."""

_IN_FRONT = (
    *furniture.IN_FRONT,
    *(THINGS[name].make for name in things_for("floor")),
)
"""Makers of pieces that may be the nearest in the picture."""


def compose(scene: Composition) -> None:
    """Add the furniture to an empty room, then walls, windows, the objects on the furniture, pictures and lights."""
    rng = scene.rng("room")
    shell = Shell(
        rng.uniform(3.4, 5.2), -1.2, rng.uniform(3.6, 5.6), rng.uniform(2.45, 2.9)
    )
    plan = _FloorPlan(scene, shell, _set_view(scene, shell))
    plan.place_in_front()
    furnished = min(1.0, 1.5 * scene.rng("furnished").random())  # rooms may be bare
    for side, most in zip(_SIDES, (5, 3, 3), strict=True):
        plan.place_along(side, round(furnished * most))
    plan.place_in_the_middle()
    _add_shell(scene, shell)
    _add_windows(scene, shell, plan)
    for index, (piece, pose) in enumerate(plan.placed):
        _add_piece(scene, index, piece, pose)
    _add_things(scene, shell, plan)
    _add_small_objects(scene, plan)
    _decorate(scene, shell, plan)
    _light(scene, shell)


def _add_piece(scene: Composition, index: int, piece: Piece, pose: Float) -> None:
    """Add the parts of the `index`-th piece of furniture; parts of one material look alike."""
    if piece.kind in THINGS:
        add_thing(scene, piece, [pose], ("piece", index))
        return
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    shared = int(scene.rng("tone", piece.kind, index).integers(1 << 30))
    for name, mesh, word in piece.parts:
        says_all = name.startswith(piece.kind) or piece.kind in ("lamp", "plant")
        label = name if says_all else f"{piece.kind}-{name}"
        if word == "lit":
            radiance = scene.rng("lit", index).uniform(2.0, 4.0) * lighting.WARM
            lighting.emitter(scene, label, mesh, pose, radiance, 0.4)
            continue
        part = (piece.kind, index, name)
        look = furniture_material(scene, part, word, pixel, shared)
        scene.add(label, mesh, look, pose)


@dataclass(frozen=True)
class Shell:
    """The room's box: x from -width/2 to width/2, y from `front` to `back`, z from 0 to `height`, metres."""

    width: float
    front: float
    back: float
    height: float

    def sheets(self) -> dict[str, Sheet]:
        """Its six sides, their fronts inside."""
        w = np.array([self.width, 0, 0])
        h = np.array([0, 0, self.height])
        d = np.array([0, self.back - self.front, 0])
        low = np.array([-self.width / 2, self.front, 0.0])
        return {
            "floor": Sheet(low, w, d),
            "ceiling": Sheet(low + h + d, w, -d),
            "back-wall": Sheet(low + d, w, h),
            "left-wall": Sheet(low, d, h),
            "right-wall": Sheet(low + w + d, -d, h),
            "front-wall": Sheet(low + w, -w, h),
        }

    def wall_length(self, side: str) -> float:
        return self.width if side == "back" else self.back - self.front

    def against(self, side: str, along: float, off: float) -> Float:
        """The pose (4, 4) of an object with its back to a wall: `off` metres from it, `along` from its middle."""
        middle = 0.5 * (self.front + self.back)
        if side == "back":
            return translation([along, self.back - off, 0.0])
        sign = -1.0 if side == "left" else 1.0
        place = [sign * (self.width / 2 - off), middle + along, 0.0]
        return translation(place) @ rotation([0, 0, 1], -90.0 * sign)


def _set_view(scene: Composition, shell: Shell) -> float:
    """Look from eye height near the open end, narrow enough for the depth ratio; returns the nearest depth.

    Some cameras are close to a side wall, which they see at a grazing angle.
    """
    rng = scene.rng("view")
    x = rng.uniform(-0.3, 0.3) * shell.width
    beside = scene.rng("beside")
    is_beside = beside.random() < _BESIDE_WALL
    if is_beside:
        x = math.copysign(0.5 * shell.width - beside.uniform(0.3, 0.6), x)
    y = shell.front + rng.uniform(0.25, 0.5)
    eye = np.array([x, y, rng.uniform(0.7, 1.9)])
    # To the back wall, or past it to the side wall that is farther away.
    aside = -math.copysign(0.5 * shell.width, x)
    aim = -0.6 * x + rng.uniform(-0.4, 0.4) + aside * scene.rng("aside").random() ** 2
    if is_beside:
        aim = x - math.copysign(beside.uniform(-0.3, 0.8), x)
    target = np.array([aim, shell.back, rng.uniform(0.4, 1.1)])
    scene.look(eye, target, rng.uniform(50, 63))
    depth_ratio = scene.depth_ratio(3.2, 6.0)
    sides = [sheet.mesh() for sheet in shell.sheets().values()]
    while True:
        floor, far = scene.visible_range(sides, 320)
        if floor >= far / depth_ratio or scene.view.fov_x_deg < 25:
            return far / depth_ratio
        scene.view = replace(scene.view, fov_x_deg=0.95 * scene.view.fov_x_deg)


def _floor_rectangle(
    size: tuple[float, float], pose: Float, margin: float = 0.0
) -> Float:
    """The corners (4, 2) on the floor of a rectangle of this size at a pose, wider by a margin on each side."""
    half = np.array(size) / 2 + margin
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return transform_points(pose, np.column_stack([corners, np.zeros(4)]))[:, :2]


@dataclass(eq=False)
class _FloorPlan:
    """Furniture, and what stands or hangs at each wall: (position along it, width, height)."""

    scene: Composition
    shell: Shell
    near: float
    placed: list[tuple[Piece, Float]] = field(default_factory=list)
    walls: dict[str, list[tuple[float, float, float]]] = field(
        default_factory=lambda: {side: [] for side in _SIDES}
    )

    def _place_if_free(
        self, piece: Piece, pose: Float, margin: float = 0.04, near: float | None = None
    ) -> bool:
        """Place a piece inside the walls, beside all others and no nearer than `near`; False where it is not."""
        outline = _floor_rectangle(piece.floor, pose, margin)
        x, y = outline.T
        most_x = self.shell.width / 2 - 0.01 + margin
        most_y = self.shell.back - 0.01 + margin
        if (np.abs(x) > most_x).any() or (y > most_y).any():
            return False
        for neighbour, place in self.placed:
            if gap(outline, _floor_rectangle(neighbour.floor, place)) <= 0:
                return False
        least = self.near if near is None else near
        if self._least_depth(piece, pose) < least:
            return False
        self.placed.append((piece, pose))
        return True

    def _least_depth(self, piece: Piece, pose: Float) -> float:
        """The least depth of the box around a piece."""
        floor = _floor_rectangle(piece.floor, pose)
        low = np.column_stack([floor, np.zeros(4)])
        high = np.column_stack([floor, np.full(4, piece.height)])
        return float(self.scene.view.depth(np.concatenate([low, high])).min())

    def place_along(self, side: str, most: int) -> None:
        rng = self.scene.rng("along", side)
        names = list(furniture.AGAINST_WALLS)
        for attempt in range(2 * most):
            name = one_of(rng, names[:3] if attempt < 2 else names)
            same = (name, "armchair") if name == "sofa" else (name,)
            if sum(piece.kind in same for piece, _ in self.placed) >= 2:
                continue
            make = furniture.AGAINST_WALLS[name]
            piece = make(self.scene.rng("piece", side, attempt))
            width, depth = piece.floor
            room = self.shell.wall_length(side) - width
            along = float(rng.uniform(-0.5, 0.5) * room)
            pose = self.shell.against(side, along, depth / 2 + 0.05)
            if self._place_if_free(piece, pose):
                self.walls[side].append((along, width, piece.height))

    def place_in_the_middle(self) -> None:
        rng = self.scene.rng("middle")
        piece = one_of(rng, furniture.IN_THE_MIDDLE)(self.scene.rng("piece", "middle"))
        for _ in range(30):
            x = rng.uniform(-0.25, 0.25) * self.shell.width
            y = rng.uniform(0.35, 0.75) * self.shell.back
            pose = translation([x, y, 0]) @ rotation([0, 0, 1], rng.normal(0, 12))
            if self._place_if_free(piece, pose):
                if piece.height == furniture.DINING_HEIGHT:
                    self._place_chairs(pose, piece)
                return

    def _place_chairs(self, pose: Float, table: Piece) -> None:
        """Place up to four chairs at the long sides of a table, turned roughly towards it."""
        rng = self.scene.rng("chairs")
        chair = furniture.chair(self.scene.rng("piece", "chair"))
        width, depth = table.floor
        for sign, x in itertools.product((-1, 1), (-0.25, 0.25)):
            if rng.random() >= 0.75:
                continue
            facing = 180.0 if sign < 0 else 0.0
            turn = rotation([0, 0, 1], facing + float(rng.normal(0, 14)))
            off = depth / 2 + chair.floor[1] / 2 + rng.uniform(0.06, 0.25)
            place = pose @ translation([x * width, sign * off, 0])
            self._place_if_free(chair, place @ turn, 0.01)

    def place_in_front(self) -> None:
        """Place a piece at one side of the picture, moved along the view until its nearest visible depth is `near`."""
        rng = self.scene.rng("front")
        for attempt in range(16):
            make = one_of(rng, _IN_FRONT)
            piece = make(self.scene.rng("piece", "front", attempt))
            side = one_of(rng, [-1.0, 1.0]) * rng.uniform(0.4, 0.8)
            turn = rotation([0, 0, 1], float(rng.uniform(0, 360)))
            pose, nearest = self._moved_to_near(piece, side, turn)
            is_near = abs(nearest - self.near) < 0.01 * self.near
            if is_near and self._place_if_free(piece, pose, near=0.0):
                return

    def _moved_to_near(
        self, piece: Piece, side: float, turn: Float
    ) -> tuple[Float, float]:
        """The pose of a piece at `side` of the picture after six steps towards `near`, and its nearest depth there."""
        depth = self.near + 0.3
        for _ in range(6):
            on_floor = self.scene.view.at(side, 0.0, depth) * [1, 1, 0]
            pose = translation(on_floor) @ turn
            nearest = self._nearest_visible(piece, pose)
            is_visible = math.isfinite(nearest)
            depth += self.near - nearest if is_visible else 0.2 * self.near
        return pose, nearest

    def _nearest_visible(self, piece: Piece, pose: Float) -> float:
        """The smallest depth of a piece in the picture; +inf where it is not visible."""
        meshes = [
            (transform_points(pose, mesh.vertices), mesh.faces)
            for _, mesh, _ in piece.parts
        ]
        return float(rasterize(self.scene.view, meshes).min())


def _add_shell(scene: Composition, shell: Shell) -> None:
    """Add floor, walls, ceiling and skirting in the scene's colours; the back wall may have its own pattern."""
    rng = scene.rng("shell")
    colors = surface_colors(scene, scene.rng("wall colours"), 0.4)
    name, tile = surface_pattern(scene, rng, WALLS)
    accent = rng.random() < 0.5
    for side, sheet in shell.sheets().items():
        if side == "front-wall" and not scene.own_lights:
            continue
        kind, size, tones, finish = name, tile, colors, "matte"
        if side == "floor":
            kind, size = surface_pattern(scene, rng, FLOORS)
            tones = surface_colors(scene, scene.rng("floor colours"), 0.55)
            finish = one_of(rng, ["matte", "satin", "clearcoat"])
        elif side == "ceiling":
            kind, size, tones = "plain", 2.0, np.array([[0.78, 0.77, 0.74]])
        elif side == "back-wall" and accent:
            kind, size = surface_pattern(scene, rng, WALLS)
            tones = surface_colors(scene, scene.rng("accent"), 0.45)
        stream = scene.rng("surface", side)
        fitted, look = surface(scene, stream, sheet, kind, tones, size, finish)
        scene.add(side, fitted.mesh(), look)
    if rng.random() < 0.8:
        white = furniture_material(scene, ("skirting",), "white", scene.view.pixel(2.0))
        scene.add("skirting", _skirting(shell), white)


def _skirting(shell: Shell) -> Mesh:
    """Boards along the back wall and both side walls."""
    depth, tall, length = 0.015, 0.09, shell.back - shell.front
    at_back = (0, shell.back - depth / 2, tall / 2)
    boards = [board((shell.width, depth, tall), at_back)]
    middle = 0.5 * (shell.front + shell.back)
    for sign in (-1, 1):
        x = sign * (shell.width - depth) / 2
        boards.append(board((depth, length, tall), (x, middle, tall / 2)))
    return shapes.merged(boards)


def _add_window(scene: Composition, pose: Float, index: int) -> None:
    """Add a window that shines, its frame, and in half of them curtains, to a wall at a pose."""
    rng = scene.rng("window", index)
    wide, tall = rng.uniform(0.9, 1.7), rng.uniform(1.1, 1.5)
    sill = rng.uniform(0.75, 0.95)
    sky = lighting.COOL * (0.7, 0.85, 1.0) if rng.random() < 0.7 else lighting.WARM
    upright = translation([0, -0.012, sill + tall / 2]) @ rotation([1, 0, 0], 90.0)
    pane = shapes.transformed(lighting.rectangle(wide, tall), upright)
    # By day as bright as a covered sky to a sunlit street, which clip; at night nearly black.
    levels = (0.004, 0.05) if scene.is_night else (4.0, 50.0)
    level = log_uniform(rng, *levels)
    lighting.emitter(scene, f"window-pane-{index}", pane, pose, level * sky)
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    white = furniture_material(scene, ("window", index), "white", pixel)
    scene.add("window-frame", _window_frame(rng, wide, tall, sill), white, pose)
    if rng.random() < 0.5:
        part = ("curtains", index)
        cloth = furniture_material(scene, part, "fabric", pixel, 1 + index)
        scene.add("curtains", _curtains(rng, wide, tall, sill), cloth, pose)


def _window_frame(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """A frame, bars between one to three columns and rows of panes, and a sill."""
    bar, deep = 0.06, 0.05
    z = sill + tall / 2
    parts = []
    for sign in (-1, 1):
        x = sign * wide / 2
        parts.append(board((bar, deep, tall + bar), (x, -deep / 2, z)))
    for sign in (-1, 1):
        end = z + sign * tall / 2
        parts.append(board((wide + bar, deep, bar), (0, -deep / 2, end)))
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    for column in range(1, columns):
        x = wide * (column / columns - 0.5)
        parts.append(board((0.03, 0.035, tall), (x, -0.03, z)))
    for row in range(1, rows):
        height = sill + tall * row / rows
        parts.append(board((wide, 0.035, 0.03), (0, -0.03, height)))
    parts.append(board((wide + 0.2, 0.16, 0.03), (0, -0.08, sill - 0.045)))
    return shapes.merged(parts)


def _curtains(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """Two pushed-back curtains in folds, to the floor or to a little below the sill."""
    low = 0.03 if rng.random() < 0.6 else sill - 0.2
    heights = np.array([low, sill + tall + 0.14])
    half = wide / 2 + 0.14
    curtains = []
    for side in (-1, 1):
        span = rng.uniform(0.3, 0.45)
        folds = rng.uniform(4, 6)
        curtains.append(_curtain(side, half, span, folds, heights))
    return shapes.merged(curtains)


def _curtain(side: int, half: float, span: float, folds: float, z: Float) -> Mesh:
    """A curtain `span` metres wide around x = side * half, between two heights (2,)."""
    t = np.linspace(0, 1, 60)
    x = side * half - side * span * (t - 0.35)
    y = -0.1 - 0.03 * np.sin(2 * np.pi * t * folds)
    points = np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)
    # Columns run to the right.
    points = points if side < 0 else points[:, ::-1]
    slope = np.gradient(points[0, :, 1], points[0, :, 0])
    normal = np.stack([slope, -np.ones_like(slope), np.zeros_like(slope)], axis=-1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normals = np.concatenate([normal, normal])
    # A curtain in folds is 1.4 times as wide as its span.
    uv = np.stack(np.broadcast_arrays(t * span * 1.4, z[:, None]), axis=-1)
    faces = shapes.grid(60, 2)
    return double_sided(points.reshape(-1, 3), faces, normals, uv.reshape(-1, 2), 1e-3)


def _add_things(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    """Add things to the floor beside the furniture: none in many rooms, a thicket of plants and chairs in some."""
    view, far = scene.view, shell.back - scene.view.eye[1]

    def holds(footprint: Float) -> bool:
        x, y = footprint.T
        is_inside = np.abs(x).max() < shell.width / 2 - _OFF_WALLS
        return bool(is_inside and y.max() < shell.back - _OFF_WALLS)

    def place(rng: Rng, size: float) -> Float:
        # Even in 1/depth, as disparities are.
        depth = 1 / rng.uniform(1 / far, 1 / (plan.near + 0.2 * size))
        return view.at(rng.uniform(-1.1, 1.1), 0.0, depth)[:2]

    ground = Ground(scene, 0.0, 0.01, plan.near, holds)
    for piece, pose in plan.placed:
        outline = _floor_rectangle(piece.floor, pose)
        ground.filled.append(Layer(0.0, piece.height, outline))
    count = spread_count(scene, "floor things", _MOST_ON_FLOOR)
    ground.scatter("floor things", things_for("floor"), count, place)


def _add_shelf_things(
    scene: Composition, index: int, shelf: Shelf, pose: Float, count: int
) -> Ground:
    """Add at most `count` things to a shelf of a piece at a pose (4, 4) in the room."""
    piece_from_room = inverse(pose)
    half = np.array(shelf.size) / 2

    def holds(footprint: Float) -> bool:
        points = np.column_stack([footprint, np.zeros(len(footprint))])
        local = transform_points(piece_from_room, points)[:, :2]
        return bool((np.abs(local - shelf.middle) < half).all())

    def place(rng: Rng, size: float) -> Float:
        local = np.append(shelf.middle + half * rng.uniform(-1, 1, 2), 0.0)
        return transform_points(pose, local)[:2]

    ground = Ground(scene, shelf.height, 0.005, 0.0, holds)
    most = min(0.95 * shelf.free, 1.2 * float(half.max()), 0.6)
    if most > _LEAST_SIZE:
        sizes = max(_LEAST_SIZE, 0.4 * most), most
        names = things_for("table")
        ground.scatter(f"shelf-{index}", names, count, place, sizes)
    return ground


def _add_small_objects(scene: Composition, plan: _FloorPlan) -> None:
    """Add things and bodies to the shelves of the furniture, the more the larger a shelf is."""
    shelves = [(shelf, pose) for piece, pose in plan.placed for shelf in piece.shelves]
    if not shelves:
        return
    sizes = np.array([shelf.size for shelf, _ in shelves])
    weights = np.sqrt(sizes[:, 0] * sizes[:, 1])
    share = weights / weights.sum()
    chosen = scene.rng("clutter").choice(len(shelves), size=scene.count, p=share)
    for index, (shelf, pose) in enumerate(shelves):
        wanted = int((chosen == index).sum())
        most = min(wanted, _MOST_ON_SHELF)
        count = count_among_bodies(scene, f"shelf-{index}", most)
        ground = _add_shelf_things(scene, index, shelf, pose, count)
        filled = [layer.moved(inverse(pose)) for layer in ground.filled]
        _add_shelf_bodies(scene, index, shelf, pose, wanted - ground.count, filled)


def _add_shelf_bodies(
    scene: Composition,
    index: int,
    shelf: Shelf,
    pose: Float,
    count: int,
    filled: list[Layer],
) -> None:
    """Rest at most `count` bodies on a shelf of a piece at a pose (4, 4), beside the layers that are filled."""
    parts = [(index, number) for number in range(count)]
    resting = bodies_at_rest(scene, "clutter", parts, _SMALL)
    fitting = [
        (body, rest, rng) for body, rest, rng in resting if rest.height < shelf.free
    ]
    area = Area(
        middle=np.array(shelf.middle),
        half=np.array(shelf.size) / 2,
        height=shelf.height,
        spacing=0.01,
        stacked=0.35 if shelf.free > 0.5 else 0.0,
        filled=filled,
    )
    for placement in arrange(fitting, area):
        body = placement.body
        world_from_body = pose @ placement.pose
        look = body.material(scene.pixel_at(world_from_body[:3, 3], 0.3))
        scene.add(body.name, body.solid.mesh, look, world_from_body)


def _add_windows(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    """Add one or two windows where the walls are free, or only low furniture stands."""
    rng = scene.rng("windows")
    sides = rng.permutation(["left", "right", "back"])[: int(rng.integers(1, 3))]
    for index, side in enumerate(sides):
        for _ in range(12):
            along = float(rng.uniform(-0.5, 0.5) * (shell.wall_length(side) - 1.9))
            is_free = all(
                abs(along - at) > 0.95 + wide / 2 or tall < 0.75
                for at, wide, tall in plan.walls[side]
            )
            if is_free:
                _add_window(scene, shell.against(side, along, 0.0), index)
                plan.walls[side].append((along, 2.0, 2.3))
                break


def _decorate(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    """Add a rug in most rooms, and pictures where the walls are free."""
    rng = scene.rng("decoration")
    if rng.random() < 0.75:
        _add_rug(scene, rng, shell)
    for index, side in enumerate((*_SIDES, "back")):
        for _ in range(8):
            along = float(rng.uniform(-0.42, 0.42) * shell.wall_length(side))
            size = rng.uniform(0.35, 0.9), rng.uniform(0.35, 0.8)
            is_free = all(
                abs(along - at) > 0.5 * (size[0] + wide) + 0.1 or tall < 1.0
                for at, wide, tall in plan.walls[side]
            )
            if is_free:
                plan.walls[side].append((along, size[0], 2.0))
                _add_picture(scene, index, shell.against(side, along, 0.0), size)
                break


def _add_rug(scene: Composition, rng: Rng, shell: Shell) -> None:
    extents = rng.uniform(1.5, 2.4), rng.uniform(1.0, 1.7), 0.012
    rug = board(extents, (0, 0, 0.006), 0.005)
    x, y = rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.6) * shell.back
    pose = translation([x, y, 0.0005]) @ rotation([0, 0, 1], rng.normal(0, 10))
    look = furniture_material(scene, ("rug",), "rug", scene.view.pixel(2.0))
    scene.add("rug", rug, look, pose)


def _add_picture(
    scene: Composition, index: int, pose: Float, size: tuple[float, float]
) -> None:
    """Add a framed picture of `size` metres on the wall at `pose`, at eye height."""
    w, h = size
    z = 1.55
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    frame = []
    for sign in (-1, 1):
        rail = (0, -0.015, z + sign * h / 2)
        frame.append(board((w + 0.05, 0.03, 0.035), rail))
    for sign in (-1, 1):
        stile = (sign * w / 2, -0.015, z)
        frame.append(board((0.035, 0.03, h + 0.05), stile))
    wood = furniture_material(scene, ("frame", index), "wood", pixel)
    scene.add("picture-frame", shapes.merged(frame), wood, pose)
    canvas = board((w, 0.012, h), (0, -0.007, z))
    canvas = replace(canvas, uv=np.asarray(canvas.uv) / [w, h])
    # The picture fills (u, v) in [0, 1], so its pixel is a share of its size.
    share = pixel / max(w, h)
    printed = furniture_material(scene, ("picture", index), "picture", share)
    scene.add("picture", canvas, printed, pose)


def _light(scene: Composition, shell: Shell) -> None:
    """Add a large window beside the camera, out of the image, and in most rooms a warm lamp below the ceiling.

    At night there is a small lamp alone, with hard shadows, or one at the camera.
    """
    rng = scene.rng("light")
    if scene.is_night and rng.random() < lighting.HEADLIGHTS:
        middle = np.array([0.0, 0.5 * shell.back, 0.4 * shell.height])
        # Towards the middle of the room, away from a wall that is near.
        side = -math.copysign(1.0, scene.view.eye[0])
        lighting.headlight(scene, rng, middle, 0.5 * shell.width, side)
        return
    if scene.is_night:
        _add_ceiling_lamp(scene, rng, shell, rng.uniform(0.2, 0.5), rng.uniform(18, 30))
        return
    if rng.random() < 0.8:
        _add_ceiling_lamp(scene, rng, shell, rng.uniform(1.0, 1.7), rng.uniform(4, 12))
    # On the side wall that the camera looks away from, or on the other one if that is before its eyes.
    near = 1.0 if scene.view.eye[0] > 0 else -1.0
    if abs(scene.view.eye[0]) > 0.33 * shell.width:
        near = -near
    x = near * (shell.width / 2 - 0.02)
    place = np.array([x, shell.front + 0.55, 0.55 * shell.height])
    size = np.array([1.1, 0.7 * shell.height])
    level = rng.uniform(9.0, 15.0)
    tone = one_of(rng, [lighting.COOL, lighting.COOL, lighting.NEUTRAL])
    inwards = place - np.array([near, 0, 0])
    lighting.panel(scene, "side-window", place, inwards, size, level * tone)


def _add_ceiling_lamp(
    scene: Composition, rng: Rng, shell: Shell, side: float, flux: float
) -> None:
    """Add a square lamp below the ceiling, moved towards the camera until it is out of the picture.

    side : metres. flux : its radiance times its area.
    """
    x = rng.uniform(-0.2, 0.2) * shell.width
    y = rng.uniform(0.3, 0.6) * shell.back
    spot = np.array([x, y, shell.height - 0.02])
    tone = one_of(rng, [lighting.WARM, lighting.WARM, lighting.NEUTRAL])
    level = flux / side**2
    lamp = lighting.rectangle(side + 0.3, side + 0.3)
    front = shell.front + side / 2
    while spot[1] > front:
        depth = rasterize(scene.view, [(lamp.vertices + spot, lamp.faces)], 64)
        if not np.isfinite(depth).any():
            break
        spot = spot - [0.0, min(0.2, spot[1] - front), 0.0]
    below = spot - [0, 0, 1]
    lighting.panel(scene, "ceiling-light", spot, below, np.full(2, side), level * tone)
