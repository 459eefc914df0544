"""The truth where it is hardest: planes seen edge on, mirrored and inside-out meshes, stretched instances, files."""

import numpy as np
import pytest

from tests.rendering import rendering_corners as corners
from tests.rendering.rendering_answers import View
from tests.rendering.rendering_bodies import Ball, unit

CASES = corners.cases()
FINE = ("plain ball", "mirrored ball", "inside out ball")


@pytest.fixture
def truth(renderer):
    """Truth fields of one case's view, one row a pixel, and the View of its closed form."""
    arrays = renderer("corners")

    def of(name, index=0):
        bodies, _, rig = CASES[name]
        view = View(bodies, rig, index)
        fields = (
            "depth",
            "visible",
            "normal",
            "shading_normal",
            "object_id",
            "position",
        )
        flat = {field: arrays[f"{name}/{index}/{field}"] for field in fields}
        return {
            field: array.reshape(len(view.pixels()), *array.shape[2:])
            for field, array in flat.items()
        }, view

    return of


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("edge on")])
def test_a_plane_does_not_occlude_itself_at_grazing_angles(truth, name):
    found, view = truth(name)
    assert (found["object_id"] > 0).sum() > 100
    wrong = found["visible"] != view.all_visible
    assert view.near_edge(view.visible, view.pixels()[wrong], 0.01).all()


@pytest.mark.parametrize(
    "name", [name for name in CASES if not name.startswith("edge on")]
)
@pytest.mark.parametrize("index", [0, 1])
def test_placed_meshes_equal_their_closed_form(truth, name, index):
    found, view = truth(name, index)
    pixels = view.pixels()
    depth, body, _ = view.hits(pixels)
    hit = found["object_id"] > 0
    assert view.near_edge(view.label, pixels[hit != (body >= 0)], 1e-3).all()
    clear = hit & (body >= 0) & (view.all_cosines > 0.02)
    assert clear.sum() > 200
    assert np.abs(found["depth"][clear] / depth[clear] - 1).max() <= 1e-6
    wrong = found["visible"] != view.all_visible
    assert view.near_edge(view.visible, pixels[wrong], 0.01).all()
    assert np.quantile(np.abs(found["normal"] - view.all_normals)[clear], 0.99) < 1e-6


@pytest.mark.parametrize("name", FINE)
def test_smooth_normals_are_interpolated_and_face_the_camera(truth, name):
    """Those of a ball are its radii, to the square of the triangles' size, whichever way its faces are wound."""
    found, _ = truth(name)
    hit = found["object_id"] > 0
    radius, smooth, flat = (
        unit(found["position"][hit]),
        found["shading_normal"][hit],
        found["normal"][hit],
    )
    assert np.abs(smooth - radius).max() < 0.007
    assert np.abs(flat - radius).max() > 0.05
    assert ((smooth * flat).sum(axis=-1) > 0.99).all()
    assert np.abs(np.linalg.norm(smooth, axis=-1) - 1).max() < 1e-6


def test_a_mitsuba_file_has_ground_truth(renderer):
    arrays = renderer("corners")
    assert str(arrays["xml"]) == "ball"
    view = View([Ball(np.array([0.3, 0.2, 0.1]), 0.5)], corners.rig(), 0)
    depth, body, _ = view.hits(view.pixels())
    given = arrays["xml/depth"].ravel()
    clear = (body >= 0) & (view.all_cosines > 0.02)
    assert np.abs(given[clear] / depth[clear] - 1).max() <= 3e-6
