"""The family "cards": test charts, steps, wedges and waves on a floor, each at its own distance and slant."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twinlens.families import lighting
from twinlens.families.composition import Composition, Viewpoint
from twinlens.families.draws import Rng, one_of, weighted
from twinlens.families.furniture import board
from twinlens.families.materials import (
    material,
    metal_pixels,
    resized,
    texels,
    user_texture,
)
from twinlens.families.patterns import draw_chart
from twinlens.families.relief import draw_front
from twinlens.families.surfaces import (
    FLOORS,
    QUAD,
    WALLS,
    Sheet,
    quad,
    surface,
    surface_colors,
    surface_pattern,
)
from twinlens.families.things import names_in_scenes, things_for
from twinlens.families.things.ground import Ground, Layer, spread_count
from twinlens.geometry import Float, transform_points
from twinlens.scenes import shapes
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Bitmap, Mesh
from twinlens.scenes.stable_poses import gap, outline

_TRIES = 30  # random poses of a chart before it is left out
_NEAREST = 0.92  # metres, before scaling to the depth range
_LOWEST = 0.3  # metres, of a wall below the sky
_DENTS = 0.01, 0.06  # metres, the depth of those of rough ground
_MOST_THINGS, _SIZES_OF_THINGS = 16, (0.2, 1.0)
NAMES = names_in_scenes() | {
    "wall",
    "floor",
    "chart",
    "chart-foot",
    "steps",
    "wedge",
    "wave",
    *lighting.NAMES,
}
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    """Add charts at even steps of 1/depth, the floor they stand on, the wall behind, lights."""
    depth_ratio = scene.depth_ratio(2.2, 6.0)
    rng = scene.rng("view")
    # Level or looking down a little along +y; the floor is z = 0.
    eye = np.array([0.0, 0.0, rng.uniform(0.45, 0.7)])
    target = eye + np.array([0.0, 1.0, -rng.uniform(0.05, 0.3)])
    scene.look(eye, target, rng.uniform(45, 62))
    surroundings = _Surroundings(scene, scene.yaw(depth_ratio))
    _add_charts(scene, depth_ratio, surroundings.behind(depth_ratio))
    surroundings.add(depth_ratio)
    middle = np.array([0.0, 0.55 * depth_ratio, 0.3])
    open_side = math.copysign(1.0, surroundings.yaw)
    outdoors = math.isfinite(scene.skyline())
    radius = 0.42 * depth_ratio
    lighting.one_kind(scene, scene.rng("light"), middle, radius, open_side, outdoors)


def _add_charts(scene: Composition, depth_ratio: float, behind: Float) -> None:
    """Add charts from near to far, left and right by turns; footprints overlap neither each other nor `behind`."""
    view = scene.view
    things = spread_count(scene, "things", min(scene.count, _MOST_THINGS))
    count = max(scene.count - things, 1)
    # One step of 1/depth for each chart, from 1 m to 0.88 `depth_ratio`, at a random place within it.
    steps = (np.arange(count) + scene.rng("steps").uniform(0.1, 0.9, count)) / count
    depths = 1 / (1 + (1 / (0.88 * depth_ratio) - 1) * steps)
    taken = [behind]
    turn_deg = float(scene.rng("turn").uniform(8, 70))
    for index, depth in enumerate(depths.tolist()):
        place = scene.rng("place", index)
        name = weighted(place, list(BODIES), _WEIGHTS)
        size = float(place.uniform(0.26, 0.5)) * view.covered(depth)[1]
        mesh, height = BODIES[name](scene.rng("shape", index), size)
        pose = _free_pose(view, place, index, depth, mesh, taken, turn_deg)
        if pose is not None:
            n = texels(height, scene.pixel_at(pose[:3, 3], 0.3))
            _add_card(scene, place, index, name, mesh, n, pose)
    _add_things(scene, things, taken, 0.88 * depth_ratio)


def _add_things(scene: Composition, count: int, taken: list[Float], far: float) -> None:
    """Add at most `count` things to the floor, nearer than `far` metres, beside the footprints that are taken."""
    ground = Ground(scene, 0.0, 0.01, _NEAREST)
    ground.filled += [Layer(0.0, math.inf, footprint) for footprint in taken]

    def place(rng: Rng, size: float) -> Float:
        depth = 1 / rng.uniform(1 / far, 1 / (_NEAREST + 0.2 * size))
        return scene.view.at(rng.uniform(-1, 1), 0.0, depth)[:2]

    names = *things_for("floor"), *things_for("outdoors")
    ground.scatter("things", names, count, place, _SIZES_OF_THINGS)


def _free_pose(
    view: Viewpoint,
    rng: Rng,
    index: int,
    depth: float,
    mesh: Mesh,
    taken: list[Float],
    turn_sd_deg: float,
) -> Float | None:
    """A pose on the floor apart from the footprints that are taken, to which its own is added; None without one."""
    for attempt in range(_TRIES):
        side = (-1) ** (index + attempt) * rng.uniform(0.05, 0.95)
        on_floor = view.at(side, 0.0, depth) * [1, 1, 0]
        turn_deg = np.clip(rng.normal(0, turn_sd_deg), -78, 78)
        pose = translation(on_floor) @ rotation([0, 0, 1], turn_deg)
        points = transform_points(pose, mesh.vertices)
        footprint = outline(points[:, :2])
        is_far = float(view.depth(points).min()) > _NEAREST
        is_clear = all(gap(footprint, neighbour) > 0.01 for neighbour in taken)
        if is_far and is_clear:
            taken.append(footprint)
            return pose
    return None


def _add_card(
    scene: Composition,
    rng: Rng,
    index: int,
    name: str,
    mesh: Mesh,
    n: int,
    pose: Float,
) -> None:
    """Add a body with a chart, or a user's picture, of n x n texels; a flat chart stands on a foot of steel."""
    picture = user_texture(scene, "chart", index)
    if picture is None:
        stream = scene.rng("chart", index)
        picture = draw_chart(stream, n, scene.palette.accents)
    else:
        picture = resized(picture, n)
    finish = one_of(rng, ["matte", "matte", "satin", "clearcoat"])
    scene.add(name, mesh, material(rng, finish, Bitmap(picture, wrap="mirror")), pose)
    if name == "chart":
        steel = Bitmap(metal_pixels(scene.rng("foot", index), 32, "metal"))
        scene.add("chart-foot", _foot(mesh), material(rng, "metal", steel), pose)


