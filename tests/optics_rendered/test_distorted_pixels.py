"""Images with lens distortion: lights are at the pixels of `Camera.project`."""

import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, centroid, grey, lamps
from twinlens.camera import BrownConrady, KannalaBrandt

DISTORTIONS = {
    "barrel": BrownConrady(k1=-0.25, k2=0.06, p1=0.002, p2=-0.003),
    "rational": BrownConrady(
        k1=0.1, k2=0.02, p1=-0.001, p2=0.002, k3=0.01, k4=0.15, k5=0.03, k6=0.005
    ),
    "fisheye": KannalaBrandt(k1=-0.03, k2=0.01, k3=-0.002, k4=0.0005),
}
CAMERA = tl.Camera(160, 120, fx=130.0, fy=124.0, cx=76.3, cy=61.8)
DEPTH = 2.0


RADIUS = 1.5 * DEPTH / CAMERA.fx


def gathered(image: np.ndarray, near) -> np.ndarray:
    """The centroid of the pixels around `near` (u, v)."""
    u, v = np.round(near).astype(int)
    return centroid(image[v - 6 : v + 7, u - 6 : u + 7]) + np.array([u - 6, v - 6])


def landing(camera: tl.Camera, place: np.ndarray) -> np.ndarray:
    """The expected centroid of a disk of light, from the projections of many of its points, binned to pixels."""
    r, turn = (
        np.sqrt((np.arange(40000) + 0.5) / 40000),
        np.arange(40000) * 2.399963229728653,
    )  # a sunflower's seeds
    points = place + RADIUS * np.stack(
        [r * np.cos(turn), r * np.sin(turn), 0 * r], axis=-1
    )
    return np.floor(camera.project(points) + 0.5).mean(axis=0)


@pytest.mark.parametrize(
    "name", ["barrel", pytest.param("rational", marks=pytest.mark.slow), "fisheye"]
)
def test_lights_are_at_their_projections(name):
    """Centroids of 20 lights within 0.02 px; without distortion they are pixels away."""
    camera = CAMERA.replace(distortion=DISTORTIONS[name])
    wanted = np.array(
        [
            (u, v)
            for u in (9.3, 45.7, 80.2, 115.6, 150.9)
            for v in (9.1, 43.4, 78.8, 110.5)
        ]
    )
    places = camera.unproject(wanted) * DEPTH
    image = grey(
        tl.render(lamps(places, RADIUS), tl.Rig([camera], [HERE]), spp=1024, seed=0)[0]
    )
    missed = [
        gathered(image, pixel) - landing(camera, place)
        for pixel, place in zip(wanted, places, strict=True)
    ]
    assert np.abs(missed).max() < 0.02
    assert np.abs(CAMERA.project(places) - wanted).max() > 1.0
