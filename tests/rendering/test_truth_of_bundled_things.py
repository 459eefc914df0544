"""Truth of the bundled scenes of thin things, against their triangles in float64, one by one."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.geometry import transform_points
from twinlens.scenes.scene import Mesh
from twinlens.scenes.shapes import tessellated

WIDTH, HEIGHT = 24, 18
CHUNK = 256  # triangles at a time


def triangles(scene):
    """All triangles of a scene, (F, 3, 3), in metres in the world."""
    corners = []
    for item in scene.objects:
        mesh = item.shape if isinstance(item.shape, Mesh) else tessellated(item.shape)
        for copy in item.instances or (np.eye(4),):
            pose = copy @ item.world_from_object
            corners.append(transform_points(pose, mesh.vertices)[mesh.faces])
    return np.concatenate(corners)


def first_distances(origin, directions, corners):
    """The parameter t of the first hit of rays origin + t direction (N, 3), +inf for none.

    A ray from the tip of a tetrahedron enters its base a, b, c where it is on the same side of its three other faces;
    it meets the plane of the base, which is normal to a x b + b x c + c x a, at t = a . (b x c) / (direction . normal).
    """
    nearest = np.full(len(directions), np.inf)
    for start in range(0, len(corners), CHUNK):
        a, b, c = (corners[start : start + CHUNK] - origin).transpose(1, 0, 2)
        faces = np.cross(a, b), np.cross(b, c), np.cross(c, a)
        sides = np.stack([directions @ face.T for face in faces])
        hit = (sides >= 0).all(axis=0) | (sides <= 0).all(axis=0)
        volume = (a * faces[1]).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = volume / sides.sum(axis=0)
        nearest = np.minimum(nearest, np.where(hit & (t > 0), t, np.inf).min(axis=1))
    return nearest


@pytest.mark.parametrize("name", ["corner", "yard"])
def test_disparity_and_visibility_are_those_of_the_triangles(name):
    scene = tl.load_scene(name)
    camera = tl.Camera.from_fov(WIDTH, HEIGHT, scene.fov_x_deg)
    rig = tl.Rig.stereo(camera, scene.baseline, scene.world_from_left)
    truth = tl.ground_truth(scene, rig)[0]
    corners = triangles(scene)

    v, u = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1).astype(float)
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    bearings = np.stack([x, y, np.ones_like(x)], axis=-1)
    left, right = rig.world_from_cams
    rays = bearings @ left[:3, :3].T
    depth = first_distances(left[:3, 3], rays, corners)
    disparity = camera.fx * scene.baseline / depth

    # A ray that passes within rounding of an edge may hit what is before or behind it.
    error = np.abs(truth.disparity.ravel() - disparity)
    assert (error < 1e-4).mean() > 0.995

    points = left[:3, 3] + depth[:, None] * rays
    to_points = points - right[:3, 3]
    is_seen = first_distances(right[:3, 3], to_points, corners) > 1 - 1e-4
    u_right = u - disparity
    is_inside = (u_right >= -0.5) & (u_right < WIDTH - 0.5)
    expected = is_seen & is_inside
    assert 0.05 < 1 - expected.mean() < 0.2
    assert (truth.visible.ravel() == expected).mean() > 0.995
