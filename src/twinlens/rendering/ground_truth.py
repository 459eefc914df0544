"""Exact ground truth of every view: what the chief rays through its pixels hit, and whether other views see it too.

    Built + Rig --chief rays, trace_surfaces--> ViewHits --channels--> Truth

A channel is an array over the pixels of a view. Those of every `Truth` are its fields. A further one is a function of
`ViewHits` and a row of `EXTRA_CHANNELS`; `Truth.extra` has it under its name.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Rig
from twinlens.camera.truth import Correspondence, Projection, Truth
from twinlens.errors import InputError, check_int, format_value, located
from twinlens.geometry import Float, inverse, rotate, transform_points
from twinlens.geometry.motion import check_time
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.framing import built_at, built_for
from twinlens.rendering.object_truth import models_of, object_truths
from twinlens.rendering.requests import check_types, check_view
from twinlens.rendering.tracing import (
    Hits,
    Rays,
    Stop,
    intersect,
    trace_surfaces,
    visible_from,
)
from twinlens.scenes import Scene


@dataclass(frozen=True, eq=False)
class ViewHits:
    """What the chief rays of camera `index` of a rig hit; arrays have one row per pixel, N = H W.

    rays : the chief rays, in world coordinates.
    cosine : (N,), of the angle between a ray and the optical axis.
    first : the surfaces that they hit first.
    """

    built: BuiltScene
    rig: Rig
    index: int
    rays: Rays
    cosine: Float
    first: Hits

    @property
    def camera(self) -> Camera:
        """The camera of the view."""
        return self.rig.cameras[self.index]

    @property
    def depth(self) -> Float:
        """Distance along the optical axis (N,), metres: that along the ray times the cosine; +inf without a hit."""
        along_axis = self.first.distance * self.cosine
        return np.where(self.first.is_hit, along_axis, np.inf)

    def layers(self) -> list[Hits]:
        """The surfaces along the chief rays, through mirrors, glass and openings, from the first one on."""
        return trace_surfaces(self.built, self.rays, Stop.ALL)

    def image(self, values: NDArray[Any], dtype: Any = None) -> NDArray[Any]:
        """The values (N, ...) as an image (H, W, ...)."""
        shape = (self.camera.height, self.camera.width, *values.shape[1:])
        return values.astype(dtype or values.dtype, copy=False).reshape(shape)


EXTRA_CHANNELS: dict[str, Callable[[ViewHits], NDArray[Any]]] = {}
"""Channels of `Truth.extra`, by name: functions from the hits of a view to an array (N,) or (N, 3).

