"""What each object covers of an image, also where others hide it: the same rays, cast at the object alone.

A pose must be rigid, so the scale of an object belongs to its model: the linear part of its placement is R P with a
rotation R and a symmetric P (the polar decomposition), P is applied to the vertices, and R is in the pose.
"""

import hashlib
import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import polar

from twinlens.camera import Camera, ObjectTruth, Rig
from twinlens.camera.masks import encode_mask
from twinlens.geometry import Float, inverse, rotate, transform_points
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import Body, BuiltScene, build
from twinlens.rendering.frames import SceneFrame, default_frame
from twinlens.rendering.surfaces import Surface, Triangles, pose_of, surfaces
from twinlens.rendering.tracing import Rays, intersect, lengths
from twinlens.scenes import Mesh, Plugin, Scene
from twinlens.scenes.shapes import tessellated

_DIGITS = 12  # of a model's scale: poses that differ by rounding give the same model
_RAYS = 1 << 22  # traced at once; bounds the memory
_BEYOND = 1.001  # of the distance of its farthest corner: no ray hits an object there
_SIDE_POINTS = 65  # of a box, which lens distortion bends


class Window(NamedTuple):
    """A rectangle of pixels: the first column and row, and those after the last."""

    u0: int
    v0: int
    u1: int
    v1: int


def object_models(scene: Scene) -> dict[str, tuple[Float, NDArray[Any]]]:
    """The triangles of every object of a scene in its own axes, by `ObjectTruth.model`: vertices, metres, and faces."""
    return {
        model.digest: (model.mesh.vertices, model.mesh.faces)
        for model in models_of(scene).values()
    }


class Model(NamedTuple):
    """An object's triangles in its own axes, their digest, and its rigid pose."""

    mesh: Mesh
    digest: str
    world_from_model: Float


def models_of(scene: Scene, built: BuiltScene | None = None) -> dict[int, Model]:
    """The model of each object, by object id. Instances of Mitsuba files have none.

    built : the scene in any frame. Models of a scene file do not depend on it. The vertices of a Mitsuba file are read
        back from the renderer, in one frame, so that their rounding and their digests do not depend on the rig.
    """
    if built is None or scene.xml is not None:
        built = build(scene, default_frame(scene))
    return _models(built)


def _models(built: BuiltScene) -> dict[int, Model]:
    if "models" not in built.cache:
        by_object: dict[int, Model] = {}
        by_shape: dict[tuple[int, bytes], tuple[Mesh, str]] = {}  # shared by copies
        for body, surface in zip(built.bodies, surfaces(built), strict=True):
            source, affine = _source(body, surface, built.frame)
            if source is None or affine is None:
                continue
            world_from_model, scale = _split(affine)
            key = id(source), scale.tobytes()
            if key not in by_shape:
                by_shape[key] = _scaled_mesh(source, scale)
            by_object[body.object_id] = Model(*by_shape[key], world_from_model)
        built.cache["models"] = by_object
    return built.cache["models"]  # type: ignore[no-any-return]


def _source(
    body: Body, surface: Surface | None, frame: SceneFrame
) -> tuple[Mesh | Plugin | None, Float | None]:
    """A body's shape and its affine pose: those of the scene file, or else those that Mitsuba read, in `frame`."""
    if body.model is not None or surface is None:
        return body.model, body.world_from_model
    pose = frame.to_world @ surface.world_from_local
    if isinstance(surface, Triangles):
        vertices = transform_points(pose, surface.vertices)
        return Mesh(vertices, surface.faces), np.eye(4)
    return {"type": surface.kind}, pose


def _split(affine: Float) -> tuple[Float, Float]:
    """(rigid, scale), both (4, 4), whose product is `affine`; the scale of a mirror image mirrors.

    The polar decomposition A = R S of the linear part, with R orthogonal and S symmetric and positive. Where det R =
    -1, (-R) (-S) has a rotation. S is rounded, so that copies of one size in other poses have the same model to the
    bit.
    """
    rotation, stretch = polar(affine[:3, :3])
    sign = np.sign(np.linalg.det(rotation))
    rigid, scale = np.eye(4), np.eye(4)
    rigid[:3, :3], rigid[:3, 3] = sign * rotation, affine[:3, 3]
    scale[:3, :3] = sign * np.round(stretch, _DIGITS)
    return rigid, scale


