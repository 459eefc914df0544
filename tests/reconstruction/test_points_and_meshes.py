"""Points and meshes of one depth map: positions, colours, discontinuities, and files."""

import numpy as np
import pytest
import trimesh

import twinlens as tl
from twinlens.camera import BrownConrady, Camera, Rig
from twinlens.camera.layouts import toed_in
from twinlens.errors import InputError
from twinlens.geometry import look_at
from twinlens.reconstruction import mesh_of, points_of, view_of_disparity
from twinlens.reconstruction.picture import orbit, splat
from twinlens.reconstruction.surface import (
    Cloud,
    DepthView,
    Surface,
    sampled,
    view_of_truth,
    write_glb,
    write_ply,
)

POSE = look_at([1.0, -2.0, 1.5], [0.2, 3.0, 1.0])
CAMERA = Camera(40, 30, 45.0, 44.0, 18.5, 15.25, BrownConrady(-0.1, 0.02))
EPS = float(np.finfo(np.float32).eps)


def view(depth, **changes):
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
    return DepthView(CAMERA.replace(**changes), POSE, depth, image)


def test_points_of_true_disparity_are_on_the_surface_within_float32_rounding():
    """The relative error of z is that of d = fB/z, half a unit in the last place, and slightly more with doffs."""
    scene = tl.load_scene("cards")
    left = Camera(96, 72, 105.0, 105.0, 47.5, 35.5)
    rig = Rig.stereo(left, 0.1, scene.world_from_left, right=left.replace(cx=48.75))
    truth = tl.ground_truth(scene, rig)[0]
    view_of_pair = view_of_disparity(truth.disparity, rig)
    hit = truth.hit
    assert hit.mean() > 0.9
    off = np.linalg.norm(view_of_pair.positions()[hit] - truth.position[hit], axis=1)
    ray = np.linalg.norm(truth.position[hit] - scene.world_from_left[:3, 3], axis=1)
    disparity = truth.disparity[hit].astype(float)
    assert (
        off <= 0.51 * EPS * ray * np.abs(disparity) / (disparity + rig.doffs()) + 1e-12
    ).all()
    assert (
        off.max() > 0.05 * EPS * ray.max()
    )  # it is float32 that limits, and nothing else


def test_points_project_to_their_pixels_and_have_their_colours():
    depth = np.random.default_rng(1).uniform(1, 3, (30, 40))
    depth[3:6, 10:20] = np.inf
    one = view(depth)
    cloud = points_of(one)
    assert len(cloud) == 30 * 40 - 30
    assert (
        np.abs(one.rig.project(0, cloud.points) - CAMERA.pixel_grid()[one.known]).max()
        < 1e-9
    )
    assert np.array_equal(cloud.colors, one.image[one.known])
    assert np.isposinf(one.positions()[4, 12]).all()


def plane_depth(camera, normal, offset):
    """Depths of the plane normal . X = offset in the camera's frame."""
    return offset / (camera.unproject(camera.pixel_grid()) @ np.asarray(normal))


