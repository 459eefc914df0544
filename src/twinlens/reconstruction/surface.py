"""Depth maps with their camera and image; point clouds and triangle meshes of them; PLY and glTF files."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, Rig, Truth
from twinlens.dataset.files import write_file
from twinlens.dataset.pictures import rgb8
from twinlens.dataset.storage import Where
from twinlens.errors import InputError, check_number
from twinlens.geometry import Float, check_rigid, depth_from_disparity, float_array

_MOST_SAMPLES = 50_000_000
_ROUNDING = 1e-6  # of coordinates in files, relative to the extent of a shape
_END_OF_HEADER = b"end_header\n"
_GLTF_FROM_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_GLTF_FROM_CAM = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class DepthView:
    """A depth map and its image.

    camera : Camera, with any distortion. world_from_cam : (4, 4).
    depth : float64 (H, W), metres along the axis, > 0; +inf where unknown.
    image : uint8 or uint16 (H, W[, 3]), kept as uint8 (H, W, 3), or None.

    Raises InputError when an array does not fit the camera, or a depth is NaN or not positive.
    """

    camera: Camera
    world_from_cam: Float
    depth: Float
    image: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        pose = check_rigid(self.world_from_cam, "world_from_cam")
        depth = np.asarray(self.depth, dtype=np.float64)
        image = None if self.image is None else rgb8(self.image)
        size = self.camera.height, self.camera.width
        image_shape = None if image is None else image.shape
        if depth.shape != size or image_shape not in (None, (*size, 3)):
            raise InputError(
                f"a view of {size} pixels needs depth (H, W), image (H, W, 3); got {depth.shape}, {image_shape}"
            )
        if not (depth > 0).all():
            raise InputError(
                "depths must be positive, or +inf where unknown; got NaN or values <= 0"
            )
        # The converted arrays replace the given ones; the class is frozen for everyone else.
        object.__setattr__(self, "world_from_cam", pose)
        object.__setattr__(self, "depth", depth)
        object.__setattr__(self, "image", image)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where the depth is known, bool (H, W)."""
        return np.isfinite(self.depth)

    @property
    def rig(self) -> Rig:
        """The camera as a rig of one."""
        return Rig([self.camera], [self.world_from_cam])

    def positions(self) -> Float:
        """World coordinates (H, W, 3) of every pixel, metres; +inf where unknown."""
        depth = np.where(self.known, self.depth, 1.0)
        points = self.rig.unproject(0, self.camera.pixel_grid(), depth)
        return np.where(self.known[..., None], points, np.inf)


def view_of_truth(
    truth: Truth, rig: Rig, index: int, image: NDArray[Any] | None = None
) -> DepthView:
    """The true depths of camera `index`, with its image."""
    return DepthView(rig.cameras[index], rig.world_from_cams[index], truth.depth, image)


def view_of_disparity(
    disparity: ArrayLike,
    rig: Rig,
    left: int = 0,
    right: int = 1,
    image: NDArray[Any] | None = None,
) -> DepthView:
    """Depths z = fx B / (d + doffs) of the left view of a rectified pair, from its disparity map (H, W), +inf unknown.

    A disparity of -doffs or less, at or beyond infinity, gives an unknown depth. Raises InputError unless the pair is
    rectified, and for NaN or -inf.
    """
    values = float_array("a disparity map", disparity)
    if not rig.is_rectified(left, right):
        raise InputError(
            f"cameras {left} and {right} are not a rectified pair in this order: rectify them first"
        )
    if np.isnan(values).any() or np.isneginf(values).any():
        raise InputError("unknown disparities must be +inf, got NaN or -inf")
    doffs = rig.doffs(left, right)
    finite = np.where(values + doffs > 0, values, np.inf)
    depth = depth_from_disparity(
        finite, rig.cameras[left].fx, rig.baseline(left, right), doffs
    )
    return DepthView(rig.cameras[left], rig.world_from_cams[left], depth, image)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points float64 (N, 3), world metres; colours uint8 (N, 3) or None. Raises InputError unless all are finite."""

    points: Float
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        _check("a cloud's points", self.points, self.colors)

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh: vertices float64 (V, 3), world metres, faces int64 (F, 3), counter-clockwise seen from the
    camera, colours uint8 (V, 3) or None. Raises InputError unless all are finite and every face has its vertices.
    """

    vertices: Float
    faces: NDArray[np.int64]
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        _check("a surface's vertices", self.vertices, self.colors)
        corners = self.faces
        if (
            corners.ndim != 2
            or corners.shape[1] != 3
            or (corners.size and not corners.min() >= 0)
        ):
            raise InputError(
                f"a surface's faces must be (F, 3) indices of vertices, got shape {corners.shape}"
            )
        if corners.size and corners.max() >= len(self.vertices):
            raise InputError(
                f"a face refers to vertex {corners.max()} of {len(self.vertices)}"
            )


