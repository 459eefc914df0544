"""Stable poses against closed forms and trimesh; distances of outlines against densely sampled points."""

import math

import numpy as np
import pytest
import trimesh

from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import (
    centre_of_mass,
    gap,
    inside_by,
    outline,
    stable_poses,
)


def ours(made):
    return Mesh(np.array(made.vertices), np.array(made.faces))


def test_box_has_six_stable_poses():
    extents = np.array([1.0, 0.6, 0.3])
    found = stable_poses(ours(trimesh.creation.box(extents)))
    assert len(found) == 6
    assert sorted(round(rest.height, 6) for rest in found) == [
        0.3,
        0.3,
        0.6,
        0.6,
        1.0,
        1.0,
    ]
    assert found[0].height == pytest.approx(
        0.3
    )  # the largest face is the most probable
    for rest in found:
        np.testing.assert_allclose(rest.turn @ rest.turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rest.turn) == pytest.approx(1.0)
        assert rest.points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert rest.top is not None


def test_a_sheared_box_topples_once_its_centre_of_mass_passes_its_edge():
    """Sheared further, the box is no longer stable on its base."""
    box = trimesh.creation.box([0.3, 0.3, 1.0])
    for lean, stays in ((0.25, True), (0.35, False)):
        sheared = np.array(box.vertices)
        sheared[:, 0] += lean * sheared[:, 2] * (0.3 / 0.3)
        found = stable_poses(Mesh(sheared, np.array(box.faces)))
        on_base = [rest for rest in found if abs(rest.turn[2, 2]) > 1 - 1e-9]
        assert bool(on_base) == (stays or lean < 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_stable_faces_are_those_of_trimesh(seed):
    points = np.random.default_rng(seed).normal(size=(14, 3))
    hull = trimesh.convex.convex_hull(points)
    transforms, _ = trimesh.poses.compute_stable_poses(
        hull, sigma=0.0, n_samples=1, threshold=0.0
    )
    theirs = {tuple(np.round(t[2, :3], 4) + 0.0) for t in transforms}
    mine = {tuple(np.round(rest.turn[2], 4) + 0.0) for rest in stable_poses(ours(hull))}
    assert mine <= theirs
    assert (
        len(theirs) - len(mine) <= 1
    )  # a face with the centre of mass nearly above its edge


@pytest.mark.parametrize("place", [(0, 0, 0), (3.0, -2.0, 1.0)])
def test_the_centre_of_mass_of_a_solid_and_of_a_shell(place):
    """Of a half ball 3/8 of the radius from its middle; of an open hemisphere 1/2."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    shell = ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0]
    rim = len(ball.vertices)
    edges = np.sort(trimesh.Trimesh(*shell, process=False).edges, axis=1)
    ends, count = np.unique(edges, axis=0, return_counts=True)
    once = {tuple(end) for end in ends[count == 1]}
    open_edges = [
        edge
        for edge in trimesh.Trimesh(*shell, process=False).edges
        if tuple(np.sort(edge)) in once
    ]
    lid = np.array([[b, a, rim] for a, b in open_edges])
    vertices = np.vstack([ball.vertices, [0, 0, 0]]) + place
    for faces, depth in ((shell[1], 0.5), (np.vstack([shell[1], lid]), 0.375)):
        centre = centre_of_mass(Mesh(vertices, faces.astype(np.uint32))) - place
        np.testing.assert_allclose(centre, [0, 0, -depth], atol=0.02)


def test_a_bowl_has_no_level_top():
    profile = np.array(
        [
            (0, 0),
            (0.2, 0),
            (0.2, 0),
            (0.5, 0.4),
            (0.5, 0.4),
            (0.45, 0.4),
            (0.45, 0.4),
            (0.15, 0.05),
            (0, 0.05),
        ]
    )
    upright = [
        rest
        for rest in stable_poses(shapes.lathe(profile, 32, smooth=False))
        if rest.turn[2, 2] > 0.999
    ]
    assert upright
    assert all(rest.top is None for rest in upright)


def test_gap_is_a_lower_bound_of_the_distance():
    rng = np.random.default_rng(5)
    apart = 0
    for _ in range(200):
        a, b = (
            outline(rng.normal(size=(9, 2)) + rng.uniform(-4, 4, 2)) for _ in range(2)
        )
        edge = np.concatenate(
            [a + t * (np.roll(a, -1, axis=0) - a) for t in np.linspace(0, 1, 40)]
        )
        other = np.concatenate(
            [b + t * (np.roll(b, -1, axis=0) - b) for t in np.linspace(0, 1, 40)]
        )
        distance = np.linalg.norm(edge[:, None] - other[None], axis=-1).min()
        meets = any(inside_by(b, p) > 0 for p in edge) or any(
            inside_by(a, p) > 0 for p in other
        )
        assert gap(a, b) <= distance + 1e-9
        assert not (meets and gap(a, b) > 0)
        apart += gap(a, b) > 0
    assert apart > 50


def test_inside_by_is_the_distance_to_the_nearest_edge():
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])
    assert inside_by(square, np.array([1.0, 0.25])) == pytest.approx(0.25)
    assert inside_by(square, np.array([3.0, 1.0])) == pytest.approx(-1.0)
    assert math.isclose(inside_by(square, np.array([2.0, 1.0])), 0.0, abs_tol=1e-12)
