"""The family "room": a furnished room seen from its open end, with furniture, windows, pictures and small objects."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from twinlens.families import furniture, lighting
from twinlens.families.arrangement import Area, arrange, choose_rest
from twinlens.families.bodies import draw_body
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, one_of
from twinlens.families.family import Family, Request
from twinlens.families.furniture import Piece, Shelf
from twinlens.families.materials import furniture_material
from twinlens.families.poses import move, turn_z
from twinlens.families.room_shell import Shell, add_shell, add_window
from twinlens.families.stable_poses import StablePose, gap
from twinlens.families.view import View, rasterize, triangles
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh, Scene

_SMALL = ("vase", "bottle", "bowl", "cup", "jar", "tin", "candle", "book", "book", "carton", "ball", "pebble", "knot",
          "plate", "blob", "superquadric", "goblet", "crystal", "ring")  # fmt: skip
_SIDES = ("back", "left", "right")


def compose(request: Request) -> Scene:
    """One scene: the empty room and the camera, the furniture, the objects on it, then lights."""
    rng = request.rng("room")
    shell = Shell(rng.uniform(3.4, 5.2), -1.2, rng.uniform(3.6, 5.6), rng.uniform(2.45, 2.9))
    view, near = _narrowed(_view(request, shell), shell, request.depth_ratio(3.2, 6.0))
    scene = Composition(request, view)
    plan = _FloorPlan(scene, shell, near)
    plan.furnish()
    add_shell(scene, shell)
    _add_windows(scene, shell, plan)
    for index, (piece, pose) in enumerate(plan.placed):
        _add_piece(scene, piece, pose, index)
    _add_small_objects(scene, plan)
    _decorate(scene, shell, plan)
    _light(scene, shell)
    return scene.scene(FAMILY.about)


FAMILY = Family("a furnished room", (12, 26), compose, 2.5)


def _view(request: Request, shell: Shell) -> View:
    """A view at eye height near the open end, turned a little to one side."""
    rng = request.rng("view")
    eye = np.array([rng.uniform(-0.3, 0.3) * shell.width, shell.front + rng.uniform(0.25, 0.5), rng.uniform(1.15, 1.6)])
    target = np.array([-0.6 * eye[0] + rng.uniform(-0.4, 0.4), shell.back, rng.uniform(0.55, 1.0)])
    return request.view(eye, target, rng.uniform(50, 63))


def _narrowed(view: View, shell: Shell, depth_ratio: float) -> tuple[View, float]:
    """The view with a field narrow enough that the floor is not seen nearer than far/depth_ratio, and that depth."""
    sides = [triangles(sheet.mesh()) for sheet in shell.sheets().values()]
    while True:
        floor, far = rasterize(view, sides, 320).depth_range
        if floor >= far / depth_ratio or view.fov_x_deg < 25:
            return view, far / depth_ratio
        view = replace(view, fov_x_deg=0.95 * view.fov_x_deg)


def _floor_rectangle(size: tuple[float, float], pose: Float, margin: float = 0.0) -> Float:
    """The outline (4, 2) of a piece on the floor."""
    half = np.array(size) / 2 + margin
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return transform_points(pose, np.column_stack([corners, np.zeros(4)]))[:, :2]


@dataclass(eq=False)
class _FloorPlan:
    """Positions of the furniture: no two pieces overlap, and none is nearer to the camera than `near` metres.

    `walls` lists the furniture, windows and pictures at each wall: (position along it, width, height).
    """

    scene: Composition
    shell: Shell
    near: float
    placed: list[tuple[Piece, Float]] = field(default_factory=list)
    taken: list[Float] = field(default_factory=list)
    walls: dict[str, list[tuple[float, float, float]]] = field(default_factory=lambda: {side: [] for side in _SIDES})

    def furnish(self) -> None:
        """Place a piece at the nearest depth, pieces along the walls, and a table in the middle."""
        self._place_in_front()
        for side, most in zip(_SIDES, (5, 3, 3), strict=True):
            self._place_along(side, most)
        self._place_in_the_middle()

    def _place_if_free(self, piece: Piece, pose: Float, margin: float = 0.04, near: float | None = None) -> bool:
        """Place a piece if its floor is free and inside the room, and it is far enough from the camera."""
        outline = _floor_rectangle(piece.floor, pose, margin)
        limit = np.array([self.shell.width / 2 - 0.01, self.shell.back - 0.01]) + margin
        if (np.abs(outline[:, 0]) > limit[0]).any() or (outline[:, 1] > limit[1]).any():
            return False
        least = self.near if near is None else near
        if any(gap(outline, other) <= 0 for other in self.taken) or self._nearest_depth(piece, pose) < least:
            return False
        self.placed.append((piece, pose))
        self.taken.append(_floor_rectangle(piece.floor, pose))
        return True

    def _nearest_depth(self, piece: Piece, pose: Float) -> float:
        """The nearest depth of the piece's bounding box."""
        outline = _floor_rectangle(piece.floor, pose)
        corners = np.concatenate([np.column_stack([outline, np.full(4, z)]) for z in (0.0, piece.height)])
        return float(self.scene.view.depth(corners).min())

    def _place_along(self, side: str, most: int) -> None:
        rng = self.scene.rng("along", side)
        names = list(furniture.AGAINST_WALLS)
        for attempt in range(2 * most):
            name = one_of(rng, names[:3] if attempt < 2 else names)
            same = (name, "armchair") if name == "sofa" else (name,)
            if sum(piece.kind in same for piece, _ in self.placed) >= 2:
                continue
            piece = furniture.AGAINST_WALLS[name](self.scene.rng("piece", side, attempt))
            along = float(rng.uniform(-0.5, 0.5) * (self.shell.wall_length(side) - piece.floor[0]))
            if self._place_if_free(piece, self.shell.against(side, along, piece.floor[1] / 2 + 0.05)):
                self.walls[side].append((along, piece.floor[0], piece.height))

    def _place_in_the_middle(self) -> None:
        rng = self.scene.rng("middle")
        make = one_of(rng, furniture.IN_THE_MIDDLE)
        piece = make(self.scene.rng("piece", "middle"))
        for _ in range(30):
            x, y = rng.uniform(-0.25, 0.25) * self.shell.width, rng.uniform(0.35, 0.75) * self.shell.back
            pose = move(x, y, 0) @ turn_z(rng.normal(0, 12))
            if self._place_if_free(piece, pose):
                if make is furniture.dining_table:
                    self._place_chairs(pose, piece)
                return

    def _place_chairs(self, pose: Float, table: Piece) -> None:
        rng = self.scene.rng("chairs")
        made = furniture.chair(self.scene.rng("piece", "chair"))
        for sign in (-1, 1):
            for x in (-0.25, 0.25):
                if rng.random() < 0.75:
                    turn = turn_z((180.0 if sign < 0 else 0.0) + float(rng.normal(0, 14)))
                    off = table.floor[1] / 2 + made.floor[1] / 2 + rng.uniform(0.06, 0.25)
                    self._place_if_free(made, pose @ move(x * table.floor[0], sign * off, 0) @ turn, 0.01)

    def _place_in_front(self) -> None:
        """Place a piece at one side of the picture, moved along the view until its nearest visible depth is `near`."""
        rng = self.scene.rng("front")
        for attempt in range(16):
            piece = one_of(rng, furniture.IN_FRONT)(self.scene.rng("piece", "front", attempt))
            side, turn = one_of(rng, [-1.0, 1.0]) * rng.uniform(0.4, 0.8), float(rng.uniform(0, 360))
            depth = found = self.near + 0.3
            for _ in range(6):
                pose = translation(self.scene.view.at(side, 0.0, depth) * [1, 1, 0]) @ turn_z(turn)
                meshes = [triangles(mesh, pose) for _, mesh, _ in piece.parts]
                found = float(rasterize(self.scene.view, meshes).depth.min())  # +inf where the piece is not visible
                depth += self.near - found if math.isfinite(found) else 0.2 * self.near
            if abs(found - self.near) < 0.01 * self.near and self._place_if_free(piece, pose, near=0.0):
                return