def _chart(rng: Rng, size: float) -> tuple[Mesh, float]:
    """A board that leans back or forward, its front covered by the whole texture, above the floor."""
    width, thickness = size * rng.uniform(0.7, 1.3), 0.02 * size
    made = board((width, thickness, size), (0, 0, 0))
    u = made.vertices[:, 0] / width + 0.5
    v = made.vertices[:, 2] / size + 0.5
    upright = Mesh(made.vertices, made.faces, made.normals, np.column_stack([u, v]))
    leaning = shapes.transformed(upright, rotation([1, 0, 0], rng.uniform(-25, 35)))
    rise = 0.12 * size - float(leaning.vertices[:, 2].min())
    return shapes.transformed(leaning, translation([0, 0, rise])), size


def _foot(chart: Mesh) -> Mesh:
    """A plate on the floor and two posts below the lower edge of a chart."""
    low, high = chart.vertices.min(axis=0), chart.vertices.max(axis=0)
    width = high[0] - low[0]
    is_lower = chart.vertices[:, 2] < low[2] + 0.03 * (high[2] - low[2])
    _, edge_y, _ = chart.vertices[is_lower].mean(axis=0)
    thickness = 0.02 * width
    sides = (0.8 * width, 0.3 * width, 0.5 * thickness)
    plate = board(sides, (0, edge_y, 0.25 * thickness))
    # The posts end a little above the edge, so that no gap is visible.
    sides = (thickness, thickness, low[2] + 0.2 * thickness)
    left, right = (
        board(sides, (sign * 0.3 * width, edge_y, low[2] / 2)) for sign in (-1, 1)
    )
    return shapes.merged([plate, left, right])


def _extruded(profile: Float, width: float) -> Mesh:
    """A strip of (y, z) points, bottom to top as seen from the front, extruded along x, with sides and back."""
    rear = profile[:, 0].max()
    return shapes.merged(
        [*_front(profile, width), *_flanks(profile, width, rear), _back(profile, width, rear)]
    )  # fmt: skip


def _left_and_right(width: float) -> Float:
    """x of the corners of a rectangle that is seen from the front, counter-clockwise."""
    return np.array([-width / 2, width / 2, width / 2, -width / 2])


def _front(profile: Float, width: float) -> list[Mesh]:
    """A quadrilateral for each pair of points; v is the share of the strip's length below."""
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    x = _left_and_right(width)
    parts = []
    for (a, b), (low, high) in zip(pairwise(profile), pairwise(length), strict=True):
        v = np.array([low, low, high, high]) / length[-1]
        y, z = [a[0], a[0], b[0], b[0]], [a[1], a[1], b[1], b[1]]
        corners = np.column_stack([x, y, z])
        parts.append(quad(corners, np.column_stack([x / width + 0.5, v])))
    return parts


def _flanks(profile: Float, width: float, rear: float) -> list[Mesh]:
    """Both sides, in slices between each pair of points and the rear."""
    parts = []
    for side, faces in ((-1.0, QUAD[:, ::-1]), (1.0, QUAD)):
        normals = np.tile([side, 0.0, 0.0], (4, 1))
        for a, b in pairwise(profile):
            yz = np.array([a, [rear, a[1]], [rear, b[1]], b])
            corners = np.column_stack([np.full(4, side * width / 2), yz])
            uv = (yz - profile.min(axis=0)) / width
            parts.append(Mesh(corners, faces, normals, uv))
    return parts


def _back(profile: Float, width: float, rear: float) -> Mesh:
    z = profile[[0, 0, -1, -1], 1]
    corners = np.column_stack([_left_and_right(width), np.full(4, rear), z])
    normals = np.tile([0.0, 1.0, 0.0], (4, 1))
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.uint32)
    return Mesh(corners, faces, normals, np.zeros((4, 2)))


