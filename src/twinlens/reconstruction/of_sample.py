"""Reconstruction of a stored sample: its views' depths, true or matched, fused into points and a surface."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.camera.rectification import rectify
from twinlens.dataset import StoredSample
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.record import encode_json
from twinlens.errors import InputError
from twinlens.reconstruction.evaluation import compare
from twinlens.reconstruction.fusion import fuse, integrate, surface_of
from twinlens.reconstruction.picture import orbit, splat
from twinlens.reconstruction.surface import (
    Cloud,
    DepthView,
    Surface,
    glb_bytes,
    ply_bytes,
    sampled,
    view_of_disparity,
    view_of_truth,
)

MatcherFactory = Callable[..., Any]
"""(num_disparities=, min_disparity=) -> an object with `match(left, right)`."""
RECORD = "reconstruction.json"
_CELLS = 160  # along the longest side of the points
_ORBIT_DEG, _RISE_DEG = (-25.0, 25.0), 10.0  # viewpoints of the picture


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Fused points and surface of depth maps, and a comparison with the true surface; {} if there is no truth."""

    views: list[DepthView]
    points: Cloud
    surface: Surface
    cell: float
    against_truth: dict[str, Any]

    def record(self) -> dict[str, Any]:
        """Counts, the cell in millimetres, and the comparison, as plain data."""
        return {
            "views": len(self.views),
            "points": len(self.points),
            "vertices": len(self.surface.vertices),
            "faces": len(self.surface.faces),
            "cell_mm": 1e3 * self.cell,
            "against_truth": self.against_truth,
        }

    def files(self, record: dict[str, Any]) -> dict[str, bytes]:
        """Contents by file name: points and surface as PLY and glTF, the record, and a picture of both."""
        return {
            "points.ply": ply_bytes(self.points),
            "mesh.ply": ply_bytes(self.surface),
            "mesh.glb": glb_bytes(self.surface, self.views[0].world_from_cam),
            RECORD: encode_json(record),
            "reconstruction.png": encode_png(self.picture()),
        }

    def picture(self) -> NDArray[np.uint8]:
        """The points above the surface, each from two viewpoints: uint8 (H, W, 3)."""
        middle = self.views[len(self.views) // 2]
        camera = middle.camera.replace(distortion=None)
        target = np.median(self.points.points, axis=0)
        rows = []
        for cloud in (self.points, sampled(self.surface, 0.5 * self.cell)):
            images = []
            for angle in _ORBIT_DEG:
                pose = orbit(middle.world_from_cam, target, angle, _RISE_DEG)
                images.append(splat(cloud, camera, pose, size_px=3))
            rows.append(np.hstack(images))
        return np.vstack(rows)


def reconstruct(
    stored: StoredSample,
    matcher: MatcherFactory | None = None,
    *,
    cell: float | None = None,
    min_views: int = 1,
    far: float = np.inf,
    spacing: float | None = None,
    progress: Callable[[float, str], None] = lambda fraction, stage: None,
) -> Reconstruction:
    """Fuse the depth maps of a sample and compare the result with its true surface.

    matcher : computes the depths; None uses the true ones.
    cell : of the surface, metres; by default 1/160 of the points' longest side.
    min_views : as in `fuse`. far : depths beyond this, metres, are left out.
    spacing : both point sets are thinned to this spacing before the comparison, metres; by default half a cell.
    progress : called with the fraction done and the stage.

    Raises InputError where no point is left, or two views have nothing in common.
    """
    if not far > 0:
        raise InputError(f"far must be a number of metres above 0, got {far}")
    views = depth_views(stored, matcher, far)
    progress(0.4, "fusing")
    points = fuse(views, min_views=min_views)
    if not len(points):
        raise InputError(
            f"{stored.folder}: no point is left; allow larger depths, or require fewer views per point"
        )
    if cell is None:
        cell = float(np.ptp(points.points, axis=0).max()) / _CELLS
    surface = surface_of(integrate(views, cell))
    clouds = {"points": points, "mesh": sampled(surface, 0.5 * cell)}
    progress(0.8, "comparing")
    against_truth: dict[str, Any] = {}
    if stored.has_truth(0):
        true = fuse(depth_views(stored, None, far))
        spacing_mm = 1e3 * (0.5 * cell if spacing is None else spacing)
        for name, cloud in clouds.items():
            comparison = compare(cloud, true, spacing_mm=spacing_mm)
            against_truth[name] = asdict(comparison)
    return Reconstruction(views, points, surface, cell, against_truth)


def depth_views(
    stored: StoredSample, matcher: MatcherFactory | None, far: float
) -> list[DepthView]:
    """The depth maps of a sample up to `far`: of each view from truth, or of each pair of neighbours from matching."""
    rig = stored.rig
    if matcher is None:
        views = [
            view_of_truth(stored.truth(index), rig, index, stored.image(index))
            for index in range(len(rig))
        ]
    elif len(rig) < 2:
        raise InputError(
            f"{stored.folder}: matching needs two views, the sample has one; use its truth"
        )
    else:
        views = [_matched(stored, matcher, left) for left in range(len(rig) - 1)]
    return [
        replace(view, depth=np.where(view.depth <= far, view.depth, np.inf))
        for view in views
    ]


def _matched(stored: StoredSample, matcher: MatcherFactory, left: int) -> DepthView:
    """The depths from matching views `left` and `left` + 1, rectified; the search range is from truth or calib.txt."""
    rig = stored.rig.pair(left, left + 1)
    images = [stored.image(left), stored.image(left + 1)]
    if not rig.is_rectified():
        result = rectify(rig, zero_doffs=False)
        images = [result.warp(side, image) for side, image in enumerate(images)]
        rig = result.rectified_rig
    if stored.has_truth(left):
        first, count = _search_range(stored, rig, left)
    else:
        # Only a rectified pair has a number of disparities.
        first, count = 0, stored.ndisp
    disparity = matcher(num_disparities=count, min_disparity=first).match(*images)
    return view_of_disparity(disparity, rig, image=images[0])


def _search_range(stored: StoredSample, rig: Rig, left: int) -> tuple[int, int]:
    """(min_disparity, num_disparities) of all but 0.2 % of the true surface, with two pixels of margin."""
    truth = stored.truth(left)
    positions = truth.position[truth.hit]
    disparity = rig.project(0, positions)[:, 0] - rig.project(1, positions)[:, 0]
    disparity = disparity[np.isfinite(disparity)]
    if not disparity.size:
        raise InputError(
            f"{stored.folder}: view {left} has no surface that both cameras can see; leave it out"
        )
    low, high = np.percentile(disparity, (0.1, 99.9))
    least, most = math.floor(low), math.ceil(high)
    return least - 2, most - least + 5
