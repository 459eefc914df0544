"""What each object covers of an image, also where others hide it: the same rays, cast at the object alone.

A pose must be rigid, so the scale of an object belongs to its model: the linear part of its placement is R P with a
rotation R and a symmetric P (the polar decomposition), P is applied to the vertices, and R is in the pose.
"""

import hashlib
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import polar

from twinlens.camera import Camera, ObjectTruth, Rig
from twinlens.camera.masks import encode_mask
from twinlens.geometry import Float, inverse, rotate, transform_points
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import Body, BuiltScene, build
from twinlens.rendering.cast import Quadric, Triangles, cast, surfaces
from twinlens.scenes import Mesh, Plugin, Scene
from twinlens.scenes.shapes import tessellated

_DIGITS = 12  # of a model's scale: poses that differ by rounding give the same model
_RAYS = 1 << 22  # traced at once; bounds the memory
_BEYOND = 1.001  # of the depth of its farthest corner: no ray hits an object there
_SIDE_POINTS = 65  # of a box, which lens distortion bends

Window = tuple[int, int, int, int]
"""The first column and row, and those after the last."""


def object_models(scene: Scene) -> dict[str, tuple[Float, NDArray[Any]]]:
    """The triangles of every object of a scene in its own axes, by `ObjectTruth.model`: vertices, metres, and faces."""
    return {
        name: (mesh.vertices, mesh.faces)
        for mesh, name, _ in models(build(scene)).values()
    }


def models(built: BuiltScene) -> dict[int, tuple[Mesh, str, Float]]:
    """By object id: the triangles in the object's own axes, their digest, and the rigid world_from_model (4, 4).

    Instances of Mitsuba files have none.
    """
    if "models" not in built.cache:
        found, known = {}, {}
        for body, surface in zip(built.bodies, surfaces(built), strict=True):
            source: Mesh | Plugin | None
            source, affine = body.model, body.world_from_model
            if isinstance(surface, Triangles) and source is None:
                source, affine = (
                    Mesh(surface.vertices, surface.faces),
                    surface.world_from_local,
                )
            elif isinstance(surface, Quadric) and source is None:
                source, affine = {"type": surface.kind}, surface.world_from_local
            if source is None or affine is None:
                continue
            world_from_model, scale = _split(affine)
            key = id(source), scale.tobytes()
            if key not in known:
                known[key] = _model(source, scale)
            found[body.object_id] = (*known[key], world_from_model)
        built.cache["models"] = found
    return built.cache["models"]  # type: ignore[no-any-return]


def _split(affine: Float) -> tuple[Float, Float]:
    """(rigid, scale), both (4, 4), whose product is `affine`; the scale of a mirror image mirrors."""
    rotation, stretch = polar(affine[:3, :3])
    sign = np.sign(np.linalg.det(rotation))
    rigid, scale = np.eye(4), np.eye(4)
    rigid[:3, :3], rigid[:3, 3] = sign * rotation, affine[:3, 3]
    scale[:3, :3] = sign * np.round(stretch, _DIGITS)
    return rigid, scale


def _model(source: Mesh | Plugin, scale: Float) -> tuple[Mesh, str]:
    mesh = source if isinstance(source, Mesh) else tessellated(source)
    faces = mesh.faces if np.linalg.det(scale) > 0 else mesh.faces[:, ::-1]
    mesh = Mesh(mesh.vertices @ scale[:3, :3], faces)  # scale is symmetric
    vertices = np.ascontiguousarray(mesh.vertices, dtype="<f4") + 0.0  # no -0.0
    return mesh, hashlib.sha256(
        vertices.tobytes() + mesh.faces.astype("<u4").tobytes()
    ).hexdigest()[:16]


