"""A still life: bodies at rest on a table, a wall behind, light from one side."""

import math
from dataclasses import dataclass

import numpy as np

from twinlens.families import fitting, lighting
from twinlens.families.arranging import Standing, arrange, choose_rest
from twinlens.families.bodies import Drawn, draw_body
from twinlens.families.family import Family, Request
from twinlens.families.palettes import Palette, draw_palette
from twinlens.families.resting import Rest, Rng
from twinlens.families.stage import Stage
from twinlens.families.surfaces import FLOORS, TOPS, WALLS, Sheet, surface, wall_colors
from twinlens.families.view import View
from twinlens.geometry import Float, look_at
from twinlens.scenes.scene import Mesh, Scene

_TABLE_HEIGHT = 0.74
_THICKNESS = 0.035


def compose(request: Request) -> Scene:
    """One scene: camera, bodies, then table, wall and floor to suit them, then light."""
    palette = draw_palette(request.rng("palette"))
    deep = fitting.ratio(request, 2.0, 5.0)
    view = _view(request, deep)
    stage = Stage()
    for standing in _still_life(request, view, palette):
        drawn = standing.drawn
        pixel = view.pixel(float(view.depth(standing.place[None])[0]))
        stage.add(drawn.name, drawn.solid.mesh, drawn.material(pixel), standing.pose)
    _surroundings(request, stage, view, palette, deep)
    _light(request, stage, view)
    return fitting.finished(request, stage, view, FAMILY.about)


FAMILY = Family("bodies at rest on a table", (9, 18), compose, 1.8)


def _view(request: Request, deep: float) -> View:
    """Looking down at the origin, closer with a wide field or farther with a narrow one, as the depths demand."""
    rng = request.rng("view")
    pitch, fov = math.radians(rng.uniform(14, 36)), rng.uniform(38, 56)
    while fov > 12 and _nearest_share(pitch, fov, request.aspect) < 1.45 / deep:
        fov *= 0.94
    distance = rng.uniform(0.34, 0.46) / math.tan(math.radians(fov) / 2)
    eye = distance * np.array([0.0, -math.cos(pitch), math.sin(pitch)])
    aim = np.array([0.0, 0.0, 0.07])
    return View(look_at(eye + aim, aim), float(fov), request.aspect, request.width_px)


def _nearest_share(pitch: float, fov: float, aspect: float) -> float:
    """The depth of the table at the picture's lower edge over that at its middle."""
    half = math.atan(math.tan(math.radians(fov) / 2) / aspect)
    return math.sin(pitch) * math.cos(half) / math.sin(pitch + half)


def _still_life(request: Request, view: View, palette: Palette) -> list[Standing]:
    """Large bodies first and rather behind, in a loose group around the middle of what is seen."""
    bodies: list[tuple[Drawn, Rest, Rng]] = []
    for index in range(request.count):
        drawn = draw_body(request, ("body", index), palette)
        rest = choose_rest(drawn, request.rng("rest", index))
        if rest is not None:
            bodies.append((drawn, rest, request.rng("place", index)))
    bodies.sort(key=lambda body: -body[1].height * np.ptp(body[1].points[:, 0]))
    half = 0.5 * view.covered(float(view.depth(np.zeros((1, 3)))[0]))
    reach = np.array([0.8 * half[0], 0.7 * half[0]])

    def where(rng: Rng, rest: Rest) -> Float:
        back = 0.5 * min(rest.height / 0.3, 1.0) - 0.15
        return np.asarray(np.clip(rng.normal([0.0, back], [0.55, 0.45]), -1, 1) * reach)

    def allowed(outline: Float) -> bool:
        return bool((np.abs(outline / (1.15 * reach)) < 1).all())

    spacing = float(request.rng("spacing").uniform(0.003, 0.02))
    return arrange(bodies, where, 0.0, allowed, spacing, 0.3)


