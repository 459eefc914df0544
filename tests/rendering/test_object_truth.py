"""What objects cover of an image, also where they are hidden, beside closed forms and reprojected meshes."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

import twinlens as tl
from twinlens import geometry, rendering
from twinlens.camera import BrownConrady, KannalaBrandt
from twinlens.scenes import Color, Scene, SceneObject, shapes

GREY = {"grey": {"type": "diffuse", "reflectance": Color((0.5, 0.5, 0.5))}}
CAMERA = tl.Camera(96, 72, 80.0, 76.0, 46.5, 35.25)
LARGE = CAMERA.replace(width=288, height=216, fx=260.0, fy=255.0, cx=143.0, cy=108.0)
TURNED = geometry.look_at([0.3, -2.0, 1.1], [0.1, 2.0, 0.7])


def view(objects, camera=CAMERA, pose=TURNED):
    """The left view of objects placed in the camera's frame."""
    placed = tuple(
        replace(each, instances=tuple(pose @ copy for copy in each.instances))
        if each.instances
        else replace(each, world_from_object=pose @ each.world_from_object)
        for each in objects
    )
    scene = Scene(
        "test", placed, GREY, pose, (0.5, 10.0), lights={"sky": {"type": "constant"}}
    )
    rig = tl.Rig.stereo(camera, 0.1, world_from_left=pose)
    return tl.ground_truth(scene, rig)[0], scene, rig


def thing(name, shape, at=(0, 0, 0), linear=None, instances=()):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.eye(3) if linear is None else linear, at
    return SceneObject(name, shape, "grey", pose, instances=instances)


def wide_grid(camera):
    """Pixel centres of a frame of three times the image's size, centred on it."""
    v, u = np.mgrid[
        -camera.height : 2 * camera.height, -camera.width : 2 * camera.width
    ]
    return np.stack([u, v], axis=-1).astype(float)


def ball_mask(camera, centre, radius):
    rays = camera.unproject(wide_grid(camera))
    along = rays @ centre
    return (along > 0) & (along**2 >= (rays**2).sum(-1) * (centre @ centre - radius**2))


def in_image(mask, camera):
    return mask[camera.height : 2 * camera.height, camera.width : 2 * camera.width]


def bounds(mask, camera):
    v, u = np.nonzero(mask)
    return (
        u.min() - camera.width,
        v.min() - camera.height,
        np.ptp(u) + 1,
        np.ptp(v) + 1,
    )