A name must not be that of a field of `Truth`.
"""


def ground_truth(
    scene: Scene,
    rig: Rig,
    *,
    sky_disparity: bool = False,
    objects: bool = True,
    check: Callable[[Sequence[Truth]], object] = lambda truths: None,
) -> list[Truth]:
    """The exact ground truth of every camera of `rig`, with disparity to its partner (`Rig.partner`).

    It does not depend on lens or samples.

    Parameters
    ----------
    sky_disparity : bool
        Give rays that hit nothing the disparity at infinity, -doffs, instead of +inf (unknown).
    objects : bool
        Also compute `Truth.objects`, by casting the rays at each object alone. This takes about as long as the rest.
    check : callable
        Called with the truth of every camera before its objects are computed. It may raise, which saves their time.

    Returns
    -------
    list of Truth
        One per camera.

    Raises
    ------
    InputError
        If `scene` or `rig` is not one, or the scene cannot be built.
    """
    check_view(scene, rig)
    _check_extra_names()
    built = built_for(scene, rig)
    truths, distances = [], []
    for index in range(len(rig)):
        hits = _view_hits(built, rig, index)
        truths.append(_truth(hits, sky_disparity))
        distances.append(hits.image(hits.first.distance))
    check(truths)
    if not objects:
        return truths
    models = models_of(scene, built)
    return [
        replace(
            truth,
            objects=object_truths(built, models, rig, index, truth.object_id, distance),
        )
        for index, (truth, distance) in enumerate(zip(truths, distances, strict=True))
    ]


def _view_hits(built: BuiltScene, rig: Rig, index: int) -> ViewHits:
    camera, pose = rig.cameras[index], rig.world_from_cams[index]
    bearings = camera.rays(camera.pixel_grid()).reshape(-1, 3)
    rays = Rays.from_point(pose[:3, 3], rotate(pose, bearings))
    (first,) = trace_surfaces(built, rays, Stop.FIRST)
    return ViewHits(built, rig, index, rays, bearings[:, 2], first)


def _truth(view: ViewHits, sky_disparity: bool) -> Truth:
    """The channels of a view, without its objects."""
    built, first = view.built, view.first
    partner = _in_partner(view, sky_disparity)
    ids = [
        (body.object_id, body.material_id, body.material_kind) for body in built.bodies
    ]
    ids.append((0, 0, 0))  # row -1, of no hit
    object_id, material_id, material_kind = np.array(ids).T[:, first.body]
    return Truth(
        depth=view.image(view.depth, np.float64),
        position=view.image(first.position, np.float64),
        disparity=view.image(partner.disparity, np.float32),
        visible=view.image(partner.visible, np.bool_),
        normal=view.image(first.normal, np.float32),
        shading_normal=view.image(first.shading_normal, np.float32),
        object_id=view.image(object_id, np.int32),
        material_id=view.image(material_id, np.int32),
        material_kind=view.image(material_kind, np.uint8),
        object_names=built.object_names,
        material_names=built.material_names,
        projections=tuple(
            _projection(view, projector)
            for projector in range(len(view.rig.projectors))
        ),
        extra={name: _extra_channel(view, name) for name in EXTRA_CHANNELS},
    )


def _extra_channel(view: ViewHits, name: str) -> NDArray[Any]:
    """The image of a row of `EXTRA_CHANNELS`. Raises InputError for an array of another shape."""
    values = EXTRA_CHANNELS[name](view)
    pixels = len(view.rays)
    is_array = isinstance(values, np.ndarray)
    if not is_array or values.shape not in ((pixels,), (pixels, 3)):
        result = f"the shape {values.shape}" if is_array else type(values).__name__
        raise InputError(
            f"the function of channel {name!r} must return an array ({pixels},) or ({pixels}, 3), a row for each pixel "
            f"of {view.camera.height} x {view.camera.width}, got {result}"
        )
    return view.image(values)


def _check_extra_names() -> None:
    """Raise InputError for a channel whose name is taken, which nothing would read."""
    for field in fields(Truth):
        if field.name in EXTRA_CHANNELS:
            raise InputError(
                f"channel {field.name!r} of EXTRA_CHANNELS needs another name: Truth has a field of that name"
            )


_moving = threading.RLock()
"""Held while a moving scene is traced at its two times."""


class _Instant(NamedTuple):
    """A camera at a time in seconds."""

    camera: int
    time: float


def correspondence(
    scene: Scene,
    rig: Rig,
    source: int | tuple[int, float] = 0,
    target: int | tuple[int, float] = 1,
    *,
    sky: bool = False,
) -> Correspondence:
    """The position of every pixel of camera `source` in the image of camera `target`, and its visibility there.

    The hits of the source's chief rays move with their objects to the target's time, and are projected into the target.
    Any poses and distortions are allowed, also two cameras at one position, and any times, also backwards.

    Parameters
    ----------
    source, target : int or (int, float)
        A camera of the rig, or a camera and a time in seconds; without a time, 0. The same camera at two times gives
        optical flow.
    sky : bool
        Give rays that hit nothing the pixel of the point at infinity, instead of +inf (unknown).

    Disparities are those of `source` and `target`; if these are one camera, of this camera and its partner
    (`Rig.partner`).

    Raises InputError unless source and target are two cameras of the rig, or one camera at two times; and for times
    that the motions of scene and rig do not cover.
    """
    check_types(scene, rig)
    here, there = _instant(rig, "source", source), _instant(rig, "target", target)
    if here == there:
        raise InputError(
            f"a pair needs two different cameras from 0 to {len(rig) - 1}, or one camera at two times (camera, "
            f"seconds), got {source} and {target}"
        )
    # A moving scene is built once, and others must not move it meanwhile.
    with _moving if scene.motion else contextlib.nullcontext():
        return _correspondence(scene, rig, here, there, sky)


def _correspondence(
    scene: Scene, rig: Rig, here: _Instant, there: _Instant, sky: bool
) -> Correspondence:
    rig_now = rig.at(here.time)
    view = _view_hits(built_at(scene, here.time, rig_now), rig_now, here.camera)
    now = _Then(view.built, rig_now, view.first.position)
    # At the target's time `view.built` is moved too, and only its hits are used.
    poses = _poses(view.built)
    rig_then = rig.at(there.time)
    built = built_at(scene, there.time, rig_then)
    then = _Then(built, rig_then, _carried(view.first, poses, _poses(built)))
    seen = _seen_from(view, then, there.camera, sky)
    is_one_camera = here.camera == there.camera
    partner = rig.partner(here.camera) if is_one_camera else there.camera
    return Correspondence(
        view.image(seen.pixels, np.float64),
        view.image(seen.visible, np.bool_),
        view.image(_disparity_at(view, now, partner, sky), np.float32),
        view.image(_disparity_at(view, then, partner, sky), np.float32),
        view.image(_scene_flow(view, then), np.float64),
    )


def _instant(rig: Rig, name: str, value: Any) -> _Instant:
    """A camera, or (camera, seconds), of a rig. Raises InputError."""
    camera, time = value, 0.0
    if isinstance(value, (tuple, list)):
        if len(value) != 2:
            raise InputError(
                f"{name} must be a camera, or (camera, seconds), got {format_value(value)}"
            )
        camera, time = value
    check_int(f"the {name} camera", camera, 0, len(rig) - 1)
    with located(name):
        return _Instant(int(camera), check_time(time))


def _poses(built: BuiltScene) -> list[Float | None]:
    """The poses of all bodies now; None for shapes of a Mitsuba file."""
    return [body.world_from_model for body in built.bodies]


def _carried(
    first: Hits, before: Sequence[Float | None], after: Sequence[Float | None]
) -> Float:
    """The hits (N, 3), in the world, after their bodies moved from the poses `before` to those `after`."""
    position = first.position.copy()
    for row in np.unique(first.body[first.is_hit]).tolist():
        start, end = before[row], after[row]
        if start is None or end is None or np.array_equal(start, end):
            continue
        on_body = first.body == row
        # Differences from the body's origin come first: they are exact far from the origin of the world.
        turn = end[:3, :3] @ np.linalg.inv(start[:3, :3])
        from_origin = position[on_body] - start[:3, 3]
        position[on_body] = from_origin @ turn.T + end[:3, 3]
    return position


def _disparity_at(
    view: ViewHits, then: "_Then", partner: int | None, sky: bool
) -> Float:
    """The disparity (N,) of the hits between the view's camera and a partner, at a time; +inf without a partner."""
    if partner is None:
        return np.full(len(view.rays), np.inf)
    if then.position is view.first.position:
        own_pixels = view.camera.pixel_grid().reshape(-1, 2)  # without rounding
    else:
        own_pixels = _pixels_in(view, then, view.index, sky)
    pixels = _pixels_in(view, then, partner, sky)
    return _disparity(view, then.rig, (view.index, partner), own_pixels, pixels)


