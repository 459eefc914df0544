"""A furnished room seen from its open end: walls and windows, furniture along them and in the middle, clutter."""

import math
from dataclasses import replace

import numpy as np

from twinlens.families import fitting, furnishings, furniture, lighting
from twinlens.families.arranging import arrange, choose_rest
from twinlens.families.bodies import draw_body
from twinlens.families.dressing import dress
from twinlens.families.family import Family, Request
from twinlens.families.furniture import Piece, Shelf
from twinlens.families.palettes import Palette, draw_palette
from twinlens.families.resting import Rest, Rng, gap
from twinlens.families.shell import Shell, build_shell, window
from twinlens.families.stage import Stage
from twinlens.families.view import View, look
from twinlens.geometry import Float, look_at, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Scene

_CLUTTER = ("vase", "bottle", "bowl", "cup", "jar", "tin", "candle", "book", "book", "carton", "ball", "pebble", "knot",
            "plate", "blob", "superquadric", "goblet", "crystal", "ring")  # fmt: skip
_ON_FLOOR = ("ball", "carton", "block", "superquadric", "vase", "jar", "pebble", "crystal")


def compose(request: Request) -> Scene:
    """One scene: the empty room and the camera, the furniture, what stands on it, then surfaces and light."""
    palette = draw_palette(request.rng("palette"))
    rng = request.rng("room")
    shell = Shell(rng.uniform(3.4, 5.2), -1.2, rng.uniform(3.6, 5.6), rng.uniform(2.45, 2.9))
    view, near = _composed(_view(request, shell), shell, fitting.ratio(request, 3.2, 6.0))
    plan = _Plan(request, shell, view, near)
    plan.furnish()
    stage = Stage()
    build_shell(request, stage, shell, view, palette)
    _windows(request, stage, shell, plan)
    for index, (piece, pose) in enumerate(plan.placed):
        _put(request, stage, view, palette, piece, pose, index)
    _clutter(request, stage, view, palette, plan)
    _decorate(request, stage, view, palette, shell, plan)
    _light(request, stage, shell, view)
    return fitting.finished(request, stage, view, FAMILY.about)


FAMILY = Family("a furnished room", (12, 26), compose, 2.5)


def _view(request: Request, shell: Shell) -> View:
    """At eye height near the open end, turned a little to one side."""
    rng = request.rng("view")
    eye = np.array([rng.uniform(-0.3, 0.3) * shell.width, shell.front + rng.uniform(0.25, 0.5), rng.uniform(1.15, 1.6)])
    target = np.array([-0.6 * eye[0] + rng.uniform(-0.4, 0.4), shell.back, rng.uniform(0.55, 1.0)])
    return View(look_at(eye, target), float(rng.uniform(50, 63)), request.aspect, request.width_px)


def _composed(view: View, shell: Shell, deep: float) -> tuple[View, float]:
    """The view, narrowed until no floor is seen nearer than it may be, and that nearest depth."""
    sides = [(mesh.vertices, mesh.faces) for mesh in shell.meshes()]
    while True:
        floor, far = look(view, sides, 320).depth_range
        if floor >= far / deep or view.fov_x_deg < 25:
            return view, far / deep
        view = replace(view, fov_x_deg=0.95 * view.fov_x_deg)


def _rectangle(size: tuple[float, float], pose: Float, margin: float = 0.0) -> Float:
    """The outline (4, 2) of a piece on the floor."""
    half = np.array(size) / 2 + margin
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    return transform_points(pose, np.column_stack([corners, np.zeros(4)]))[:, :2]


