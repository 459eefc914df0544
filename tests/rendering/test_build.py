"""A built scene whose objects move: its images and its truth are those of a scene that is built at the new poses."""

from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from twinlens.camera import Projector
from twinlens.errors import InputError
from twinlens.geometry import rigid
from twinlens.rendering.build import build, build_moved
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.shapes import tessellated

PAINT = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
LAMP = {"type": "area", "radiance": {"type": "rgb", "value": 5.0}}
SKY = {"type": "constant", "radiance": {"type": "rgb", "value": 0.4}}
BALL = {"type": "sphere", "radius": 0.3}
TILE = {"type": "rectangle", "to_world": np.diag([0.3, 0.3, 1.0, 1.0])}
BOX = tessellated({"type": "cube"})
BACK = np.diag([1.0, 1.0, -1.0, 1.0])
WIDE = np.diag([9.0, 9.0, 1.0, 1.0])
CAMERA = tl.Camera.from_fov(32, 24, 60)


def pose(x: float, y: float, z: float, turn: float = 0.0, size: float = 1.0):
    cos = np.cos(turn)
    sin = np.sin(turn)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
    return rigid(rotation, [x, y, z]) @ np.diag([size, size, size, 1.0])


def scene(moved: bool) -> Scene:
    """A wall, and before it a ball, a tile, a lamp, a box and two copies of a box, in one place or another."""
    d = 0.25 if moved else 0.0
    objects = (
        SceneObject(
            "wall", {"type": "rectangle"}, "paint", pose(0, 0, 4) @ BACK @ WIDE
        ),
        SceneObject("ball", BALL, "paint", pose(-0.6 + d, 0.2, 3)),
        SceneObject("tile", TILE, "paint", pose(0.6, 0.3 - d, 2.5) @ BACK),
        SceneObject("lamp", BALL, "paint", pose(0, -0.8 - d, 3), LAMP),
        SceneObject("box", BOX, "paint", pose(0.1, 0.5, 3 - d, turn=d, size=0.2)),
        SceneObject(
            "pair",
            BOX,
            "paint",
            pose(0, 0, 0, turn=d, size=0.15),
            instances=(pose(-0.3, -0.4 + d, 3), pose(0.7, -0.5, 3 + d, turn=2 * d)),
        ),
    )
    return Scene("moving", objects, {"paint": PAINT}, np.eye(4), (1, 5), {"sky": SKY})


def rig() -> tl.Rig:
    dots = Projector(pose(0.05, 0, 0), CAMERA, np.eye(24, 32), power=20.0, band="rgb")
    cameras = [CAMERA, CAMERA]
    return tl.Rig(cameras, [np.eye(4), pose(0.1, 0, 0)], projectors=[dots])


@pytest.fixture
def there_and_then() -> tuple[Scene, Scene]:
    """A scene whose objects moved after it was rendered, and one that was built at the new poses."""
    before = scene(moved=False)
    fresh = scene(moved=True)
    tl.render(before, rig(), spp=1)
    tl.ground_truth(before, rig())
    objects = []
    for old, new in zip(before.objects, fresh.objects, strict=True):
        poses = {"world_from_object": new.world_from_object, "instances": new.instances}
        objects.append(replace(old, **poses))
    moved = replace(before, objects=tuple(objects))
    built = build(before)
    assert build_moved(moved, before) is built
    assert build(moved) is built
    return moved, fresh


def test_the_truth_is_that_of_a_scene_built_at_the_new_poses(there_and_then):
    moved, fresh = (tl.ground_truth(scene, rig())[0] for scene in there_and_then)
    for name in ("depth", "position", "normal", "object_id", "visible"):
        np.testing.assert_allclose(
            getattr(moved, name), getattr(fresh, name), rtol=1e-6, atol=1e-6
        )
    still = tl.ground_truth(scene(moved=False), rig())[0]
    assert (still.object_id != moved.object_id).mean() > 0.05
    for ours, theirs in zip(moved.objects, fresh.objects, strict=True):
        np.testing.assert_allclose(
            ours.cam_from_object, theirs.cam_from_object, atol=1e-6
        )


@pytest.mark.parametrize("denoise", [False, True])
def test_images_are_those_of_a_scene_built_at_the_new_poses(there_and_then, denoise):
    moved, fresh = (
        np.array(tl.render(scene, rig(), spp=16, denoise=denoise))
        for scene in there_and_then
    )
    np.testing.assert_allclose(moved, fresh, rtol=1e-3, atol=1e-3)


def test_only_poses_may_differ():
    before = scene(moved=False)
    for other in (
        replace(before, objects=before.objects[1:]),
        replace(before, ambient=2.0),
        replace(before, materials={**before.materials}),
        scene(moved=True).at(before.world_from_left),
    ):
        with pytest.raises(InputError, match="only the poses of objects may differ"):
            build_moved(other, before)
