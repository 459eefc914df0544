"""What stands in the bundled scenes `corner` and `yard` rests on something and overlaps nothing."""

from itertools import combinations

import pytest

from twinlens.families.things.ground import layers_of
from twinlens.scenes import load_scene
from twinlens.scenes.shapes import transformed

HEIGHTS = {
    "corner": {
        "plant": 0.0,
        "chair": 0.0,
        "grille": 0.0,
        "wheel": 0.0,
        "basket": 0.0,
        "desk": 0.0,
        "box": 0.0,
        "lamp": 0.76,
        "book": 0.76,
    },
    "yard": {
        "bush": 0.0,
        "bicycle": 0.0,
        "trellis": 0.0,
        "steps": 0.0,
        "landing": 0.0,
        "crate": 0.0,
        "apples": 0.012,
    },
}
"""The height in metres at which a thing stands; its objects are those whose names begin with this word."""
HANGING = {"corner": ("cord",), "yard": ("towel", "sheet", "shed")}


def placed(scene, word):
    """The meshes of a thing in the world, one for each object and instance."""
    meshes = []
    for item in scene.objects:
        if item.name.split("_")[0] == word:
            poses = item.instances or (None,)
            for copy in poses:
                pose = item.world_from_object
                pose = pose if copy is None else copy @ pose
                meshes.append(transformed(item.shape, pose))
    assert meshes, word
    return meshes


@pytest.mark.parametrize("name", HEIGHTS)
def test_things_stand_on_something(name):
    scene = load_scene(name)
    for word, height in HEIGHTS[name].items():
        lowest = min(mesh.vertices[:, 2].min() for mesh in placed(scene, word))
        assert lowest == pytest.approx(height, abs=1.5e-3), word


@pytest.mark.parametrize("name", HEIGHTS)
def test_things_do_not_overlap(name):
    """Between two heights, the convex outlines of two parts are apart."""
    scene = load_scene(name)
    layers = {}
    for word in (*HEIGHTS[name], *HANGING[name]):
        parts = [layers_of([mesh]) for mesh in placed(scene, word)]
        layers[word] = [layer for part in parts for layer in part]
    for one, other in combinations(layers, 2):
        for layer in layers[one]:
            for beside in layers[other]:
                assert layer.is_clear_of(beside, 0.0), (one, other)
