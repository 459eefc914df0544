"""Random rigs of different cameras around a cloud of points that all see, for tests of geometry."""

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig

DISTORTIONS = (None, BrownConrady(-0.1, 0.02, 1e-3, -5e-4), KannalaBrandt(0.02, -0.01))


def camera(rng, distortion=None):
    fx = rng.uniform(500, 900)
    cx, cy = 319.5 + rng.uniform(-20, 20), 239.5 + rng.uniform(-20, 20)
    return Camera(640, 480, fx, fx * rng.uniform(0.95, 1.05), cx, cy, distortion)


def px_from_world(rig, index):
    """The projection matrix K [R | t] of one camera, (3, 4), without its distortion."""
    return rig.cameras[index].K @ np.linalg.inv(rig.world_from_cams[index])[:3]


def rotation(rng, largest=np.pi):
    axis = rng.normal(size=3)
    return Rotation.from_rotvec(
        axis / np.linalg.norm(axis) * rng.uniform(0, largest)
    ).as_matrix()


def random_rig(rng, count=2, distorted=False):
    """Cameras 2 to 4 m from a target somewhere in the world, 0.3 m or more apart, rolled and aimed near it."""
    world = geometry.rigid(rotation(rng), rng.uniform(-5, 5, 3))
    places = [
        (0.8 * i + rng.uniform(-0.2, 0.2), *rng.uniform(-0.5, 0.5, 2))
        for i in range(count)
    ]
    target = np.array([0.4 * (count - 1), 0.0, 3.0])
    poses = [
        world
        @ geometry.look_at(
            place, target + rng.uniform(-0.1, 0.1, 3), up=(0.3 * rng.normal(), -1, 0)
        )
        for place in places
    ]
    cameras = [
        camera(rng, DISTORTIONS[rng.integers(3)] if distorted else None)
        for _ in range(count)
    ]
    points = geometry.transform_points(world, target + rng.uniform(-0.5, 0.5, (20, 3)))
    return Rig(cameras, poses), points


def seen(rig, points, index):
    """Pixels of world points by the camera's own projection, distortion included."""
    return rig.cameras[index].project(
        geometry.transform_points(geometry.inverse(rig.world_from_cams[index]), points)
    )
