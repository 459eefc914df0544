"""The Jacobian of the projection against finite differences."""

import numpy as np
import pytest

from twinlens.camera import BrownConrady, Camera, KannalaBrandt
from twinlens.errors import InputError

MODELS = [
    None,
    BrownConrady(-0.2, 0.05, 1e-3, 2e-3, 0.01, 0.02),
    KannalaBrandt(0.05, -0.02, 0.01, 0.003),
]


@pytest.mark.parametrize(
    "model", MODELS, ids=lambda model: getattr(model, "name", "none")
)
def test_jacobian_equals_differences_of_project(model):
    camera = Camera(640, 480, 700.0, 680.0, 310.0, 241.0, model)
    points = np.array([[0.3, -0.2, 1.5], [0.0, 0.0, 2.0], [-0.5, 0.4, 3.0]])
    step = 1e-6
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (camera.project(points + shift) - camera.project(points - shift)) / (
            2 * step
        )
        assert np.allclose(
            camera.projection_jacobian(points)[..., axis], slope, atol=1e-5
        )


@pytest.mark.parametrize("point", [[0, 0, 0], [0, 0, -1], [np.inf, 0, 1], [50.0, 0, 1]])
def test_points_without_an_image_raise(point):
    camera = Camera(640, 480, 700.0, 680.0, 310.0, 241.0, BrownConrady(-0.2))
    with pytest.raises(InputError, match="leave out"):
        camera.projection_jacobian([point])
