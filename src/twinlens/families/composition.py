"""Composition of a random scene: collects objects, materials and lights, and makes a `Scene` of them.

Every random decision has its own stream, named after what it decides: `Composition.rng("object", 3, "texture")`. So a
texture added to the tables moves no object.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.families.assets import Assets, UserMesh
from twinlens.families.draws import PALETTES, Palette, Rng, log_uniform, one_of
from twinlens.geometry import Float, inverse, look_at, rigid, transform_points
from twinlens.scenes.materials import Bitmap, Material
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene import Mesh, Plugin, Scene, SceneObject, free_name
from twinlens.scenes.shapes import merged
from twinlens.seeds import generator

Triangles = tuple[Float, NDArray[np.uint32]]
"""Vertices (V, 3) in the world, and faces (F, 3)."""

_SHARES = 0.03, 0.27  # of the picture's width: the largest disparity
_OVERGROWN = 0.2  # share of the scenes that are full of plants
_NIGHTS = 0.35  # share of the scenes that are lit by one lamp
_HELD, _TILT_DEG = (
    0.4,
    20.0,
)  # share of the cameras held by hand, and how far these are from level
_MAX_FACES = 100_000  # of a scene, without the user's meshes
_FACES_OF_SURROUNDINGS = 12_000  # walls, tables and floors, which are added last
_ROUGH = 0.3  # share of the scenes with rough ground, where a family has it
_FACES_OF_ROUGH_GROUND = 46_000
_OPEN_AIR = (
    0.7  # share of the scenes by day with sky above the wall, where a family has both
)
_NEAR = 1e-3  # metres: triangles are clipped at this depth


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A pinhole camera: its pose (4, 4), horizontal field of view, width over height, and pixels across."""

    world_from_cam: Float
    fov_x_deg: float
    aspect: float
    width_px: int = 640

    @property
    def half(self) -> tuple[float, float]:
        """(x, y) of the picture's right and lower edge at depth 1."""
        x = math.tan(math.radians(self.fov_x_deg) / 2)
        return x, x / self.aspect

    @cached_property
    def cam_from_world(self) -> Float:
        return inverse(self.world_from_cam)

    @property
    def eye(self) -> Float:
        return self.world_from_cam[:3, 3]

    def depth(self, points: Float) -> Float:
        """Depth (N,) along the axis of world points (N, 3)."""
        return np.asarray(transform_points(self.cam_from_world, points)[..., 2])

    def pixel(self, depth: float) -> float:
        """Width of a pixel in metres at this depth."""
        return 2 * self.half[0] * depth / self.width_px

    def at(self, x: float, y: float, depth: float) -> Float:
        """The world point (3,) at (x, y) of the picture, each in [-1, 1] from left to right and from top to bottom."""
        return transform_points(
            self.world_from_cam,
            np.array([x * self.half[0], y * self.half[1], 1.0]) * depth,
        )

    def covered(self, depth: float) -> Float:
        """Width and height in metres of the picture's field at this depth."""
        return 2 * depth * np.array(self.half)


def rasterize(
    view: Viewpoint, meshes: Iterable[Triangles], columns: int = 160
) -> Float:
    """The depth (H, W) of meshes at pixel centres, `columns` pixels wide; +inf where nothing is hit.

    Source: Pineda, A Parallel Algorithm for Polygon Rasterization, SIGGRAPH 1988.
    """
    rows = max(1, round(columns / view.aspect))
    corners = [
        transform_points(view.cam_from_world, vertices)[faces]
        for vertices, faces in meshes
    ]
    triangles = _clipped(np.concatenate([np.empty((0, 3, 3)), *corners]))
    # Indices from here on: axis, corner, triangle. Positions uv are in pixels, their centres at integers.
    xyz = np.ascontiguousarray(triangles.T)
    size = np.array([[columns], [rows]])
    half = np.reshape(view.half, (2, 1, 1))
    uv = (xyz[:2] / xyz[2] / half + 1) / 2 * size[..., None] - 0.5
    index, x, y = _pixels_of_bounding_boxes(uv, size)

    # Edge functions: twice the signed areas that a pixel spans with the edge opposite to each corner.
    to_u, to_v = np.stack([x, y])[:, None] - uv[..., index]
    weights = np.stack(
        [to_u[i - 2] * to_v[i - 1] - to_v[i - 2] * to_u[i - 1] for i in range(3)]
    )
    area = weights.sum(axis=0)
    inside = (weights * np.sign(area) >= 0).all(axis=0) & (area != 0)
    index, weights, area = index[inside], weights[:, inside], area[inside]

    # 1/depth is linear in the picture, so it is the mean of the corners' by barycentric weights.
    barycentric = weights / area
    z = 1 / (barycentric / xyz[2][:, index]).sum(axis=0)
    depth = np.full((rows, columns), np.inf)
    np.minimum.at(depth.reshape(-1), y[inside] * columns + x[inside], z)
    return depth


