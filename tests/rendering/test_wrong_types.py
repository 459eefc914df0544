import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.rendering import render_measured


@pytest.fixture(scope="module")
def view():
    scene = tl.load_scene("cards")
    return scene, tl.Rig.stereo(
        tl.Camera.from_fov(16, 12, 50), 0.1, scene.world_from_left
    )


def test_arguments_of_wrong_types_are_input_errors(view):
    scene, rig = view
    for call, words in (
        (lambda: tl.render("cards", rig), "load_scene"),
        (lambda: tl.ground_truth("cards", rig), "load_scene"),
        (lambda: tl.render(scene, rig.cameras[0]), "Rig"),
        (lambda: tl.render(scene, rig, "pinhole"), "a lens must be"),
        (lambda: tl.render_lens_grid(scene, rig, tl.Pinhole()), "list"),
        (lambda: tl.render(scene, rig, spp="4"), "'4'"),
        (lambda: render_measured(scene, rig, tl.Pinhole(), "4", 0), "'4'"),
        (lambda: render_measured(scene, rig, tl.Pinhole(), 1, 0), "spp >= 2"),
        (lambda: render_measured(scene, rig, tl.Pinhole(), 4, -1), "seed"),
        (lambda: render_measured(scene, rig, "pinhole", 4, 0), "a lens must be"),
    ):
        with pytest.raises(InputError, match=words):
            call()
