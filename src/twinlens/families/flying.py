"""The family "flying": bodies in the air at evenly spread disparities, before a wall or the open sky."""

import math
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens.families import lighting
from twinlens.families.composition import Composition, Viewpoint, similarity
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.furniture import Piece
from twinlens.families.kinds import KINDS, draw_body
from twinlens.families.materials import body_material
from twinlens.families.surfaces import (
    WALLS,
    Sheet,
    surface,
    surface_colors,
    surface_pattern,
)
from twinlens.families.things import (
    THINGS,
    add_thing,
    make_thing,
    names_in_scenes,
    things_for,
)
from twinlens.families.things.ground import PLANTS
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_TRIES = 40  # random places of a body before it is left out
_SIZES, _SIZES_OF_THINGS = (0.1, 0.34), (0.15, 0.6)  # shares of the picture's width
_WITHOUT_THINGS = 0.35  # share of the scenes
NAMES = names_in_scenes() | {"backdrop", "moon", *lighting.NAMES}
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
    """Add bodies and things at even steps of 1/depth from 1 m to 0.9 `depth_ratio`, in front of the wall.

    Their bounding spheres do not overlap.
    """
    count = scene.count
    # One step of 1/depth for each body, at a random place within it.
    steps = (np.arange(count) + scene.rng("steps").random(count)) / count
    inverse = 1 + (1 / (0.9 * depth_ratio) - 1) * steps
    models = _draw_models(scene)
    air = _Air(scene.view, wall)
    for index, depth in enumerate((1 / inverse).tolist()):
        rng, model = scene.rng("place", index), models[index]
        if model is None:
            _add_body(scene, air, index, depth, rng)
            continue
        if not scene.has_room_for(air.faces + model.faces):
            continue
        reach = air.reach(depth, log_uniform(rng, *_SIZES_OF_THINGS))
        centre = air.take(rng, depth, reach)
        if centre is not None:
            model.place(_random_rotation(rng), centre, reach)
            air.faces += model.faces
    drawn = [model for model in models if model is not None and model.poses]
    for number, model in enumerate(dict.fromkeys(drawn)):
        add_thing(scene, model.piece, model.poses, ("thing", number))


def _add_body(
    scene: Composition, air: "_Air", index: int, depth: float, rng: Rng
) -> None:
    """Add a body beyond a depth in metres, unless no place is free."""
    body = draw_body(scene, ("body", index))
    if body.kind and not scene.has_room_for(air.faces + len(body.solid.mesh.faces)):
        return
    reach = air.reach(depth, log_uniform(rng, *_SIZES))
    # The radius of the bounding sphere of the mesh.
    radius = float(np.linalg.norm(body.solid.mesh.vertices, axis=1).max())
    size = reach / radius
    if scene.assets.keep_scale and not body.kind:
        size, reach = body.size, body.size * radius
    centre = air.take(rng, depth, reach)
    if centre is None:
        return
    pose = similarity(_random_rotation(rng), centre, size)
    # The body's material is that of `body.size`; it is enlarged together with its texels.
    look = body.material(scene.view.pixel(depth) / size * body.size)
    scene.add(body.name, body.solid.mesh, look, pose)


def _draw_models(scene: Composition) -> "list[_Model | None]":
    """For each of the objects, the thing that it is a copy of, or None for a body.

    Many scenes have bodies alone; in the others the share of things is uniform.
    """
    rng = scene.rng("things")
    share = 0.0
    if rng.random() >= _WITHOUT_THINGS:
        share = scene.assets.share_of_ours * float(rng.random()) ** 0.6
    if scene.is_overgrown:
        share = scene.assets.share_of_ours
    is_thing = rng.random(scene.count) < share
    number = max(1, math.ceil(is_thing.sum() / log_uniform(rng, 1.0, 4.0)))
    names = tuple(name for name in THINGS if name not in things_for("street"))
    if scene.is_overgrown:
        # Two other things make each of these scenes look different.
        names = (*PLANTS, *one_of(rng, list(combinations(names, 2))))
    drawn = [
        _Model.of(make_thing(one_of(rng, names), scene.rng("thing", "shape", index)))
        for index in range(number)
    ]
    return [one_of(rng, drawn) if chosen else None for chosen in is_thing]


@dataclass(eq=False)
class _Model:
    """A thing, the middle (3,) and radius of its bounding sphere, and the poses (4, 4) of its copies."""

    piece: Piece
    middle: Float
    radius: float
    poses: list[Float] = field(default_factory=list)

    @property
    def faces(self) -> int:
        """Of one copy."""
        return sum(len(mesh.faces) for _, mesh, _ in self.piece.parts)

    @staticmethod
    def of(piece: Piece) -> "_Model":
        vertices = np.concatenate([mesh.vertices for _, mesh, _ in piece.parts])
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        radius = float(np.linalg.norm(vertices - middle, axis=1).max())
        return _Model(piece, middle, radius)

    def place(self, turn: Float, centre: Float, reach: float) -> None:
        """Add a copy that fills the sphere of radius `reach` around a centre (3,)."""
        size = reach / self.radius
        self.poses.append(similarity(turn, centre - size * turn @ self.middle, size))


@dataclass(eq=False)
class _Air:
    """The space before the camera: the spheres that are taken, (centre, radius), and the wall behind.

    faces : of the things that have a place and are not yet objects of the scene.
    """

    view: Viewpoint
    wall: "_Wall | None"
    taken: list[tuple[Float, float]] = field(default_factory=list)
    faces: int = 0

    def reach(self, depth: float, share: float) -> float:
        """The radius of a sphere at a depth that covers a share of the picture's width."""
        return 0.5 * share * float(self.view.covered(depth)[0])

    def take(self, rng: Rng, depth: float, reach: float) -> Float | None:
        """A centre (3,) in the picture of a free sphere that begins at a depth; None where none is found."""
        for _ in range(_TRIES):
            x, y = rng.uniform(-1, 1, 2) * (1.0, 0.95)
            centre = self.view.at(float(x), float(y), depth + reach)
            is_free = all(
                np.linalg.norm(centre - neighbour) > reach + radius
                for neighbour, radius in self.taken
            )
            if is_free and (self.wall is None or self.wall.clearance(centre) > reach):
                self.taken.append((centre, reach))
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
    name, tile = surface_pattern(scene, rng, WALLS)
    tile *= 0.25 * view.covered(distance)[0]
    sheet, colors = wall.sheet(distance), surface_colors(scene, rng)
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
