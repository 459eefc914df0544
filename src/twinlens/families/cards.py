"""Test charts in a laboratory: boards, steps, wedges and waves on a floor, each at its own distance and slant."""

import math
from itertools import pairwise

import numpy as np

from twinlens.families import fitting, lighting
from twinlens.families.bodies import own_texture, shrunk
from twinlens.families.charts import draw_chart
from twinlens.families.family import Family, Request
from twinlens.families.finishes import material, metal_pixels, texels
from twinlens.families.furniture import board
from twinlens.families.palettes import Palette, draw_palette
from twinlens.families.resting import Rng, gap, outline
from twinlens.families.stage import Stage, world
from twinlens.families.surfaces import FLOORS, WALLS, Sheet, surface, wall_colors
from twinlens.families.view import View, look
from twinlens.geometry import Float, look_at, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Bitmap, Mesh, Plugin, Scene


def compose(request: Request) -> Scene:
    """One scene: charts at even steps of 1/depth, the floor they stand on, the wall behind, light."""
    palette = draw_palette(request.rng("palette"))
    deep = fitting.ratio(request, 2.2, 6.0)
    view = _view(request)
    stage = Stage()
    _charts(request, stage, view, palette, deep)
    _surroundings(request, stage, view, palette, deep)
    rng = request.rng("light")
    light = lighting.daylight if rng.random() < 0.3 else lighting.key_and_fill
    light(stage, rng, np.array([0.0, 0.55 * deep, 0.3]), 0.42 * deep, -90.0)
    return fitting.finished(request, stage, view, FAMILY.about)


FAMILY = Family("test charts, steps and waves at set distances and slants", (5, 11), compose, 1.8)


def _view(request: Request) -> View:
    """Level or looking down a little, eyes over the floor z = 0; charts stand at y > 0."""
    rng = request.rng("view")
    eye = np.array([0.0, 0.0, rng.uniform(0.45, 0.7)])
    target = eye + np.array([0.0, 1.0, -rng.uniform(0.05, 0.3)])
    return View(look_at(eye, target), float(rng.uniform(45, 62)), request.aspect, request.width_px)


def _charts(request: Request, stage: Stage, view: View, palette: Palette, deep: float) -> None:
    """Nearest first, by turns left and right, none on the floor of another."""
    count = request.count
    rng = request.rng("steps")
    steps = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    depths = 1 / (1 + (1 / (0.88 * deep) - 1) * steps)
    taken: list[Float] = []
    for index, depth in enumerate(depths):
        place = request.rng("place", index)
        name = str(place.choice(list(BODIES), p=[0.62, 0.14, 0.12, 0.12]))
        size = float(place.uniform(0.26, 0.5)) * view.covered(float(depth))[1]
        mesh, height = BODIES[name](request.rng("shape", index), size)
        for attempt in range(30):
            side = (-1) ** (index + attempt) * place.uniform(0.05, 0.95)
            at = view.at(side, 0.0, float(depth)) * [1, 1, 0]
            pose = translation(at) @ rotation(np.array([0.0, 0, 1]), float(np.clip(place.normal(0, 28), -60, 60)))
            ground = transform_points(pose, mesh.vertices)
            shadow = outline(ground[:, :2])
            if float(view.depth(ground).min()) > 0.92 and all(gap(shadow, other) > 0.01 for other in taken):
                taken.append(shadow)
                _add(request, stage, view, palette, name, index, mesh, pose, height)
                break


def _add(
    request: Request,
    stage: Stage,
    view: View,
    palette: Palette,
    name: str,
    index: int,
    mesh: Mesh,
    pose: Float,
    height: float,
) -> None:
    pixel = view.pixel(max(float(view.depth(pose[None, :3, 3])[0]), 0.3))
    stage.add(name, mesh, _print(request, index, palette, height, pixel), pose)
    if name == "chart":
        steel = material("metal", Bitmap(metal_pixels(request.rng("foot", index), 32, "metal")), 0.2)
        stage.add("chart-foot", _foot(mesh), steel, pose)


def _print(request: Request, index: int, palette: Palette, height: float, pixel: float) -> Plugin:
    """A chart's picture, its finest mark no less than two pixels."""
    n = texels(height, pixel)
    own = own_texture(request, "chart", index)
    pixels = shrunk(own, n) if own is not None else draw_chart(request.rng("chart", index), n, palette)
    rng = request.rng("finish", index)
    return material(str(rng.choice(["matte", "matte", "satin"])), Bitmap(pixels, wrap="mirror"), 0.3)


def _chart(rng: Rng, size: float) -> tuple[Mesh, float]:
    """A board leaning back or forward a little, held above the floor by its foot."""
    w, h, thick = size * rng.uniform(0.7, 1.3), size, 0.02 * size
    made = board((w, thick, h), (0, 0, 0))
    uv = np.column_stack([made.vertices[:, 0] / w + 0.5, made.vertices[:, 2] / h + 0.5])
    lean = rotation(np.array([1.0, 0, 0]), float(rng.uniform(-25, 35)))
    placed = shapes.transformed(Mesh(made.vertices, made.faces, made.normals, uv), lean)
    rise = 0.12 * size - float(placed.vertices[:, 2].min())
    return shapes.transformed(placed, translation(np.array([0, 0, rise]))), size


