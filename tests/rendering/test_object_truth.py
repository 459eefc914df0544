"""What objects cover of an image, also where they are hidden, beside closed forms and reprojected meshes."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.rendering.rendering_cases import pose
from twinlens import geometry, rendering
from twinlens.camera import BrownConrady, KannalaBrandt
from twinlens.scenes import Color, Scene, SceneObject, shapes

CAMERA = tl.Camera(96, 72, 80.0, 76.0, 46.5, 35.25)
LARGE = CAMERA.replace(width=288, height=216, fx=260.0, fy=255.0, cx=143.0, cy=108.0)
TURNED = geometry.look_at([0.3, -2.0, 1.1], [0.1, 2.0, 0.7])
MATERIALS = {
    "grey": {"type": "diffuse", "reflectance": Color((0.5, 0.5, 0.5))},
    "dark": {"type": "diffuse", "reflectance": Color((0.1, 0.1, 0.1))},
}


def rotation(seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def placed_object(name, shape, at=(0, 0, 0), linear=1.0, instances=()):
    """An object in the camera's frame."""
    placed = pose(np.eye(3) * linear if np.ndim(linear) == 0 else linear, at)
    return SceneObject(name, shape, "grey", placed, instances=instances)


def ball(name, at, radius):
    return placed_object(name, {"type": "sphere", "radius": radius}, at)


def view(*objects, camera=CAMERA):
    """The left view of objects, its scene and its rig."""
    placed = []
    for item in objects:
        if item.instances:
            copies = tuple(TURNED @ copy for copy in item.instances)
            placed.append(replace(item, instances=copies))
        else:
            moved = TURNED @ item.world_from_object
            placed.append(replace(item, world_from_object=moved))
    lights = {"sky": {"type": "constant"}}
    scene = Scene("test", tuple(placed), MATERIALS, TURNED, (0.5, 10.0), lights=lights)
    rig = tl.Rig.stereo(camera, 0.1, world_from_left=TURNED)
    return tl.ground_truth(scene, rig)[0], scene, rig


def bodies_of(*objects):
    return view(*objects)[0].objects


def ball_mask(camera, centre, radius):
    """Which pixels of a frame of three times the image's size, centred on it, a ball covers."""
    height = camera.height
    width = camera.width
    v, u = np.mgrid[-height : 2 * height, -width : 2 * width]
    rays = camera.unproject(np.stack([u, v], axis=-1).astype(float))
    along = rays @ centre
    past = (rays**2).sum(-1) * (np.dot(centre, centre) - radius**2)
    return (along > 0) & (along**2 >= past)


def in_image(mask, camera):
    return mask[camera.height : 2 * camera.height, camera.width : 2 * camera.width]


def bounds(mask, camera):
    v, u = np.nonzero(mask)
    corner = u.min() - camera.width, v.min() - camera.height
    return *corner, np.ptp(u) + 1, np.ptp(v) + 1


BALLS = {
    "front": ((0.05, 0.0, 2.0), 0.3),
    "behind": ((0.2, 0.1, 3.0), 0.5),
    "left": ((-1.2, 0.0, 2.2), 0.35),
}


@pytest.mark.parametrize(
    "distortion", [None, BrownConrady(k1=-0.12, p1=0.004), KannalaBrandt(k1=0.03)]
)
def test_balls_cover_their_closed_form_also_where_hidden_and_outside(distortion):
    """Rays in float32 decide pixels within 1e-3 px of the edge."""
    camera = CAMERA.replace(distortion=distortion)
    truth, _, _ = view(
        *(ball(name, *row) for name, row in BALLS.items()), camera=camera
    )
    assert [truth.object_name(body) for body in truth.objects] == [*BALLS]
    masks = {name: ball_mask(camera, *row) for name, row in BALLS.items()}
    for body, (name, whole) in zip(truth.objects, masks.items(), strict=True):
        at, radius = BALLS[name]
        assert abs(body.pixel_count - whole.sum()) <= 1
        differs = truth.silhouette(body) != in_image(whole, camera)
        assert np.count_nonzero(differs) <= 1
        np.testing.assert_allclose(body.box, bounds(whole, camera), atol=1)
        np.testing.assert_allclose(body.cam_from_object[:3, 3], at, atol=1e-12)
        extent = [[-radius] * 3, [radius] * 3]
        np.testing.assert_allclose(body.extent, extent, atol=1e-12)
    front, behind, left = truth.objects
    hidden = in_image(masks["behind"] & masks["front"], camera)
    lost = behind.pixel_count - behind.visible_pixel_count
    assert abs(lost - hidden.sum()) <= 1
    assert front.visible_fraction == 1
    for body in (behind, left):
        assert 0.2 < body.visible_fraction < 0.95
    assert left.box[0] < 0
    assert left.visible_box[0] == 0


