"""Exact ground truth of every view: one chief ray per pixel, refined in float64, and one ray from the other camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.camera.truth import Correspondence, Projection, Truth
from twinlens.errors import InputError, check_int
from twinlens.geometry import Float, inverse, rotate, transform_points
from twinlens.rendering.build import BuiltScene, build
from twinlens.rendering.cast import Exact, Hits, cast, exact_hits, visible_from
from twinlens.rendering.object_truth import object_truths
from twinlens.rendering.radiance import check_view
from twinlens.scenes import Scene


@dataclass(frozen=True, eq=False)
class _View:
    """The hits of one camera's chief rays, one row per pixel, with directions and positions (N, 3)."""

    index: int
    hits: Hits
    exact: Exact
    directions: Float
    position: Float


def ground_truth(
    scene: Scene, rig: Rig, *, sky_disparity: bool = False, objects: bool = True
) -> list[Truth]:
    """The exact ground truth of every camera of `rig`, with disparity to its partner (`Rig.partner`).

    It does not depend on lens or samples.

    Parameters
    ----------
    sky_disparity : bool
        Give rays that hit nothing the disparity at infinity, -doffs, instead of +inf (unknown).
    objects : bool
        Also compute `Truth.objects`, by casting the rays at each object alone.

    Returns
    -------
    list of Truth
        One per camera.
    """
    check_view(scene, rig)
    built = build(scene)
    truths = [
        _view_truth(built, rig, index, sky_disparity) for index in range(len(rig))
    ]
    return with_object_truth(scene, rig, truths) if objects else truths


def with_object_truth(scene: Scene, rig: Rig, truths: Sequence[Truth]) -> list[Truth]:
    """The truths of `ground_truth` for the same scene and rig, with `Truth.objects`."""
    built = build(scene)
    return [
        replace(each, objects=object_truths(built, rig, i, each.object_id, each.depth))
        for i, each in enumerate(truths)
    ]


def correspondence(
    scene: Scene, rig: Rig, source: int = 0, target: int = 1, *, sky: bool = False
) -> Correspondence:
    """The position of every pixel of camera `source` in the image of camera `target`, and its visibility there.

    The hits of the source's chief rays are projected into the target. Any poses and distortions are allowed, also two
    cameras at one position.

    Parameters
    ----------
    sky : bool
        Give rays that hit nothing the pixel of the point at infinity, instead of +inf (unknown).

    Raises InputError unless source and target are two cameras of the rig.
    """
    check_view(scene, rig)
    if not (0 <= source < len(rig) and 0 <= target < len(rig)) or source == target:
        raise InputError(
            f"a pair needs two different cameras from 0 to {len(rig) - 1}, got {source} and {target}"
        )
    built = build(scene)
    pixels, disparity, visible = _project_into(
        built, rig, _cast_view(built, rig, source), target, sky
    )
    shape = rig.cameras[source].height, rig.cameras[source].width
    return Correspondence(
        pixels.reshape(*shape, 2),
        visible.reshape(shape),
        disparity.astype(np.float32).reshape(shape),
    )


def projection(
    scene: Scene, rig: Rig, camera: int = 0, projector: int = 0
) -> Projection:
    """The position in the pattern of `projector` that lights what each pixel of `camera` sees, and whether it does.

    A chief ray through each pixel's centre, and a ray from the projector's centre to where it hits. Projector i is
    camera len(rig) + i of `rig.views`, with which these pixels can be triangulated.

    Raises InputError unless both are in the rig.
    """
    check_view(scene, rig)
    if not rig.projectors:
        raise InputError("the rig has no projectors")
    check_int("camera", camera, 0, len(rig) - 1)
    check_int("projector", projector, 0, len(rig.projectors) - 1)
    built = build(scene)
    return _projection(built, rig, _cast_view(built, rig, camera), projector)


def _projection(built: BuiltScene, rig: Rig, view: _View, projector: int) -> Projection:
    camera, views, lamp = rig.cameras[view.index], rig.views, len(rig) + projector
    pixels, _, lit = _project_into(built, views, view, lamp, sky=False)
    with np.errstate(invalid="ignore"):  # +inf where nothing was hit
        towards = views.world_from_cams[lamp][:3, 3] - view.position
        lit &= (_facing(view.exact.normal, -view.directions) * towards).sum(axis=1) > 0
    shape = camera.height, camera.width
    return Projection(pixels.reshape(*shape, 2), lit.reshape(shape))


