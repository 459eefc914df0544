"""Requests that cannot be rendered are errors of one line that name the argument, its value and what is allowed."""

import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.rendering import render_measured


@pytest.fixture(scope="module")
def view():
    scene = tl.load_scene("cards")
    camera = tl.Camera.from_fov(16, 12, 50)
    return scene, tl.Rig.stereo(camera, 0.1, scene.world_from_left)


def test_arguments_of_wrong_types_are_input_errors(view):
    scene, rig = view
    pinhole = tl.Pinhole()
    for words, call, arguments in (
        ("load_scene", tl.render, ("cards", rig)),
        ("load_scene", tl.ground_truth, ("cards", rig)),
        ("Rig", tl.render, (scene, rig.cameras[0])),
        ("a lens must be", tl.render, (scene, rig, "pinhole")),
        ("a lens must be", render_measured, (scene, rig, "pinhole", 4, 0)),
        ("one lens, or one for each camera, got 3", tl.render, (scene, rig, [pinhole] * 3)),
        ("list", tl.render_lens_grid, (scene, rig, pinhole)),
        ("at least one lens", tl.render_lens_grid, (scene, rig, [])),
        ("spp .* got 0", tl.render, (scene, rig, pinhole, 0)),
        ("seed .* got -1", tl.render, (scene, rig, pinhole, 4, -1)),
        ("spp >= 2", render_measured, (scene, rig, pinhole, 1, 0)),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            call(*arguments)
    with pytest.raises(InputError, match="did you mean 'multijitter'"):
        tl.render(scene, rig, sampler="multijiter")
