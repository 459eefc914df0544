"""What must hold between the arrays of one sample, whatever scene was photographed: each law a function that returns
what it found wrong, one sentence each, and nothing when the law holds.

Tolerances are those of the files: depth, position and disparity are float32, so a law may be off by a few units in
their last place, and by 1e-4 px where pixels are compared.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from twinlens import geometry
from twinlens.camera import Camera, Lens, Rig
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.occlusion import HIDDEN, UNKNOWN, VISIBLE
from twinlens.dataset.truth_files import blur_circle_px

_LOOKED_AT, _FEWEST = 50_000, 1_000  # pixels: chance alone correlates a thousand by 0.03
_CLEARLY = 0.15

Arrays = Mapping[str, Any]
Findings = list[str]

_PX = 1e-4
_LAST_PLACES = 4 * float(np.finfo(np.float32).eps)
_SLACK_DEPTH = 1e-3  # of the depth: what may lie between neighbouring pixel centres
_SELDOM = 0.05  # of the pixels inside one object's picture; it may hide parts of itself, and bend between centres
_BY_CHANCE = 1e-6
_FLAT = 0.05  # px: what bends, and float32, may seem to move a surface by, where it is said to be flat
_FEWEST_FLAT = 100  # pixels
_QUARTER = 0.25  # px: half a pixel is the error that conventions make


def positions_agree(truth: Arrays, camera: Camera, world_from_cam: NDArray[np.float64]) -> Findings:
    """Every position lies at its depth, on the ray of its pixel's centre."""
    hit = truth["object_id"] > 0
    if not np.array_equal(hit, np.isfinite(truth["depth"])):
        return ["depth is finite elsewhere than object_id > 0"]
    world = truth["position"][hit].astype(np.float64)
    if not np.isfinite(world).all() or not (truth["depth"][hit] > 0).all():
        return ["position is not finite, or depth not positive, where something was hit"]
    cam = geometry.transform_points(geometry.inverse(world_from_cam), world)
    scale = np.abs(world).sum(axis=-1) + np.abs(world_from_cam[:3, 3]).sum()
    depth = truth["depth"][hit].astype(np.float64)
    in_px = scale * _LAST_PLACES * max(camera.fx, camera.fy) / depth + _PX
    off_px = np.abs(camera.project(cam) - camera.pixel_grid()[hit]).max(axis=-1, initial=0.0)
    return [
        *_off("position's z differs from depth", np.abs(cam[:, 2] - depth), (scale + depth) * _LAST_PLACES, "m"),
        *_off("position projects beside its pixel", off_px, in_px, "px"),
    ]


def disparity_agrees(truth: Arrays, disparity: NDArray[np.float32], calibration: Calibration) -> Findings:
    """d = fx B / z - doffs where something was hit; elsewhere unknown, or that of infinity."""
    hit = truth["object_id"] > 0
    elsewhere = disparity[~hit]
    if not (np.isposinf(elsewhere) | (np.abs(elsewhere + calibration.doffs) <= _PX)).all():
        return ["disparity is neither unknown nor -doffs where nothing was hit"]
    depth, d = truth["depth"][hit], disparity[hit].astype(np.float64)
    expected = geometry.disparity_from_depth(depth, calibration.fx, calibration.baseline, calibration.doffs)
    allowed = _PX + _LAST_PLACES * (np.abs(expected) + abs(calibration.doffs))
    return _off("disparity differs from fx B / z - doffs", np.abs(d - expected), allowed, "px")


def mask_agrees(mask: NDArray[Any], known: NDArray[np.bool_], visible: NDArray[np.bool_]) -> Findings:
    """A mask says 0 where nothing is known, 255 where the partner sees it, 128 elsewhere."""
    if not np.isin(mask, (UNKNOWN, HIDDEN, VISIBLE)).all():
        return [f"mask holds other values than {UNKNOWN}, {HIDDEN} and {VISIBLE}"]
    expected = np.where(known, np.where(visible, VISIBLE, HIDDEN), UNKNOWN)
    wrong = np.count_nonzero(mask != expected)
    return [f"mask differs from what the truth says at {wrong} of {mask.size} pixels"] if wrong else []


