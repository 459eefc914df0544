"""The family "room": a furnished room seen from its open end, with furniture, windows, pictures and small objects."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from twinlens.families import furniture, lighting
from twinlens.families.arrangement import Area, arrange, bodies_at_rest
from twinlens.families.composition import Composition, rasterize
from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import Piece, board
from twinlens.families.materials import furniture_material
from twinlens.families.solids import double_sided
from twinlens.families.surfaces import (
    FLOORS,
    WALLS,
    Sheet,
    surface,
    surface_pattern,
    wall_colors,
)
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import gap

_SMALL = ("vase", "bottle", "bowl", "cup", "jar", "tin", "candle", "book", "book", "carton", "ball", "pebble", "knot",
          "plate", "blob", "superquadric", "goblet", "crystal", "ring")  # fmt: skip
_SIDES = ("back", "left", "right")


NAMES = frozenset({
    "left-wall", "right-wall", "back-wall", "front-wall", "floor", "ceiling", "skirting", "window-frame", "window-pane",
    "curtains", "side-window", "ceiling-light", "rug", "picture", "picture-frame", "table-top", "table-legs",
    "stool-table-top", "stool-table-legs", "chair", "chair-seat", "sofa", "sofa-cushions", "sofa-feet", "sofa-pillow",
    "armchair-sofa", "armchair-cushions", "armchair-feet", "armchair-pillow", "bookcase", "bookcase-books", "sideboard",
    "sideboard-doors", "sideboard-knobs", "sideboard-feet", "pot", "leaves", "lamp", "shade", "box",
})  # fmt: skip
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    """Add the furniture to an empty room, then walls, windows, the objects on the furniture, pictures and lights."""
    rng = scene.rng("room")
    shell = Shell(
        rng.uniform(3.4, 5.2), -1.2, rng.uniform(3.6, 5.6), rng.uniform(2.45, 2.9)
    )
    plan = _FloorPlan(scene, shell, _set_view(scene, shell))
    plan.place_in_front()
    for side, most in zip(_SIDES, (5, 3, 3), strict=True):
        plan.place_along(side, most)
    plan.place_in_the_middle()
    _add_shell(scene, shell)
    _add_windows(scene, shell, plan)
    for index, (piece, pose) in enumerate(plan.placed):
        pixel = scene.pixel_at(pose[:3, 3], 0.5)
        shared = int(scene.rng("tone", piece.kind, index).integers(1 << 30))
        for name, mesh, word in piece.parts:
            label = (
                name
                if name.startswith(piece.kind) or piece.kind in ("lamp", "plant")
                else f"{piece.kind}-{name}"
            )
            if word == "lit":
                radiance = scene.rng("lit", index).uniform(2.0, 4.0) * lighting.WARM
                lighting.emitter(scene, label, mesh, pose, radiance, 0.4)
            else:
                scene.add(
                    label,
                    mesh,
                    furniture_material(
                        scene, (piece.kind, index, name), word, pixel, shared
                    ),
                    pose,
                )
    _add_small_objects(scene, plan)
    _decorate(scene, shell, plan)
    _light(scene, shell)


@dataclass(frozen=True)
class Shell:
    """The room's box: x from -width/2 to width/2, y from `front` to `back`, z from 0 to `height`, metres."""

    width: float
    front: float
    back: float
    height: float

    def sheets(self) -> dict[str, Sheet]:
        """Its six sides, their fronts inside."""
        w, h, d = (
            np.array([self.width, 0, 0]),
            np.array([0, 0, self.height]),
            np.array([0, self.back - self.front, 0]),
        )
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
        return translation(
            [sign * (self.width / 2 - off), middle + along, 0.0]
        ) @ rotation([0, 0, 1], -90.0 * sign)