def proper(seed):
    """A rotation matrix."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def painted(truth, each, mesh, camera, factor=8):
    """Where OpenCV paints the mesh in its pose: eight times finer, sampled at pixel centres."""
    points = geometry.transform_points(each.cam_from_object, mesh[0])
    pixels = camera.project(points)
    canvas = np.zeros((camera.height * factor, camera.width * factor), np.uint8)
    for triangle in pixels[mesh[1]]:
        cv2.fillConvexPoly(
            canvas, np.rint(triangle * factor * 16).astype(np.int32), 255, shift=4
        )
    return canvas[::factor, ::factor] > 0


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        CAMERA.replace(distortion=BrownConrady(k1=-0.12, p1=0.004)),
        CAMERA.replace(distortion=KannalaBrandt(k1=0.03)),
    ],
    ids=["pinhole", "Brown-Conrady", "Kannala-Brandt"],
)
def test_balls_cover_their_closed_form_also_where_hidden_and_outside(camera):
    balls = {
        "front": ((0.05, 0.0, 2.0), 0.3),
        "behind": ((0.2, 0.1, 3.0), 0.5),
        "left": ((-1.2, 0.0, 2.2), 0.35),
    }
    truth, _, _ = view(
        [
            thing(name, {"type": "sphere", "radius": r}, at)
            for name, (at, r) in balls.items()
        ],
        camera,
    )
    assert [truth.object_name(each) for each in truth.objects] == [*balls]
    for each, (at, radius) in zip(truth.objects, balls.values(), strict=True):
        whole = ball_mask(camera, np.array(at), radius)
        # float32 rays decide pixels within 1e-3 px of the edge.
        assert abs(each.pixel_count - whole.sum()) <= 1
        assert np.count_nonzero(truth.silhouette(each) != in_image(whole, camera)) <= 1
        np.testing.assert_allclose(each.box, bounds(whole, camera), atol=1)
        np.testing.assert_allclose(each.cam_from_object[:3, 3], at, atol=1e-12)
        np.testing.assert_allclose(
            each.extent, [[-radius] * 3, [radius] * 3], atol=1e-12
        )
    front, behind, left = truth.objects
    assert front.visible_fraction == 1
    hidden = in_image(ball_mask(camera, np.array(balls["behind"][0]), 0.5), camera)
    hidden &= in_image(ball_mask(camera, np.array(balls["front"][0]), 0.3), camera)
    assert abs(behind.pixel_count - behind.visible_pixel_count - hidden.sum()) <= 1
    assert 0.2 < behind.visible_fraction < 0.95
    assert left.box[0] < 0
    assert left.visible_box[0] == 0
    assert 0.2 < left.visible_fraction < 0.95


def test_a_box_behind_another_one_covers_its_projected_faces():
    front = thing("front", shapes.box(np.array([0.5, 0.4, 0.1])), (0.0, 0.0, 1.5))
    behind = thing(
        "behind", shapes.box(np.array([0.6, 0.3, 0.3])), (0.1, 0.05, 2.5), proper(1)
    )
    truth, _, _ = view([front, behind])
    each = truth.objects[1]
    corners = np.array(list(itertools.product(*each.extent.T)))
    np.testing.assert_allclose(
        each.extent, np.array([[-0.3, -0.15, -0.15], [0.3, 0.15, 0.15]]), atol=1e-12
    )
    np.testing.assert_allclose(
        each.corners_px,
        CAMERA.project(geometry.transform_points(each.cam_from_object, corners)),
        atol=1e-9,
    )
    hull = cv2.convexHull(
        each.corners_px.astype(np.float32)
    )  # the silhouette of a convex body
    grid = CAMERA.pixel_grid().reshape(-1, 2)
    distance = np.array(
        [cv2.pointPolygonTest(hull, point, True) for point in grid.tolist()]
    ).reshape(72, 96)
    mask, sure = truth.silhouette(each), np.abs(distance) > 1e-3
    np.testing.assert_array_equal(mask[sure], (distance > 0)[sure])
    assert 0.05 < each.visible_fraction < 0.6
    np.testing.assert_array_equal((truth.object_id == 2) & ~mask, False)


def test_a_body_that_is_hidden_completely_is_listed():
    wall = thing("wall", {"type": "rectangle"}, (0, 0, 1.0), np.diag([4.0, 4.0, 1.0]))
    truth, _, _ = view(
        [wall, thing("ball", {"type": "sphere", "radius": 0.2}, (0, 0, 2.0))]
    )
    ball = truth.objects[1]
    assert (ball.visible_pixel_count, ball.visible_box, ball.visible_fraction) == (
        0,
        (0, 0, 0, 0),
        0.0,
    )
    assert ball.pixel_count > 100


def test_bodies_outside_the_image_are_left_out_and_those_around_the_camera_are_counted_in_it():
    around = thing("around", {"type": "cube"}, (0, 0, 1.0), np.diag([5.0, 5.0, 5.0]))
    away = thing("away", {"type": "sphere", "radius": 0.1}, (3.0, 0, 2.0))
    back = thing("back", {"type": "sphere", "radius": 0.1}, (0, 0, -2.0))
    truth, _, _ = view([around, away, back])
    (each,) = truth.objects
    assert each.object_id == 1
    assert each.box == (0, 0, 96, 72)
    assert each.pixel_count == each.visible_pixel_count == 96 * 72
    assert np.isinf(each.corners_px).any()
    assert np.isfinite(each.corners_px).any()


SHAPES = {
    "bunched mesh": shapes.lathe(
        np.array([[0, 0], [0.3, 0.1], [0.1, 0.5], [0.2, 0.7], [0, 0.8]]), 48
    ),
    "box": shapes.box(np.array([0.4, 0.6, 0.2])),
    "ball": {"type": "sphere", "center": (0.1, 0.0, 0.2), "radius": 0.4},
    "tube": {
        "type": "cylinder",
        "p0": (0.0, 0.1, 0.0),
        "p1": (0.3, 0.2, 0.6),
        "radius": 0.2,
    },
    "disk": {"type": "disk"},
    "rectangle": {"type": "rectangle"},
    "cube": {"type": "cube"},
}
PLACES = {
    "turned": (proper(2), ()),
    "scaled": (0.7 * proper(3), ()),
    "mirrored": (-0.7 * proper(4), ()),
    "copies": (
        0.8 * proper(5),
        (
            geometry.rigid(proper(6), [-0.3, 0, 0.2]),
            geometry.rigid(proper(7), [0.4, 0.1, 0.5]),
        ),
    ),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", SHAPES)
def test_poses_reproject_the_models_onto_the_masks(name, place):
    linear, copies = PLACES[place]
    at = (0, 0, 2.0)
    copies = tuple(geometry.rigid(np.eye(3), at) @ copy for copy in copies)
    objects = [thing(name, SHAPES[name], (0, 0, 0) if copies else at, linear, copies)]
    truth, scene, _ = view(objects, LARGE)
    models = rendering.object_models(scene)
    assert len(truth.objects) == max(1, len(copies))
    assert len(models) == len({each.model for each in truth.objects}) == 1
    for each in truth.objects:
        ours = painted(truth, each, models[each.model], LARGE)
        mask = truth.silhouette(each)
        assert (ours & mask).sum() / (ours | mask).sum() >= 0.99
        vertices = models[each.model][0]
        np.testing.assert_allclose(
            each.extent, [vertices.min(axis=0), vertices.max(axis=0)], atol=1e-12
        )


def test_stretched_meshes_have_rigid_poses_and_stretched_models():
    stretch = np.diag([0.5, 1.5, 0.8])
    truth, _, _ = view([thing("mesh", SHAPES["box"], (0, 0, 2.5), proper(8) @ stretch)])
    (each,) = truth.objects
    np.testing.assert_allclose(each.cam_from_object[:3, :3], proper(8), atol=1e-9)
    np.testing.assert_allclose(np.ptp(each.extent, axis=0), [0.2, 0.9, 0.16], atol=1e-9)


def test_the_same_mesh_has_the_same_model_in_every_pose_and_another_one_in_another_size():
    def models(linear):
        return [
            each.model
            for each in view(
                [thing("mesh", SHAPES["bunched mesh"], (0, 0, 2.5), linear)]
            )[0].objects
        ]

    assert (
        models(proper(1))
        == models(proper(2))
        == models(np.eye(3))
        != models(2 * proper(1))
    )
    assert models(0.7 * proper(1)) == models(0.7 * proper(2))


def test_objects_can_be_left_out():
    _, scene, rig = view([thing("ball", {"type": "sphere"}, (0, 0, 4.0))])
    plain = tl.ground_truth(scene, rig, objects=False)
    assert plain[0].objects == ()
    completed = rendering.with_object_truth(scene, rig, plain)
    assert [each.model for each in completed[1].objects] == [
        each.model for each in tl.ground_truth(scene, rig)[1].objects
    ]


def test_shapes_of_a_mitsuba_file_have_the_worlds_axes(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="50"/></sensor>
        <emitter type="constant"/>
        <shape type="sphere"><point name="center" x="0.1" y="0" z="3"/><float name="radius" value="0.5"/></shape>
        <shape type="cube">
            <transform name="to_world"><scale value="0.2"/><translate z="1.5" x="0.3"/></transform>
        </shape>
        </scene>"""
    )
    scene = tl.load_scene(path)
    rig = tl.Rig.stereo(LARGE, 0.1, world_from_left=np.eye(4))
    truth = tl.ground_truth(scene, rig)[0]
    models = rendering.object_models(scene)
    for each in truth.objects:
        ours, mask = (
            painted(truth, each, models[each.model], LARGE),
            truth.silhouette(each),
        )
        assert (ours & mask).sum() / (ours | mask).sum() >= 0.99
    assert (
        abs(
            truth.objects[0].pixel_count
            - ball_mask(LARGE, np.array([0.1, 0, 3.0]), 0.5).sum()
        )
        <= 1
    )


def test_an_object_of_several_materials_is_one_object():
    two = GREY | {"dark": {"type": "diffuse", "reflectance": Color((0.1, 0.1, 0.1))}}
    mesh = SHAPES["box"]
    parts = replace(mesh, surface=np.arange(len(mesh.faces), dtype=np.uint32) % 2)
    pose = geometry.rigid(proper(1), (0, 0, 2.0))
    rig = tl.Rig.stereo(CAMERA, 0.1, world_from_left=np.eye(4))
    found = []
    for each in (
        SceneObject("box", mesh, "grey", pose),
        SceneObject("box", parts, ("grey", "dark"), pose),
    ):
        scene = Scene(
            "test",
            (each,),
            two,
            np.eye(4),
            (0.5, 10.0),
            lights={"sky": {"type": "constant"}},
        )
        found.append(tl.ground_truth(scene, rig)[0].objects)
    (whole,), (joined,) = found
    for name in (
        "object_id",
        "model",
        "silhouette",
        "pixel_count",
        "box",
        "visible_pixel_count",
        "visible_box",
    ):
        assert getattr(joined, name) == getattr(whole, name)