class _Plan:
    """Where furniture stands: no two pieces on the same floor, nothing nearer to the camera than is wanted."""

    def __init__(self, request: Request, shell: Shell, view: View, near: float) -> None:
        self.request, self.shell, self.view, self.near = request, shell, view, near
        self.placed: list[tuple[Piece, Float]] = []
        self.taken: list[Float] = []
        self.walls: dict[str, list[tuple[float, float, float]]] = {"back": [], "left": [], "right": []}

    def furnish(self) -> None:
        """Along the back, along the sides, in the middle, and one piece in front that is as near as is wanted."""
        self._in_front()
        self._along("back", self.shell.width, 5)
        for side in ("left", "right"):
            self._along(side, self.shell.back - self.shell.front, 3)
        self._in_the_middle()

    def _try(self, piece: Piece, pose: Float, margin: float = 0.04, near: float | None = None) -> bool:
        """Put a piece there if it is free, inside, and far enough away."""
        least = self.near if near is None else near
        outline = _rectangle(piece.floor, pose, margin)
        inner = np.array([self.shell.width / 2 - 0.01, self.shell.back - 0.01])
        if (np.abs(outline[:, 0]) > inner[0] + margin).any() or (outline[:, 1] > inner[1] + margin).any():
            return False
        if any(gap(outline, other) <= 0 for other in self.taken) or self._depth(piece, pose) < least:
            return False
        self.placed.append((piece, pose))
        self.taken.append(_rectangle(piece.floor, pose))
        return True

    def _depth(self, piece: Piece, pose: Float) -> float:
        """The nearest depth of the piece's box."""
        outline = _rectangle(piece.floor, pose)
        corners = np.concatenate([np.column_stack([outline, np.full(4, z)]) for z in (0.0, piece.height)])
        return float(self.view.depth(corners).min())

    def _along(self, side: str, length: float, most: int) -> None:
        rng = self.request.rng("along", side)
        names = list(furnishings.AGAINST_WALLS)
        for attempt in range(2 * most):
            name = names[int(rng.integers(3 if attempt < 2 else len(names)))]
            if sum(piece.kind in (name, "armchair" if name == "sofa" else name) for piece, _ in self.placed) >= 2:
                continue
            piece = furnishings.AGAINST_WALLS[name](self.request.rng("piece", side, attempt))
            along = float(rng.uniform(-0.5, 0.5) * (length - piece.floor[0]))
            off = piece.floor[1] / 2 + 0.05
            if self._try(piece, self.shell.against(side, along, off)):
                self.walls[side].append((along, piece.floor[0], piece.height))

    def _in_the_middle(self) -> None:
        rng = self.request.rng("middle")
        name = list(furnishings.IN_THE_MIDDLE)[int(rng.integers(len(furnishings.IN_THE_MIDDLE)))]
        piece = furnishings.IN_THE_MIDDLE[name](self.request.rng("piece", "middle"))
        for _ in range(30):
            place = np.array(
                [rng.uniform(-0.25, 0.25) * self.shell.width, rng.uniform(0.35, 0.75) * self.shell.back, 0]
            )
            pose = translation(place) @ rotation(np.array([0.0, 0, 1]), float(rng.normal(0, 12)))
            if self._try(piece, pose):
                break
        else:
            return
        if name == "dining table":
            self._chairs(pose, piece)

    def _chairs(self, pose: Float, table: Piece) -> None:
        rng = self.request.rng("chairs")
        made = furniture.chair(self.request.rng("piece", "chair"))
        for sign in (-1, 1):
            for x in (-0.25, 0.25):
                if rng.random() < 0.75:
                    turn = rotation(np.array([0.0, 0, 1]), (180.0 if sign < 0 else 0.0) + float(rng.normal(0, 14)))
                    off = table.floor[1] / 2 + made.floor[1] / 2 + rng.uniform(0.06, 0.25)
                    self._try(made, pose @ translation(np.array([x * table.floor[0], sign * off, 0])) @ turn, 0.01)

    def _in_front(self) -> None:
        """At one side of the picture, shifted along the view until its nearest corner is where it should be."""
        rng = self.request.rng("front")
        names = list(furnishings.IN_FRONT)
        for attempt in range(16):
            make = furnishings.IN_FRONT[names[int(rng.integers(len(names)))]]
            piece = make(self.request.rng("piece", "front", attempt))
            side, turn = float(rng.choice([-1.0, 1.0])) * rng.uniform(0.4, 0.8), float(rng.uniform(0, 360))
            depth = found = self.near + 0.3
            for _ in range(6):
                pose = translation(self.view.at(side, 0.0, depth) * [1, 1, 0]) @ rotation(np.array([0.0, 0, 1]), turn)
                found = self._nearest_seen(piece, pose)
                depth += self.near - found if math.isfinite(found) else 0.2 * self.near
            if abs(found - self.near) < 0.01 * self.near and self._try(piece, pose, near=0.0):
                return

    def _nearest_seen(self, piece: Piece, pose: Float) -> float:
        """The nearest depth at which the picture shows the piece; +inf where it does not."""
        parts = [(transform_points(pose, mesh.vertices), mesh.faces) for _, mesh, _ in piece.parts]
        return float(look(self.view, parts).depth.min())