def object_truths(
    built: BuiltScene, rig: Rig, index: int, object_id: NDArray[Any], depth: Float
) -> tuple[ObjectTruth, ...]:
    """Every object in the image of camera `index`; `object_id` and `depth` (H, W) are the view's."""
    camera, world_from_cam = rig.cameras[index], rig.world_from_cams[index]
    found = []
    bodies: dict[int, list[Body]] = {}
    for body in built.bodies:
        bodies.setdefault(body.object_id, []).append(
            body
        )  # one for each of its materials
    for number, (mesh, digest, world_from_model) in models(built).items():
        extent = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
        cam_from_object = inverse(world_from_cam) @ world_from_model
        corners = transform_points(
            cam_from_object, np.array(list(itertools.product(*extent.T)))
        )
        window = _window(camera, corners)
        if window is None:
            continue
        mask, visible = np.zeros(object_id.shape, dtype=bool), object_id == number
        u0, v0, u1, v1 = window
        rows, columns = slice(max(v0, 0), max(v1, 0)), slice(max(u0, 0), max(u1, 0))
        image = (
            slice(max(-v0, 0), min(camera.height, v1) - v0),
            slice(max(-u0, 0), min(camera.width, u1) - u0),
        )
        unknown = np.ones((v1 - v0, u1 - u0), dtype=bool)
        if (
            bodies[number][0].instance is None
        ):  # rays at the edge of an instance may differ by rounding: its own axes
            farthest = _BEYOND * corners[:, 2].max()
            unknown[image] = (depth[rows, columns] < farthest) & ~visible[rows, columns]
        casts = [
            _cast_alone(built, body, camera, world_from_cam, window, unknown)
            for body in bodies[number]
        ]
        whole = np.any(casts, axis=0)
        whole[image] |= visible[rows, columns]
        mask[rows, columns] = whole[image]
        if not mask.any():
            continue
        pixels = camera.project(corners)
        found.append(
            ObjectTruth(
                object_id=number,
                model=digest,
                cam_from_object=cam_from_object,
                extent=extent,
                corners_px=np.where(np.isnan(pixels), np.inf, pixels),
                silhouette=encode_mask(mask),
                pixel_count=int(np.count_nonzero(whole)),
                box=_box(whole, u0, v0),
                visible_pixel_count=int(np.count_nonzero(visible)),
                visible_box=_box(visible),
            )
        )
    return tuple(found)


def _window(camera: Camera, corners: Float) -> Window | None:
    """The pixels that a box with `corners` (8, 3), camera frame, can cover; None if none is in the image.

    The whole image for a box that reaches behind the camera, or farther from the image than the image's size.
    """
    width, height = camera.width, camera.height
    whole = 0, 0, width, height
    if (corners[:, 2] <= 0).any():
        return whole
    low, high = (
        end(corners[:, :2] / corners[:, 2:], axis=0) for end in (np.min, np.max)
    )
    along = np.linspace(low, high, _SIDE_POINTS)
    sides = [
        np.column_stack([along[:, 0], np.full(_SIDE_POINTS, v)])
        for v in (low[1], high[1])
    ]
    sides += [
        np.column_stack([np.full(_SIDE_POINTS, u), along[:, 1]])
        for u in (low[0], high[0])
    ]
    border = np.concatenate(sides)
    pixels = camera.project(np.column_stack([border, np.ones(len(border))]))
    if np.isnan(pixels).any():
        return whole
    (u0, v0), (u1, v1) = (
        np.floor(pixels.min(axis=0)) - 1,
        np.ceil(pixels.max(axis=0)) + 2,
    )
    if u0 >= width or v0 >= height or u1 <= 0 or v1 <= 0:
        return None
    if u0 < -width or v0 < -height or u1 > 2 * width or v1 > 2 * height:
        return whole
    return int(u0), int(v0), int(u1), int(v1)


def _cast_alone(
    built: BuiltScene,
    body: Body,
    camera: Camera,
    world_from_cam: Float,
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
    local_from_cam = world_from_cam
    if body.instance is not None:
        pose = np.asarray(
            mitsuba().traverse(body.instance)["to_world"].matrix, dtype=np.float64
        ).reshape(4, 4)
        local_from_cam = np.linalg.inv(pose) @ world_from_cam
    step = max(1, _RAYS // chosen.shape[1])
    for start in range(0, len(chosen), step):
        v, u = np.nonzero(chosen[start : start + step])
        v += start
        rays = rotate(
            local_from_cam,
            camera.unproject(np.stack([u + window[0], v + window[1]], axis=-1)),
        )
        known = np.isfinite(rays).all(axis=1)
        hit[v[known], u[known]] = (
            cast(alone, local_from_cam[:3, 3], rays[known]).body >= 0
        )
    return hit


def _scene_of(built: BuiltScene, body: Body) -> BuiltScene:
    """A scene with only the shape of a body, made once for each shape."""
    scenes = built.cache.setdefault("alone", {})
    if id(body.shape) not in scenes:
        parts = {
            "type": "scene",
            "embree_use_robust_intersections": True,
            "shape": body.shape,
        }
        scene = mitsuba().load_dict(parts, optimize=False)
        only = Body(body.object_id, body.material_id, body.material_kind, body.shape)
        scenes[id(body.shape)] = BuiltScene(scene, None, (only,), (), ())
    return scenes[id(body.shape)]  # type: ignore[no-any-return]


def _box(mask: NDArray[np.bool_], u0: int = 0, v0: int = 0) -> tuple[int, ...]:
    """(u, v, width, height) of the set pixels of a mask whose first pixel is (u0, v0); zeros if none is set."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return (0, 0, 0, 0)
    u, v = int(columns[0]), int(rows[0])
    return (u + u0, v + v0, int(columns[-1]) - u + 1, int(rows[-1]) - v + 1)
