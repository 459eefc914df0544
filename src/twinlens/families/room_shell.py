"""The empty room: floor, walls, ceiling, skirting, and windows."""

from dataclasses import dataclass

import numpy as np

from twinlens.families import lighting
from twinlens.families.colors import varied
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import board
from twinlens.families.materials import material
from twinlens.families.patterns import pattern
from twinlens.families.poses import move, turn_x, turn_z
from twinlens.families.solids import double_sided
from twinlens.families.surfaces import FLOORS, WALLS, Sheet, surface, wall_colors
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Bitmap, Mesh, Plugin


@dataclass(frozen=True)
class Shell:
    """The room's box: x from -width/2 to width/2, y from `front` to `back`, z from 0 to `height`, metres."""

    width: float
    front: float
    back: float
    height: float

    def sheets(self) -> dict[str, Sheet]:
        """Its six sides, their fronts inside."""
        w, h, d = np.array([self.width, 0, 0]), np.array([0, 0, self.height]), np.array([0, self.back - self.front, 0])
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
        """The length of the "back", "left" or "right" wall."""
        return self.width if side == "back" else self.back - self.front

    def against(self, side: str, along: float, off: float) -> Float:
        """The pose (4, 4) of an object with its back to a wall: `off` metres from it, `along` from its middle."""
        middle = 0.5 * (self.front + self.back)
        if side == "back":
            return move(along, self.back - off, 0.0)
        sign = -1.0 if side == "left" else 1.0
        return move(sign * (self.width / 2 - off), middle + along, 0.0) @ turn_z(-90.0 * sign)


def add_shell(scene: Composition, shell: Shell) -> None:
    """Add floor, walls, ceiling and skirting in the scene's colours; the back wall may have its own pattern."""
    rng = scene.rng("shell")
    colors = wall_colors(scene.rng("wall colours"), scene.palette, 0.25)
    name, tile = one_of(rng, WALLS) if rng.random() < 0.35 else ("cloudy", 1.8)
    accent = rng.random() < 0.5
    for side, sheet in shell.sheets().items():
        stream = ("surface", side)
        if side == "floor":
            kind, size = one_of(rng, FLOORS)
            ground = wall_colors(scene.rng("floor colours"), scene.palette, 0.45)
            finish = one_of(rng, ["matte", "satin", "satin"])
            made = surface(scene, stream, sheet, kind, ground, size, finish, 0.3)
        elif side == "ceiling":
            white = np.array([[0.78, 0.77, 0.74], [0.72, 0.71, 0.69]])
            made = surface(scene, stream, sheet, "cloudy", white, 2.0, mottle=0.05)
        elif side == "back-wall" and accent:
            kind, size = one_of(rng, WALLS)
            made = surface(scene, stream, sheet, kind, wall_colors(scene.rng("accent"), scene.palette, 0.3), size)
        else:
            made = surface(scene, stream, sheet, name, colors, tile)
        scene.add(side, sheet.mesh(), made)
    if rng.random() < 0.8:
        _add_skirting(scene, shell)


def _add_skirting(scene: Composition, shell: Shell) -> None:
    depth, tall = 0.015, 0.09
    length, middle = shell.back - shell.front, 0.5 * (shell.front + shell.back)
    boards = [board((shell.width, depth, tall), (0, shell.back - depth / 2, tall / 2))]
    boards += [board((depth, length, tall), (s * (shell.width - depth) / 2, middle, tall / 2)) for s in (-1, 1)]
    tone = varied(scene.rng("skirting"), np.array([[0.7, 0.69, 0.66]]), 0.1)
    scene.add("skirting", shapes.merged(boards), _paint(scene, "skirting", tone, 64))


def _paint(scene: Composition, part: str, tone: Float, texels: int) -> Plugin:
    """One colour (1, 3), slightly mottled."""
    return material("satin", Bitmap(pattern("plain", texels, scene.rng("paint", part), tone, 0.05)), 0.3)


def add_window(scene: Composition, shell: Shell, side: str, along: float, index: int) -> None:
    """Add a window: a bright pane that lights the room, a frame, sometimes curtains."""
    rng = scene.rng("window", index)
    wide, tall = rng.uniform(0.9, 1.7), rng.uniform(1.1, 1.5)
    sill = rng.uniform(0.75, 0.95)
    pose = shell.against(side, along, 0.0)
    sky = lighting.COOL * (0.7, 0.85, 1.0) if rng.random() < 0.7 else lighting.WARM
    pane = lighting.rectangle(wide, tall)
    pane = shapes.transformed(pane, move(0, -0.012, sill + tall / 2) @ turn_x(90.0))
    lighting.emitter(scene, f"window-pane-{index}", pane, pose, float(rng.uniform(1.8, 3.0)) * sky)
    white = _paint(scene, f"frame{index}", np.array([[0.75, 0.74, 0.72]]), 32)
    scene.add("window-frame", _frame(rng, wide, tall, sill), white, pose)
    if rng.random() < 0.5:
        cloth = pattern("weave", 64, rng, varied(rng, scene.palette.grounds), 0.06)
        weave = material("matte", Bitmap(cloth, to_uv=np.diag([3.0, 3.0, 1.0, 1.0])))
        scene.add("curtains", _curtains(rng, wide, tall, sill), weave, pose)


def _frame(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """A window frame with glazing bars and a sill board."""
    bar, deep = 0.06, 0.05
    z = sill + tall / 2
    parts = [board((bar, deep, tall + bar), (s * wide / 2, -deep / 2, z)) for s in (-1, 1)]
    parts += [board((wide + bar, deep, bar), (0, -deep / 2, z + s * tall / 2)) for s in (-1, 1)]
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    parts += [board((0.03, 0.035, tall), (wide * (i / columns - 0.5), -0.03, z)) for i in range(1, columns)]
    parts += [board((wide, 0.035, 0.03), (0, -0.03, sill + tall * j / rows)) for j in range(1, rows)]
    parts.append(board((wide + 0.2, 0.16, 0.03), (0, -0.08, sill - 0.045)))
    return shapes.merged(parts)


def _curtains(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """A folded cloth at each side of a window, down to the floor or the sill."""
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
        uv = np.stack(np.broadcast_arrays(t * span * 1.4, z[:, None]), axis=-1).reshape(-1, 2)
        normals = np.concatenate([normal, normal])
        made.append(double_sided(points.reshape(-1, 3), shapes.grid(60, 2), normals, uv, 1e-3))
    return shapes.merged(made)
