"""What the partner view sees: masks computed from disparity maps, and correspondences between stored views.

Rendered samples have exact masks. For real pairs `mask_from_both` uses the cross-check of both disparity maps, and
`mask_from_one` warps a single map into the partner view, where the nearer surface hides the farther one.

Source: Scharstein and Szeliski, A taxonomy and evaluation of dense two-frame stereo correspondence algorithms, 2002,
section 5 (occlusion by forward and inverse mapping).
"""

import numpy as np
from numpy.typing import NDArray

from twinlens import geometry
from twinlens.camera import Rig
from twinlens.camera.truth import Correspondence, Truth
from twinlens.errors import InputError

VISIBLE, HIDDEN, UNKNOWN = 255, 128, 0

_CROSS_CHECK_PX = 1.0
_PLANE_TOLERANCE = 1e-3  # of the distance: between a point and the tangent plane of what the target view sees

Mask = NDArray[np.uint8]
Disparity = NDArray[np.float32]


def mask_from_both(disparity: Disparity, partner: Disparity, left: bool = True) -> Mask:
    """Middlebury mask of a view, uint8 (H, W), by the cross-check with its partner's disparity (H, W).

    A pixel is visible (255) if the partner's disparity at the pixel nearest to its match, at u - d (`left`) or u + d,
    differs by at most one pixel; otherwise, and if the match is outside the image, hidden (128). It is 0 where the
    disparity is unknown (+inf). Raises InputError if the shapes differ.
    """
    _, target, inside = _matches(disparity, partner, left)
    matched = np.take_along_axis(partner, target, axis=1)
    finite = np.isfinite(disparity)
    difference = np.abs(
        np.where(inside, matched, np.inf) - np.where(finite, disparity, 0)
    )
    return mask_of(finite, inside & (difference <= _CROSS_CHECK_PX))


def mask_from_one(disparity: Disparity, left: bool = True) -> Mask:
    """Middlebury mask of a view, uint8 (H, W), from its own disparity only; see `mask_from_both`.

    Each known pixel is warped to its match and covers the two pixels around it; the largest disparity wins. A pixel is
    hidden if the winner at the pixel nearest to its match is more than one pixel of disparity nearer. Surfaces of
    unknown disparity hide nothing, so the visible area is an upper bound.

    >>> mask_from_one(np.float32([[0, 0, 0, 2, 0]])).tolist()
    [[255, 128, 255, 255, 255]]
    """
    matches, target, inside = _matches(disparity, disparity, left)
    winners = np.full(disparity.shape, -np.inf, np.float32)
    # A z-buffer: of the pixels that land on a column, the one with the largest disparity is nearest.
    for columns in (np.floor(matches), np.ceil(matches)):
        covered = (columns >= 0) & (columns < disparity.shape[1])
        rows = np.nonzero(covered)[0]
        pixels = rows, columns[covered].astype(np.intp)
        np.maximum.at(winners, pixels, disparity[covered])
    finite = np.isfinite(disparity)
    winner = np.take_along_axis(winners, target, axis=1)
    farthest = np.where(finite, disparity, 0) + _CROSS_CHECK_PX
    return mask_of(finite, inside & (winner <= farthest))