def _put(request: Request, stage: Stage, view: View, palette: Palette, piece: Piece, pose: Float, index: int) -> None:
    pixel = view.pixel(max(float(view.depth(pose[None, :3, 3])[0]), 0.5))
    tone = request.rng("tone", piece.kind, index)
    shared = int(tone.integers(1 << 30))
    for name, mesh, word in piece.parts:
        label = name if name.startswith(piece.kind) or piece.kind in ("lamp", "plant") else f"{piece.kind}-{name}"
        if word == "lit":
            lighting.glow(stage, label, mesh, pose, request.rng("lit", index).uniform(2.0, 4.0) * lighting.WARM, 0.4)
            continue
        stage.add(label, mesh, dress(request, (piece.kind, index, name), word, palette, pixel, shared), pose)


def _clutter(request: Request, stage: Stage, view: View, palette: Palette, plan: _Plan) -> None:
    """Bodies at rest on shelves and tables, by their room."""
    shelves = [(shelf, pose, i) for i, (piece, pose) in enumerate(plan.placed) for shelf in piece.shelves]
    if not shelves:
        return
    rng = request.rng("clutter")
    weights = np.array([math.sqrt(shelf.size[0] * shelf.size[1]) for shelf, _, _ in shelves])
    chosen = rng.choice(len(shelves), size=request.count, p=weights / weights.sum())
    for index, (shelf, pose, _) in enumerate(shelves):
        wanted = int((chosen == index).sum())
        if wanted:
            _fill(request, stage, view, palette, shelf, pose, index, wanted)


def _fill(
    request: Request, stage: Stage, view: View, palette: Palette, shelf: Shelf, pose: Float, index: int, wanted: int
) -> None:
    bodies = []
    for k in range(wanted):
        drawn = draw_body(request, ("clutter", index, k), palette, _CLUTTER)
        rest = choose_rest(drawn, request.rng("rest", index, k))
        if rest is not None and rest.height < shelf.free:
            bodies.append((drawn, rest, request.rng("place", index, k)))
    half = np.array(shelf.size) / 2

    def where(rng: Rng, rest: Rest) -> Float:
        return np.asarray(rng.uniform(-1, 1, 2) * half + shelf.middle)

    def allowed(outline: Float) -> bool:
        return bool((np.abs(outline - shelf.middle) < half).all())

    stacked = 0.35 if shelf.free > 0.5 else 0.0
    for standing in arrange(bodies, where, shelf.height, allowed, 0.01, stacked):
        drawn = standing.drawn
        at = pose @ standing.pose
        pixel = view.pixel(max(float(view.depth(at[None, :3, 3])[0]), 0.3))
        stage.add(drawn.name, drawn.solid.mesh, drawn.material(pixel), at)


def _windows(request: Request, stage: Stage, shell: Shell, plan: _Plan) -> None:
    """One or two, where no high furniture stands; the room's daylight."""
    rng = request.rng("windows")
    sides = rng.permutation(["left", "right", "back"])[: int(rng.integers(1, 3))]
    for index, side in enumerate(sides):
        length = shell.width if side == "back" else shell.back - shell.front
        for _ in range(12):
            along = float(rng.uniform(-0.5, 0.5) * (length - 1.9))
            if all(abs(along - at) > 0.95 + wide / 2 or tall < 0.75 for at, wide, tall in plan.walls[side]):
                window(request, stage, shell, side, along, index)
                plan.walls[side].append((along, 2.0, 2.3))
                break