def _steps(rng: Rng, size: float) -> tuple[Mesh, float]:
    count = int(rng.integers(3, 8))
    rise, run = 0.8 * size / count, size * rng.uniform(0.6, 1.2) / count
    corners = [(i * run, j * rise) for i in range(count) for j in (i, i + 1)]
    profile = np.array([*corners, (count * run, count * rise)])
    centred = profile - [0.5 * count * run, 0]
    # The texture covers the height and the depth of the stairs.
    return _extruded(centred, size * rng.uniform(0.7, 1.1)), size * 1.6


def _wedge(rng: Rng, size: float) -> tuple[Mesh, float]:
    rise = rng.uniform(0.5, 0.9)
    profile = np.array([(-0.5, 0.0), (-0.5, 0.02), (0.5, rise)])
    return _extruded(profile * size, size), size


def _wave(rng: Rng, size: float) -> tuple[Mesh, float]:
    """An upright sine wave: extruded along x, then turned so that its texture stands."""
    count, amplitude = int(rng.integers(2, 6)), size * rng.uniform(0.04, 0.1)
    t = np.linspace(0, 1, 16 * count + 1)
    width, height = size * rng.uniform(1.0, 1.5), 0.85 * size
    y = amplitude * np.sin(2 * np.pi * count * t)
    lying = _extruded(np.column_stack([y, (t - 0.5) * width]), height)
    upright = shapes.transformed(lying, rotation([0, 1, 0], 90.0))
    return shapes.transformed(upright, translation([0, 0, 0.425 * size])), size


BODIES = {"chart": _chart, "steps": _steps, "wedge": _wedge, "wave": _wave}
"""Functions of a random stream and a size that make a mesh and the height of its whole texture in metres."""
_WEIGHTS = (0.62, 0.14, 0.12, 0.12)  # of the bodies in draws


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """The floor, and the wall behind, turned by `yaw` radians: positive where its right is farther."""

    scene: Composition
    yaw: float

    def sheets(self, distance: float) -> tuple[Sheet, Sheet]:
        """Floor and wall, with the wall `distance` metres away where the camera looks."""
        view = self.scene.view
        along = np.array([math.cos(self.yaw), math.sin(self.yaw), 0.0])
        # The farther side of the wall is seen at a grazing angle.
        grazing = math.cos(self.yaw) - 1.2 * view.half[0] * abs(math.sin(self.yaw))
        wide = 2.2 * view.covered(distance)[0] / max(grazing, 0.25)
        middle = np.array([0.0, distance, 0.0])
        height = 1.6 * view.covered(distance)[1] / max(grazing, 0.25) + 1
        skyline = self.scene.skyline()
        if math.isfinite(skyline):
            height = max(float(view.at(0.0, skyline, distance)[2]), _LOWEST)
        up = np.array([0, 0, height])
        wall = Sheet(middle - 0.5 * wide * along, wide * along, up)
        deep = distance + 0.5 * wide * abs(math.sin(self.yaw)) + 0.2
        corner = np.array([-wide / 2, -0.2, 0.0])
        across = np.array([wide, 0.0, 0.0])
        floor = Sheet(corner, across, np.array([0.0, deep, 0.0]))
        return floor, wall

    def meshes(self, distance: float) -> list[Mesh]:
        return [sheet.mesh() for sheet in self.sheets(distance)]

    def distance(self, depth_ratio: float, nearest: float = math.inf) -> float:
        """The wall's distance; `nearest` is the depth of things that are not added yet."""
        floor, _ = self.sheets(depth_ratio)
        near, _ = self.scene.visible_range([floor.mesh()])
        far = min(near, nearest) * depth_ratio
        return self.scene.backdrop_distance(self.meshes, far, far)

    def behind(self, depth_ratio: float) -> Float:
        """The ground (4, 2) behind the wall; once the charts are added the wall may be farther, but not nearer."""
        _, wall = self.sheets(self.distance(depth_ratio, _NEAREST))
        start, end = wall.corner[:2], wall.corner[:2] + wall.u[:2]
        away = np.array([-wall.u[1], wall.u[0]]) / wall.lengths[0] * depth_ratio
        return np.array([start, end, end + away, start + away])

    def add(self, depth_ratio: float) -> None:
        """Add floor and wall, with patterns of their own."""
        scene, rng = self.scene, self.scene.rng("surroundings")
        distance = self.distance(depth_ratio)
        floor, wall = self.sheets(distance)
        parts = (("floor", floor, FLOORS, 0.55), ("wall", wall, WALLS, 0.4))
        for name, sheet, patterns, contrast in parts:
            kind, tile = surface_pattern(scene, rng, patterns)
            colors = surface_colors(scene, scene.rng(name, "colours"), contrast)
            tile *= 0.3 * scene.view.covered(distance)[0]
            fitted, look = surface(scene, scene.rng(name), sheet, kind, colors, tile)
            front = None
            if name == "floor" and scene.is_rough:
                front = draw_front(scene.rng("dents"), fitted, _DENTS)
            scene.add(name, fitted.mesh(front=front), look)