def correspondence_of(
    truths: tuple[Truth, Truth], rig: Rig, source: int, target: int
) -> Correspondence:
    """Where each pixel of camera `source` is in camera `target`; `truths` are those of the two, in this order.

    Positions are float32 in a file, so pixels are within 1e-7 fx |X| / z of `tl.correspondence`. If the target is the
    source's partner, visibility is the file's. Otherwise a point is visible if the target sees, at the nearest pixel,
    the same object with a tangent plane within a thousandth of the distance. This is correct to half a pixel at edges,
    and misses points on surfaces that curve more than this within a pixel.

    Raises InputError unless the two are different cameras of the rig.
    """
    if not (0 <= source < len(rig) and 0 <= target < len(rig)) or source == target:
        raise InputError(
            f"a pair needs two different cameras from 0 to {len(rig) - 1}, got {source} and {target}"
        )
    here, there = truths
    points = geometry.transform_points(
        geometry.inverse(rig.world_from_cams[target]), here.position[here.hit]
    )
    projected = rig.cameras[target].project(points)
    pixels = np.full((*here.hit.shape, 2), np.inf)
    pixels[here.hit] = np.where(np.isnan(projected), np.inf, projected)
    if rig.partner(source) == target:
        visible = here.visible & here.hit
    else:
        visible = _visible_in(here, there, rig, target, pixels)
    disparity = np.full(here.hit.shape, np.inf)
    shift = rig.cameras[source].pixel_grid()[here.hit, 0] - pixels[here.hit, 0]
    # u_left - u_right, whichever of the two is the left one.
    if rig.is_rectified(source, target):
        disparity[here.hit] = shift
    elif rig.is_rectified(target, source):
        disparity[here.hit] = -shift
    disparity = disparity.astype(np.float32)
    # Both views are of one time: surfaces are still, and the disparity at the target's time is the same.
    still = np.full(here.position.shape, np.inf)
    still[here.hit] = 0.0
    return Correspondence(pixels, visible, disparity, disparity, still)


def _visible_in(
    here: Truth, there: Truth, rig: Rig, target: int, pixels: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the target's truth shows the surface of each point at the pixel nearest to it."""
    inside = here.hit & rig.cameras[target].contains(
        np.where(np.isfinite(pixels), pixels, np.nan)
    )
    centre = rig.world_from_cams[target][:3, 3]
    u, v = np.floor(pixels[inside] + 0.5).astype(int).T
    visible = np.zeros(here.hit.shape, dtype=bool)
    visible[inside] = on_surface(
        there, (u, v), here.position[inside], here.object_id[inside], centre
    )
    return visible


def on_surface(
    truth: Truth,
    at: tuple[NDArray[np.int64], NDArray[np.int64]],
    points: NDArray[np.float64],
    object_ids: NDArray[np.int32],
    centre: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Whether the pixels `at`, (u, v) of (N,) each, of a view show the objects (N,) at the points (N, 3), world.

    They do if the point is within a thousandth of its distance from the view's `centre` (3,) of the tangent plane of
    what the pixel sees.
    """
    u, v = at
    tolerance = _PLANE_TOLERANCE * np.linalg.norm(points - centre, axis=1)
    same = truth.object_id[v, u] == object_ids
    # Distance of the point from the tangent plane of what the view sees there.
    step = points - np.where(same[:, None], truth.position[v, u], points)
    normal = truth.normal[v, u].astype(np.float64)
    distance = np.abs(np.einsum("nc,nc->n", step, normal))
    return np.asarray(same & (distance <= tolerance))


def _matches(
    disparity: Disparity, partner: Disparity, left: bool
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.bool_]]:
    """Each pixel's match u -+ d, the pixel nearest to it (0 outside), and whether it is inside the image."""
    if disparity.ndim != 2 or disparity.shape != partner.shape:
        raise InputError(
            f"disparity maps must be (H, W) of equal shape, got {disparity.shape} and {partner.shape}"
        )
    if not ((disparity > -np.inf).all() and (partner > -np.inf).all()):
        raise InputError(
            "a disparity map contains NaN or -inf; unknown pixels must be +inf"
        )
    u = np.arange(disparity.shape[1], dtype=np.float64)
    matches = u - disparity if left else u + disparity
    inside = (matches >= -0.5) & (matches < disparity.shape[1] - 0.5)
    nearest = np.floor(np.where(inside, matches, 0.0) + 0.5).astype(np.intp)
    return matches, nearest, inside


def mask_of(has_truth: NDArray[np.bool_], visible: NDArray[np.bool_]) -> Mask:
    """The mask, uint8 (H, W), of pixels whose truth is known and whose point the partner sees."""
    mask = np.full(has_truth.shape, UNKNOWN, np.uint8)
    mask[has_truth] = HIDDEN
    mask[has_truth & visible] = VISIBLE
    return mask