def _add_piece(scene: Composition, piece: Piece, pose: Float, index: int) -> None:
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    shared = int(scene.rng("tone", piece.kind, index).integers(1 << 30))
    for name, mesh, word in piece.parts:
        label = name if name.startswith(piece.kind) or piece.kind in ("lamp", "plant") else f"{piece.kind}-{name}"
        if word == "lit":
            radiance = scene.rng("lit", index).uniform(2.0, 4.0) * lighting.WARM
            lighting.emitter(scene, label, mesh, pose, radiance, 0.4)
        else:
            scene.add(label, mesh, furniture_material(scene, (piece.kind, index, name), word, pixel, shared), pose)


def _add_small_objects(scene: Composition, plan: _FloorPlan) -> None:
    """Add bodies on shelves and tables, more on the larger ones."""
    shelves = [(shelf, pose) for piece, pose in plan.placed for shelf in piece.shelves]
    if not shelves:
        return
    weights = np.array([math.sqrt(shelf.size[0] * shelf.size[1]) for shelf, _ in shelves])
    chosen = scene.rng("clutter").choice(len(shelves), size=scene.request.count, p=weights / weights.sum())
    for index, (shelf, pose) in enumerate(shelves):
        _fill_shelf(scene, shelf, pose, index, int((chosen == index).sum()))


