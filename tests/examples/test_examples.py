"""The examples, with small images."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl
from twinlens.scenes import Color

FOLDER = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the examples are not installed")


def example(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def clearance(path, inside):
    """The smallest distance, metres, from a path (N, 2) to the points of the floor that are `inside` an obstacle."""
    x, y = np.meshgrid(np.arange(-2, 2, 0.02), np.arange(1, 5.6, 0.02))
    solid = np.stack([x, y], axis=-1)[inside(x, y)]
    return np.linalg.norm(path[:, None] - solid[None], axis=2).min()


def box(centre, size, degrees):
    a = np.radians(degrees)

    def inside(x, y):
        u = (x - centre[0]) * np.cos(a) + (y - centre[1]) * np.sin(a)
        v = -(x - centre[0]) * np.sin(a) + (y - centre[1]) * np.cos(a)
        return (np.abs(u) < size[0] / 2) & (np.abs(v) < size[1] / 2)

    return inside


def test_the_path_reaches_the_goal_with_clearance_from_the_true_obstacles():
    robot = example("robot")
    left, view = robot.observe(spp=32)
    found = robot.plan(view)
    assert np.allclose(found.path[0], robot.START, atol=robot.CELL)
    assert np.allclose(found.path[-1], robot.GOAL, atol=robot.CELL)
    steps = np.linalg.norm(np.diff(found.path, axis=0), axis=1)
    assert steps.max() < 1.5 * robot.CELL
    assert steps.sum() < 1.7 * np.linalg.norm(np.subtract(robot.GOAL, robot.START))
    for body in (
        box((-0.1, 2.4), (0.6, 0.5), 15),
        box((-1.3, 3.2), (0.6, 0.6), -20),
        box((0.35, 4.4), (0.7, 0.6), 35),
        lambda x, y: np.hypot(x - 1.15, y - 3.1) < 0.2,
    ):
        assert clearance(found.path, body) > robot.RADIUS - 2 * robot.CELL
    picture = robot.picture(left, view, found)
    assert picture.height == 320
    assert (np.asarray(picture)[:, :480] == (255, 220, 0)).all(axis=2).sum() > 50


def test_an_enclosed_goal_has_no_path():
    robot = example("robot")
    depth = np.full((40, 60), np.inf)
    camera = tl.Camera.from_fov(60, 40, 70)
    pose = tl.load_scene(FOLDER / "hall.toml").world_from_left
    wall = (3.0 - pose[1, 3]) / (camera.unproject(camera.pixel_grid()) @ pose[:3, :3].T)[..., 1]  # y = 3 m
    view = robot.DepthView(camera, pose, np.where(wall > 0, wall, depth))
    assert not len(robot.plan(view).path)


@pytest.mark.slow
def test_the_inserted_ball_equals_the_rendered_one():
    """A weakly emitting ball: the composed image equals a rendering of the scene with the ball."""
    virtual = example("virtual_object")
    scene, rig, lens, place = virtual.stage(size=(100, 75))
    glow = 0.02
    photos = tl.render(scene, rig, lens, spp=64)
    balls = (replace(virtual.ball(place, glow), material="black"), virtual.ball(place, 1.0))
    mixed, covered = virtual.insert(photos, rig, lens, virtual.room_meshes(scene, rig), balls, spp=64)
    dull = {"type": "diffuse", "reflectance": Color((0.0, 0.0, 0.0))}
    there = replace(
        scene,
        objects=(*scene.objects, replace(virtual.ball(place, glow), material="dull")),
        materials={**scene.materials, "dull": dull},
    )
    for i, real in enumerate(tl.render(there, rig, lens, spp=64)):
        share = covered[i][..., 0]
        assert 0.98 < share.max() < 1.02
        full = share > 0.99
        assert full.sum() > 50
        assert np.abs(mixed[i][full] - real[full]).mean() < 1e-3
        rim = (share > 0.02) & ~full
        assert rim.sum() > 30  # the lens blurs its edge
        before, after = (np.abs(image - real).mean(axis=2) for image in (photos[i], mixed[i]))
        assert np.median(after[rim]) < 0.3 * np.median(before[rim])
        assert after[share > 0.02].mean() < 0.4 * before[share > 0.02].mean()
    disk = np.pi * (rig.cameras[0].fx * virtual.RADIUS / virtual.DEPTH) ** 2
    assert covered[0][..., 0].sum() < 0.85 * disk  # the jug occludes a part of it


@pytest.mark.slow
def test_an_object_is_captured_from_all_sides():
    capture = example("capture")
    made = capture.capture(count=12, width=128, spp=8, cell=0.015)
    assert made.found.accuracy_mean_mm < 8
    assert made.found.completeness_mean_mm < 8
    assert next(s for s in made.found.shares if s.tolerance_mm == 20).f_score > 0.85
    size = made.surface.vertices.max(axis=0) - made.surface.vertices.min(axis=0)
    assert (np.abs(size[:2] - capture.SIZE * 1.1) < 0.15).all()
    assert capture.picture(made).size == (384, 256)
