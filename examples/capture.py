"""Reconstruct an object from a ring of cameras and compare the surface with the true one.

    ring of cameras -> rectify each neighbouring pair -> semi-global matching -> depth maps
    -> truncated signed distances -> triangles -> distance from the true surface in millimetres

Run: ``python examples/capture.py capture.png``.
"""

import sys
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.camera import layouts
from twinlens.geometry import look_at
from twinlens.reconstruction import (
    Cloud,
    Comparison,
    DepthView,
    Surface,
    compare,
    fuse,
    integrate,
    sampled,
    surface_of,
    view_of_disparity,
    view_of_truth,
)
from twinlens.reconstruction.picture import orbit, splat
from twinlens.scenes import Bitmap, Mesh, SceneObject

DISTANCE, SIZE = (
    1.2,
    0.5,
)  # metres: from the cameras to the centre, and diameter of the object
CELL = 0.006
KEY = 12  # grey levels: largest difference of the background from the corner's colour


@dataclass(frozen=True)
class Capture:
    """The images, the reconstructed surface, and its comparison with the true one."""

    photos: list[NDArray[np.uint8]]
    surface: Surface
    found: Comparison


def object_scene() -> tl.Scene:
    """A deformed sphere with a random texture under a uniform sky."""
    import trimesh

    ball = trimesh.creation.uv_sphere(radius=1.0, count=[96, 192])
    direction = np.asarray(ball.vertices)
    lumps = (
        1
        + 0.12 * np.sin(5 * direction[:, 0]) * np.cos(4 * direction[:, 1])
        + 0.08 * np.sin(6 * direction[:, 2])
    )
    vertices = 0.5 * SIZE * lumps[:, None] * direction
    around = np.arctan2(direction[:, 1], direction[:, 0]) / (2 * np.pi)
    uv = np.stack(
        [2 * np.abs(around), 0.5 + 0.5 * direction[:, 2]], axis=1
    )  # mirrored at the back, without a seam
    rng = np.random.default_rng(0)
    dots = np.kron(
        rng.random((64, 64, 3)), np.ones((4, 4, 1))
    ) * 0.7 + 0.3 * rng.random((256, 256, 3))
    paint = {
        "type": "diffuse",
        "reflectance": Bitmap((0.02 + 0.75 * dots**2).astype(np.float32)),
    }
    mesh = Mesh(vertices, np.asarray(ball.faces, dtype=np.uint32), uv=uv)
    objects = (SceneObject("object", mesh, "paint"),)
    pose = look_at([0.0, -DISTANCE, 0.0], [0, 0, 0])
    return tl.Scene(
        "object",
        objects,
        {"paint": paint},
        pose,
        (0.8, 1.5),
        lights={"sky": {"type": "constant"}},
    )


def photograph(
    count: int, width: int, spp: int
) -> tuple[tl.Rig, list[NDArray[np.uint8]], list[tl.Truth]]:
    """The rig, a closed ring of cameras; its 8-bit images; and the ground truth of every view."""
    scene = object_scene()
    camera = tl.Camera.from_fov(width, width, fov_x_deg=34)
    rig = layouts.arc(camera, count, DISTANCE, 360.0, scene.world_from_left)
    photos = tl.Sensor().expose_rig(
        tl.render(scene, rig, spp=spp), rig=rig, lens=tl.Pinhole(), seed=2
    )
    return rig, [photo.image for photo in photos], tl.ground_truth(scene, rig)


def depths(rig: tl.Rig, photos: list[NDArray[np.uint8]]) -> list[DepthView]:
    """Depth maps of each pair of neighbours by semi-global matching."""
    views = []
    for a, b in pairwise([*range(len(rig)), 0]):
        result = tl.rectify(rig.pair(a, b), zero_doffs=False)
        left, right = (result.warp(side, photos[i]) for side, i in enumerate((a, b)))
        new = result.rectified_rig
        nearest = (
            new.cameras[0].fx * result.baseline / (DISTANCE - 0.6 * SIZE) - result.doffs
        )
        farthest = (
            new.cameras[0].fx * result.baseline / (DISTANCE + 0.3 * SIZE) - result.doffs
        )
        low, count = int(farthest) - 1, int(nearest - farthest) + 3
        found = tl.match(
            left,
            right,
            method="sgm",
            min_disparity=low,
            num_disparities=count,
            lr_check=1,
        )
        sky = (
            np.abs(left.astype(int) - photos[a][0, 0]).max(axis=2) < KEY
        )  # without texture
        found[sky | ~result.valid(0)] = np.inf
        views.append(view_of_disparity(found, new, image=left))
    return views


def capture(
    count: int = 20, width: int = 256, spp: int = 32, cell: float = CELL
) -> Capture:
    """Render, match, fuse and evaluate."""
    rig, photos, truths = photograph(count, width, spp)
    surface = surface_of(integrate(depths(rig, photos), cell, reach=4 * cell))
    true = fuse([view_of_truth(truth, rig, i) for i, truth in enumerate(truths)])
    return Capture(
        photos,
        surface,
        compare(sampled(surface, 0.5 * cell), true, spacing_mm=500 * cell),
    )


def picture(made: Capture) -> Image.Image:
    """Three images in the first row, the surface from three sides in the second."""
    width = made.photos[0].shape[1]
    camera = tl.Camera.from_fov(width, width, fov_x_deg=34)
    pose = look_at([0.0, -DISTANCE, 0.0], [0, 0, 0])
    cloud: Cloud = sampled(made.surface, 0.3 * CELL)
    sides = [
        splat(cloud, camera, orbit(pose, [0, 0, 0], angle, 15.0))
        for angle in (0, 120, 240)
    ]
    step = len(made.photos) // 3
    rows = [
        np.concatenate(row, axis=1)
        for row in ([made.photos[i * step] for i in range(3)], sides)
    ]
    return Image.fromarray(np.concatenate(rows, axis=0))


def main(path: str) -> None:
    made = capture()
    picture(made).save(path)
    found = made.found
    print(
        f"{path}: accuracy {found.accuracy_mean_mm:.2f} mm, completeness {found.completeness_mean_mm:.2f} mm"
    )
    print(
        ", ".join(
            f"F {share.f_score:.1%} at {share.tolerance_mm:g} mm"
            for share in found.shares
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["capture.png"])
