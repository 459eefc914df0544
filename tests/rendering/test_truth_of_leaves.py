"""Truth of a plant with two instances, against the float64 closed form of its triangles."""

import numpy as np

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


def nearest_depths(camera, triangles):
    """Depth (H, W) of the first of triangles (F, 3, 3) along each pixel's ray, +inf beside all.

    A ray (x, y, 1) z meets the plane n (p - a) = 0 at z = n a / n (x, y, 1), inside where all edge products agree.
    """
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)],
        axis=-1,
    ).reshape(-1, 3)
    depth = np.full(len(rays), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (normal @ a) / (rays @ normal)
            points = z[:, None] * rays
            inside = np.isfinite(z) & (z > 0)
            for start, end in ((a, b), (b, c), (c, a)):
                inside &= np.cross(end - start, points - start) @ normal >= 0
        depth = np.where(inside & (z < depth), z, depth)
    return depth.reshape(HEIGHT, WIDTH)


def test_disparities_of_leaves_are_those_of_their_triangles():
    piece = make_thing("pot-plant", np.random.default_rng(4))
    mesh = merged([part for _, part, _ in piece.parts])
    plant = SceneObject("plant", mesh, "green", instances=poses())
    green = {"green": lambert(Color((0.1, 0.4, 0.1)))}
    scene = Scene(
        "plants",
        (plant,),
        green,
        world_from_left=np.eye(4),
        depth_range=(0.8, 3.0),
    )
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, fov_x_deg=50)
    rig = tl.Rig.stereo(camera, baseline=BASELINE)
    truth = tl.ground_truth(scene, rig)[0]
    placed = [transform_points(pose, mesh.vertices)[mesh.faces] for pose in poses()]
    depth = nearest_depths(camera, np.concatenate(placed))
    expected = camera.fx * BASELINE / depth
    hit = np.isfinite(depth)
    # A ray that passes within rounding of an edge may hit or miss: a few pixels of all.
    agree = np.isfinite(truth.disparity) == hit
    assert agree.mean() > 0.998
    error = np.abs(truth.disparity - expected)[hit & agree]
    assert hit.sum() > 300
    assert np.quantile(error, 0.998) < 1e-4