def points_of(view: DepthView) -> Cloud:
    """One point per pixel of known depth, row by row from the top left."""
    colors = None if view.image is None else view.image[view.known]
    return Cloud(view.positions()[view.known], colors)


def mesh_of(view: DepthView, max_angle_deg: float = 85.0) -> Surface:
    """Two triangles for each four neighbouring pixels of known depth, except across depth discontinuities.

    A triangle is omitted when the angle between its normal and the viewing ray exceeds `max_angle_deg`: a depth step
    between neighbouring pixels of more than tan(max_angle) pixel footprints z / fx (11 at 85 degrees).
    """
    check_number(
        "max_angle_deg", max_angle_deg, "between 0 and 90 degrees", above=0, below=90
    )
    is_known = view.known.reshape(-1)
    positions = np.where(is_known[:, None], view.positions().reshape(-1, 3), 0.0)
    pixel = np.arange(is_known.size).reshape(view.known.shape)
    # The corners of each four neighbours: top left, top right, bottom left, bottom right.
    a, b = pixel[:-1, :-1].ravel(), pixel[:-1, 1:].ravel()
    c, d = pixel[1:, :-1].ravel(), pixel[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    faces = faces[is_known[faces].all(axis=1)]
    corners = positions[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ray = view.world_from_cam[:3, 3] - corners.mean(axis=1)
    size = np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    least_cosine = math.cos(math.radians(max_angle_deg))
    faces = faces[np.einsum("nc,nc->n", normal, ray) > least_cosine * size]
    used, renamed = np.unique(faces, return_inverse=True)
    colors = None if view.image is None else view.image.reshape(-1, 3)[used]
    return Surface(positions[used], renamed.reshape(faces.shape), colors)


def sampled(surface: Surface, spacing: float, seed: int = 0) -> Cloud:
    """Random points uniform on the triangles of a surface, at least one per `spacing` squared (metres) of area.

    Colours are interpolated between the corners. Raises InputError for more than 50 million points.
    """
    check_number("spacing", spacing, "a positive number of metres", above=0)
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    counts = np.ceil(areas / spacing**2).astype(np.int64)
    count = counts.sum()
    if count > _MOST_SAMPLES:
        limit = f"{count} points, more than {_MOST_SAMPLES}"
        raise InputError(f"a spacing of {spacing} m makes {limit}: use a wider spacing")
    face = np.repeat(np.arange(len(counts)), counts)
    # Barycentric coordinates, uniform on the triangle (Osada et al., Shape Distributions, 2002, equation 1).
    r, s = np.random.default_rng(seed).random((2, len(face)))
    root = np.sqrt(r)
    shares = np.stack([1 - root, root * (1 - s), root * s], axis=1)
    corners = surface.faces[face]
    points = np.einsum("nk,nkc->nc", shares, surface.vertices[corners])
    if surface.colors is None:
        return Cloud(points)
    colors = surface.colors[corners].astype(np.float64)
    mixed = np.einsum("nk,nkc->nc", shares, colors)
    return Cloud(points, np.rint(mixed).astype(np.uint8))


def write_ply(path: Where, shape: Cloud | Surface) -> None:
    """Write `ply_bytes`. Raises OutputError."""
    write_file(path, ply_bytes(shape))


def write_glb(
    path: Where, shape: Cloud | Surface, world_from_cam: ArrayLike | None = None
) -> None:
    """Write `glb_bytes`. Raises OutputError."""
    write_file(path, glb_bytes(shape, world_from_cam))


def ply_bytes(shape: Cloud | Surface) -> bytes:
    """A binary PLY in world axes, metres, with colours. Coordinates are float32, or double far from the origin."""
    written = bytes(_trimesh(shape).export(file_type="ply"))
    points = _points(shape)
    return written if _is_float32_enough(points) else _with_doubles(written, points)


def glb_bytes(shape: Cloud | Surface, world_from_cam: ArrayLike | None = None) -> bytes:
    """A binary glTF 2.0: metres, float32, vertex colours.

    glTF's axes are x right, y up, z towards the viewer. With `world_from_cam` (4, 4) the camera looks along -z with
    its up direction along y; without it, the world's z axis is up: (x, z, -y). Far from the origin, vertices are
    relative to a node, whose translation is exact.
    """
    if world_from_cam is None:
        gltf_from_world = _GLTF_FROM_WORLD
    else:
        gltf_from_world = _GLTF_FROM_CAM @ np.linalg.inv(np.asarray(world_from_cam))
    model = _trimesh(shape).apply_transform(gltf_from_world)
    scene = model.scene()
    points = np.asarray(model.vertices)
    if not _is_float32_enough(points):
        import trimesh

        middle = np.round(points.mean(axis=0))
        node = trimesh.transformations.translation_matrix(middle)
        scene = trimesh.Scene()
        scene.add_geometry(model.apply_translation(-middle), transform=node)
    return bytes(scene.export(file_type="glb"))


def _points(shape: Cloud | Surface) -> Float:
    return shape.points if isinstance(shape, Cloud) else shape.vertices


def _is_float32_enough(points: Float) -> bool:
    """Whether float32 coordinates are right to `_ROUNDING` of the extent of points (N, 3)."""
    if len(points) < 2:
        return True
    extent = float(np.ptp(points, axis=0).max())
    error = float(np.abs(points).max()) * float(np.finfo(np.float32).eps) / 2
    return error <= _ROUNDING * extent


def _with_doubles(ply: bytes, points: Float) -> bytes:
    """A binary PLY of trimesh with its vertices' coordinates as doubles.

    Its header declares x, y and z as floats, then the rest of a vertex, floats and bytes.
    """
    end = ply.index(_END_OF_HEADER) + len(_END_OF_HEADER)
    header = ply[:end]
    of_vertex = header.split(b"element face")[0]
    colors = of_vertex.count(b"property uchar")
    rest = colors + 4 * (of_vertex.count(b"property float") - 3)
    old = np.dtype([("xyz", "<f4", 3), ("rest", "u1", (rest,))])
    new = np.dtype([("xyz", "<f8", 3), ("rest", "u1", (rest,))])
    vertices = np.frombuffer(ply, old, count=len(points), offset=end)
    exact = np.empty(len(points), new)
    exact["xyz"] = points
    exact["rest"] = vertices["rest"]
    for axis in (b"x", b"y", b"z"):
        header = header.replace(
            b"property float " + axis + b"\n", b"property double " + axis + b"\n"
        )
    return header + exact.tobytes() + ply[end + vertices.nbytes :]


def _trimesh(shape: Cloud | Surface) -> Any:
    import trimesh

    if isinstance(shape, Cloud):
        return trimesh.PointCloud(shape.points, colors=shape.colors)
    return trimesh.Trimesh(
        shape.vertices, shape.faces, vertex_colors=shape.colors, process=False
    )


def _check(name: str, points: Float, colors: NDArray[np.uint8] | None) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"{name} must be finite (N, 3), got shape {points.shape}")
    if colors is not None and (
        colors.shape != points.shape or colors.dtype != np.uint8
    ):
        raise InputError(
            f"{name} need colours uint8 {points.shape}, got {colors.dtype} {colors.shape}"
        )
