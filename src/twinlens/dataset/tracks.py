"""Points on the surfaces of a sample and the pixels of the views that see them, as structure from motion finds them.

Each view proposes points at random pixels. A point is kept with the views that certainly see it:

- the view that proposed it, and the partner of that view if its mask says so, which is exact;
- another view if it looks at the front of the surface, and if the four pixels around the point show the same object
  at the same place: the point is within a thousandth of the distance from their tangent planes.

The last rule leaves out points beside edges, so tracks may lack a view. What is thinner than a pixel may hide a point
from a view without being in one of the four pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.dataset.pictures import rgb8
from twinlens.dataset.visibility import on_surface
from twinlens.geometry import Float, inverse, transform_points
from twinlens.seeds import generator

MOST_POINTS = 10_000
"""Points of a sample, unless the caller asks for another number."""

_FEWEST_VIEWS = 2
_PROPOSED = 4  # proposals per point, as some are seen by one view alone
_AROUND = ((0, 0), (1, 0), (0, 1), (1, 1))


@dataclass(frozen=True, eq=False)
class Tracks:
    """N points, each seen by two views or more, and their M observations, ordered by view and then by point.

    points : float64 (N, 3), world coordinates, metres.
    colors : uint8 (N, 3), RGB: the mean of the nearest pixels of the views that see the point.
    views : int64 (M,), the view of each observation.
    numbers : int64 (M,), its point, an index into `points`.
    pixels : float64 (M, 2), its pixel (u, v), distorted; centres of pixels are at integers.
    """

    points: Float
    colors: NDArray[np.uint8]
    views: NDArray[np.int64]
    numbers: NDArray[np.int64]
    pixels: Float

    def __len__(self) -> int:
        return len(self.points)


NO_TRACKS = Tracks(
    np.zeros((0, 3)),
    np.zeros((0, 3), np.uint8),
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
    np.zeros((0, 2)),
)
"""Tracks without a point."""


@dataclass(frozen=True, eq=False)
class _Proposals:
    """Points (N, 3) that views propose, with their unit normals towards the view, objects, views, and whether the
    partner of the view sees them."""

    points: Float
    normals: Float
    objects: NDArray[np.int32]
    sources: NDArray[np.int64]
    in_partner: NDArray[np.bool_]


def find_tracks(
    rig: Rig,
    truth: Callable[[int], Truth],
    image: Callable[[int], NDArray[Any]],
    most: int = MOST_POINTS,
    seed: int = 0,
) -> Tracks:
    """Up to `most` points of the surfaces that two views or more of `rig` see, chosen evenly over views and pixels.

    truth, image : called with the number of a view, for its truth and its image, uint8 or uint16 (H, W[, 3]). One truth
        is in memory at a time.
    seed : of the choice of pixels.
    """
    share = max(1, most // len(rig))
    proposals = _proposals(rig, truth, share * _PROPOSED, seed)
    count = len(proposals.points)
    pixels = np.full((len(rig), count, 2), np.nan)
    colors = np.zeros((count, 3))
    for view in range(len(rig)):
        seen, at = _observed(rig, view, truth(view), proposals)
        pixels[view, seen] = at[seen]
        u, v = _nearest(at[seen]).T
        colors[seen] += rgb8(image(view))[v, u]
    num_views = np.isfinite(pixels[..., 0]).sum(axis=0)
    kept = _first_of_each_view(num_views >= _FEWEST_VIEWS, proposals.sources, share)
    kept = kept[:most]
    views, numbers = np.nonzero(np.isfinite(pixels[:, kept, 0]))
    return Tracks(
        points=proposals.points[kept],
        colors=np.rint(colors[kept] / num_views[kept, None]).astype(np.uint8),
        views=views,
        numbers=numbers,
        pixels=pixels[:, kept][views, numbers],
    )


def _proposals(
    rig: Rig, truth: Callable[[int], Truth], count: int, seed: int
) -> _Proposals:
    """Points at up to `count` random pixels of each view, in random order."""
    parts = []
    for view in range(len(rig)):
        local = truth(view)
        hits = np.flatnonzero(local.hit)
        rng = generator(seed, "tracks", view)
        chosen = rng.permutation(hits)[:count]
        part = (
            local.position.reshape(-1, 3)[chosen],
            local.normal.reshape(-1, 3)[chosen].astype(np.float64),
            local.object_id.ravel()[chosen],
            np.full(len(chosen), view),
            local.visible.ravel()[chosen],
        )
        parts.append(part)
    return _Proposals(*map(np.concatenate, zip(*parts, strict=True)))


def _observed(
    rig: Rig, view: int, truth: Truth, proposals: _Proposals
) -> tuple[NDArray[np.bool_], Float]:
    """Whether a view certainly sees each proposed point, (N,), and the pixel (N, 2) of it; NaN without an image."""
    points_cam = transform_points(inverse(rig.world_from_cams[view]), proposals.points)
    pixels = rig.cameras[view].project(points_cam)
    seen = _certainly_seen(rig, view, truth, proposals, pixels)
    for source in range(len(rig)):
        is_proposed = proposals.sources == source
        if source == view:
            seen[is_proposed] = True
        elif rig.partner(source) == view:
            seen[is_proposed] = proposals.in_partner[is_proposed]
    return seen & rig.cameras[view].contains(pixels), pixels


def _certainly_seen(
    rig: Rig, view: int, truth: Truth, proposals: _Proposals, pixels: Float
) -> NDArray[np.bool_]:
    """Whether the view looks at the front of the surface, and the four pixels around the point show the surface."""
    camera = rig.cameras[view]
    centre = rig.world_from_cams[view][:3, 3]
    to_camera = centre - proposals.points
    facing = np.einsum("nc,nc->n", to_camera, proposals.normals)
    seen = np.asarray(facing > 0)
    corner = np.floor(np.where(np.isfinite(pixels), pixels, -1.0)).astype(np.int64)
    u, v = corner.T
    seen &= (u >= 0) & (v >= 0) & (u < camera.width - 1) & (v < camera.height - 1)
    for right, down in _AROUND:
        where = np.flatnonzero(seen)
        seen[where] = on_surface(
            truth,
            (u[where] + right, v[where] + down),
            proposals.points[where],
            proposals.objects[where],
            centre,
        )
    return seen


def _nearest(pixels: Float) -> NDArray[np.int64]:
    """The nearest pixels (N, 2) of points (N, 2) in the image."""
    return np.floor(pixels + 0.5).astype(np.int64)


def _first_of_each_view(
    is_usable: NDArray[np.bool_], sources: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """The numbers of the first `count` usable proposals of each view."""
    chosen = [np.zeros(0, np.int64)]
    for source in np.unique(sources):
        usable = np.flatnonzero(is_usable & (sources == source))
        chosen.append(usable[:count])
    return np.concatenate(chosen)