def _fill_shelf(scene: Composition, shelf: Shelf, pose: Float, index: int, count: int) -> None:
    bodies = []
    for k in range(count):
        body = draw_body(scene, ("clutter", index, k), _SMALL)
        rest = choose_rest(body, scene.rng("rest", index, k))
        if rest is not None and rest.height < shelf.free:
            bodies.append((body, rest, scene.rng("place", index, k)))
    half = np.array(shelf.size) / 2

    def sample(rng: Rng, rest: StablePose) -> Float:
        return np.asarray(rng.uniform(-1, 1, 2) * half + shelf.middle)

    def contains(outline: Float) -> bool:
        return bool((np.abs(outline - shelf.middle) < half).all())

    area = Area(sample, contains, shelf.height, 0.01, 0.35 if shelf.free > 0.5 else 0.0)
    for placement in arrange(bodies, area):
        at = pose @ placement.pose
        body = placement.body
        scene.add(body.name, body.solid.mesh, body.material(scene.pixel_at(at[:3, 3], 0.3)), at)


def _add_windows(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    """Add one or two windows where no high furniture stands."""
    rng = scene.rng("windows")
    sides = rng.permutation(["left", "right", "back"])[: int(rng.integers(1, 3))]
    for index, side in enumerate(sides):
        for _ in range(12):
            along = float(rng.uniform(-0.5, 0.5) * (shell.wall_length(side) - 1.9))
            if all(abs(along - at) > 0.95 + wide / 2 or tall < 0.75 for at, wide, tall in plan.walls[side]):
                add_window(scene, shell, side, along, index)
                plan.walls[side].append((along, 2.0, 2.3))
                break


def _decorate(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    """Add a rug in the middle, and pictures where the walls are free."""
    rng = scene.rng("decoration")
    if rng.random() < 0.75:
        rug = furniture.board((rng.uniform(1.5, 2.4), rng.uniform(1.0, 1.7), 0.012), (0, 0, 0.006), 0.005)
        place = move(rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.6) * shell.back, 0.0005)
        pose = place @ turn_z(rng.normal(0, 10))
        scene.add("rug", rug, furniture_material(scene, ("rug",), "rug", scene.view.pixel(2.0)), pose)
    for index, side in enumerate((*_SIDES, "back")):
        for _ in range(8):
            along = float(rng.uniform(-0.42, 0.42) * shell.wall_length(side))
            w, h = rng.uniform(0.35, 0.9), rng.uniform(0.35, 0.8)
            if all(abs(along - at) > 0.5 * (w + wide) + 0.1 or tall < 1.0 for at, wide, tall in plan.walls[side]):
                _add_picture(scene, shell.against(side, along, 0.0), w, h, index)
                plan.walls[side].append((along, w, 2.0))
                break


def _add_picture(scene: Composition, pose: Float, w: float, h: float, index: int) -> None:
    z = 1.55
    frame = [furniture.board((w + 0.05, 0.03, 0.035), (0, -0.015, z + s * h / 2)) for s in (-1, 1)]
    frame += [furniture.board((0.035, 0.03, h + 0.05), (s * w / 2, -0.015, z)) for s in (-1, 1)]
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    wood = furniture_material(scene, ("frame", index), "wood", pixel)
    scene.add("picture-frame", shapes.merged(frame), wood, pose)
    canvas = furniture.board((w, 0.012, h), (0, -0.007, z))
    canvas = Mesh(canvas.vertices, canvas.faces, canvas.normals, np.asarray(canvas.uv) / [w, h])
    printed = furniture_material(scene, ("picture", index), "picture", pixel / max(w, h))
    scene.add("picture", canvas, printed, pose)


def _light(scene: Composition, shell: Shell) -> None:
    """Add a lamp below the ceiling, or a bright front wall behind the camera; neither is visible.

    Windows and lamp shades are visible and set the exposure; with no other light the room would be dark. A window does
    not light its own wall, nor the objects in front of that wall.
    """
    rng = scene.rng("light")
    by_lamp = rng.random() < 0.8
    if by_lamp:
        spot = np.array([rng.uniform(-0.2, 0.2) * shell.width, rng.uniform(0.3, 0.6) * shell.back, shell.height - 0.02])
        side = rng.uniform(1.0, 1.7)
        tone = one_of(rng, [lighting.WARM, lighting.NEUTRAL])
        level = rng.uniform(8.0, 12.0) / side**2
        spot = lighting.out_of_view(scene.view, spot, side, shell.front + side / 2)
        lighting.panel(scene, "ceiling-light", spot, spot - [0, 0, 1], (side, side), level * tone)
    place = np.array([0.0, shell.front + 0.02, 0.55 * shell.height])
    size = (0.9 * shell.width, 0.8 * shell.height)
    level = rng.uniform(1.4, 2.2) if by_lamp else rng.uniform(3.5, 5.0)
    tone = lighting.NEUTRAL if by_lamp else lighting.COOL
    lighting.panel(scene, "hall-light", place, place + np.array([0, 1, 0]), size, level * tone)