def _scaled_mesh(source: Mesh | Plugin, scale: Float) -> tuple[Mesh, str]:
    """The triangles of a shape after `scale` (4, 4), and the digest of these in float32."""
    mesh = source if isinstance(source, Mesh) else tessellated(source)
    faces = mesh.faces if np.linalg.det(scale) > 0 else mesh.faces[:, ::-1]
    mesh = Mesh(mesh.vertices @ scale[:3, :3], faces)  # scale is symmetric
    vertices = np.ascontiguousarray(mesh.vertices, dtype="<f4") + 0.0  # no -0.0
    content = vertices.tobytes() + mesh.faces.astype("<u4").tobytes()
    return mesh, hashlib.sha256(content).hexdigest()[:16]


def object_truths(
    built: BuiltScene,
    models: dict[int, Model],
    rig: Rig,
    index: int,
    object_id: NDArray[Any],
    distance: Float,
) -> tuple[ObjectTruth, ...]:
    """Every object in the image of camera `index`; `object_id` and `distance` (H, W) are the view's."""
    view = _View(rig.cameras[index], rig.world_from_cams[index], object_id, distance)
    bodies: dict[int, list[Body]] = {}  # of each object, one for each of its materials
    for body in built.bodies:
        bodies.setdefault(body.object_id, []).append(body)
    truths = [
        _object_truth(built, view, number, model, bodies[number])
        for number, model in models.items()
    ]
    return tuple(truth for truth in truths if truth is not None)


@dataclass(frozen=True, eq=False)
class _View:
    """A camera, its pose, and the objects and their distances (H, W) that it sees."""

    camera: Camera
    world_from_cam: Float
    object_id: NDArray[Any]
    distance: Float


def _object_truth(
    built: BuiltScene, view: _View, number: int, model: Model, bodies: list[Body]
) -> ObjectTruth | None:
    """The truth of object `number`; None if no chief ray through the image meets it."""
    low = model.mesh.vertices.min(axis=0)
    high = model.mesh.vertices.max(axis=0)
    cam_from_object = inverse(view.world_from_cam) @ model.world_from_model
    box = np.array(list(itertools.product(*zip(low, high, strict=True))))
    corners = transform_points(cam_from_object, box)
    window = _window(view.camera, corners)
    if window is None:
        return None
    visible = view.object_id == number
    farthest = lengths(corners).max()
    whole = _coverage(built, view, bodies, window, farthest, visible)
    mask = np.zeros(visible.shape, dtype=bool)
    in_image, in_window = _overlap(view.camera, window)
    mask[in_image] = whole[in_window]
    if not mask.any():
        return None
    pixels = view.camera.project(corners)
    return ObjectTruth(
        object_id=number,
        model=model.digest,
        cam_from_object=cam_from_object,
        extent=np.stack([low, high]),
        corners_px=np.where(np.isnan(pixels), np.inf, pixels),
        silhouette=encode_mask(mask),
        pixel_count=int(np.count_nonzero(whole)),
        box=_box(whole, window.u0, window.v0),
        visible_pixel_count=int(np.count_nonzero(visible)),
        visible_box=_box(visible),
    )