def ids_agree(truth: Arrays) -> Findings:
    """Ids count the names that the file lists, and kinds count MATERIAL_KINDS."""
    limits = {
        "object_id": len(truth["object_names"]),
        "material_id": len(truth["material_names"]),
        "material_kind": len(MATERIAL_KINDS) - 1,
    }
    return [
        f"{name} goes up to {truth[name].max()}, and {limit} are named"
        for name, limit in limits.items()
        if truth[name].max() > limit
    ]


def blur_agrees(truth: Arrays, camera: Camera, lens: Lens) -> Findings:
    """The blur circles are those of the lens that sample.json names."""
    expected = blur_circle_px(truth["depth"], camera, lens).astype(np.float64)
    error = np.abs(truth["blur_circle_px"] - expected)
    return _off("blur_circle_px is not that of the lens", error, _PX + 10 * _LAST_PLACES * np.abs(expected), "px")


def views_agree(truths: tuple[Arrays, Arrays], rig: Rig, views: tuple[int, int]) -> Findings:
    """What one view shows and the other sees lies, in the other's image, at a depth the other has there.

    The point's depth must lie between the least and the greatest of the 3x3 pixels around its projection. That says
    something only where both views show one object all around: at the border a point may lie beyond the last centre,
    and at silhouettes, which in a small picture are nearly everywhere, the centres may show what is beside it. Of the
    pixels that remain 5% may fail; swapped views, and views of different worlds or sizes, fail nearly everywhere. Where
    a few are left, as many may fail as 5% come to by chance once in a million times, as if pixels failed alone: a rule
    of thumb.

    Bounds of 3x3 pixels hide a view that stands a pixel beside its place. Where the other view is flat and slanted its
    depths tell to a fraction of a pixel how far beside its surface a point lies: along the slope, so that surfaces
    slanted to the side answer for u, those slanted up or down for v. Half of either, if there are enough, must lie
    within a quarter of a pixel.
    """
    here, there = truths
    camera = rig.cameras[views[1]]
    seen = here["visible"] & (here["object_id"] > 0)
    world = here["position"][seen].astype(np.float64)
    cam = geometry.transform_points(geometry.inverse(rig.world_from_cams[views[1]]), world)
    px = camera.project(cam)
    # A projection on the border itself may fall outside by float32's last places.
    inside = camera.contains(px) | camera.contains(px - 1e-3) | camera.contains(px + 1e-3)
    if not inside.all():
        return [f"{np.count_nonzero(~inside)} visible pixels project outside the other view"]
    v, u = _nearest(px, camera)
    judged = _inside_one_object(here["object_id"])[seen] & _inside_one_object(there["object_id"])[v, u]
    px, cam, world = px[judged], cam[judged], world[judged]
    around = _around(there["depth"], px, camera)
    low, high = around.min(axis=0), around.max(axis=0)
    agree = (cam[:, 2] >= low * (1 - _SLACK_DEPTH)) & (cam[:, 2] <= high * (1 + _SLACK_DEPTH))
    wrong = int(np.count_nonzero(~agree))
    if wrong and bdtrc(wrong - 1, agree.size, _SELDOM) < _BY_CHANCE:
        return [f"only {agree.mean():.1%} of its visible pixels are at a depth that the other view has there"]
    scale = np.abs(world).sum(axis=-1) + np.abs(rig.world_from_cams[views[1]][:3, 3]).sum()
    few = slice(None, None, max(1, len(px) // _LOOKED_AT))
    return _beside(around[:, few], px[few], cam[few, 2], scale[few], camera)


def _beside(
    around: NDArray[Any], px: NDArray[np.float64], z: NDArray[np.float64], scale: NDArray[np.float64], camera: Camera
) -> Findings:
    """How far points lie beside the surfaces of a view, where those are flat: 1/z is linear in u and v on a plane.

    around (9, N): the view's depths in the 3x3 pixels around px (N, 2), where points of depth z (N,) project. scale
    (N,): the size of the numbers, metres, of which the last places are lost.
    """
    lost = _LAST_PLACES * scale / z
    with np.errstate(all="ignore"):  # depths of a damaged file; what comes of them is not said to be flat
        near = 1.0 / around.astype(np.float64)
        slope = 0.5 * np.stack([near[5] - near[3], near[7] - near[1]])
        steps = np.array([(du, dv) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
        bent = np.abs(near - near[4] - steps @ slope).max(axis=0) + (lost + _LAST_PLACES) * near[4]
        steep = np.hypot(*slope)
        flat = (bent <= _FLAT * steep) & (steep > 0) & (lost * max(camera.fx, camera.fy) <= _FLAT)
        off_px = np.abs(1.0 / z - near[4] - ((px - np.floor(px + 0.5)).T * slope).sum(axis=0)) / steep
    findings = []
    sideways = np.abs(slope[0]) > np.abs(slope[1])
    for name, chosen in (("u", sideways), ("v", ~sideways)):
        along = off_px[flat & chosen]
        if along.size >= _FEWEST_FLAT and np.median(along) > _QUARTER:
            findings.append(f"lies {np.median(along):.2g} px along {name} beside the surfaces that the other view has")
    return findings


def eyes_agree(
    images: tuple[NDArray[Any], NDArray[Any]], disparity: NDArray[np.float32], mask: NDArray[Any]
) -> Findings:
    """The left and right images are not exchanged: their edges match at the true disparity better than the other way.

    Compared are horizontal differences of what both views see, at whole pixels, by their correlation. Pictures of
    little texture or much noise match in neither way, and say nothing.
    """
    v, u = np.nonzero((mask == VISIBLE) & np.isfinite(disparity))
    step = max(1, len(u) // _LOOKED_AT)
    v, u = v[::step], u[::step]
    match = np.floor(u - disparity[v, u] + 0.5).astype(int)
    inside = (match >= 0) & (match < disparity.shape[1])
    if np.count_nonzero(inside) < _FEWEST:
        return []
    v, u, match = v[inside], u[inside], match[inside]
    left, right = (_edges(image) for image in images)
    straight, exchanged = (_alike(a[v, u], b[v, match]) for a, b in ((left, right), (right, left)))
    if exchanged < straight + _CLEARLY:
        return []
    told = f"their edges correlate by {straight:.2f} at the true disparity, and by {exchanged:.2f} the other way round"
    return [f"looks exchanged with its partner's image: {told}"]


def calibration_agrees(calibration: Calibration, rig: Rig) -> Findings:
    """calib.txt and the rig of sample.json describe the same pair."""
    if not rig.is_rectified():
        return ["describes a rectified pair, and the rig of sample.json is none"]
    expected = Calibration.from_rig(rig)
    names = ("cam0", "cam1", "baseline", "width", "height", "doffs")
    return [
        f"{name} is {getattr(calibration, name)}, the rig of sample.json says {getattr(expected, name)}"
        for name in names
        if not np.allclose(getattr(calibration, name), getattr(expected, name), rtol=1e-9, atol=1e-9)
    ]


def _edges(image: NDArray[Any]) -> NDArray[np.float64]:
    grey = image.astype(np.float64) if image.ndim == 2 else image.mean(axis=-1)
    return np.diff(grey, axis=1, append=grey[:, -1:])


def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Pearson's correlation, 0 where one of the two is constant."""
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / scale) if scale else 0.0


def _nearest(px: NDArray[np.float64], camera: Camera) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the whole pixel nearest to each of px (N, 2)."""
    u, v = np.floor(px + 0.5).astype(int).T
    return v.clip(0, camera.height - 1), u.clip(0, camera.width - 1)


def _around(depth: NDArray[Any], px: NDArray[np.float64], camera: Camera) -> NDArray[Any]:
    """The depths (9, N) of the 3x3 pixels around each of px (N, 2), none of which is nearest to the border."""
    v, u = _nearest(px, camera)
    return np.stack([depth[v + dv, u + du] for dv in (-1, 0, 1) for du in (-1, 0, 1)])


def _inside_one_object(ids: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether a pixel's eight neighbours are there and show the object that it shows, or nothing as it does; (H, W)."""
    inside = np.zeros(ids.shape, np.bool_)
    if min(ids.shape) < 3:
        return inside
    height, width = ids.shape
    middle = ids[1:-1, 1:-1]
    shifted = (ids[dv : height - 2 + dv, du : width - 2 + du] for dv in range(3) for du in range(3))
    inside[1:-1, 1:-1] = np.logical_and.reduce([other == middle for other in shifted])
    return inside


def _off(what: str, error: NDArray[np.float64], allowed: NDArray[np.float64], unit: str) -> Findings:
    wrong = ~(error <= allowed)
    if not wrong.any():
        return []
    worst = np.where(np.isnan(error), np.inf, error).max()
    return [f"{what} at {np.count_nonzero(wrong)} of {wrong.size} pixels, by up to {worst:.3g} {unit}"]