def test_a_plane_gives_all_triangles_facing_the_camera():
    one = view(plane_depth(CAMERA, [0.3, -0.2, 1.0], 2.0))
    mesh = mesh_of(one)
    assert len(mesh.faces) == 2 * 29 * 39
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    normal = POSE[:3, :3] @ (
        np.array([-0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    )
    assert np.allclose(solid.face_normals, normal, atol=1e-6)
    assert np.array_equal(mesh.colors, one.image.reshape(-1, 3))


def test_no_triangles_across_discontinuities_and_unknown_depths():
    depth = np.full((30, 40), 2.0)
    depth[:, 20:] = 3.0
    depth[10, 5] = np.inf
    mesh = mesh_of(view(depth))
    assert (
        len(mesh.faces) == 2 * 29 * 38 - 6
    )  # one column of cells, and the six triangles at one pixel
    side = np.linalg.norm(
        mesh.vertices[mesh.faces] - np.roll(mesh.vertices[mesh.faces], 1, axis=1),
        axis=2,
    )
    assert side.max() < 0.2
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)


def test_a_step_is_cut_beyond_the_angle():
    footprint = 2.0 / 45.0
    depth = np.full((30, 40), 2.0)
    depth[:, 20:] += 5 * footprint  # about 79 degrees
    assert len(mesh_of(view(depth, distortion=None), 84).faces) == 2 * 29 * 39
    assert len(mesh_of(view(depth, distortion=None), 70).faces) == 2 * 29 * 38


@pytest.mark.parametrize("make", [points_of, mesh_of])
def test_files_are_read_by_trimesh(make, tmp_path):
    shape = make(view(np.random.default_rng(2).uniform(1, 1.1, (30, 40))))
    points = shape.points if isinstance(shape, Cloud) else shape.vertices
    write_ply(tmp_path / "a.ply", shape)
    back = trimesh.load(tmp_path / "a.ply", process=False)
    assert np.abs(back.vertices - points).max() <= EPS * np.abs(points).max()
    colors = back.colors if isinstance(shape, Cloud) else back.visual.vertex_colors
    assert np.array_equal(np.asarray(colors)[:, :3], shape.colors)
    write_glb(tmp_path / "a.glb", shape, POSE)
    (back,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    assert (back.vertices[:, 2] < 0).all()  # before a viewer who looks along -z
    x, y = (points - POSE[:3, 3]) @ POSE[:3, 0], (points - POSE[:3, 3]) @ POSE[:3, 1]
    assert np.abs(back.vertices[:, 0] - x).max() < 1e-5
    assert np.abs(back.vertices[:, 1] + y).max() < 1e-5


@pytest.mark.parametrize("make", [points_of, mesh_of])
@pytest.mark.parametrize("with_colors", [True, False])
def test_files_are_exact_far_from_the_origin(make, with_colors, tmp_path):
    """At UTM coordinates, float32 is off by 0.25 m."""
    place = np.eye(4)
    place[:3, 3] = 408201.5848, 4080928.0166, 31.4
    depth = np.random.default_rng(2).uniform(1, 1.1, (30, 40))
    image = np.zeros((30, 40, 3), np.uint8) + 7 if with_colors else None
    shape = make(DepthView(CAMERA, place @ POSE, depth, image))
    points = shape.points if isinstance(shape, Cloud) else shape.vertices
    write_ply(tmp_path / "a.ply", shape)
    back = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(back.vertices, points)
    if isinstance(shape, Surface):
        np.testing.assert_array_equal(back.faces, shape.faces)
    if with_colors:
        colors = back.colors if isinstance(shape, Cloud) else back.visual.vertex_colors
        assert (np.asarray(colors)[:, :3] == 7).all()
    write_glb(tmp_path / "a.glb", shape)
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    (node,) = scene.graph.nodes_geometry
    world_from_node, name = scene.graph[node]
    vertices = trimesh.transform_points(scene.geometry[name].vertices, world_from_node)
    x, y, z = points.T
    np.testing.assert_allclose(vertices, np.stack([x, z, -y], 1), rtol=0, atol=1e-6)


def test_a_view_of_truth_has_its_depth_and_an_8_bit_image():
    scene = tl.load_scene("cards")
    rig = toed_in(
        Camera(24, 18, 26.0, 26.0, 11.5, 8.5), 0.2, 1.5, scene.world_from_left
    )
    truth = tl.ground_truth(scene, rig)[1]
    one = view_of_truth(truth, rig, 1, np.full((18, 24), 7 << 8, np.uint16))
    assert np.abs(one.positions() - truth.position)[truth.hit].max() < 1e-12
    assert (one.image == 7).all()
    assert one.image.shape == (18, 24, 3)


FLAT = np.full((30, 40), 2.0)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: view(np.where(FLAT > 1, np.nan, 0)), "NaN"),
        (lambda: view(FLAT[1:]), "needs depth"),
        (
            lambda: view_of_disparity(FLAT, toed_in(CAMERA, 0.3, 2.0)),
            "rectify them first",
        ),
        (lambda: mesh_of(view(FLAT), 90), "max_angle_deg"),
        (lambda: Cloud(np.array([[np.inf, 0, 0]])), "finite"),
        (lambda: Cloud(np.zeros((2, 3)), np.zeros((1, 3), np.uint8)), "colours"),
        (lambda: Surface(np.zeros((2, 3)), np.array([[0, 1, 2]])), "vertex 2"),
    ],
)
def test_invalid_input_raises(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_samples_are_uniform_on_the_triangles_with_interpolated_colours():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
    colors = np.array([[0, 0, 0], [200, 0, 0], [0, 200, 0], [200, 200, 0]], np.uint8)
    cloud = sampled(Surface(corners, np.array([[0, 1, 2], [1, 3, 2]]), colors), 0.02)
    assert len(cloud) == 1250 + 2166
    flat = cloud.points[:1250]
    assert (flat[:, 2] == 0).all()
    assert (flat[:, :2].sum(axis=1) <= 1 + 1e-12).all()
    assert np.allclose(flat.mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.03)
    assert np.abs(cloud.colors[:, :2] - 200 * cloud.points[:, :2]).max() <= 0.5 + 1e-9
    with pytest.raises(InputError, match="wider spacing"):
        sampled(Surface(corners, np.array([[0, 1, 2]])), 1e-5)


def test_splatted_points_are_at_their_projections_and_occlude_farther_ones():
    camera = Camera(40, 30, 45.0, 45.0, 19.5, 14.5)
    points = np.array([[0.0, 0, 3], [0.0, 0, 2], [0.5, 0.2, 2]])
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]], np.uint8)
    for order in ([0, 1, 2], [1, 0, 2]):
        picture = splat(Cloud(points[order], colors[order]), camera, np.eye(4), 2)
        assert (picture[14:16, 19:21] == [0, 255, 0]).all()
        u, v = camera.project(points[2])
        assert (picture[round(v), round(u)] == [0, 0, 255]).all()
        assert (picture == 255).all(axis=2).sum() == 40 * 30 - 8
    carried = orbit(POSE, [0.2, 3.0, 1.0], 30.0, 10.0)
    target = np.linalg.inv(carried)[:3] @ [0.2, 3.0, 1.0, 1]
    distance = np.linalg.norm(POSE[:3, 3] - [0.2, 3.0, 1.0])
    np.testing.assert_allclose(target, [0, 0, distance], atol=1e-9)