def _coverage(
    built: BuiltScene,
    view: _View,
    bodies: list[Body],
    window: Window,
    farthest: float,
    visible: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """The pixels of the window (h, w) whose chief rays meet the object, which ends at the distance `farthest`.

    Where it is visible, they do. Where something beyond it is visible, they do not.
    """
    in_image, in_window = _overlap(view.camera, window)
    unknown = np.ones((window.v1 - window.v0, window.u1 - window.u0), dtype=bool)
    # Instances are cast at in their own axes, where rays at an edge may differ by rounding: cast all that are not seen.
    if bodies[0].instance is None:
        may_hide = view.distance[in_image] < _BEYOND * farthest
        unknown[in_window] = may_hide & ~visible[in_image]
    whole = np.zeros_like(unknown)
    for body in bodies:
        whole |= _cast_alone(built, body, view, window, unknown)
    whole[in_window] |= visible[in_image]
    return whole


def _overlap(
    camera: Camera, window: Window
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The part that image and window share: its rows and columns in the image, and in the window."""
    u0, v0 = max(window.u0, 0), max(window.v0, 0)
    u1, v1 = min(window.u1, camera.width), min(window.v1, camera.height)
    in_image = slice(v0, max(v1, 0)), slice(u0, max(u1, 0))
    in_window = (
        slice(v0 - window.v0, v1 - window.v0),
        slice(u0 - window.u0, u1 - window.u0),
    )
    return in_image, in_window


def _window(camera: Camera, corners: Float) -> Window | None:
    """The pixels that a box with `corners` (8, 3), camera frame, can cover; None if none is in the image.

    The whole image for a box that reaches behind the camera, or farther from the image than the image's size.
    """
    width, height = camera.width, camera.height
    whole = Window(0, 0, width, height)
    if (corners[:, 2] <= 0).any():
        return whole
    border = _bounding_rectangle(corners[:, :2] / corners[:, 2:])
    pixels = camera.project(np.column_stack([border, np.ones(len(border))]))
    if np.isnan(pixels).any():
        return whole
    u0, v0 = np.floor(pixels.min(axis=0)) - 1
    u1, v1 = np.ceil(pixels.max(axis=0)) + 2
    if u0 >= width or v0 >= height or u1 <= 0 or v1 <= 0:
        return None
    if u0 < -width or v0 < -height or u1 > 2 * width or v1 > 2 * height:
        return whole
    return Window(int(u0), int(v0), int(u1), int(v1))


def _bounding_rectangle(points: Float) -> Float:
    """Points (4 n, 2) on the sides of the rectangle around `points` (m, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = np.linspace(low, high, _SIDE_POINTS).T
    ones = np.ones(_SIDE_POINTS)
    top = np.column_stack([x, low[1] * ones])
    bottom = np.column_stack([x, high[1] * ones])
    left = np.column_stack([low[0] * ones, y])
    right = np.column_stack([high[0] * ones, y])
    return np.concatenate([top, bottom, left, right])


def _cast_alone(
    built: BuiltScene,
    body: Body,
    view: _View,
    window: Window,
    chosen: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Whether the chief rays of the `chosen` pixels (h, w) of the window hit the body, (h, w) bool; False elsewhere.

    The scene has the body's shape only. Rays are cast in the axes of an instance, so that instances share this scene.
    """
    hit = np.zeros(chosen.shape, dtype=bool)
    if not chosen.any():
        return hit
    alone = _scene_of(built, body)
    local_from_cam = built.frame.rigid(view.world_from_cam)
    if body.instance is not None:
        local_from_cam = np.linalg.inv(pose_of(body.instance)) @ local_from_cam
    centre = local_from_cam[:3, 3]
    step = max(1, _RAYS // chosen.shape[1])
    for start in range(0, len(chosen), step):
        v, u = np.nonzero(chosen[start : start + step])
        v += start
        pixels = np.stack([u + window.u0, v + window.v0], axis=-1)
        ahead = rotate(local_from_cam, view.camera.rays(pixels))
        has_ray = np.isfinite(ahead[:, 0])  # pixels far outside may have none
        if not has_ray.all():
            v, u, ahead = v[has_ray], u[has_ray], ahead[has_ray]
        # The directions have unit length already, as those of a camera.
        rays = Rays(np.broadcast_to(centre, ahead.shape), ahead)
        hit[v, u] = intersect(alone, rays).body >= 0
    return hit


def _scene_of(built: BuiltScene, body: Body) -> BuiltScene:
    """A scene with only the shape of a body, made once for each shape."""
    scenes: dict[int, BuiltScene] = built.cache.setdefault("alone", {})
    if id(body.shape) not in scenes:
        parts = {
            "type": "scene",
            "embree_use_robust_intersections": True,
            "shape": body.shape,
        }
        scene = mitsuba().load_dict(parts, optimize=False)
        alone = Body(body.object_id, body.material_id, body.material_kind, body.shape)
        scenes[id(body.shape)] = BuiltScene(scene, None, [alone], (), ())
    return scenes[id(body.shape)]


def _box(mask: NDArray[np.bool_], u0: int = 0, v0: int = 0) -> tuple[int, ...]:
    """(u, v, width, height) of the set pixels of a mask whose first pixel is (u0, v0); zeros if none is set."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return (0, 0, 0, 0)
    u, v = int(columns[0]), int(rows[0])
    width, height = int(columns[-1]) - u + 1, int(rows[-1]) - v + 1
    return (u + u0, v + v0, width, height)
