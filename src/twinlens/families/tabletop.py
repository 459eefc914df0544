"""The family "tabletop": a still life of bodies at rest on a table, with a wall behind and light from one side."""

import math
from dataclasses import dataclass

import numpy as np

from twinlens.families import lighting
from twinlens.families.arrangement import Area, arrange, bodies_at_rest
from twinlens.families.composition import Composition, Viewpoint
from twinlens.families.draws import Rng, one_of
from twinlens.families.kinds import Body
from twinlens.families.relief import draw_front
from twinlens.families.surfaces import (
    FLOORS,
    TOPS,
    WALLS,
    Sheet,
    surface,
    surface_colors,
    surface_pattern,
)
from twinlens.families.things import names_in_scenes, things_for
from twinlens.families.things.ground import Ground, count_among_bodies
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import StablePose

_TABLE_HEIGHT = 0.74  # metres, of the table's top above the floor
_THICKNESS = 0.035  # metres, of the table's top
_DENTS = 0.004, 0.022  # metres, the depth of those of a rough table
_NARROWEST_DEG = 12  # the field of view is not narrowed below it
_MOST_THINGS = 20  # on a table
_LOWEST = 0.03  # metres above the table, of the end of a wall below the sky
_TABLE_FINISHES = ("matte", "satin", "satin", "clearcoat")
_PATTERNS = {"table": (TOPS, 0.8), "wall": (WALLS, 0.45), "floor": (FLOORS, 0.6)}
"""The patterns of each surface, and the contrast of their colours."""

Vector = tuple[float, float, float]


NAMES = names_in_scenes() | {"table", "wall", "floor", *lighting.NAMES}
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    """Add the bodies, then table, wall and floor at suitable distances, then lights."""
    depth_ratio = scene.depth_ratio(2.0, 5.0)
    _set_view(scene, depth_ratio)
    depth = float(scene.view.depth(np.zeros((1, 3)))[0])
    half = float(0.5 * scene.view.covered(depth)[0])
    _add_still_life(scene, half)
    yaw = scene.yaw(depth_ratio)
    _add_surroundings(scene, depth_ratio, half, yaw)
    _light(scene, half, math.copysign(1.0, yaw))


def _light(scene: Composition, half: float, side: float) -> None:
    """Light the still life, `half` metres to each side, by a user's environment or from one `side`, -1 or 1."""
    rng = scene.rng("light")
    wants_user_environment = bool(scene.assets.hdris) and rng.random() < 0.6
    if wants_user_environment and lighting.user_environment(scene, rng):
        return
    middle, outdoors = np.array([0.0, 0.0, 0.1]), math.isfinite(scene.skyline())
    lighting.one_kind(scene, rng, middle, half, side, outdoors)


def _set_view(scene: Composition, depth_ratio: float) -> None:
    """Look down at the origin; the larger the depth ratio, the nearer the camera and the wider its field."""
    rng = scene.rng("view")
    pitch, fov_deg = math.radians(rng.uniform(9, 46)), rng.uniform(38, 56)
    while fov_deg > _NARROWEST_DEG:
        half = math.atan(math.tan(math.radians(fov_deg) / 2) / scene.aspect)
        # The depth of the table at the picture's lower edge over that at its middle.
        nearest = math.sin(pitch) * math.cos(half) / math.sin(pitch + half)
        if nearest >= 1.45 / depth_ratio:
            break
        fov_deg *= 0.94
    distance = rng.uniform(0.34, 0.46) / math.tan(math.radians(fov_deg) / 2)
    aim = np.array([0.0, 0.0, 0.07])
    backwards = np.array([0.0, -math.cos(pitch), math.sin(pitch)])
    scene.look(distance * backwards + aim, aim, fov_deg)


def _add_things(scene: Composition, half: float) -> Ground:
    """Add plants and other fine things to the table: none in many scenes, most of the objects in some."""
    camera = float(scene.view.depth(np.zeros((1, 3)))[0])
    ground = Ground(scene, 0.0, 0.005, nearest=0.5 * camera)
    count = count_among_bodies(scene, "things", min(scene.count, _MOST_THINGS))

    def place(rng: Rng, size: float) -> Float:
        # The larger a thing, the farther back: it would hide all others.
        back = 0.9 * min(size / half, 1.0) - 0.3
        return half * rng.normal([0.0, back], [0.6, 0.45])

    sizes = 0.2 * half, 1.4 * half
    ground.scatter("things", things_for("table"), count, place, sizes)
    return ground


def _add_still_life(scene: Composition, half: float) -> None:
    """Add things, then bodies in a loose group around the origin, the large ones first and towards the back."""
    ground = _add_things(scene, half)
    count = scene.count - ground.count
    bodies = bodies_at_rest(scene, "body", [(index,) for index in range(count)])

    def frontal_area(resting: tuple[Body, StablePose, Rng]) -> float:
        _, rest, _ = resting
        return float(rest.height * np.ptp(rest.points[:, 0]))

    bodies.sort(key=frontal_area, reverse=True)

    def sample(rng: Rng, rest: StablePose) -> Float:
        # High bodies, of 30 cm and more, are farther back than low ones.
        back = 0.5 * min(rest.height / 0.3, 1.0) - 0.15
        return np.asarray(np.clip(rng.normal([0.0, back], [0.55, 0.45]), -1, 1))

    area = Area(
        middle=np.zeros(2),
        half=np.array([0.8, 0.7]) * half,
        height=0.0,
        spacing=float(scene.rng("spacing").uniform(0.003, 0.02)),
        stacked=0.3,
        overhang=1.15,
        sample=sample,
        filled=ground.filled,
    )
    for placement in arrange(bodies, area):
        body = placement.body
        look = body.material(scene.pixel_at(placement.at.place))
        scene.add(body.name, body.solid.mesh, look, placement.pose)