def _scene_flow(view: ViewHits, then: "_Then") -> Float:
    """How the surface points move (N, 3), in the frame of the view's camera; +inf where nothing was hit."""
    hit = view.first.is_hit
    moved = then.position[hit] - view.first.position[hit]
    flow = np.full(then.position.shape, np.inf)
    flow[hit] = rotate(_cam_from_world(view.rig, view.index), moved)
    return flow


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
    return _projection(_view_hits(built_for(scene, rig), rig, camera), projector)


def _projection(view: ViewHits, projector: int) -> Projection:
    views = view.rig.views  # the cameras, then the projectors
    lamp = len(view.rig) + projector
    then = _Then(view.built, views, view.first.position)
    seen = _seen_from(view, then, lamp, sky=False)
    with np.errstate(invalid="ignore"):  # +inf where nothing was hit
        towards = views.world_from_cams[lamp][:3, 3] - view.first.position
        is_front_lit = (view.first.normal * towards).sum(axis=1) > 0
    return Projection(view.image(seen.pixels), view.image(seen.visible & is_front_lit))


class _Then(NamedTuple):
    """The time at which others see what a view hits: the scene and its cameras then, and where the hits are then.

    position : (N, 3), world coordinates; +inf where nothing was hit.
    """

    built: BuiltScene
    rig: Rig
    position: Float


