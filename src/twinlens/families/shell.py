"""The empty room: floor, walls, ceiling, skirting, and windows that let daylight in."""

from dataclasses import dataclass

import numpy as np

from twinlens.families import lighting
from twinlens.families.family import Request
from twinlens.families.finishes import material
from twinlens.families.furniture import board
from twinlens.families.palettes import Palette, varied
from twinlens.families.patterns import pattern
from twinlens.families.stage import Stage
from twinlens.families.surfaces import FLOORS, WALLS, Sheet, surface, wall_colors
from twinlens.families.view import View
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Bitmap, Mesh

Rng = np.random.Generator


@dataclass(frozen=True)
class Shell:
    """A box of air: x from -width/2 to width/2, y from `front` to `back`, z from 0 to `height`, metres."""

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

    def meshes(self) -> list[Mesh]:
        """The sides as triangles."""
        return [sheet.mesh() for sheet in self.sheets().values()]

    def against(self, side: str, along: float, off: float) -> Float:
        """The pose (4, 4) of something `off` metres from a wall, its back to it; `along` the wall, its middle at 0."""
        middle = 0.5 * (self.front + self.back)
        if side == "back":
            return translation(np.array([along, self.back - off, 0.0]))
        sign = -1.0 if side == "left" else 1.0
        turn = rotation(np.array([0.0, 0, 1.0]), -90.0 * sign)
        return translation(np.array([sign * (self.width / 2 - off), middle + along, 0.0])) @ turn


def build_shell(request: Request, stage: Stage, shell: Shell, view: View, palette: Palette) -> None:
    """Floor, walls and ceiling in the scene's colours, one wall perhaps another than the rest, and a skirting."""
    rng = request.rng("shell")
    quiet = wall_colors(request.rng("wall colours"), palette, 0.25)
    name, tile = WALLS[int(rng.integers(len(WALLS)))] if rng.random() < 0.35 else ("cloudy", 1.8)
    accent = rng.random() < 0.5
    for side, sheet in shell.sheets().items():
        stream = request.rng("surface", side)
        if side == "floor":
            kind, size = FLOORS[int(rng.integers(len(FLOORS)))]
            colors = wall_colors(request.rng("floor colours"), palette, 0.45)
            finish = str(rng.choice(["matte", "satin", "satin"]))
            made = surface(stream, sheet, view, kind, colors, size, finish, 0.3)
        elif side == "ceiling":
            white = np.array([[0.78, 0.77, 0.74], [0.72, 0.71, 0.69]])
            made = surface(stream, sheet, view, "cloudy", white, 2.0, mottle=0.05)
        elif side == "back-wall" and accent:
            kind, size = WALLS[int(rng.integers(len(WALLS)))]
            made = surface(stream, sheet, view, kind, wall_colors(request.rng("accent"), palette, 0.3), size)
        else:
            made = surface(stream, sheet, view, name, quiet, tile)
        stage.add(side, sheet.mesh(), made)
    if rng.random() < 0.8:
        _skirting(request, stage, shell)


def _skirting(request: Request, stage: Stage, shell: Shell) -> None:
    depth, tall = 0.015, 0.09
    length = shell.back - shell.front
    middle = 0.5 * (shell.front + shell.back)
    boards = [board((shell.width, depth, tall), (0, shell.back - depth / 2, tall / 2))]
    boards += [board((depth, length, tall), (s * (shell.width - depth) / 2, middle, tall / 2)) for s in (-1, 1)]
    tone = varied(request.rng("skirting"), np.array([[0.7, 0.69, 0.66]]), 0.1)
    stage.add("skirting", shapes.merged(boards), paint(request, "skirting", tone, 64))


def paint(request: Request, part: str, tone: Float, texels: int) -> dict[str, object]:
    """One painted colour, a little mottled."""
    pixels = pattern("plain", texels, request.rng("paint", part), tone, 0.05)
    return dict(material("satin", Bitmap(pixels), 0.3))