def _cast_view(built: BuiltScene, rig: Rig, index: int) -> _View:
    camera, pose = rig.cameras[index], rig.world_from_cams[index]
    directions = rotate(pose, camera.unproject(camera.pixel_grid())).reshape(-1, 3)
    hits = cast(built, pose[:3, 3], directions)
    exact = exact_hits(built, pose[:3, 3], directions, hits)
    found = hits.body >= 0
    position = np.full_like(directions, np.inf)
    position[found] = pose[:3, 3] + exact.t[found, None] * directions[found]
    return _View(index, hits, exact, directions, position)


def _view_truth(built: BuiltScene, rig: Rig, index: int, sky_disparity: bool) -> Truth:
    view, camera, other = (
        _cast_view(built, rig, index),
        rig.cameras[index],
        rig.partner(index),
    )
    disparity = np.full(len(view.position), np.inf)
    visible = np.zeros(len(view.position), dtype=bool)
    if other is not None:
        sky = sky_disparity and rig.is_rectified(*_in_order(rig, index, other))
        _, disparity, visible = _project_into(built, rig, view, other, sky)
    ids = [
        (body.object_id, body.material_id, body.material_kind) for body in built.bodies
    ]
    object_id, material_id, material_kind = np.array([*ids, (0, 0, 0)]).T[
        :, view.hits.body
    ]  # row -1 is no hit
    normal = _facing(view.exact.normal, -view.directions)

    def image(values: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
        return values.astype(dtype, copy=False).reshape(
            camera.height, camera.width, *values.shape[1:]
        )

    return Truth(
        depth=image(view.exact.t, np.float64),
        position=image(view.position, np.float64),
        disparity=image(disparity, np.float32),
        visible=image(visible, np.bool_),
        normal=image(normal, np.float32),
        shading_normal=image(_facing(view.exact.shading_normal, normal), np.float32),
        object_id=image(object_id, np.int32),
        material_id=image(material_id, np.int32),
        material_kind=image(material_kind, np.uint8),
        object_names=built.object_names,
        material_names=built.material_names,
        projections=tuple(
            _projection(built, rig, view, i) for i in range(len(rig.projectors))
        ),
    )


def _facing(vectors: Float, towards: Float) -> Float:
    """Vectors (N, 3), negated where they point away from `towards`."""
    away = np.einsum("nc,nc->n", vectors, towards) < 0
    return np.where(away[:, None], -vectors, vectors)


def _project_into(
    built: BuiltScene, rig: Rig, view: _View, other: int, sky: bool
) -> tuple[Float, Float, NDArray[np.bool_]]:
    """(pixels in camera `other`, disparity, visible) of every pixel of `view`; disparity for rectified pairs only."""
    found = view.hits.body >= 0
    camera, pose = rig.cameras[other], rig.world_from_cams[other]
    centre, cam_from_world = pose[:3, 3], inverse(pose)
    pixels = np.full((len(found), 2), np.inf)
    visible = np.zeros(len(found), dtype=bool)
    pixels[found] = camera.project(
        transform_points(cam_from_world, view.position[found])
    )
    visible[found] = visible_from(
        built,
        centre,
        view.position[found],
        view.hits.body[found],
        view.hits.prim[found],
    )
    if sky:
        directions = view.directions[~found]
        pixels[~found] = camera.project(rotate(cam_from_world, directions))
        visible[~found] = cast(built, centre, directions).body < 0
    pixels[np.isnan(pixels)] = np.inf  # points that the camera cannot project
    visible &= camera.contains(pixels)
    disparity = np.full(len(found), np.inf)
    left, right = _in_order(rig, view.index, other)
    if rig.is_rectified(left, right):
        u = rig.cameras[view.index].pixel_grid()[..., 0].reshape(-1)
        disparity[found] = (u[found] - pixels[found, 0]) * (
            1 if view.index == left else -1
        )
        disparity[~found] = 0.0 - rig.doffs(left, right) if sky else np.inf  # not -0.0
    return pixels, disparity, visible


def _in_order(rig: Rig, a: int, b: int) -> tuple[int, int]:
    """(left, right) of a rectified pair; of any other, (b, a) or (a, b)."""
    return (a, b) if rig.is_rectified(a, b) else (b, a)
