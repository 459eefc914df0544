"""The family "flying": bodies in the air at evenly spread disparities, before a wall or the open sky."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens.families import lighting
from twinlens.families.composition import Composition, Viewpoint, similarity
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.kinds import KINDS, draw_body
from twinlens.families.materials import body_material
from twinlens.families.surfaces import WALLS, Sheet, surface, wall_colors
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_TRIES = 40  # random places of a body before it is left out
NAMES = frozenset(("backdrop", "moon", *lighting.NAMES))
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    rng = scene.rng("view")
    target = np.array([0.0, 1.0, rng.uniform(-0.15, 0.1)])
    scene.look(np.zeros(3), target, rng.uniform(42, 65))
    depth_ratio = scene.depth_ratio(2.5, 8.0)
    open_air = scene.rng("open air").random() < 0.4
    wall = None if open_air else _Wall.draw(scene, depth_ratio)
    _add_bodies(scene, depth_ratio, wall)
    far = scene.visible_range()[0] * depth_ratio
    if wall is None:
        _add_moon(scene, far)
    else:
        _add_wall(scene, wall, far)
    rng = scene.rng("light")
    if scene.assets.hdris and lighting.user_environment(scene, rng):
        return
    if wall is None:
        sky = lighting.painted_sky(rng)
        lighting.environment(scene, sky, float(rng.uniform(0, 360)))
    else:
        middle = scene.view.at(0, 0, 0.5 * depth_ratio)
        lighting.one_kind(scene, rng, middle, 0.6 * depth_ratio, wall.open_side)


def _add_bodies(
    scene: Composition, depth_ratio: float, wall: "_Wall | None" = None
) -> None:
    """Add bodies at even steps of 1/depth from 1 m to 0.9 `depth_ratio`, in front of the wall.

    Their bounding spheres do not overlap.
    """
    count, view = scene.count, scene.view
    # One step of 1/depth for each body, at a random place within it.
    steps = (np.arange(count) + scene.rng("steps").random(count)) / count
    inverse = 1 + (1 / (0.9 * depth_ratio) - 1) * steps
    taken: list[tuple[Float, float]] = []
    for index, depth in enumerate((1 / inverse).tolist()):
        body = draw_body(scene, ("body", index))
        rng = scene.rng("place", index)
        # The radius of the bounding sphere, a share of the picture's width, and that of the mesh.
        reach = 0.5 * log_uniform(rng, 0.1, 0.34) * view.covered(depth)[0]
        radius = float(np.linalg.norm(body.solid.mesh.vertices, axis=1).max())
        size = reach / radius
        if scene.assets.keep_scale and not body.kind:
            size, reach = body.size, body.size * radius
        centre = _free_place(view, rng, depth + reach, reach, taken, wall)
        if centre is None:
            continue
        taken.append((centre, reach))
        pose = similarity(_random_rotation(rng), centre, size)
        # The body's material is that of `body.size`; it is enlarged together with its texels.
        look = body.material(view.pixel(depth) / size * body.size)
        scene.add(body.name, body.solid.mesh, look, pose)


def _free_place(
    view: Viewpoint,
    rng: Rng,
    depth: float,
    reach: float,
    taken: list[tuple[Float, float]],
    wall: "_Wall | None",
) -> Float | None:
    """A centre in the picture for a sphere of radius `reach` beside the spheres that are taken; None without one."""
    for _ in range(_TRIES):
        x, y = rng.uniform(-1, 1, 2) * (1.0, 0.95)
        centre = view.at(float(x), float(y), depth)
        is_free = all(
            np.linalg.norm(centre - other) > reach + radius for other, radius in taken
        )
        if is_free and (wall is None or wall.clearance(centre) > reach):
            return centre
    return None


def _random_rotation(rng: Rng) -> Float:
    """A uniform random rotation (3, 3). Source: Shoemake, Uniform Random Rotations, Graphics Gems III, 1992."""
    return np.asarray(Rotation.from_quat(np.roll(rng.normal(size=4), -1)).as_matrix())


@dataclass(frozen=True, eq=False)
class _Wall:
    """A wall behind the bodies, through a point on the camera's axis that is at least `nearest` metres away.

    yaw : radians, about the vertical; positive where its right is farther.
    u, v : unit vectors (3,) along it, to the right and upwards.
    """

    view: Viewpoint
    yaw: float
    u: Float
    v: Float
    nearest: float

    @staticmethod
    def draw(scene: Composition, depth_ratio: float) -> "_Wall":
        """A wall that is nowhere farther in the picture than `depth_ratio` metres."""
        view, yaw = scene.view, scene.yaw(depth_ratio)
        pitch = math.radians(scene.rng("pitch").normal(0, 5))
        # In the camera's frame, x right, y down, z forward: u turned about y by the yaw, v upwards and tilted.
        u_in_cam = [math.cos(yaw), 0, math.sin(yaw)]
        v_in_cam = [
            math.sin(yaw) * math.sin(pitch),
            -math.cos(pitch),
            -math.sin(pitch) * math.cos(yaw),
        ]
        world_from_cam = view.world_from_cam[:3, :3]
        u, v = world_from_cam @ u_in_cam, world_from_cam @ v_in_cam
        v = v - (v @ u) * u  # perpendicular to u
        wall = _Wall(view, yaw, u, v / np.linalg.norm(v), 0.0)
        # Bodies begin at 1 m, so that the wall is moved back, if at all, once they are placed.
        nearest = scene.backdrop_distance(wall.meshes, depth_ratio, 0.8 * depth_ratio)
        return replace(wall, nearest=nearest)

    @property
    def open_side(self) -> float:
        """-1 for the left, 1 for the right: where the wall is farther, and no light is behind it."""
        return math.copysign(1.0, self.yaw)

    def clearance(self, point: Float) -> float:
        """The distance of a point (3,) in front of the wall, metres; negative behind it."""
        normal = np.cross(self.u, self.v)
        return float((point - self.view.at(0, 0, self.nearest)) @ normal)

    def sheet(self, distance: float) -> Sheet:
        """The part of the wall that a pair of cameras may see."""
        # The farther side is seen at a grazing angle, up to 1.4 half pictures from the middle.
        grazing = math.cos(self.yaw) - 1.2 * self.view.half[0] * abs(math.sin(self.yaw))
        width, height = 2.2 * self.view.covered(distance * 1.4) / max(grazing, 0.25)
        centre = self.view.at(0, 0, distance)
        corner = centre - 0.5 * (width * self.u + height * self.v)
        return Sheet(corner, width * self.u, height * self.v)

    def meshes(self, distance: float) -> list[Mesh]:
        return [self.sheet(distance).mesh()]


def _add_wall(scene: Composition, wall: _Wall, far: float) -> None:
    rng, view = scene.rng("backdrop"), scene.view
    distance = scene.backdrop_distance(wall.meshes, far, wall.nearest)
    name, tile = one_of(rng, WALLS[1])  # never plain: other scenes have a plain sky
    tile *= 0.25 * view.covered(distance)[0]
    sheet, colors = wall.sheet(distance), wall_colors(rng, scene.palette)
    fitted, look = surface(scene, scene.rng("wall"), sheet, name, colors, tile)
    scene.add("backdrop", fitted.mesh(), look)


def _add_moon(scene: Composition, far: float) -> None:
    rng, view = scene.rng("moon"), scene.view
    side = one_of(rng, [-1.0, 1.0])
    x, y = side * rng.uniform(0.2, 0.6), rng.uniform(-0.5, 0.3)
    share = rng.uniform(0.16, 0.28)
    solid, turn = KINDS["ball"].make(rng), _random_rotation(rng)

    def size(distance: float) -> float:
        return 2 * share * float(view.covered(distance)[0])

    def pose(distance: float) -> Float:
        return similarity(turn, view.at(x, y, distance), size(distance))

    def meshes(distance: float) -> list[Mesh]:
        return [shapes.transformed(solid.mesh, pose(distance))]

    distance = scene.backdrop_distance(meshes, far, far)
    names = ("granite", "marble", "stripes", "cloudy", "cloudy")
    stream = scene.rng("moon", "texture")
    pixel = view.pixel(distance)
    look = body_material(
        stream, solid, size(distance), pixel, scene.palette, "matte", names
    )
    scene.add("moon", solid.mesh, look, pose(distance))