def window(request: Request, stage: Stage, shell: Shell, side: str, along: float, index: int) -> None:
    """A window in a wall: a bright pane, the room's daylight, behind frame and bars, perhaps curtains."""
    rng = request.rng("window", index)
    wide, tall = rng.uniform(0.9, 1.7), rng.uniform(1.1, 1.5)
    sill = rng.uniform(0.75, 0.95)
    pose = shell.against(side, along, 0.0)
    sky = lighting.COOL * (0.7, 0.85, 1.0) if rng.random() < 0.7 else lighting.WARM
    pane = lighting.rectangle(wide, tall)
    upright = rotation(np.array([1.0, 0, 0]), 90.0)
    pane = shapes.transformed(pane, translation(np.array([0, -0.012, sill + tall / 2])) @ upright)
    strength = float(rng.uniform(1.8, 3.0))
    lighting.glow(stage, f"window-pane-{index}", pane, pose, strength * sky)
    stage.add(
        "window-frame",
        _frame(rng, wide, tall, sill),
        paint(request, f"frame{index}", np.array([[0.75, 0.74, 0.72]]), 32),
        pose,
    )
    if rng.random() < 0.5:
        cloth = pattern("weave", 64, rng, varied(rng, request_colors(request)), 0.06)
        repeat = np.diag([3.0, 3.0, 1.0, 1.0])
        stage.add("curtains", _curtains(rng, wide, tall, sill), material("matte", Bitmap(cloth, to_uv=repeat)), pose)


def request_colors(request: Request) -> Float:
    """The grounds of the scene's palette."""
    from twinlens.families.palettes import draw_palette

    return draw_palette(request.rng("palette")).grounds


def _frame(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """Rails around and bars across, and a sill board."""
    bar, deep = 0.06, 0.05
    z = sill + tall / 2
    parts = [board((bar, deep, tall + bar), (s * wide / 2, -deep / 2, z)) for s in (-1, 1)]
    parts += [board((wide + bar, deep, bar), (0, -deep / 2, z + s * tall / 2)) for s in (-1, 1)]
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    for i in range(1, columns):
        parts.append(board((0.03, 0.035, tall), (wide * (i / columns - 0.5), -0.03, z)))
    for j in range(1, rows):
        parts.append(board((wide, 0.035, 0.03), (0, -0.03, sill + tall * j / rows)))
    parts.append(board((wide + 0.2, 0.16, 0.03), (0, -0.08, sill - 0.045)))
    return shapes.merged(parts)


def _curtains(rng: Rng, wide: float, tall: float, sill: float) -> Mesh:
    """A folded cloth at either side, from above the window to the floor or the sill."""
    low = 0.03 if rng.random() < 0.6 else sill - 0.2
    high = sill + tall + 0.14
    made = []
    for side in (-1, 1):
        span = rng.uniform(0.3, 0.45)
        t = np.linspace(0, 1, 60)
        x = side * (wide / 2 + 0.14) - side * span * (t - 0.35)
        y = -0.1 - 0.03 * np.sin(2 * np.pi * t * rng.uniform(4, 6))
        z = np.array([low, high])
        points = np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)
        points = points if side < 0 else points[:, ::-1]
        slope = np.gradient(points[0, :, 1], points[0, :, 0])
        normal = np.stack([slope, -np.ones_like(slope), np.zeros_like(slope)], axis=-1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        uv = np.stack(np.broadcast_arrays(t * span * 1.4, z[:, None]), axis=-1).reshape(-1, 2)
        faces, vertices = shapes.grid(60, 2), points.reshape(-1, 3)
        normals = np.concatenate([normal, normal])
        made += [
            Mesh(vertices, faces, normals, uv),
            Mesh(vertices - 1e-3 * normals, faces[:, ::-1], -normals, uv),
        ]
    return shapes.merged(made)
