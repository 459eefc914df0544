"""Refuses rigs whose views cannot have enough in common, before a random scene is composed for them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from twinlens.camera import Rig
from twinlens.errors import InputError, located
from twinlens.factory.gates import Gates
from twinlens.factory.lenses import Find
from twinlens.factory.settings import ANY_SCENE, RecipeSettings
from twinlens.families import FAMILIES, WIDEST_FOV_DEG
from twinlens.geometry import rigid, transform_points
from twinlens.scenes import Scene

_COLUMNS, _ROWS = 24, 18  # pixels of the first view, evenly spaced
_DISTANCES = 256  # on the ray of each pixel
_NEAREST = 1e-3  # of the farthest distance
_ALIKE_DEG = 10.0  # between the axes of a scene's own view and of a rig's first one
_FARTHER, _FARTHER_ELSEWHERE = 1.5, 3.0
"""Distance of the farthest surface over the depth of a scene's own picture: in a view like it, and in others."""


def check_overlap(
    family: str, settings: RecipeSettings, gates: Gates, file: Path, find: Find
) -> None:
    """Raise InputError if scenes of `family` cannot show both views enough of the same to pass `gates.visible`.

    Not refused are settings with objects of the user's, which may be farther away than a family's, and rigs with a pose
    in the world, whose distance from the scene is not known before it is composed.
    """
    if settings.scene.objects:
        return
    depths = settings.scene.depth_range
    deepest = FAMILIES[family].farthest if depths is None else depths[1]
    scene = _most_alike(deepest).at(settings.scene.jitter.pose())
    rig = settings.rig_of(scene, None, file, find)
    partner = rig.partner(0)
    if partner is None:
        return
    farthest = _farthest_distance(rig, deepest)
    share = largest_overlap(rig, partner, farthest)
    if share >= gates.visible or _has_pose_in_world(rig, settings, scene, file, find):
        return
    apart = float(np.linalg.norm(rig.b_from_a(0, partner)[:3, 3]))
    with located(f"{file}: rig"):
        raise InputError(
            f"cameras 0 and {partner} are {apart:.4g} m apart and have at most {share:.1%} of a view in common, as "
            f"{family} scenes have no surfaces farther than {farthest:.4g} m; minimum {gates.visible:.1%} "
            "(gates.visible). Are the rig's lengths in metres, and do the cameras look the same way?"
        )


def _most_alike(deepest: float) -> Scene:
    """A scene at the origin, whose defaults for a rig give the views more in common than a family's scenes do."""
    return replace(
        ANY_SCENE,
        fov_x_deg=WIDEST_FOV_DEG,
        baseline=1e-6 * deepest,
        depth_range=(0.1 * deepest, deepest),
    )


def _farthest_distance(rig: Rig, deepest: float) -> float:
    """Metres from the first camera of a rig at the origin, beyond which it sees hardly a surface.

    deepest : the largest depth in the picture that a scene is composed for.
    """
    pose, camera = rig.world_from_cams[0], rig.cameras[0]
    turned_deg = math.degrees(math.acos(np.clip(pose[2, 2], -1.0, 1.0)))
    is_alike = turned_deg <= _ALIKE_DEG and camera.fov_x_deg <= WIDEST_FOV_DEG + 1e-6
    factor = _FARTHER if is_alike else _FARTHER_ELSEWHERE
    return float(factor * deepest + np.linalg.norm(pose[:3, 3]))


def _has_pose_in_world(
    rig: Rig, settings: RecipeSettings, scene: Scene, file: Path, find: Find
) -> bool:
    """Whether the first camera of a rig stays where it is when the scene's viewpoint moves."""
    moved = scene.at(rigid(np.eye(3), [1.0, 0.0, 0.0]) @ scene.world_from_left)
    other = settings.rig_of(moved, None, file, find)
    return bool(np.array_equal(rig.world_from_cams[0], other.world_from_cams[0]))


def largest_overlap(rig: Rig, partner: int, farthest: float) -> float:
    """The share of the first view that camera `partner` could see too, if surfaces were at the best distances.

    A pixel counts if any point of its ray up to `farthest` metres projects into the other image.
    """
    first = rig.cameras[0]
    u = np.linspace(0, first.width - 1, _COLUMNS)
    v = np.linspace(0, first.height - 1, _ROWS)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    distances = np.geomspace(_NEAREST * farthest, farthest, _DISTANCES)
    points_cam = first.rays(pixels) * distances[:, None]
    points = transform_points(rig.world_from_cams[0], points_cam)
    is_seen = rig.cameras[partner].contains(rig.project(partner, points))
    return float(is_seen.any(axis=1).mean())