def _add_surroundings(
    scene: Composition, depth_ratio: float, half: float, yaw: float
) -> None:
    """Add the table, and the wall at the distance that gives the depth ratio; a floor where the table has an edge."""
    surroundings = _Surroundings.draw(scene, half, yaw)

    def meshes(distance: float) -> list[Mesh]:
        return [sheet.mesh() for sheet in surroundings.sheets(distance).values()]

    near, _ = scene.visible_range(meshes(depth_ratio))
    far = near * depth_ratio
    distance = scene.backdrop_distance(meshes, far, far)
    rng = scene.rng("furnish")
    for name, sheet in surroundings.sheets(distance).items():
        patterns, contrast = _PATTERNS[name]
        kind, tile = surface_pattern(scene, rng, patterns)
        colors = surface_colors(scene, scene.rng(f"{name} colours"), contrast)
        finish, thickness = "matte", 0.0
        if name == "table":
            finish, thickness = one_of(rng, _TABLE_FINISHES), _THICKNESS
        stream = scene.rng(name)
        fitted, look = surface(scene, stream, sheet, kind, colors, tile, finish)
        front = None
        if name == "table" and scene.is_rough:
            front = draw_front(scene.rng("dents"), fitted, _DENTS)
        scene.add(name, fitted.mesh(thickness, front), look)


@dataclass(frozen=True)
class _Surroundings:
    """Table, wall and floor around a still life, metres. The table top is at z = 0; the camera looks along +y.

    camera_y : of the camera; the table begins below it.
    yaw : of the wall about the vertical, radians; positive where its right is farther.
    behind : along the wall's normal, just behind the hindmost body.
    edge_y : of the far edge of the table; None where the table reaches the wall.
    skyline : see `Composition.skyline`.
    """

    view: Viewpoint
    camera_y: float
    yaw: float
    behind: float
    edge_y: float | None
    table_half: float
    skyline: float

    @staticmethod
    def draw(scene: Composition, half: float, yaw: float) -> "_Surroundings":
        """Of the bodies of a scene; most tables have an edge."""
        rng = scene.rng("surroundings")
        hindmost = [float(vertices[:, 1].max()) for vertices, _ in scene.triangles]
        behind_y = max(hindmost, default=half) + 0.02
        backwards = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        reaches = [
            float((vertices @ backwards).max()) for vertices, _ in scene.triangles
        ]
        behind = max(reaches, default=half) + 0.07
        has_edge = rng.random() < 0.6
        edge_y = behind_y + rng.uniform(0.03, 0.25) if has_edge else None
        table_half = half * rng.uniform(1.6, 3.0)
        camera_y = float(scene.view.eye[1])
        return _Surroundings(
            scene.view, camera_y, yaw, behind, edge_y, table_half, scene.skyline()
        )

    def sheets(self, distance: float) -> dict[str, Sheet]:
        """The rectangles by name, with the wall `distance` metres from the camera but behind all bodies."""
        covered_width, covered_height = self.view.covered(distance)
        sin, cos = math.sin(self.yaw), math.cos(self.yaw)
        # Where the wall crosses the plane x = 0; the camera is in it.
        wall_y = max(self.camera_y + distance, self.behind / cos)
        # Twice the picture's field, as the right camera sees more on one side, and more where the wall is grazed.
        grazing = max(cos - 1.2 * self.view.half[0] * abs(sin), 0.25)
        width = max(2.0 * covered_width, 2.2 * self.table_half) / grazing
        height = 1.2 * covered_height / grazing + 1.0 + _TABLE_HEIGHT
        if math.isfinite(self.skyline):
            top = float(self.view.at(0.0, self.skyline, distance)[2])
            height = max(top, _LOWEST) + _TABLE_HEIGHT
        deepest_y = wall_y + 0.5 * width * abs(sin)
        # A table or floor ends behind the wall, which hides the rest.
        table_y = deepest_y if self.edge_y is None else self.edge_y

        def sheet(corner: Vector, across: float, along: Vector) -> Sheet:
            return Sheet(np.array(corner), np.array([across, 0, 0]), np.array(along))

        half_wall = 0.5 * width * np.array([cos, sin, 0.0])
        foot = np.array([0.0, wall_y, -_TABLE_HEIGHT]) - half_wall

        table_corner = (-self.table_half, self.camera_y, 0.0)
        table_depth = (0, table_y - self.camera_y, 0)
        sheets = {
            "table": sheet(table_corner, 2 * self.table_half, table_depth),
            "wall": Sheet(foot, 2 * half_wall, np.array([0, 0, height])),
        }
        if self.edge_y is not None:
            floor_corner = (-width / 2, self.camera_y, -_TABLE_HEIGHT)
            floor_depth = (0, deepest_y - self.camera_y, 0)
            sheets["floor"] = sheet(floor_corner, width, floor_depth)
        return sheets
