"""Where the pixels of one stored view lie in another, from the two truth files alone: any two views of a rig."""

import numpy as np
from numpy.typing import NDArray

from twinlens import geometry
from twinlens.camera import Rig
from twinlens.camera.truth import Correspondence, Truth
from twinlens.errors import InputError

_ON_PLANE = 1e-3  # of the distance: how far a point may stand off the surface that the target sees beside it


def correspondence_of(truths: tuple[Truth, Truth], rig: Rig, source: int, target: int) -> Correspondence:
    """Where each pixel of camera `source` lies in that of `target`; `truths` are those of the two, in this order.

    Positions are float32 in a file, so pixels are within 1e-7 fx |X| / z of `tl.correspondence`'s. Visibility is the
    file's own where the target is the source's partner. For any other it is judged by what the target sees at the
    nearest pixel, and so within half a pixel at edges: the same object, its tangent plane within a thousandth of the
    distance. Where surfaces bend within a pixel by more than that, seen points are missed.

    Raises InputError unless the two are different cameras of the rig.
    """
    if not (0 <= source < len(rig) and 0 <= target < len(rig)) or source == target:
        raise InputError(f"a pair needs two different cameras out of 0 to {len(rig) - 1}, got {source} and {target}")
    here, there = truths
    points = geometry.transform_points(geometry.inverse(rig.world_from_cams[target]), here.position[here.hit])
    pixels = np.full((*here.hit.shape, 2), np.inf)
    seen = rig.cameras[target].project(points)
    pixels[here.hit] = np.where(np.isnan(seen), np.inf, seen)
    partner = rig.partner(source) == target
    visible = here.visible & here.hit if partner else _seen_there(here, there, rig, target, pixels)
    disparity = _disparity(here, rig, source, target, pixels)
    return Correspondence(pixels, visible, disparity.astype(np.float32))


def _seen_there(here: Truth, there: Truth, rig: Rig, target: int, pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the target's own truth shows the surface of each point at the pixel nearest to it."""
    inside = here.hit & rig.cameras[target].contains(np.where(np.isfinite(pixels), pixels, np.nan))
    points, ids = here.position[inside], here.object_id[inside]
    far = _ON_PLANE * np.linalg.norm(points - rig.world_from_cams[target][:3, 3], axis=1)
    u, v = np.floor(pixels[inside] + 0.5).astype(int).T
    same = there.object_id[v, u] == ids
    step = points - np.where(same[:, None], there.position[v, u], points)
    off = np.abs(np.einsum("nc,nc->n", step, there.normal[v, u].astype(np.float64)))
    visible = np.zeros(here.hit.shape, dtype=bool)
    visible[inside] = same & (off <= far)
    return visible


def _disparity(here: Truth, rig: Rig, source: int, target: int, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """u_left - u_right of a rectified pair in either order, +inf elsewhere."""
    forwards = rig.is_rectified(source, target)
    if not forwards and not rig.is_rectified(target, source):
        return np.full(here.hit.shape, np.inf)
    u = rig.cameras[source].pixel_grid()[..., 0]
    return np.where(here.hit, (u - np.where(here.hit, pixels[..., 0], 0.0)) * (1 if forwards else -1), np.inf)
