"""Rays that hit nothing: unknown, or with `sky_disparity` the point at infinity, its disparity and visibility."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.scenes import Mesh, SceneObject

WALL = Mesh(
    np.array([[-1.0, -9, 3], [0, -9, 3], [0, 9, 3], [-1, 9, 3]]),
    np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
)
CAMERA = tl.Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
BASELINE = 0.5


@pytest.fixture(scope="module")
def truths():
    """A wall over the left half of the view, and sky."""
    wall = SceneObject("wall", WALL, "grey")
    scene = tl.Scene(
        "half",
        (wall,),
        {"grey": {"type": "twosided", "bsdf": {"type": "diffuse"}}},
        np.eye(4),
        (1.0, 9.0),
    )
    rig = tl.Rig.stereo(CAMERA, BASELINE, right=CAMERA.replace(cx=CAMERA.cx + 3))
    return tl.ground_truth(scene, rig, sky_disparity=True)


def test_sky_has_the_disparity_of_infinity_and_is_seen_where_the_partner_sees_it(
    truths,
):
    for index, truth in enumerate(truths):
        sky = ~truth.hit
        assert (truth.disparity[sky] == -3.0).all()
        u = CAMERA.pixel_grid()[..., 0]
        partner_cx, to_partner = (CAMERA.cx + 3, 3) if index == 0 else (CAMERA.cx, -3)
        seen_at = (
            u + to_partner
        )  # a point at infinity moves by the principal points' difference alone
        x = (seen_at - partner_cx) / CAMERA.fx
        partner_x = BASELINE if index == 0 else 0.0
        behind_wall = (partner_x + 3 * x > -1) & (partner_x + 3 * x < 0)
        inside = (seen_at >= -0.5) & (seen_at < CAMERA.width - 0.5)
        assert (truth.visible[sky] == (inside & ~behind_wall)[sky]).all()
        assert (truth.visible[sky]).any()


def test_sky_of_a_rig_without_doffs_has_disparity_zero_without_a_sign():
    scene = tl.Scene(
        "empty",
        (SceneObject("wall", WALL, "grey"),),
        {"grey": {"type": "diffuse"}},
        np.eye(4),
        (1.0, 9.0),
    )
    for truth in tl.ground_truth(
        scene, tl.Rig.stereo(CAMERA, BASELINE), sky_disparity=True
    ):
        sky = truth.disparity[~truth.hit]
        assert sky.size
        assert (sky == 0).all()
        assert not np.signbit(sky).any()
