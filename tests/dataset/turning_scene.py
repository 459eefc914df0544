"""A floor, a ball on it and an upright card, seen by cameras all around: exact truth of any view in closed form.

The card hides parts of floor and ball, the ball hides parts of the floor, and cameras behind the card see its back.
"""

import numpy as np

from tests.dataset.dataset_scene import LENS, _extra
from twinlens import geometry
from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample, Shot

FLOOR, BALL, CARD = 1, 2, 3
CENTRE, RADIUS = np.array([0.1, 0.0, 0.3]), 0.3
CARD_X, HALF_WIDTH, HEIGHT = -0.5, 0.4, 0.7  # in the plane x = CARD_X, upright
HALF_FLOOR = 1.5
COLORS = np.array([[0, 0, 0], [200, 40, 20], [30, 180, 60], [50, 70, 220]], np.uint8)


def cast(origin, directions):
    """Distance in lengths of `directions` (..., 3), object, and normal (..., 3) of the first hit from `origin` (3,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = [_floor(origin, directions), _ball(origin, directions)]
        hits.append(_card(origin, directions))
    distance = np.stack(hits)
    nearest = distance.argmin(axis=0)
    first = distance.min(axis=0)
    ids = np.where(np.isfinite(first), nearest + 1, 0)
    points = origin + np.where(ids > 0, first, 0.0)[..., None] * directions
    return first, ids, _normals(ids, points, directions)


def _floor(origin, directions):
    t = -origin[2] / directions[..., 2]
    points = origin + t[..., None] * directions
    inside = (np.abs(points[..., :2]) < HALF_FLOOR).all(axis=-1)
    return np.where((t > 0) & inside, t, np.inf)


def _ball(origin, directions):
    # |o + t d - c|^2 = r^2, a quadratic equation of t.
    offset = origin - CENTRE
    a = (directions**2).sum(axis=-1)
    b = directions @ offset
    root = b**2 - a * (offset @ offset - RADIUS**2)
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    return np.where((root > 0) & (t > 0), t, np.inf)


def _card(origin, directions):
    t = (CARD_X - origin[0]) / directions[..., 0]
    _, y, z = np.moveaxis(origin + t[..., None] * directions, -1, 0)
    inside = (np.abs(y) < HALF_WIDTH) & (z > 0) & (z < HEIGHT)
    return np.where((t > 0) & inside, t, np.inf)


def _normals(ids, points, directions):
    normals = np.zeros(points.shape)
    normals[ids == FLOOR] = [0, 0, 1]
    normals[ids == BALL] = (points[ids == BALL] - CENTRE) / RADIUS
    normals[ids == CARD] = [1, 0, 0]
    away = (normals * directions).sum(axis=-1) > 0
    return np.where(away[..., None], -normals, normals)


def distance_from_surface(points, ids):
    """Metres between points (N, 3) and the surface of the object that each is on."""
    of_ball = np.abs(np.linalg.norm(points - CENTRE, axis=-1) - RADIUS)
    of_card = np.abs(points[:, 0] - CARD_X)
    return np.select([ids == BALL, ids == CARD], [of_ball, of_card], points[:, 2])


def is_seen(rig, view, points):
    """Whether a camera sees each of the points (N, 3), by a ray from its centre; in the image and not hidden."""
    centre = rig.world_from_cams[view][:3, 3]
    first, _, _ = cast(centre, points - centre)
    return (np.abs(first - 1) < 1e-5) & rig.cameras[view].contains(
        rig.project(view, points)
    )


def ring(cameras, distance=2.0, height=1.2):
    """Cameras all around that look at the ball."""
    angles = 2 * np.pi * np.arange(len(cameras)) / len(cameras)
    eyes = [(distance * np.cos(a), distance * np.sin(a), height) for a in angles]
    return Rig(cameras, [geometry.look_at(eye, CENTRE) for eye in eyes])


def truths(rig):
    return tuple(_truth(rig, view) for view in range(len(rig)))


def _truth(rig, view):
    camera, pose = rig.cameras[view], rig.world_from_cams[view]
    directions = geometry.rotate(pose, camera.unproject(camera.pixel_grid()))
    depth, ids, normal = cast(pose[:3, 3], directions)
    hit = ids > 0
    position = pose[:3, 3] + np.where(hit, depth, 1.0)[..., None] * directions
    partner = rig.partner(view)
    visible = np.zeros(hit.shape, bool)
    visible[hit] = is_seen(rig, partner, position[hit])
    ids = ids.astype(np.int32)
    return Truth(
        depth=depth,
        position=np.where(hit[..., None], position, np.inf),
        disparity=np.full(hit.shape, np.inf, np.float32),
        visible=visible,
        normal=normal.astype(np.float32),
        shading_normal=normal.astype(np.float32),
        object_id=ids,
        material_id=ids,
        material_kind=hit.astype(np.uint8),
        object_names=("floor", "ball", "card"),
        material_names=("floor", "ball", "card"),
        extra=_extra(depth.shape),
    )


def sample(rig):
    """A sample whose images have one colour for each object."""
    made = truths(rig)
    images = tuple(COLORS[truth.object_id] for truth in made)
    return Sample(rig, (Shot(LENS, images),), made)
