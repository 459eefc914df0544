"""The family "tabletop": a still life of bodies at rest on a table, with a wall behind and light from one side."""

import math

import numpy as np

from twinlens.families import lighting
from twinlens.families.arrangement import Area, Placement, arrange, choose_rest
from twinlens.families.bodies import draw_body
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, one_of
from twinlens.families.family import Family, Request
from twinlens.families.stable_poses import StablePose
from twinlens.families.surfaces import FLOORS, TOPS, WALLS, Sheet, surface, wall_colors
from twinlens.families.view import View
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh, Scene

_TABLE_HEIGHT = 0.74
_THICKNESS = 0.035
_ORIGIN = np.zeros(3)


def compose(request: Request) -> Scene:
    """One scene: camera, bodies, then table, wall and floor at suitable distances, then lights."""
    depth_ratio = request.depth_ratio(2.0, 5.0)
    scene = Composition(request, _view(request, depth_ratio))
    for placement in _still_life(scene):
        body = placement.body
        scene.add(body.name, body.solid.mesh, body.material(scene.pixel_at(placement.place)), placement.pose)
    _add_surroundings(scene, depth_ratio)
    _light(scene)
    return scene.scene(FAMILY.about)


FAMILY = Family("bodies at rest on a table", (9, 18), compose, 1.8)


def _view(request: Request, depth_ratio: float) -> View:
    """Looking down at the origin; the larger the depth ratio, the nearer the camera and the wider its field."""
    rng = request.rng("view")
    pitch, fov = math.radians(rng.uniform(14, 36)), rng.uniform(38, 56)
    while fov > 12 and _nearest_share(pitch, fov, request.aspect) < 1.45 / depth_ratio:
        fov *= 0.94
    distance = rng.uniform(0.34, 0.46) / math.tan(math.radians(fov) / 2)
    eye = distance * np.array([0.0, -math.cos(pitch), math.sin(pitch)])
    aim = np.array([0.0, 0.0, 0.07])
    return request.view(eye + aim, aim, fov)


def _nearest_share(pitch: float, fov: float, aspect: float) -> float:
    """The depth of the table at the picture's lower edge over that at its middle."""
    half = math.atan(math.tan(math.radians(fov) / 2) / aspect)
    return math.sin(pitch) * math.cos(half) / math.sin(pitch + half)


def _half_width(scene: Composition) -> float:
    """Half the width of the picture's field at the origin, metres."""
    return float(0.5 * scene.view.covered(scene.view.depth_of(_ORIGIN))[0])


def _still_life(scene: Composition) -> list[Placement]:
    """Bodies in a loose group around the origin, the large ones first and towards the back."""
    bodies = []
    for index in range(scene.request.count):
        body = draw_body(scene, ("body", index))
        rest = choose_rest(body, scene.rng("rest", index))
        if rest is not None:
            bodies.append((body, rest, scene.rng("place", index)))
    bodies.sort(key=lambda each: -each[1].height * np.ptp(each[1].points[:, 0]))
    reach = np.array([0.8, 0.7]) * _half_width(scene)

    def sample(rng: Rng, rest: StablePose) -> Float:
        back = 0.5 * min(rest.height / 0.3, 1.0) - 0.15
        return np.asarray(np.clip(rng.normal([0.0, back], [0.55, 0.45]), -1, 1) * reach)

    def contains(outline: Float) -> bool:
        return bool((np.abs(outline / (1.15 * reach)) < 1).all())

    spacing = float(scene.rng("spacing").uniform(0.003, 0.02))
    return arrange(bodies, Area(sample, contains, 0.0, spacing, 0.3))


def _rectangle(low: tuple[float, float, float], u: tuple[float, float, float], v: tuple[float, float, float]) -> Sheet:
    return Sheet(np.array(low), np.array(u), np.array(v))


def _add_surroundings(scene: Composition, depth_ratio: float) -> None:
    """Add the table, and the wall at the distance that gives the depth ratio; a floor where the table has an edge."""
    rng, view = scene.rng("surroundings"), scene.view
    half = _half_width(scene)
    behind = max((float(vertices[:, 1].max()) for vertices, _ in scene.triangles()), default=half) + 0.02
    near_y = float(view.eye[1])
    edge = behind + rng.uniform(0.03, 0.25) if rng.random() < 0.6 else None
    table_half = half * rng.uniform(1.6, 3.0)

    def sheets(distance: float) -> dict[str, Sheet]:
        y = max(near_y + distance, behind + 0.05)
        width = max(3.0 * view.covered(distance)[0], 2.2 * table_half)
        far = y if edge is None else min(edge, y)
        high = 1.2 * view.covered(distance)[1] + 1.0 + _TABLE_HEIGHT
        made = {
            "table": _rectangle((-table_half, near_y, 0.0), (2 * table_half, 0, 0), (0, far - near_y, 0.0)),
            "wall": _rectangle((-width / 2, y, -_TABLE_HEIGHT), (width, 0, 0), (0, 0, high)),
        }
        if edge is not None:
            made["floor"] = _rectangle((-width / 2, near_y, -_TABLE_HEIGHT), (width, 0, 0), (0, y - near_y, 0))
        return made

    def meshes(distance: float) -> list[Mesh]:
        return [sheet.mesh() for sheet in sheets(distance).values()]

    far = scene.z_buffer(meshes(depth_ratio)).depth_range[0] * depth_ratio
    _add_sheets(scene, sheets(scene.backdrop_distance(meshes, far, far)))


def _add_sheets(scene: Composition, sheets: dict[str, Sheet]) -> None:
    rng = scene.rng("furnish")
    for name, patterns, contrast in (("table", TOPS, 0.7), ("wall", WALLS, 0.35), ("floor", FLOORS, 0.5)):
        if name not in sheets:
            continue
        kind, tile = one_of(rng, patterns)
        colors = wall_colors(scene.rng(f"{name} colours"), scene.palette, contrast)
        finish, roughness = "matte", 0.25
        if name == "table":
            finish = one_of(rng, ["matte", "satin", "satin", "glossy"])
            roughness = float(rng.uniform(0.1, 0.35))
        made = surface(scene, (name,), sheets[name], kind, colors, tile, finish, roughness)
        scene.add(name, sheets[name].mesh(_THICKNESS if name == "table" else 0.0), made)


def _light(scene: Composition) -> None:
    rng = scene.rng("light")
    if scene.request.assets.hdris and rng.random() < 0.6 and lighting.user_environment(scene, rng):
        return
    light = lighting.daylight if rng.random() < 0.25 else lighting.key_and_fill
    light(scene, rng, np.array([0.0, 0.0, 0.1]), _half_width(scene))