def _set_view(scene: Composition, shell: Shell) -> float:
    """Look from eye height near the open end, narrow enough for the depth ratio; returns the nearest depth."""
    rng = scene.rng("view")
    eye = np.array(
        [
            rng.uniform(-0.3, 0.3) * shell.width,
            shell.front + rng.uniform(0.25, 0.5),
            rng.uniform(1.15, 1.6),
        ]
    )
    target = np.array(
        [-0.6 * eye[0] + rng.uniform(-0.4, 0.4), shell.back, rng.uniform(0.55, 1.0)]
    )
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
        outline = _floor_rectangle(piece.floor, pose, margin)
        limit = np.array([self.shell.width / 2 - 0.01, self.shell.back - 0.01]) + margin
        if (np.abs(outline[:, 0]) > limit[0]).any() or (outline[:, 1] > limit[1]).any():
            return False
        floor = _floor_rectangle(piece.floor, pose)
        corners = np.concatenate(
            [np.column_stack([floor, np.full(4, z)]) for z in (0.0, piece.height)]
        )
        nearest = self.scene.view.depth(corners).min()
        taken = (_floor_rectangle(other.floor, place) for other, place in self.placed)
        if any(gap(outline, other) <= 0 for other in taken) or nearest < (
            self.near if near is None else near
        ):
            return False
        self.placed.append((piece, pose))
        return True

    def place_along(self, side: str, most: int) -> None:
        rng = self.scene.rng("along", side)
        names = list(furniture.AGAINST_WALLS)
        for attempt in range(2 * most):
            name = one_of(rng, names[:3] if attempt < 2 else names)
            same = (name, "armchair") if name == "sofa" else (name,)
            if sum(piece.kind in same for piece, _ in self.placed) >= 2:
                continue
            piece = furniture.AGAINST_WALLS[name](
                self.scene.rng("piece", side, attempt)
            )
            along = float(
                rng.uniform(-0.5, 0.5) * (self.shell.wall_length(side) - piece.floor[0])
            )
            if self._place_if_free(
                piece, self.shell.against(side, along, piece.floor[1] / 2 + 0.05)
            ):
                self.walls[side].append((along, piece.floor[0], piece.height))

    def place_in_the_middle(self) -> None:
        rng = self.scene.rng("middle")
        piece = one_of(rng, furniture.IN_THE_MIDDLE)(self.scene.rng("piece", "middle"))
        for _ in range(30):
            x, y = (
                rng.uniform(-0.25, 0.25) * self.shell.width,
                rng.uniform(0.35, 0.75) * self.shell.back,
            )
            pose = translation([x, y, 0]) @ rotation([0, 0, 1], rng.normal(0, 12))
            if self._place_if_free(piece, pose):
                if piece.height == furniture.DINING_HEIGHT:
                    self._place_chairs(pose, piece)
                return

    def _place_chairs(self, pose: Float, table: Piece) -> None:
        rng = self.scene.rng("chairs")
        made = furniture.chair(self.scene.rng("piece", "chair"))
        for sign in (-1, 1):
            for x in (-0.25, 0.25):
                if rng.random() < 0.75:
                    turn = rotation(
                        [0, 0, 1],
                        (180.0 if sign < 0 else 0.0) + float(rng.normal(0, 14)),
                    )
                    off = (
                        table.floor[1] / 2 + made.floor[1] / 2 + rng.uniform(0.06, 0.25)
                    )
                    place = pose @ translation([x * table.floor[0], sign * off, 0])
                    self._place_if_free(made, place @ turn, 0.01)

    def place_in_front(self) -> None:
        """Place a piece at one side of the picture, moved along the view until its nearest visible depth is `near`."""
        rng = self.scene.rng("front")
        for attempt in range(16):
            piece = one_of(rng, furniture.IN_FRONT)(
                self.scene.rng("piece", "front", attempt)
            )
            side, turn = (
                one_of(rng, [-1.0, 1.0]) * rng.uniform(0.4, 0.8),
                float(rng.uniform(0, 360)),
            )
            depth = found = self.near + 0.3
            for _ in range(6):
                place = translation(self.scene.view.at(side, 0.0, depth) * [1, 1, 0])
                pose = place @ rotation([0, 0, 1], turn)
                meshes = [
                    (transform_points(pose, mesh.vertices), mesh.faces)
                    for _, mesh, _ in piece.parts
                ]
                found = float(
                    rasterize(self.scene.view, meshes).min()
                )  # +inf where the piece is not visible
                depth += self.near - found if math.isfinite(found) else 0.2 * self.near
            if abs(found - self.near) < 0.01 * self.near and self._place_if_free(
                piece, pose, near=0.0
            ):
                return


def _add_shell(scene: Composition, shell: Shell) -> None:
    """Add floor, walls, ceiling and skirting in the scene's colours; the back wall may have its own pattern."""
    rng = scene.rng("shell")
    colors = wall_colors(scene.rng("wall colours"), scene.palette, 0.4)
    name, tile = surface_pattern(rng, WALLS, scene.plain_surfaces)
    accent = rng.random() < 0.5
    for side, sheet in shell.sheets().items():
        if side == "front-wall" and not scene.own_lights:
            continue
        kind, size, tones, finish = name, tile, colors, "matte"
        if side == "floor":
            kind, size = surface_pattern(rng, FLOORS, scene.plain_surfaces)
            tones = wall_colors(scene.rng("floor colours"), scene.palette, 0.55)
            finish = one_of(rng, ["matte", "satin", "clearcoat"])
        elif side == "ceiling":
            kind, size, tones = "plain", 2.0, np.array([[0.78, 0.77, 0.74]])
        elif side == "back-wall" and accent:
            kind, size = surface_pattern(rng, WALLS, scene.plain_surfaces)
            tones = wall_colors(scene.rng("accent"), scene.palette, 0.45)
        made = surface(
            scene, scene.rng("surface", side), sheet, kind, tones, size, finish
        )
        scene.add(side, sheet.mesh(), made)
    if rng.random() < 0.8:
        depth, tall, length = 0.015, 0.09, shell.back - shell.front
        boards = [
            board((shell.width, depth, tall), (0, shell.back - depth / 2, tall / 2))
        ]
        middle = 0.5 * (shell.front + shell.back)
        boards += [
            board(
                (depth, length, tall), (s * (shell.width - depth) / 2, middle, tall / 2)
            )
            for s in (-1, 1)
        ]
        white = furniture_material(scene, ("skirting",), "white", scene.view.pixel(2.0))
        scene.add("skirting", shapes.merged(boards), white)


