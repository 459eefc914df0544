"""Truth of a plant with two instances, against the float64 closed form of its triangles, one by one."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.families.things import make_thing
from twinlens.geometry import transform_points
from twinlens.scenes.materials import Color, lambert
from twinlens.scenes.placement import rotation, translation
from twinlens.scenes.scene import Scene, SceneObject
from twinlens.scenes.shapes import merged

WIDTH, HEIGHT, BASELINE = 64, 48, 0.1


def poses():
    """Two copies of a plant before a camera that looks along +z with y down; their z axis points up, to -y."""
    upright = rotation([1, 0, 0], 90.0)
    near = translation([-0.25, 0.45, 1.3]) @ upright
    far = translation([0.3, 0.5, 1.9]) @ upright @ rotation([0, 0, 1], 130.0)
    return near, far


def rays_of(camera):
    """Rays (H W, 3) = (x, y, 1) through the pixel centres of a camera at the origin."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(u)], axis=-1).reshape(-1, 3)


def first_hits(rays, triangles):
    """The least t (N,) at which rays (N, 3) t from the origin meet one of triangles (F, 3, 3); +inf where none.

    A ray meets the plane n (p - a) = 0 at t = n a / n ray, inside where all edge products agree.
    """
    first = np.full(len(rays), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (normal @ a) / (rays @ normal)
            points = t[:, None] * rays
            inside = np.isfinite(t) & (t > 0)
            for start, end in ((a, b), (b, c), (c, a)):
                inside &= np.cross(end - start, points - start) @ normal >= 0
        first = np.where(inside & (t < first), t, first)
    return first


@pytest.fixture(scope="module")
def triangles():
    """Those of both plants (F, 3, 3) in the world, which is the left camera's frame."""
    mesh = plant()
    placed = [transform_points(pose, mesh.vertices)[mesh.faces] for pose in poses()]
    return np.concatenate(placed)


def plant():
    piece = make_thing("pot-plant", np.random.default_rng(4))
    return merged([part for _, part, _ in piece.parts])


@pytest.fixture(scope="module")
def rig():
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=50)
    return tl.Rig.stereo(camera, baseline=BASELINE)


@pytest.fixture(scope="module")
def truth(rig):
    """Of the left camera."""
    item = SceneObject("plant", plant(), "green", instances=poses())
    green = {"green": lambert(Color((0.1, 0.4, 0.1)))}
    left = np.eye(4)
    scene = Scene(
        "plants", (item,), green, world_from_left=left, depth_range=(0.8, 3.0)
    )
    return tl.ground_truth(scene, rig)[0]


@pytest.fixture(scope="module")
def depth(rig, triangles):
    """The closed form of the left camera's depths (H, W)."""
    hits = first_hits(rays_of(rig.cameras[0]), triangles)
    return hits.reshape(HEIGHT, WIDTH)


def test_disparities_of_leaves_are_those_of_their_triangles(rig, truth, depth):
    expected = rig.cameras[0].fx * BASELINE / depth
    hit = np.isfinite(depth)
    # A ray that passes within rounding of an edge may hit or miss: a few pixels of all.
    agree = np.isfinite(truth.disparity) == hit
    assert agree.mean() > 0.998
    error = np.abs(truth.disparity - expected)[hit & agree]
    assert hit.sum() > 300
    assert np.quantile(error, 0.998) < 1e-4


def test_leaves_are_visible_where_no_triangle_is_before_them(
    rig, truth, depth, triangles
):
    """From the right camera's centre, the first triangle towards the point is the one that the point lies on."""
    camera = rig.cameras[1]
    hit = np.isfinite(depth)
    points = (depth.reshape(-1, 1) * rays_of(camera))[hit.ravel()]
    centre = np.array([BASELINE, 0.0, 0.0])
    towards = points - centre
    first = first_hits(towards, triangles - centre)
    column = camera.fx * towards[:, 0] / towards[:, 2] + camera.cx
    in_frame = (column >= -0.5) & (column < WIDTH - 0.5)
    expected = (first > 1 - 1e-6) & in_frame
    visible = truth.visible[hit]
    # As above, for rays that graze the edge of a leaf.
    assert (visible == expected).mean() > 0.997
    assert 0.05 < 1 - expected.mean() < 0.5
    assert (first[in_frame] < 1 - 1e-3).mean() > 0.02