def _foot(chart: Mesh) -> Mesh:
    """A plate on the floor and two posts up to the board's lower edge."""
    low, high = chart.vertices.min(axis=0), chart.vertices.max(axis=0)
    w = high[0] - low[0]
    edge = chart.vertices[chart.vertices[:, 2] < low[2] + 0.03 * (high[2] - low[2])].mean(axis=0)
    thick = 0.02 * w
    posts = [board((thick, thick, low[2] + 0.2 * thick), (s * 0.3 * w, edge[1], low[2] / 2)) for s in (-1, 1)]
    return shapes.merged([board((0.8 * w, 0.3 * w, 0.5 * thick), (0, edge[1], 0.25 * thick)), *posts])


def _extruded(profile: Float, width: float) -> Mesh:
    """A strip of (y, z) points, bottom to top as it is seen from the front, drawn out along x; v by length."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    parts = []
    for a, b, low, high in zip(profile[:-1], profile[1:], length[:-1], length[1:], strict=True):
        x = np.array([-width / 2, width / 2, width / 2, -width / 2])
        corners = np.column_stack([x, [a[0], a[0], b[0], b[0]], [a[1], a[1], b[1], b[1]]])
        normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        uv = np.column_stack([x / width + 0.5, np.array([low, low, high, high]) / length[-1]])
        quad = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
        parts.append(Mesh(corners, quad, np.tile(normal / np.linalg.norm(normal), (4, 1)), uv))
    return shapes.merged([*parts, *_cheeks(profile, width)])


def _cheeks(profile: Float, width: float) -> list[Mesh]:
    """The two sides of an extruded strip, from each of its points back to its rear edge on the floor."""
    rear = profile[:, 0].max()
    made = []
    for side in (-1.0, 1.0):
        for a, b in pairwise(profile):
            yz = np.array([a, [rear, a[1]], [rear, b[1]], b])
            corners = np.column_stack([np.full(4, side * width / 2), yz])
            quad = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
            uv = (yz - profile.min(axis=0)) / width
            made.append(Mesh(corners, quad if side > 0 else quad[:, ::-1], np.tile([side, 0.0, 0.0], (4, 1)), uv))
    back = np.array(
        [[-1, rear, profile[0, 1]], [1, rear, profile[0, 1]], [1, rear, profile[-1, 1]], [-1, rear, profile[-1, 1]]]
    )
    quad = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.uint32)
    made.append(Mesh(back * [width / 2, 1, 1], quad, np.tile([0.0, 1.0, 0.0], (4, 1)), np.zeros((4, 2))))
    return made


def _steps(rng: Rng, size: float) -> tuple[Mesh, float]:
    """A flight of equal steps, rising to the back."""
    count = int(rng.integers(3, 8))
    rise, run = 0.8 * size / count, size * rng.uniform(0.6, 1.2) / count
    corners = [(i * run, j * rise) for i in range(count) for j in (i, i + 1)]
    profile = np.array([*corners, (count * run, count * rise)])
    return _extruded(profile - [0.5 * count * run, 0], size * rng.uniform(0.7, 1.1)), size * 1.6


def _wedge(rng: Rng, size: float) -> tuple[Mesh, float]:
    """One slope."""
    return _extruded(np.array([(-0.5, 0.0), (-0.5, 0.02), (0.5, rng.uniform(0.5, 0.9))]) * size, size), size


def _wave(rng: Rng, size: float) -> tuple[Mesh, float]:
    """A screen folded in waves, standing."""
    count, deep = int(rng.integers(2, 6)), size * rng.uniform(0.04, 0.1)
    t = np.linspace(0, 1, 16 * count + 1)
    width = size * rng.uniform(1.0, 1.5)
    profile = np.column_stack([deep * np.sin(2 * np.pi * count * t), (t - 0.5) * width])
    standing = _extruded(profile, 0.85 * size)
    turn = rotation(np.array([0.0, 1, 0]), 90.0)
    made = shapes.transformed(standing, turn)
    return shapes.transformed(made, translation(np.array([0, 0, 0.425 * size]))), size


BODIES = {"chart": _chart, "steps": _steps, "wedge": _wedge, "wave": _wave}


def _surroundings(request: Request, stage: Stage, view: View, palette: Palette, deep: float) -> None:
    """A floor from the camera to a wall that stands where the far end is."""
    rng = request.rng("surroundings")
    yaw = math.radians(rng.uniform(-18, 18))
    along = np.array([math.cos(yaw), math.sin(yaw), 0.0])

    def sheets(distance: float) -> tuple[Sheet, Sheet]:
        wide = 4.0 * view.covered(distance)[0]
        middle = np.array([0.0, distance, 0.0])
        wall = Sheet(middle - 0.5 * wide * along, wide * along, np.array([0, 0, 1.6 * view.covered(distance)[1] + 1]))
        floor = Sheet(np.array([-wide / 2, -0.2, 0.0]), np.array([wide, 0, 0]), np.array([0, 1.6 * distance + 0.2, 0]))
        return floor, wall

    near = look(view, [world(thing) for thing in stage.objects] + [_mesh(sheets(deep)[0])]).depth_range[0]
    distance = fitting.solve_far(view, stage, lambda d: [s.mesh() for s in sheets(d)], near * deep, near * deep)
    for name, sheet, kinds, quiet in zip(
        ("floor", "wall"), sheets(distance), (FLOORS, WALLS), (0.45, 0.25), strict=True
    ):
        kind, tile = kinds[int(rng.integers(len(kinds)))]
        colors = wall_colors(request.rng(name, "colours"), palette, quiet)
        tile *= 0.3 * view.covered(distance)[0]
        stage.add(name, sheet.mesh(), surface(request.rng(name), sheet, view, kind, colors, tile))


def _mesh(sheet: Sheet) -> tuple[Float, shapes.Faces]:
    mesh = sheet.mesh()
    return mesh.vertices, mesh.faces
