"""Checks of the relations between the arrays of a sample; each function returns its findings, one line each.

A check of one channel is a function of a `ViewContent`, named in the channel's row of `channels.CHANNELS`. Tolerances
follow from the files: depth, position and disparity are float32, so a relation may be off by a few units in the last
place, and by 1e-4 px where pixels are compared.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from twinlens import geometry
from twinlens.camera import Camera, ObjectTruth, RecipeLens, Rig, dual_pixel_disparity
from twinlens.camera.masks import decode_mask
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.points import rounding_scale, world_points
from twinlens.dataset.sample import blur_circle_px, rectified_pair
from twinlens.dataset.visibility import HIDDEN, UNKNOWN, VISIBLE, mask_of
from twinlens.errors import InputError, counted

Arrays = Mapping[str, Any]
Findings = list[str]


@dataclass(frozen=True, eq=False)
class ViewContent:
    """What a check of a channel sees: the channels of one view by name, and what sample.json says of the view.

    rig : of the truth. number : of the view in the rig.
    lens : that of the images; the truth's `blur_circle_px` is that of the first lens.
    """

    channels: Arrays
    rig: Rig
    number: int
    lens: RecipeLens

    @property
    def camera(self) -> Camera:
        """The camera of the view."""
        return self.rig.cameras[self.number]


Check = Callable[[ViewContent], Findings]

_PX = 1e-4
# Cosine of the angle to a surface that counts as lit from its edge.
_GRAZING = 1e-3
_ROUNDING = 4 * float(np.finfo(np.float32).eps)
# How much depth may vary between neighbouring pixel centres, relative.
_DEPTH_TOLERANCE = 1e-3
# Of the pixels inside one object, which may hide parts of itself and curve between pixel centres.
_ALLOWED_FAILURES = 0.05
_SIGNIFICANCE = 1e-6
# Shift that curvature and float32 may cause on a surface that counts as flat.
_FLATNESS_PX = 0.05
_MIN_FLAT_PIXELS = 100
# Wrong pixel conventions shift a view by half a pixel.
_MAX_SHIFT_PX = 0.25
# Of correlations: at a thousand pixels chance alone gives 0.03.
_MAX_PIXELS, _MIN_PIXELS = 50_000, 1_000
# Between two correlations.
_MIN_DIFFERENCE = 0.15


def check_positions(view: ViewContent) -> Findings:
    """Every position is at its depth, on the ray through its pixel centre."""
    truth, camera = view.channels, view.camera
    world_from_cam = view.rig.world_from_cams[view.number]
    hit = truth["object_id"] > 0
    if not np.array_equal(hit, np.isfinite(truth["depth"])):
        return ["depth is not finite exactly where object_id > 0"]
    world = truth["position"][hit].astype(np.float64)
    if not np.isfinite(world).all() or not (truth["depth"][hit] > 0).all():
        return [
            "position is not finite, or depth not positive, where something was hit"
        ]
    cam = geometry.transform_points(geometry.inverse(world_from_cam), world)
    # A float32 coordinate is off by a share of the largest term of its sum.
    scale = np.abs(world).sum(axis=-1) + np.abs(world_from_cam[:3, 3]).sum()
    depth = truth["depth"][hit].astype(np.float64)
    allowed_px = scale * _ROUNDING * max(camera.fx, camera.fy) / depth + _PX
    error_px = np.abs(camera.project(cam) - camera.pixel_grid()[hit]).max(
        axis=-1, initial=0.0
    )
    error, allowed = np.abs(cam[:, 2] - depth), (scale + depth) * _ROUNDING
    return [
        *_compare("position's z differs from depth", error, allowed, "m"),
        *_compare("position does not project to its pixel", error_px, allowed_px, "px"),
    ]


def check_disparity(view: ViewContent) -> Findings:
    """d = fx B / z - doffs of the rectified pair where something was hit; elsewhere +inf, or that of infinity."""
    pair = rectified_pair(view.rig, view.number)
    if pair is None:
        return ["is a disparity map, but the view is not in a rectified pair"]
    calibration = Calibration.from_rig(view.rig.pair(*pair))
    channels = view.channels
    disparity = channels["disp"]
    hit = channels["object_id"] > 0
    sky = disparity[~hit]
    if not (np.isposinf(sky) | (np.abs(sky + calibration.doffs) <= _PX)).all():
        return ["disparity is neither unknown nor -doffs where nothing was hit"]
    depth = channels["depth"][hit].astype(np.float64)
    expected = calibration.fx * calibration.baseline / depth - calibration.doffs
    error = np.abs(disparity[hit].astype(np.float64) - expected)
    allowed = _PX + _ROUNDING * (np.abs(expected) + abs(calibration.doffs))
    return _compare("disparity differs from fx B / z - doffs", error, allowed, "px")


def check_mask(view: ViewContent) -> Findings:
    """The mask is 0 where nothing is known, 255 where the partner sees the point, 128 elsewhere."""
    channels = view.channels
    mask = channels["mask_nonocc"]
    if not np.isin(mask, (UNKNOWN, HIDDEN, VISIBLE)).all():
        return [f"mask has other values than {UNKNOWN}, {HIDDEN} and {VISIBLE}"]
    has_truth = channels["object_id"] > 0
    if "disp" in channels:
        has_truth |= np.isfinite(channels["disp"])
    wrong = np.count_nonzero(mask != mask_of(has_truth, channels["visible"]))
    if not wrong:
        return []
    return [f"mask differs from the truth at {wrong} of {mask.size} pixels"]


def check_ids(name: str, names: str | Sequence[str]) -> Check:
    """A check of channel `name`, which numbers objects from 1: no number is greater than the count of names.

    names : the names, or the name of the channel that lists them.
    """

    def check(view: ViewContent) -> Findings:
        largest = view.channels[name].max()
        count = len(view.channels[names] if isinstance(names, str) else names)
        if largest <= count:
            return []
        return [f"{name} has the value {largest}, but only {count} names exist"]

    return check


def check_objects(objects: Sequence[ObjectTruth], truth: Arrays, key: str) -> Findings:
    """Objects have rising ids of the file; their visible pixels are those of the ids, and inside their silhouettes."""
    ids, count = [entry.object_id for entry in objects], len(truth["object_names"])
    is_rising = ids == sorted(set(ids))
    if ids and not (is_rising and ids[0] > 0 and ids[-1] <= count):
        return [f"{key}: object ids are not rising numbers from 1 to {count}"]
    findings = []
    for entry in objects:
        visible = truth["object_id"] == entry.object_id
        try:
            whole = decode_mask(entry.silhouette, *visible.shape)
        except InputError as error:
            findings.append(f"{key}: object {entry.object_id}: {error}")
            continue
        has_other_count = np.count_nonzero(visible) != entry.visible_pixel_count
        if has_other_count or (visible & ~whole).any():
            findings.append(
                f"{key}: object {entry.object_id} differs from the object ids of the truth"
            )
    return findings


def check_blur(view: ViewContent) -> Findings:
    """The blur circles are those of the lens in sample.json."""
    depth = view.channels["depth"]
    expected = blur_circle_px(depth, view.camera, view.lens).astype(np.float64)
    error = np.abs(view.channels["blur_circle_px"] - expected)
    allowed = _PX + 10 * _ROUNDING * np.abs(expected)
    return _compare("blur_circle_px is not that of the lens", error, allowed, "px")


def check_dual_pixels(view: ViewContent) -> Findings:
    """The disparity of dual pixels is that of the depth and of the lens in sample.json."""
    depth, disparity = view.channels["depth"], view.channels["dp_disp"]
    expected = dual_pixel_disparity(depth, view.camera, view.lens).astype(np.float64)
    hit = np.isfinite(expected)
    if not np.array_equal(disparity[~hit], expected[~hit]):
        return ["disparity is known where nothing was hit"]
    error = np.abs(disparity[hit] - expected[hit])
    allowed = _PX + 10 * _ROUNDING * np.abs(expected[hit])
    return _compare("disparity is not that of the lens", error, allowed, "px")


def check_projections(view: ViewContent) -> Findings:
    """The pixels of each projector are those of the positions; what it lights is in its pattern, and faces it."""
    projectors, stored = view.rig.projectors, view.channels["projector_pixels"]
    if len(stored) != len(projectors):
        return [
            f"has {counted(len(stored), 'projector')}, but sample.json {len(projectors)}"
        ]
    findings = []
    for number in range(len(projectors)):
        findings += _check_projection(view, number)
    return findings


def _check_projection(view: ViewContent, number: int) -> Findings:
    """`check_projections` of one projector."""
    truth, rig = view.channels, view.rig
    pattern = rig.projectors[number].intrinsics
    pose = rig.world_from_projectors[number]
    hit, lit = truth["object_id"] > 0, truth["lit"][number]
    points = world_points(
        view.camera,
        rig.world_from_cams[view.number],
        truth["depth"],
        truth["position"],
    )
    world = points[hit]
    stored = truth["projector_pixels"][number][hit].astype(np.float64)
    cam = geometry.transform_points(geometry.inverse(pose), world)
    expected = pattern.project(cam)
    # Pixels far outside the pattern are not compared: there, rounding of the positions is many pixels.
    inside = pattern.contains(stored) | pattern.contains(expected)
    centre = rig.world_from_cams[view.number][:3, 3]
    scale = rounding_scale(world, centre, pose[:3, 3])
    farthest = 2.0 * max(pattern.fx, pattern.fy, pattern.width, pattern.height)
    allowed = _PX + _ROUNDING * farthest * (1 + scale[inside] / cam[inside, 2])
    error = np.abs(stored - expected)[inside].max(axis=-1, initial=0.0)
    name = f"projector{number}"
    what = f"position does not project to {name}.u and .v"
    findings = _compare(what, error, allowed, "px")
    # A point on the border of the pattern may be outside by rounding.
    reached = np.zeros(hit.shape, dtype=bool)
    reached[hit] = (
        inside | pattern.contains(stored - _PX) | pattern.contains(stored + _PX)
    )
    if wrong := np.count_nonzero(lit & ~reached):
        findings.append(f"{name}.lit is 1 at {wrong} pixels outside its pattern")
    towards = pose[:3, 3] - world
    cosine = (truth["normal"][hit] * towards).sum(axis=-1)
    cosine /= np.linalg.norm(towards, axis=-1)
    if wrong := np.count_nonzero(lit[hit] & (cosine < -_GRAZING)):
        findings.append(
            f"{name}.lit is 1 at {wrong} pixels whose surface faces away from it"
        )
    return findings


def check_shared_points(
    truths: tuple[Arrays, Arrays], rig: Rig, views: tuple[int, int]
) -> Findings:
    """Points of one view that are visible in the other project into it, at a depth and place that it has there.

    Depth: a point must be between the minimum and the maximum of the 3x3 depths around its projection. Only pixels with
    the same object all around in both views are tested. A finding means that at a failure rate of 5% so many failures
    have a probability below one in a million. Swapped views and different scenes fail nearly everywhere.

    Place: 3x3 bounds do not notice a view that is shifted by a pixel. Where the other view is flat and slanted, depth
    gives the shift along the slope: in u for surfaces slanted sideways, in v for those slanted up or down. The median
    of each must be within a quarter of a pixel, if there are enough pixels.
    """
    here, there = truths
    camera, world_from_other = rig.cameras[views[1]], rig.world_from_cams[views[1]]
    pose = rig.world_from_cams[views[0]]
    # The visible points of this view in the other camera's frame, and their pixels there.
    is_visible = here["visible"] & (here["object_id"] > 0)
    this_camera = rig.cameras[views[0]]
    points = world_points(this_camera, pose, here["depth"], here["position"])
    world = points[is_visible]
    cam = geometry.transform_points(geometry.inverse(world_from_other), world)
    px = camera.project(cam)
    inside = _contains(camera, px)
    if not inside.all():
        outside = np.count_nonzero(~inside)
        return [f"{outside} visible pixels project outside the other view"]
    # Silhouettes are left out in both views: depth jumps there.
    v, u = _nearest(px, camera)
    tested = _inside_one_object(here["object_id"])[is_visible]
    tested &= _inside_one_object(there["object_id"])[v, u]
    px, depth, world = px[tested], cam[tested, 2], world[tested]
    v, u = _nearest(px, camera)
    around = _neighbourhood(there["depth"], u, v)
    if findings := _check_depths(around, depth):
        return findings
    scale = rounding_scale(world, pose[:3, 3], world_from_other[:3, 3])
    # Every n-th pixel is enough for a median.
    step = max(1, len(px) // _MAX_PIXELS)
    return _check_shift(
        around[:, ::step], px[::step], depth[::step], scale[::step], camera
    )


def _contains(camera: Camera, px: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether pixels (N, 2) are in the image; those on the border may be outside by rounding."""
    inside = [camera.contains(px + shift) for shift in (0.0, -1e-3, 1e-3)]
    return np.asarray(np.any(inside, axis=0))