def test_a_box_behind_another_one_has_its_projected_corners():
    size = np.array([0.6, 0.3, 0.3])
    truth, _, _ = view(
        placed_object("front", shapes.box(np.array([0.5, 0.4, 0.1])), (0.0, 0.0, 1.5)),
        placed_object("behind", shapes.box(size), (0.1, 0.05, 2.5), rotation(1)),
    )
    box = truth.objects[1]
    np.testing.assert_allclose(box.extent, [-size / 2, size / 2], atol=1e-12)
    corners = np.array(list(itertools.product(*box.extent.T)))
    in_camera = geometry.transform_points(box.cam_from_object, corners)
    np.testing.assert_allclose(box.corners_px, CAMERA.project(in_camera), atol=1e-9)
    mask = truth.silhouette(box)
    assert 0.05 < box.visible_fraction < 0.6
    assert not ((truth.object_id == 2) & ~mask).any()


def test_a_body_that_is_hidden_completely_is_listed():
    wall = placed_object(
        "wall", {"type": "rectangle"}, (0, 0, 1.0), np.diag([4.0, 4.0, 1.0])
    )
    hidden = bodies_of(wall, ball("ball", (0, 0, 2.0), 0.2))[1]
    assert hidden.visible_pixel_count == hidden.visible_fraction == 0
    assert hidden.visible_box == (0, 0, 0, 0)
    assert hidden.pixel_count > 100


def test_bodies_outside_the_image_are_left_out_and_those_around_the_camera_are_counted_in_it():
    around = placed_object("around", {"type": "cube"}, (0, 0, 1.0), 5.0)
    away = ball("away", (3.0, 0, 2.0), 0.1)
    back = ball("back", (0, 0, -2.0), 0.1)
    (room,) = bodies_of(around, away, back)
    assert room.object_id == 1
    assert room.box == (0, 0, 96, 72)
    assert room.pixel_count == room.visible_pixel_count == 96 * 72
    assert np.isinf(room.corners_px).any()
    assert np.isfinite(room.corners_px).any()


PROFILE = np.array([[0, 0], [0.3, 0.1], [0.1, 0.5], [0.2, 0.7], [0, 0.8]])
ENDS = {"p0": (0.0, 0.1, 0.0), "p1": (0.3, 0.2, 0.6), "radius": 0.2}
SHAPES = {
    "bunched mesh": shapes.lathe(PROFILE, 48),
    "box": shapes.box(np.array([0.4, 0.6, 0.2])),
    "ball": {"type": "sphere", "center": (0.1, 0.0, 0.2), "radius": 0.4},
    "tube": {"type": "cylinder", **ENDS},
    "disk": {"type": "disk"},
    "rectangle": {"type": "rectangle"},
    "cube": {"type": "cube"},
}
COPIES = (
    geometry.rigid(rotation(6), [-0.3, 0, 2.2]),
    geometry.rigid(rotation(7), [0.4, 0.1, 2.5]),
)
PLACES = {
    "turned": (rotation(2), ()),
    "scaled": (0.7 * rotation(3), ()),
    "mirrored": (-0.7 * rotation(4), ()),
    "copies": (0.8 * rotation(5), COPIES),
}