def _decorate(request: Request, stage: Stage, view: View, palette: Palette, shell: Shell, plan: _Plan) -> None:
    """A rug in the middle, and pictures where the walls are free."""
    rng = request.rng("decoration")
    if rng.random() < 0.75:
        size = (rng.uniform(1.5, 2.4), rng.uniform(1.0, 1.7))
        rug = furniture.board((*size, 0.012), (0, 0, 0.006), 0.005)
        place = np.array([rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.6) * shell.back, 0.0005])
        pose = translation(place) @ rotation(np.array([0.0, 0, 1]), float(rng.normal(0, 10)))
        stage.add("rug", rug, dress(request, ("rug",), "rug", palette, view.pixel(2.0), 0), pose)
    for index, side in enumerate(("back", "left", "right", "back")):
        length = shell.width if side == "back" else shell.back - shell.front
        for _ in range(8):
            along = float(rng.uniform(-0.42, 0.42) * length)
            w, h = rng.uniform(0.35, 0.9), rng.uniform(0.35, 0.8)
            if all(abs(along - at) > 0.5 * (w + wide) + 0.1 or tall < 1.0 for at, wide, tall in plan.walls[side]):
                _picture(request, stage, view, palette, shell.against(side, along, 0.0), (w, h), index)
                plan.walls[side].append((along, w, 2.0))
                break


def _picture(
    request: Request, stage: Stage, view: View, palette: Palette, pose: Float, size: tuple[float, float], index: int
) -> None:
    w, h = size
    z = 1.55
    frame = [furniture.board((w + 0.05, 0.03, 0.035), (0, -0.015, z + s * h / 2)) for s in (-1, 1)]
    frame += [furniture.board((0.035, 0.03, h + 0.05), (s * w / 2, -0.015, z)) for s in (-1, 1)]
    pixel = view.pixel(max(float(view.depth(pose[None, :3, 3])[0]), 0.5))
    stage.add("picture-frame", shapes.merged(frame), dress(request, ("frame", index), "wood", palette, pixel, 0), pose)
    canvas = furniture.board((w, 0.012, h), (0, -0.007, z))
    fitted = np.array(canvas.uv) / [w, h]
    canvas = type(canvas)(canvas.vertices, canvas.faces, canvas.normals, fitted)
    stage.add("picture", canvas, dress(request, ("picture", index), "picture", palette, pixel / max(w, h), 0), pose)


def _light(request: Request, stage: Stage, shell: Shell, view: View) -> None:
    """What fills the room: a lamp below the ceiling, or a glazed front behind the camera; the other one is weaker.

    Windows and lamp shades are seen, and a picture that shows them well is dark unless the rest is lit by something
    that it does not show: a window alone leaves its own wall, and all that stands before it, in the shade.
    """
    rng = request.rng("light")
    by_lamp = rng.random() < 0.8
    if by_lamp:
        spot = np.array([rng.uniform(-0.2, 0.2) * shell.width, rng.uniform(0.3, 0.6) * shell.back, shell.height - 0.02])
        side = rng.uniform(1.0, 1.7)
        tone = (lighting.WARM, lighting.NEUTRAL)[int(rng.integers(2))]
        level = rng.uniform(8.0, 12.0) / side**2
        spot = lighting.unseen(view, spot, side, shell.front + side / 2)
        lighting.panel(stage, "ceiling-light", spot, spot - [0, 0, 1], (side, side), level * tone)
    place = np.array([0.0, shell.front + 0.02, 0.55 * shell.height])
    size = (0.9 * shell.width, 0.8 * shell.height)
    level = rng.uniform(1.4, 2.2) if by_lamp else rng.uniform(3.5, 5.0)
    tone = lighting.NEUTRAL if by_lamp else lighting.COOL
    lighting.panel(stage, "hall-light", place, place + np.array([0, 1, 0]), size, level * tone)
