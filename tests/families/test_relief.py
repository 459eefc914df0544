"""Rough ground: dents below a flat sheet, with the sheet's outline and texture coordinates."""

import numpy as np
import pytest

from twinlens.families.composition import Viewpoint
from twinlens.families.relief import draw_dents, rough_front
from twinlens.families.surfaces import Sheet
from twinlens.geometry import look_at
from twinlens.scenes.shapes import face_cross

DEPTH = 0.02
VIEW = Viewpoint(look_at(np.array([0.0, 0, 1.0]), np.array([0.0, 2, 0])), 50.0, 4 / 3)
FLAT = Sheet(np.array([-1.0, 0.3, 0]), np.array([2.0, 0, 0]), np.array([0, 4.0, 0]))


@pytest.fixture(scope="module")
def sheet():
    return FLAT.seen_from(VIEW, 0.0)


@pytest.fixture(scope="module")
def rough(sheet):
    return rough_front(sheet, draw_dents(np.random.default_rng(2), DEPTH, 0.7))


def test_dents_are_below_the_sheet_and_end_at_its_edges(rough):
    x, y, z = rough.vertices.T
    assert z.max() <= 0
    assert z.min() >= -DEPTH
    assert z.min() < -0.7 * DEPTH
    is_edge = (np.abs(x) == 1) | (y == 0.3) | (y == 4.3)
    assert is_edge.sum() >= 4 * 150
    assert not z[is_edge].any()


def test_the_texture_lies_as_on_the_flat_sheet(sheet, rough):
    """At a vertex, (u, v) are those that the flat mesh has at its x and y."""
    flat = sheet.front()
    for axis in (0, 1):
        place, first = np.unique(flat.vertices[:, axis], return_index=True)
        expected = np.interp(rough.vertices[:, axis], place, flat.uv[first, axis])
        np.testing.assert_allclose(rough.uv[:, axis], expected, atol=1e-9)


def test_normals_are_those_of_the_triangles_around(rough):
    cross = face_cross(rough.vertices, rough.faces)
    assert (cross[:, 2] > 0).all()
    around = np.zeros_like(rough.vertices)
    for corner in range(3):
        np.add.at(around, rough.faces[:, corner], cross)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    cosine = (around * rough.normals).sum(axis=1)
    # Differences of two and of six neighbours are not the same where the ground is rough.
    assert np.median(cosine) > 0.98
    assert np.quantile(cosine, 0.05) > 0.85


def test_a_seed_decides_the_dents_and_seeds_differ(sheet, rough):
    again = rough_front(sheet, draw_dents(np.random.default_rng(2), DEPTH, 0.7))
    np.testing.assert_array_equal(again.vertices, rough.vertices)
    other = rough_front(sheet, draw_dents(np.random.default_rng(3), DEPTH, 0.7))
    assert np.abs(other.vertices - rough.vertices).max() > 0.2 * DEPTH


def test_dents_repeat_after_a_tile():
    dents = draw_dents(np.random.default_rng(1), DEPTH, 0.5)
    x, y = np.linspace(0, 0.4, 30), np.linspace(0, 0.3, 20)
    np.testing.assert_allclose(dents(x + 0.5, y + 1.0), dents(x, y), atol=1e-6)