def _pixels_of_bounding_boxes(
    uv: Float, size: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Every triangle with every pixel of its bounding box: triangle, x and y, each (N,)."""
    low = np.clip(np.ceil(uv.min(axis=1)), 0, size).astype(np.int64)
    high = np.clip(np.floor(uv.max(axis=1)), -1, size - 1).astype(np.int64)
    wide, tall = np.maximum(high - low + 1, 0)
    count = wide * tall
    index = np.repeat(np.arange(len(count)), count)
    first = np.cumsum(count) - count
    within = np.arange(len(index)) - np.repeat(first, count)
    down, right = np.divmod(within, wide[index])
    return index, low[0, index] + right, low[1, index] + down


def _clipped(corners: Float) -> Float:
    """The parts of triangles (F, 3, 3) beyond the near plane: none, one or two triangles each."""
    beyond = corners[..., 2] > _NEAR
    count = beyond.sum(axis=1)
    kept = [corners[count == 3]]
    for number in (1, 2):
        cut = count == number
        # Turn each triangle so that corner a is the one that is alone on its side of the plane.
        is_alone = beyond[cut] if number == 1 else ~beyond[cut]
        order = (np.argmax(is_alone, axis=1)[:, None] + np.arange(3)) % 3
        ordered = np.take_along_axis(corners[cut], order[..., None], axis=1)
        a, b, c = ordered[:, 0], ordered[:, 1], ordered[:, 2]
        ab, ac = _at_near_plane(a, b), _at_near_plane(a, c)
        triangles = [(a, ab, ac)] if number == 1 else [(ab, b, c), (ab, c, ac)]
        kept += [np.stack(triangle, axis=1) for triangle in triangles]
    return np.concatenate(kept)


def _at_near_plane(start: Float, end: Float) -> Float:
    """The points (N, 3) of segments just beyond the near plane, which they cross."""
    share = (_NEAR * 1.0001 - start[:, 2:]) / (end[:, 2:] - start[:, 2:])
    return np.asarray(start + share * (end - start))


def _triangles(meshes: Iterable[Mesh]) -> list[Triangles]:
    return [(mesh.vertices, mesh.faces) for mesh in meshes]


@dataclass(eq=False)
class Composition:
    """The settings and the content of a scene. A family adds `count` objects, a number drawn from the range `counts`.

    The image is `width_px` wide with width/height = `aspect`; `look` sets the view. Lengths are in metres. Without
    `own_lights`, `lighting.panel` adds nothing. Without `plain_surfaces`, walls, table tops and floors have patterns.
    """

    name: str
    root: np.random.SeedSequence
    assets: Assets
    depth_range: tuple[float, float] | None
    counts: tuple[int, int]
    aspect: float
    width_px: int
    own_lights: bool = True
    plain_surfaces: bool = True
    count: int = field(init=False)
    palette: Palette = field(init=False)
    view: Viewpoint = field(init=False)
    objects: list[SceneObject] = field(default_factory=list)
    triangles: list[Triangles] = field(default_factory=list)
    materials: dict[str, Material] = field(default_factory=dict)
    names_of_files: dict[tuple[Path, str], str] = field(
        default_factory=dict, repr=False
    )
    lights: dict[str, Plugin] = field(default_factory=dict)
    faces: int = 0

    def __post_init__(self) -> None:
        self.count = self._draw_count()
        self.palette = one_of(self.rng("palette"), PALETTES)

    def _draw_count(self) -> int:
        """A number of objects: uniform in half of the scenes, of uniform logarithm in the others, which are sparser."""
        least, most = self.counts
        rng = self.rng("count")
        if rng.random() < 0.5:
            return int(rng.integers(least, most + 1))
        lowest = max(least, 0.7)  # 0 has no logarithm
        return int(np.clip(int(log_uniform(rng, lowest, most + 1.0)), least, most))

    def rng(self, *part: str | int) -> Rng:
        """The random stream of one part of the scene, independent of all others."""
        entropy: Any = self.root.entropy
        return generator(entropy, *self.root.spawn_key, *map(str, part))

    def depth_ratio(self, low: float, high: float) -> float:
        """Far depth over near depth: as requested, or drawn between `low` and `high`."""
        if self.depth_range is not None:
            return self.depth_range[1] / self.depth_range[0]
        return log_uniform(self.rng("depth"), low, high)

    def look(self, eye: Float, target: Float, fov_x_deg: float) -> None:
        """Set the view from `eye` to `target`; most cameras are nearly level, two of five are held by hand."""
        rng = self.rng("roll")
        is_held = rng.random() < _HELD
        tilt_deg = rng.uniform(-_TILT_DEG, _TILT_DEG)
        roll_deg = tilt_deg if is_held else rng.normal(0, 0.8)
        pose = look_at(eye, target) @ rotation([0, 0, 1], roll_deg)
        self.view = Viewpoint(pose, float(fov_x_deg), self.aspect, self.width_px)

    def yaw(self, depth_ratio: float) -> float:
        """How far a wall behind the scene is turned about the vertical, radians; positive where its right is farther.

        Many walls face the camera, some are seen at a grazing angle. The wall's nearest visible part is 1.4 times as
        far as the scene's nearest point or more, where its farthest part is `depth_ratio` times as far.
        """
        rng = self.rng("yaw")
        side = one_of(rng, [-1.0, 1.0])
        # In the picture at x, in units of the focal length, 1/depth is proportional to 1 - x tan(yaw).
        share = max(1.0, depth_ratio / 1.4)
        most = (share - 1) / (share + 1) / self.view.half[0]
        turned = min(1.0, 1.3 * float(rng.random()))
        return side * math.atan(turned * most)

    @cached_property
    def is_night(self) -> bool:
        """Whether the scene is lit by one lamp, and what is around it is dark."""
        return bool(self.rng("night").random() < _NIGHTS)

    @cached_property
    def is_overgrown(self) -> bool:
        """Whether all things of the scene are plants, as many and as large as there may be."""
        return bool(self.rng("overgrown").random() < _OVERGROWN)

    @cached_property
    def is_rough(self) -> bool:
        """Whether the ground or the table top has dents."""
        return bool(self.rng("rough").random() < _ROUGH)

    def plain_share(self, mean: float) -> float:
        """The probability in this scene that a surface is plain, where it is `mean` over all scenes.

        u^(1/mean - 1) of a uniform number u has this mean. So there are scenes with patterns alone, and bare ones.
        """
        drawn = float(self.rng("plainness").random())
        return float(drawn ** (1 / mean - 1))

    def has_room_for(self, faces: int) -> bool:
        """Whether an object of so many triangles keeps the scene within the limit that its size has."""
        kept = _FACES_OF_SURROUNDINGS
        if self.is_rough:
            kept += _FACES_OF_ROUGH_GROUND
        return self.faces + faces <= _MAX_FACES - kept

    def skyline(self) -> float:
        """Where in the picture the wall behind the scene ends, from -1 at its top to 1; -inf where it has no end."""
        rng = self.rng("skyline")
        if self.is_night or rng.random() >= _OPEN_AIR:
            return -math.inf
        return float(rng.uniform(-0.9, 0.35))

    def add(
        self,
        name: str,
        mesh: Mesh,
        material: Material,
        pose: Float | None = None,
        emitter: Plugin | None = None,
    ) -> None:
        """Add an object with its own material, or those of a user's mesh. Names become unique: bottle, bottle-2, ..."""
        unique = self._free_name(name)
        of_file: tuple[str, ...] = ()
        if isinstance(mesh, UserMesh):
            of_file = tuple(self._materials_of_file(mesh))
        if not of_file:
            mesh, material = _with_plain_texture(mesh, material)
            self.materials[unique] = material
        world_from_object = (
            np.eye(4) if pose is None else np.asarray(pose, dtype=np.float64)
        )
        self.objects.append(
            SceneObject(unique, mesh, of_file or unique, world_from_object, emitter)
        )
        self.triangles.append(
            (transform_points(world_from_object, mesh.vertices), mesh.faces)
        )
        if not isinstance(mesh, UserMesh):
            self.faces += len(mesh.faces)

    def add_surfaces(
        self,
        name: str,
        surfaces: Iterable[tuple[str, Mesh, Material]],
        poses: Sequence[Float],
    ) -> None:
        """Add an object of surfaces (name, mesh, material) at each pose; they share a mesh and materials.

        A material is named after the object and its surface, a number that makes it unique at the end.
        """
        meshes, words = [], []
        for number, (label, mesh, material) in enumerate(surfaces):
            mesh, material = _with_plain_texture(mesh, material)
            word = free_name(f"{name}-{label}", self.materials)
            self.materials[word] = material
            words.append(word)
            surface = np.full(len(mesh.faces), number, dtype=np.uint16)
            meshes.append(replace(mesh, surface=surface))
        whole = merged(meshes)
        # Not instances: Mitsuba compiles functions of its own for each of these, meshes share theirs.
        for pose in poses:
            world_from_mesh = np.asarray(pose, dtype=np.float64)
            made = SceneObject(
                self._free_name(name), whole, tuple(words), world_from_mesh
            )
            self.objects.append(made)
            vertices = transform_points(world_from_mesh, whole.vertices)
            self.triangles.append((vertices, whole.faces))
            self.faces += len(whole.faces)

    def _free_name(self, name: str) -> str:
        plain = re.sub(r"[^A-Za-z0-9_]+", "-", name).strip("-") or "body"
        taken = {*self.materials, *(item.name for item in self.objects)}
        return free_name(plain, taken)

    def _materials_of_file(self, mesh: UserMesh) -> Iterator[str]:
        """The names in the scene of the materials of a mesh's file, which are added once for all its copies.

        The key is the path, not the mesh: the file may have been read again since.
        """
        for name, material in mesh.materials.items():
            key = mesh.path, name
            if key not in self.names_of_files:
                self.names_of_files[key] = free_name(name, self.materials)
                self.materials[self.names_of_files[key]] = material
            yield self.names_of_files[key]

    def pixel_at(self, point: Float, min_depth: float = -np.inf) -> float:
        """Width in metres of a pixel at a world point (3,), whose depth is taken as at least `min_depth`."""
        return self.view.pixel(max(float(self.view.depth(point[None])[0]), min_depth))

    def visible_range(
        self, others: Iterable[Mesh] = (), columns: int = 160
    ) -> tuple[float, float]:
        """The smallest and the largest depth in the picture of all objects and of `others`, meshes in the world."""
        depth = rasterize(self.view, [*self.triangles, *_triangles(others)], columns)
        finite = depth[np.isfinite(depth)]
        return float(finite.min()), float(finite.max())

    def backdrop_distance(
        self, backdrop: Callable[[float], list[Mesh]], far: float, start: float
    ) -> float:
        """The distance of a backdrop, meshes in the world, that makes `far` metres the largest depth in the picture."""
        distance, before = start, rasterize(self.view, self.triangles, 96)
        for _ in range(5):
            depth = np.minimum(
                before, rasterize(self.view, _triangles(backdrop(distance)), 96)
            )
            farthest = float(depth[np.isfinite(depth)].max())
            if abs(farthest - far) < 0.005 * far:
                break
            distance = max(distance * far / farthest, 0.2 * start)
        return distance

    def scene(self, about: str) -> Scene:
        """The scene, scaled to the requested nearest depth about the camera's centre, which changes no pixel.

        The baseline gives the nearest point a disparity of 3% to 27% of the picture's width.
        """
        objects, view = self.objects, self.view
        near, far = self.visible_range()
        if self.depth_range is not None:
            scale = self.depth_range[0] / near
            about_eye = similarity(np.eye(3), (1 - scale) * view.eye, scale)
            objects = [_moved(item, about_eye) for item in objects]
            near, far = near * scale, far * scale
        share = log_uniform(self.rng("baseline"), *_SHARES)
        return Scene(
            name=self.name,
            objects=tuple(objects),
            materials=self.materials,
            lights=self.lights,
            world_from_left=view.world_from_cam,
            fov_x_deg=view.fov_x_deg,
            baseline=float(share * 2 * view.half[0] * near),
            depth_range=(near, far),
            description=about,
        )


@dataclass(frozen=True)
class Family:
    """A description, the default object count (min, max), `compose`, and the smallest far/near that it supports.

    farthest : metres, the largest depth in the picture of any scene without a `depth_range`.
    names : of its objects besides bodies, without the numbers that may follow, as in chair-2.
    may_be_empty : whether it has scenes without objects.
    """

    about: str
    object_count: tuple[int, int]
    compose: Callable[[Composition], None]
    least_ratio: float
    farthest: float
    names: frozenset[str]
    may_be_empty: bool = False


def _moved(item: SceneObject, pose: Float) -> SceneObject:
    """An object moved by a pose (4, 4) of the world."""
    return replace(item, world_from_object=pose @ item.world_from_object)


def _with_plain_texture(mesh: Mesh, material: Material) -> tuple[Mesh, Material]:
    """A mesh whose (u, v) are those of the picture of its material: the renderer compiles a kernel for each `to_uv`."""
    color = material.base_color
    if not isinstance(color, Bitmap):
        return mesh, material
    uv = np.asarray(mesh.uv) * np.diag(color.to_uv)[:2]
    plain = replace(color, to_uv=np.eye(4))
    return replace(mesh, uv=uv), replace(material, base_color=plain)


def similarity(turn: Float, position: Float, size: float) -> Float:
    """The pose (4, 4) that scales by `size`, rotates by `turn` (3, 3), then moves to `position` (3,)."""
    pose = rigid(turn, position)
    pose[:3, :3] *= size
    return pose
