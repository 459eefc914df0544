"""Things in the air, at disparities spread evenly, before a wall or an open sky."""

import math

import numpy as np

from twinlens.families import fitting, lighting
from twinlens.families.bodies import draw_body, random_turn
from twinlens.families.catalogue import KINDS
from twinlens.families.family import Family, Request
from twinlens.families.finishes import coat
from twinlens.families.palettes import Palette, draw_palette
from twinlens.families.sky import painted_sky
from twinlens.families.stage import Stage, placed
from twinlens.families.surfaces import WALLS, Sheet, surface, wall_colors
from twinlens.families.view import View
from twinlens.geometry import Float, look_at, transform_points
from twinlens.scenes.scene import Mesh, Scene


def compose(request: Request) -> Scene:
    """One scene: bodies, then what stands behind them, then light."""
    palette = draw_palette(request.rng("palette"))
    view = _view(request)
    deep = fitting.ratio(request, 2.5, 8.0)
    stage = Stage()
    _bodies(request, stage, view, palette, deep)
    near = stage.seen(view).depth_range[0]
    open_air = request.rng("open air").random() < 0.4
    (_moon if open_air else _backdrop)(request, stage, view, palette, near * deep)
    _light(request, stage, view, deep, open_air)
    return fitting.finished(request, stage, view, FAMILY.about)


FAMILY = Family("things in the air, at disparities spread evenly", (14, 26), compose, 1.3)


def _view(request: Request) -> View:
    rng = request.rng("view")
    target = np.array([0.0, 1.0, rng.uniform(-0.15, 0.1)])
    return View(look_at(np.zeros(3), target), float(rng.uniform(42, 65)), request.aspect, request.width_px)


def _bodies(request: Request, stage: Stage, view: View, palette: Palette, deep: float) -> None:
    """Bodies at even steps of 1/depth from 1 to `deep`, the nearest towards the edges, none within another's reach."""
    count = request.count
    steps = (np.arange(count) + request.rng("steps").random(count)) / count
    inverse = 1 + (1 / (0.9 * deep) - 1) * steps
    taken: list[tuple[Float, float]] = []
    for index, depth in enumerate(1 / inverse):
        drawn = draw_body(request, ("body", index), palette)
        rng = request.rng("place", index)
        share = math.exp(rng.uniform(math.log(0.1), math.log(0.34)))
        reach = 0.5 * share * view.covered(float(depth))[0]
        size = reach / float(np.linalg.norm(drawn.solid.mesh.vertices, axis=1).max())
        for _ in range(40):
            x, y = rng.uniform(-1, 1, 2) * (1.0, 0.95)
            centre = view.at(float(x), float(y), float(depth) + reach)
            if all(np.linalg.norm(centre - other) > reach + radius for other, radius in taken):
                taken.append((centre, reach))
                pose = placed(random_turn(rng), centre, size)
                pixel = view.pixel(float(depth)) / size * drawn.size
                stage.add(drawn.name, drawn.solid.mesh, drawn.material(pixel), pose)
                break


def _backdrop(request: Request, stage: Stage, view: View, palette: Palette, far: float) -> None:
    """A large wall, turned a little."""
    rng = request.rng("backdrop")
    yaw, pitch = np.radians(rng.uniform(-25, 25)), np.radians(rng.uniform(-8, 8))
    pose = view.world_from_cam[:3, :3]
    u = pose @ [math.cos(yaw), 0, math.sin(yaw)]
    v = pose @ [math.sin(yaw) * math.sin(pitch), -math.cos(pitch), -math.sin(pitch) * math.cos(yaw)]
    v = v - (v @ u) * u

    def sheet(distance: float) -> Sheet:
        width, height = 2.2 * view.covered(distance * 1.4)
        centre = view.at(0, 0, distance)
        return Sheet(centre - 0.5 * (width * u + height * v), width * u, height * v)

    distance = fitting.solve_far(view, stage, lambda d: [sheet(d).mesh()], far, 0.8 * far)
    name, tile = WALLS[int(rng.integers(len(WALLS)))]
    wall = sheet(distance)
    tile *= 0.25 * view.covered(distance)[0]
    material = surface(request.rng("wall"), wall, view, name, wall_colors(rng, palette), tile)
    stage.add("backdrop", wall.mesh(), material)


def _moon(request: Request, stage: Stage, view: View, palette: Palette, far: float) -> None:
    """In the open air, a great ball is what is farthest."""
    rng = request.rng("moon")
    x, y = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.6), rng.uniform(-0.5, 0.3)
    share = rng.uniform(0.16, 0.28)
    solid = KINDS["ball"].make(rng)
    turn = random_turn(rng)

    def pose(distance: float) -> Float:
        return placed(turn, view.at(x, y, distance), 2 * share * float(view.covered(distance)[0]))

    def mesh(distance: float) -> list[Mesh]:
        return [Mesh(transform_points(pose(distance), solid.mesh.vertices), solid.mesh.faces)]

    distance = fitting.solve_far(view, stage, mesh, far, far)
    size = 2 * share * float(view.covered(distance)[0])
    names = ("granite", "marble", "stripes", "cloudy", "cloudy")
    made = coat(request.rng("moon", "texture"), solid, size, view.pixel(distance), palette, "matte", names)
    stage.add("moon", solid.mesh, made.plugin(), pose(distance))


def _light(request: Request, stage: Stage, view: View, deep: float, open_air: bool) -> None:
    rng = request.rng("light")
    if request.assets.hdris and lighting.given_environment(stage, rng, request.assets):
        return
    if open_air:
        lighting.environment(stage, painted_sky(rng), float(rng.uniform(0, 360)))
    else:
        lighting.key_and_fill(stage, rng, view.at(0, 0, 0.5 * deep), 0.6 * deep, -90.0)