def _neighbourhood(
    values: NDArray[Any], u: NDArray[np.intp], v: NDArray[np.intp]
) -> NDArray[Any]:
    """The values (9, N) of the 3 x 3 pixels around (u, v), row by row."""
    shifts = itertools.product((-1, 0, 1), repeat=2)
    return np.stack([values[v + dv, u + du] for dv, du in shifts])


def _check_depths(around: NDArray[Any], depth: NDArray[np.float64]) -> Findings:
    """Points at `depth` (N,) are between the smallest and largest of the nine depths around them (9, N)."""
    nearest = around.min(axis=0) * (1 - _DEPTH_TOLERANCE)
    farthest = around.max(axis=0) * (1 + _DEPTH_TOLERANCE)
    agree = (depth >= nearest) & (depth <= farthest)
    wrong = int(np.count_nonzero(~agree))
    # The probability of as many failures, or more, is a binomial tail.
    if wrong and bdtrc(wrong - 1, agree.size, _ALLOWED_FAILURES) < _SIGNIFICANCE:
        return [
            f"only {agree.mean():.1%} of its visible pixels are at a depth that the other view has there"
        ]
    return []


def _check_shift(
    around: NDArray[Any],
    px: NDArray[np.float64],
    z: NDArray[np.float64],
    scale: NDArray[np.float64],
    camera: Camera,
) -> Findings:
    """Shift of points from the flat surfaces of a view; 1/z is linear in u and v on a plane.

    around (9, N): the view's depths in the 3x3 pixels around px (N, 2), where points of depth z (N,) project. scale
    (N,): magnitude of the coordinates, metres, which sets their rounding error.
    """
    rounding = _ROUNDING * scale / z
    # Depths of a damaged file may be 0 or not finite; the results do not count as flat.
    with np.errstate(all="ignore"):
        inverse = 1.0 / around.astype(np.float64)
        # Derivatives of 1/z along u and v, by central differences around the middle, number 4.
        slope = 0.5 * np.stack([inverse[5] - inverse[3], inverse[7] - inverse[1]])
        steepness = np.hypot(*slope)
        # What a plane through the nine values leaves, and the rounding of the values.
        steps = np.array([(du, dv) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
        residual = np.abs(inverse - inverse[4] - steps @ slope).max(axis=0)
        curvature = residual + (rounding + _ROUNDING) * inverse[4]
        flat = (curvature <= _FLATNESS_PX * steepness) & (steepness > 0)
        flat &= rounding * max(camera.fx, camera.fy) <= _FLATNESS_PX
        # The difference in 1/z, beyond that of the subpixel offset, is a shift along the slope.
        offset = ((px - np.floor(px + 0.5)).T * slope).sum(axis=0)
        shift_px = np.abs(1.0 / z - inverse[4] - offset) / steepness
    findings = []
    sideways = np.abs(slope[0]) > np.abs(slope[1])
    for name, chosen in (("u", sideways), ("v", ~sideways)):
        along = shift_px[flat & chosen]
        if along.size >= _MIN_FLAT_PIXELS and np.median(along) > _MAX_SHIFT_PX:
            findings.append(
                f"is shifted by {np.median(along):.2g} px along {name} against the other view's surfaces"
            )
    return findings


def check_exchange(
    images: tuple[NDArray[Any], NDArray[Any]],
    disparity: NDArray[np.float32],
    mask: NDArray[Any],
) -> Findings:
    """The left and right images are not exchanged: their edges correlate better at the true disparity than swapped.

    Horizontal differences are compared at whole pixels where both views see the point. Images with little texture or
    much noise correlate in neither order and give no finding.
    """
    v, u = np.nonzero((mask == VISIBLE) & np.isfinite(disparity))
    step = max(1, len(u) // _MAX_PIXELS)
    v, u = v[::step], u[::step]
    match = np.floor(u - disparity[v, u] + 0.5).astype(int)
    height, width = np.minimum(images[0].shape[:2], images[1].shape[:2])
    inside = (match >= 0) & (np.maximum(match, u) < width) & (v < height)
    if np.count_nonzero(inside) < _MIN_PIXELS:
        return []
    v, u, match = v[inside], u[inside], match[inside]
    left, right = map(_edges, images)
    straight = _correlation(left[v, u], right[v, match])
    swapped = _correlation(right[v, u], left[v, match])
    if swapped < straight + _MIN_DIFFERENCE:
        return []
    values = f"edges correlate by {straight:.2f} at the true disparity, and by {swapped:.2f} if swapped"
    return [f"looks exchanged with its partner's image: {values}"]


def _edges(image: NDArray[Any]) -> NDArray[np.float64]:
    """Horizontal differences of the mean of the channels, (H, W)."""
    mean = image.reshape(*image.shape[:2], -1).mean(axis=-1)
    return np.diff(mean, axis=1, append=mean[:, -1:])


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    if not (np.ptp(a) and np.ptp(b)):
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def check_calibration(calibration: Calibration, rig: Rig) -> Findings:
    """calib.txt and the rig of sample.json describe the same pair."""
    if not rig.is_rectified():
        return ["describes a rectified pair, but the rig of sample.json is not one"]
    expected = Calibration.from_rig(rig)
    findings = []
    for name in ("cam0", "cam1", "baseline", "width", "height", "doffs"):
        value, right = getattr(calibration, name), getattr(expected, name)
        if not np.allclose(value, right, rtol=1e-9, atol=1e-9):
            findings.append(f"{name} is {value}, but {right} in sample.json")
    return findings


def _nearest(
    px: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the pixel nearest to each of px (N, 2)."""
    u, v = np.floor(px + 0.5).astype(int).T
    return v.clip(0, camera.height - 1), u.clip(0, camera.width - 1)


def _inside_one_object(ids: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether all eight neighbours of a pixel exist and have its id, (H, W)."""
    padded = np.pad(ids, 1, constant_values=-1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.asarray((windows == ids[..., None, None]).all(axis=(2, 3)))


def _compare(
    what: str, error: NDArray[np.float64], allowed: NDArray[np.float64], unit: str
) -> Findings:
    wrong = ~(error <= allowed)
    if not wrong.any():
        return []
    worst = np.where(np.isnan(error), np.inf, error).max()
    return [
        f"{what} at {np.count_nonzero(wrong)} of {wrong.size} pixels, by up to {worst:.3g} {unit}"
    ]