class _Seen(NamedTuple):
    """Where another view sees what the pixels of a view hit.

    pixels : (N, 2), +inf for points without an image.
    visible : (N,), whether the point is in the other's image and not occluded.
    """

    pixels: Float
    visible: NDArray[np.bool_]


def _seen_from(view: ViewHits, then: _Then, target: int, sky: bool) -> _Seen:
    """Where view `target` of the rig sees the hits; with `sky`, also the points at infinity of rays without a hit."""
    first, hit = view.first, view.first.is_hit
    centre = then.rig.world_from_cams[target][:3, 3]
    pixels = _pixels_in(view, then, target, sky)
    visible = np.zeros(len(hit), dtype=bool)
    visible[hit] = visible_from(
        then.built, centre, then.position[hit], first.body[hit], first.prim[hit]
    )
    if sky:
        towards_sky = Rays.from_point(centre, view.rays.direction[~hit])
        visible[~hit] = intersect(then.built, towards_sky).body < 0
    return _Seen(pixels, visible & then.rig.cameras[target].contains(pixels))


def _pixels_in(view: ViewHits, then: _Then, index: int, sky: bool) -> Float:
    """The pixels (N, 2) of the hits in a camera; with `sky`, also of the points at infinity of rays without a hit."""
    hit = view.first.is_hit
    camera, cam_from_world = then.rig.cameras[index], _cam_from_world(then.rig, index)
    pixels = np.full((len(hit), 2), np.inf)
    pixels[hit] = camera.project(transform_points(cam_from_world, then.position[hit]))
    if sky:
        directions = view.rays.direction[~hit]
        pixels[~hit] = camera.project(rotate(cam_from_world, directions))
    pixels[np.isnan(pixels)] = np.inf  # points that the camera cannot project
    return pixels


def _cam_from_world(rig: Rig, index: int) -> Float:
    return inverse(rig.world_from_cams[index])


class _Partner(NamedTuple):
    """Disparity (N,), pixels, and visibility (N,) towards the partner of a view."""

    disparity: Float
    visible: NDArray[np.bool_]


def _in_partner(view: ViewHits, sky_disparity: bool) -> _Partner:
    partner = view.rig.partner(view.index)
    if partner is None:
        count = len(view.rays)
        return _Partner(np.full(count, np.inf), np.zeros(count, dtype=bool))
    sky = sky_disparity and _is_rectified(view.rig, view.index, partner)
    then = _Then(view.built, view.rig, view.first.position)
    seen = _seen_from(view, then, partner, sky)
    own_pixels = view.camera.pixel_grid().reshape(-1, 2)
    pair = view.index, partner
    disparity = _disparity(view, view.rig, pair, own_pixels, seen.pixels)
    return _Partner(disparity, seen.visible)


def _disparity(
    view: ViewHits, rig: Rig, pair: tuple[int, int], pixels: Float, others: Float
) -> Float:
    """u_left - u_right (N,) of a rectified pair in either order, from the pixels (N, 2) of the hits in its two cameras.

    At infinity it is -doffs. +inf for cameras that are no such pair, and for points without an image.
    """
    hit = view.first.is_hit
    disparity = np.full(len(hit), np.inf)
    if not _is_rectified(rig, *pair):
        return disparity
    is_left = rig.is_rectified(*pair)
    left, right = pair if is_left else pair[::-1]
    has_images = np.isfinite(pixels[:, 0]) & np.isfinite(others[:, 0])
    near, far = hit & has_images, ~hit & has_images
    difference = pixels[near, 0] - others[near, 0]
    disparity[near] = difference if is_left else -difference
    disparity[far] = 0.0 - rig.doffs(left, right)  # not -0.0
    return disparity


def _is_rectified(rig: Rig, a: int, b: int) -> bool:
    """Whether two cameras are a rectified pair, in either order."""
    return rig.is_rectified(a, b) or rig.is_rectified(b, a)