@dataclass(frozen=True, eq=False)
class _Setting:
    """How far the table and the things behind it reach: the y of the table's far edge, half its width, and the wall."""

    edge: float | None
    half_width: float
    near: float

    def table(self, wall: float) -> Sheet:
        far = wall if self.edge is None else min(self.edge, wall)
        return Sheet(
            np.array([-self.half_width, self.near, 0.0]),
            np.array([2 * self.half_width, 0, 0]),
            np.array([0, far - self.near, 0.0]),
        )

    def wall(self, y: float, width: float, height: float) -> Sheet:
        return Sheet(
            np.array([-width / 2, y, -_TABLE_HEIGHT]), np.array([width, 0, 0]), np.array([0, 0, height + _TABLE_HEIGHT])
        )

    def floor(self, y: float, width: float) -> Sheet:
        return Sheet(
            np.array([-width / 2, self.near, -_TABLE_HEIGHT]), np.array([width, 0, 0]), np.array([0, y - self.near, 0])
        )


def _surroundings(request: Request, stage: Stage, view: View, palette: Palette, deep: float) -> None:
    rng = request.rng("surroundings")
    half = 0.5 * view.covered(float(view.depth(np.zeros((1, 3)))[0]))[0]
    behind = max([float(_world(stage, i)[:, 1].max()) for i in range(len(stage.objects))], default=half) + 0.02
    near_y = float(view.eye[1])
    free = rng.random() < 0.6
    setting = _Setting(behind + rng.uniform(0.03, 0.25) if free else None, half * rng.uniform(1.6, 3.0), near_y)

    def sheets(distance: float) -> list[Sheet]:
        y = max(near_y + distance, behind + 0.05)
        width = max(3.0 * view.covered(distance)[0], 2.2 * setting.half_width)
        around = [setting.table(y), setting.wall(y, width, 1.2 * view.covered(distance)[1] + 1.0)]
        return [*around, setting.floor(y, width)] if setting.edge is not None else around

    def meshes(distance: float) -> list[Mesh]:
        return [sheet.mesh() for sheet in sheets(distance)]

    near = _near(stage, view, meshes(deep))
    distance = fitting.solve_far(view, stage, meshes, near * deep, near * deep)
    table, wall, *floor = sheets(distance)
    _furnish(request, stage, view, palette, table, wall, floor)


def _world(stage: Stage, index: int) -> Float:
    from twinlens.families.stage import world

    return world(stage.objects[index])[0]


def _near(stage: Stage, view: View, around: list[Mesh]) -> float:
    from twinlens.families.stage import world
    from twinlens.families.view import look

    bodies = [world(thing) for thing in stage.objects] + [(mesh.vertices, mesh.faces) for mesh in around]
    return look(view, bodies).depth_range[0]


def _furnish(
    request: Request, stage: Stage, view: View, palette: Palette, table: Sheet, wall: Sheet, floor: list[Sheet]
) -> None:
    rng = request.rng("furnish")
    name, tile = TOPS[int(rng.integers(len(TOPS)))]
    colors = wall_colors(request.rng("table colours"), palette, 0.7)
    finish = str(rng.choice(["matte", "satin", "satin", "glossy"]))
    top = surface(request.rng("table"), table, view, name, colors, tile, finish, float(rng.uniform(0.1, 0.35)))
    stage.add("table", table.mesh(_THICKNESS), top)
    name, tile = WALLS[int(rng.integers(len(WALLS)))]
    colors = wall_colors(request.rng("wall colours"), palette)
    stage.add("wall", wall.mesh(), surface(request.rng("wall"), wall, view, name, colors, tile))
    for sheet in floor:
        name, tile = FLOORS[int(rng.integers(len(FLOORS)))]
        colors = wall_colors(request.rng("floor colours"), palette, 0.5)
        stage.add("floor", sheet.mesh(), surface(request.rng("floor"), sheet, view, name, colors, tile))


def _light(request: Request, stage: Stage, view: View) -> None:
    rng = request.rng("light")
    if request.assets.hdris and rng.random() < 0.6 and lighting.given_environment(stage, rng, request.assets):
        return
    half = 0.5 * view.covered(float(view.depth(np.zeros((1, 3)))[0]))[0]
    light = lighting.daylight if rng.random() < 0.25 else lighting.key_and_fill
    light(stage, rng, np.array([0.0, 0.0, 0.1]), half, -90.0)