def _add_window(scene: Composition, pose: Float, index: int) -> None:
    rng = scene.rng("window", index)
    wide, tall = rng.uniform(0.9, 1.7), rng.uniform(1.1, 1.5)
    sill = rng.uniform(0.75, 0.95)
    sky = lighting.COOL * (0.7, 0.85, 1.0) if rng.random() < 0.7 else lighting.WARM
    upright = translation([0, -0.012, sill + tall / 2]) @ rotation([1, 0, 0], 90.0)
    pane = shapes.transformed(lighting.rectangle(wide, tall), upright)
    lighting.emitter(
        scene, f"window-pane-{index}", pane, pose, float(rng.uniform(1.8, 3.0)) * sky
    )
    pixel = scene.pixel_at(pose[:3, 3], 0.5)
    bar, deep = 0.06, 0.05
    z = sill + tall / 2
    parts = [
        board((bar, deep, tall + bar), (s * wide / 2, -deep / 2, z)) for s in (-1, 1)
    ]
    parts += [
        board((wide + bar, deep, bar), (0, -deep / 2, z + s * tall / 2))
        for s in (-1, 1)
    ]
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    parts += [
        board((0.03, 0.035, tall), (wide * (i / columns - 0.5), -0.03, z))
        for i in range(1, columns)
    ]
    parts += [
        board((wide, 0.035, 0.03), (0, -0.03, sill + tall * j / rows))
        for j in range(1, rows)
    ]
    parts.append(board((wide + 0.2, 0.16, 0.03), (0, -0.08, sill - 0.045)))
    white = furniture_material(scene, ("window", index), "white", pixel)
    scene.add("window-frame", shapes.merged(parts), white, pose)
    if rng.random() < 0.5:
        cloth = furniture_material(
            scene, ("curtains", index), "fabric", pixel, 1 + index
        )
        scene.add("curtains", _curtains(rng, wide, tall, sill), cloth, pose)