@pytest.mark.parametrize("place", PLACES)
def test_poses_reproject_the_models_onto_the_masks(place):
    linear, copies = PLACES[place]
    at = (0, 0, 0) if copies else (0, 0, 2.0)
    for name, shape in SHAPES.items():
        item = placed_object(name, shape, at, linear, copies)
        truth, scene, _ = view(item, camera=LARGE)
        assert len(truth.objects) == max(1, len(copies))
        assert len(rendering.object_models(scene)) == 1
        assert_reprojected(truth, scene)


def assert_reprojected(truth, scene):
    """The models, painted by OpenCV in their poses, cover the silhouettes."""
    models = rendering.object_models(scene)
    for body in truth.objects:
        vertices, faces = models[body.model]
        of_model = painted(body, vertices, faces, LARGE)
        mask = truth.silhouette(body)
        assert (of_model & mask).sum() / (of_model | mask).sum() >= 0.99
        extent = [vertices.min(axis=0), vertices.max(axis=0)]
        np.testing.assert_allclose(body.extent, extent, atol=1e-12)


def painted(body, vertices, faces, camera, factor=8):
    """Where OpenCV paints the mesh in its pose: eight times finer, sampled at pixel centres."""
    points = geometry.transform_points(body.cam_from_object, vertices)
    pixels = np.rint(camera.project(points) * factor * 16).astype(np.int32)
    canvas = np.zeros((camera.height * factor, camera.width * factor), np.uint8)
    for triangle in pixels[faces]:
        cv2.fillConvexPoly(canvas, triangle, 255, shift=4)
    return canvas[::factor, ::factor] > 0


def test_stretched_meshes_have_rigid_poses_and_stretched_models():
    stretched = rotation(8) @ np.diag([0.5, 1.5, 0.8])
    (body,) = bodies_of(placed_object("mesh", SHAPES["box"], (0, 0, 2.5), stretched))
    np.testing.assert_allclose(body.cam_from_object[:3, :3], rotation(8), atol=1e-9)
    np.testing.assert_allclose(np.ptp(body.extent, axis=0), [0.2, 0.9, 0.16], atol=1e-9)


def test_the_same_mesh_has_the_same_model_in_every_pose_and_another_one_in_another_size():
    def model(linear):
        (body,) = bodies_of(
            placed_object("m", SHAPES["bunched mesh"], (0, 0, 2.5), linear)
        )
        return body.model

    assert model(rotation(1)) == model(rotation(2)) == model(1.0)
    assert model(0.7 * rotation(1)) == model(0.7 * rotation(2))
    assert model(rotation(1)) != model(2 * rotation(1))


XML = """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="50"/></sensor>
<emitter type="constant"/>
<shape type="sphere"><point name="center" x="0.1" y="0" z="3"/><float name="radius" value="0.5"/></shape>
<shape type="cube">
    <transform name="to_world"><scale value="0.2"/><translate z="1.5" x="0.3"/></transform>
</shape>
</scene>"""


def test_shapes_of_a_mitsuba_file_have_the_worlds_axes(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    scene = tl.load_scene(path)
    truth = tl.ground_truth(scene, tl.Rig.stereo(LARGE, 0.1))[0]
    assert_reprojected(truth, scene)
    whole = ball_mask(LARGE, (0.1, 0, 3.0), 0.5)
    assert abs(truth.objects[0].pixel_count - whole.sum()) <= 1


def test_an_object_of_several_materials_is_one_object():
    mesh = SHAPES["box"]
    surface = np.arange(len(mesh.faces), dtype=np.uint32) % 2
    whole = placed_object("box", mesh, (0, 0, 2.0), rotation(1))
    two_paints = {"shape": replace(mesh, surface=surface), "material": ("grey", "dark")}
    (body,), (joined,) = bodies_of(whole), bodies_of(replace(whole, **two_paints))
    names = "object_id model silhouette pixel_count box visible_pixel_count visible_box"
    for name in names.split():
        assert getattr(joined, name) == getattr(body, name)
