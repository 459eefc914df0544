"""The z-buffer of a view, against closed forms."""

import numpy as np

from twinlens.families.composition import Viewpoint, rasterize
from twinlens.geometry import look_at

QUAD = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def view():
    return Viewpoint(look_at([0, 0, 0], [0, 1, 0]), 60.0, 4 / 3)


def rays(columns):
    """(x, y) at depth 1 of each pixel centre."""
    rows = round(columns / (4 / 3))
    half = np.tan(np.radians(30))
    x = (2 * (np.arange(columns) + 0.5) / columns - 1) * half
    y = (2 * (np.arange(rows) + 0.5) / rows - 1) * half / (4 / 3)
    return np.meshgrid(x, y)


def test_a_slanted_plane_has_its_closed_form_depth():
    """World y forward, z up: the plane y = 3 + x/2 has depth z = 3/(1 - x/2) in the camera."""
    wall = np.array([[-9, -1.5, -9], [5, 5.5, -9], [5, 5.5, 9], [-9, -1.5, 9.0]])
    seen = rasterize(view(), [(wall, QUAD)])
    x, _ = rays(160)
    np.testing.assert_allclose(seen, 3 / (1 - x / 2), rtol=1e-9)


def test_a_floor_under_the_camera_is_clipped_and_visible_to_the_horizon():
    floor = np.array(
        [[-500, -500, -1], [500, -500, -1], [500, 500, -1], [-500, 500, -1.0]]
    )
    seen = rasterize(view(), [(floor, QUAD)])
    _, y = rays(160)
    expected = np.where((y > 1 / 500), 1 / np.where(y > 0, y, 1), np.inf)
    np.testing.assert_allclose(seen, expected, rtol=1e-6)


def test_the_nearer_mesh_hides_the_farther_in_any_order():
    far = np.array([[-9, 5, -9], [9, 5, -9], [9, 5, 9], [-9, 5, 9.0]])
    near = np.array([[0, 2, -9], [9, 2, -9], [9, 2, 9], [0, 2, 9.0]])
    x, _ = rays(160)
    for order in ([(far, QUAD), (near, QUAD)], [(near, QUAD), (far, QUAD)]):
        np.testing.assert_allclose(rasterize(view(), order), np.where(x > 0, 2.0, 5.0))


def test_a_mesh_behind_the_camera_is_not_visible():
    behind = np.array([[-9, -5, -9], [9, -5, -9], [9, -5, 9], [-9, -5, 9.0]])
    assert not np.isfinite(rasterize(view(), [(behind, QUAD)])).any()