def _curtains(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    low = 0.03 if rng.random() < 0.6 else sill - 0.2
    z = np.array([low, sill + tall + 0.14])
    t = np.linspace(0, 1, 60)
    made = []
    for side in (-1, 1):
        span = rng.uniform(0.3, 0.45)
        x = side * (wide / 2 + 0.14) - side * span * (t - 0.35)
        y = -0.1 - 0.03 * np.sin(2 * np.pi * t * rng.uniform(4, 6))
        points = np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)
        points = points if side < 0 else points[:, ::-1]
        slope = np.gradient(points[0, :, 1], points[0, :, 0])
        normal = np.stack([slope, -np.ones_like(slope), np.zeros_like(slope)], axis=-1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        uv = np.stack(np.broadcast_arrays(t * span * 1.4, z[:, None]), axis=-1).reshape(
            -1, 2
        )
        normals = np.concatenate([normal, normal])
        made.append(
            double_sided(points.reshape(-1, 3), shapes.grid(60, 2), normals, uv, 1e-3)
        )
    return shapes.merged(made)


def _add_small_objects(scene: Composition, plan: _FloorPlan) -> None:
    shelves = [(shelf, pose) for piece, pose in plan.placed for shelf in piece.shelves]
    if not shelves:
        return
    weights = np.array(
        [math.sqrt(shelf.size[0] * shelf.size[1]) for shelf, _ in shelves]
    )
    chosen = scene.rng("clutter").choice(
        len(shelves), size=scene.count, p=weights / weights.sum()
    )
    for index, (shelf, pose) in enumerate(shelves):
        parts = [(index, k) for k in range(int((chosen == index).sum()))]
        bodies = [
            each
            for each in bodies_at_rest(scene, "clutter", parts, _SMALL)
            if each[1].height < shelf.free
        ]
        half, stacked = np.array(shelf.size) / 2, 0.35 if shelf.free > 0.5 else 0.0
        for placement in arrange(
            bodies, Area(np.array(shelf.middle), half, shelf.height, 0.01, stacked)
        ):
            at, body = pose @ placement.pose, placement.body
            scene.add(
                body.name,
                body.solid.mesh,
                body.material(scene.pixel_at(at[:3, 3], 0.3)),
                at,
            )


def _add_windows(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    rng = scene.rng("windows")
    sides = rng.permutation(["left", "right", "back"])[: int(rng.integers(1, 3))]
    for index, side in enumerate(sides):
        for _ in range(12):
            along = float(rng.uniform(-0.5, 0.5) * (shell.wall_length(side) - 1.9))
            if all(
                abs(along - at) > 0.95 + wide / 2 or tall < 0.75
                for at, wide, tall in plan.walls[side]
            ):
                _add_window(scene, shell.against(side, along, 0.0), index)
                plan.walls[side].append((along, 2.0, 2.3))
                break


def _decorate(scene: Composition, shell: Shell, plan: _FloorPlan) -> None:
    rng = scene.rng("decoration")
    if rng.random() < 0.75:
        rug = board(
            (rng.uniform(1.5, 2.4), rng.uniform(1.0, 1.7), 0.012), (0, 0, 0.006), 0.005
        )
        place = translation(
            [rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.6) * shell.back, 0.0005]
        )
        pose = place @ rotation([0, 0, 1], rng.normal(0, 10))
        scene.add(
            "rug",
            rug,
            furniture_material(scene, ("rug",), "rug", scene.view.pixel(2.0)),
            pose,
        )
    for index, side in enumerate((*_SIDES, "back")):
        for _ in range(8):
            along = float(rng.uniform(-0.42, 0.42) * shell.wall_length(side))
            w, h = rng.uniform(0.35, 0.9), rng.uniform(0.35, 0.8)
            if all(
                abs(along - at) > 0.5 * (w + wide) + 0.1 or tall < 1.0
                for at, wide, tall in plan.walls[side]
            ):
                plan.walls[side].append((along, w, 2.0))
                pose, z = shell.against(side, along, 0.0), 1.55
                pixel = scene.pixel_at(pose[:3, 3], 0.5)
                frame = [
                    board((w + 0.05, 0.03, 0.035), (0, -0.015, z + s * h / 2))
                    for s in (-1, 1)
                ]
                frame += [
                    board((0.035, 0.03, h + 0.05), (s * w / 2, -0.015, z))
                    for s in (-1, 1)
                ]
                wood = furniture_material(scene, ("frame", index), "wood", pixel)
                scene.add("picture-frame", shapes.merged(frame), wood, pose)
                canvas = board((w, 0.012, h), (0, -0.007, z))
                printed = furniture_material(
                    scene, ("picture", index), "picture", pixel / max(w, h)
                )
                scene.add(
                    "picture",
                    replace(canvas, uv=np.asarray(canvas.uv) / [w, h]),
                    printed,
                    pose,
                )
                break


def _light(scene: Composition, shell: Shell) -> None:
    """Add a large window beside the camera, out of the image, and in most rooms a warm lamp below the ceiling."""
    rng = scene.rng("light")
    if rng.random() < 0.8:
        spot = np.array(
            [
                rng.uniform(-0.2, 0.2) * shell.width,
                rng.uniform(0.3, 0.6) * shell.back,
                shell.height - 0.02,
            ]
        )
        side = rng.uniform(1.0, 1.7)
        tone = one_of(rng, [lighting.WARM, lighting.WARM, lighting.NEUTRAL])
        level = rng.uniform(4.0, 12.0) / side**2
        lamp, front = lighting.rectangle(side + 0.3, side + 0.3), shell.front + side / 2
        while (
            spot[1] > front
            and np.isfinite(
                rasterize(scene.view, [(lamp.vertices + spot, lamp.faces)], 64)
            ).any()
        ):
            spot = spot - [
                0.0,
                min(0.2, spot[1] - front),
                0.0,
            ]  # towards the camera, until the lamp is not visible
        lighting.panel(
            scene,
            "ceiling-light",
            spot,
            spot - [0, 0, 1],
            np.full(2, side),
            level * tone,
        )
    near = (
        1.0 if scene.view.eye[0] > 0 else -1.0
    )  # the side wall that the camera looks away from
    place = np.array(
        [near * (shell.width / 2 - 0.02), shell.front + 0.55, 0.55 * shell.height]
    )
    size, level = np.array([1.1, 0.7 * shell.height]), rng.uniform(9.0, 15.0)
    tone = one_of(rng, [lighting.COOL, lighting.COOL, lighting.NEUTRAL])
    lighting.panel(
        scene, "side-window", place, place - np.array([near, 0, 0]), size, level * tone
    )
