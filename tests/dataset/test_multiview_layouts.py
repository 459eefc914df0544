"""Exports of many views, opened by the programs that read them: pycolmap."""

import shutil

import numpy as np
import pycolmap
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset import turning_scene as scene
from tests.dataset.dataset_scene import (
    cast as cast_pair,
    edited,
    sample as pair_sample,
    stored,
)
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.dataset import open_sample
from twinlens.dataset.export import export
from twinlens.dataset.poses import read_colmap, write_colmap
from twinlens.dataset.tracks import find_tracks
from twinlens.errors import FileError, InputError
from twinlens.geometry import inverse, transform_points

PLAIN = Camera(64, 48, 60.0, 58.0, 31.0, 24.5)
CAMERAS = {
    "PINHOLE": PLAIN,
    "OPENCV": PLAIN.replace(distortion=BrownConrady(-0.1, 0.02, 1e-3, -2e-3)),
    "FULL_OPENCV": PLAIN.replace(
        distortion=BrownConrady(-0.1, 0.02, 1e-3, -2e-3, 0.003, 0.05, -0.01, 0.002)
    ),
    "OPENCV_FISHEYE": PLAIN.replace(distortion=KannalaBrandt(0.05, -0.02, 0.01, -1e-3)),
}
RIG = scene.ring([*CAMERAS.values(), PLAIN])
PLAIN_RIG = scene.ring([PLAIN] * 6)


BENT, FLAT = scene.sample(RIG), scene.sample(PLAIN_RIG)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    return [stored(folder / "bent", BENT), stored(folder / "plain", FLAT)]


@pytest.fixture(scope="module")
def colmap(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("colmap") / "out"
    export(data, out, "colmap")
    return out


def tracks_of(made, **options):
    images = made.shots[0].images
    truth, image = made.truths.__getitem__, images.__getitem__
    return find_tracks(made.rig, truth, image, **options)


def read_text(folder):
    model = pycolmap.Reconstruction()
    model.read_text(folder)
    return model


def read_binary(folder):
    model = pycolmap.Reconstruction()
    model.read_binary(folder)
    return model


def observations(model):
    """(point, view, pixel from the image's corner) of every element of every track."""
    for point in model.points3D.values():
        for element in point.track.elements:
            image = model.images[element.image_id]
            xy = image.points2D[element.point2D_idx].xy
            yield point, element.image_id - 1, xy


@pytest.mark.parametrize("read", [read_text, read_binary])
def test_pycolmap_has_the_cameras_and_poses(colmap, read):
    folder = colmap / "bent" / "sparse"
    model = read(folder if read is read_text else folder / "0")
    assert len(model.cameras) == len(CAMERAS)  # the fifth image has the first camera
    for view, camera in enumerate(RIG.cameras):
        image = model.images[view + 1]
        assert image.name == f"im{view}.png"
        expected = list(CAMERAS)[view % len(CAMERAS)]
        assert model.cameras[image.camera_id].model.name == expected
        assert (model.cameras[image.camera_id].width, camera.height) == (64, 48)
        cam_from_world = image.cam_from_world().matrix()
        assert_allclose(
            cam_from_world, inverse(RIG.world_from_cams[view])[:3], atol=1e-12
        )


@pytest.mark.parametrize("read", [read_text, read_binary])
def test_pycolmap_projects_the_points_to_the_observations(colmap, read):
    folder = colmap / "bent" / "sparse"
    model = read(folder if read is read_text else folder / "0")
    errors = [
        np.abs(model.images[view + 1].project_point(point.xyz) - xy).max()
        for point, view, xy in observations(model)
    ]
    assert len(errors) > 1000
    assert max(errors) < 1e-3


def contents(model):
    """Texts and whole numbers of a model, and its other numbers, each in one order."""
    texts, numbers = [], []
    for key, camera in sorted(model.cameras.items()):
        texts.append((key, camera.model.name, camera.width, camera.height))
        numbers += list(camera.params)
    for key, image in sorted(model.images.items()):
        points = [point.point3D_id for point in image.points2D]
        texts.append((key, image.name, image.camera_id, points))
        numbers += image.cam_from_world().matrix().ravel().tolist()
        numbers += [number for point in image.points2D for number in point.xy]
    for key, point in sorted(model.points3D.items()):
        track = [(part.image_id, part.point2D_idx) for part in point.track.elements]
        texts.append((key, point.color.tolist(), track))
        numbers += point.xyz.tolist()
    return texts, numbers


def test_both_models_have_the_same_content(colmap):
    folder = colmap / "bent" / "sparse"
    texts, numbers = contents(read_text(folder))
    binary_texts, binary_numbers = contents(read_binary(folder / "0"))
    assert texts == binary_texts
    assert_allclose(numbers, binary_numbers, rtol=1e-14)


def test_points_are_on_the_surfaces_that_their_views_show(data, colmap):
    for stored_sample, rig in zip(data, (RIG, PLAIN_RIG), strict=True):
        model = read_binary(colmap / stored_sample.name / "sparse" / "0")
        points = np.array([point.xyz for point in model.points3D.values()])
        ids = (
            scene.COLORS[1:]
            == np.array([point.color for point in model.points3D.values()])[:, None]
        )
        # At the edge of an object the nearest pixel of a view may show another one.
        is_pure = ids.all(axis=-1).any(axis=-1)
        assert is_pure.mean() > 0.9
        objects = ids.all(axis=-1).argmax(axis=-1) + 1
        assert set(objects[is_pure]) == {scene.FLOOR, scene.BALL, scene.CARD}
        away = scene.distance_from_surface(points[is_pure], objects[is_pure])
        assert np.abs(away).max() < 1e-6  # float32 coordinates of about 1 m
        at = [[] for _ in rig.cameras]
        for point, view, _ in observations(model):
            at[view].append(point.xyz)
        for view, points_of_view in enumerate(at):
            assert scene.is_seen(rig, view, np.array(points_of_view)).all()


@pytest.mark.parametrize("made", [BENT, FLAT], ids=["bent", "plain"])
def test_tracks_have_most_of_the_views_that_see_their_points(made):
    tracks = tracks_of(made)
    in_track = np.bincount(tracks.numbers, minlength=len(tracks))
    views = range(len(made.rig))
    seen = [scene.is_seen(made.rig, view, tracks.points) for view in views]
    assert (in_track <= np.sum(seen, axis=0)).all()
    assert in_track.sum() > 0.5 * np.sum(seen)


def test_a_pair_has_a_point_for_every_pixel_that_both_see():
    made = pair_sample()
    tracks = tracks_of(made)
    assert len(tracks) == sum(int((t.visible & t.hit).sum()) for t in made.truths)
    assert_array_equal(np.bincount(tracks.numbers), 2)
    assert_array_equal(tracks.numbers[tracks.views == 0], np.arange(len(tracks)))
    # One of both observations is the centre of a pixel, whose ray meets the point.
    for view in (0, 1):
        pixels = tracks.pixels[tracks.views == view]
        is_centre = np.abs(pixels - np.round(pixels)).max(axis=1) < 1e-9
        count = int((made.truths[view].visible & made.truths[view].hit).sum())
        assert is_centre.sum() >= count
    left = transform_points(inverse(made.rig.world_from_cams[0]), tracks.points)
    depth, _ = cast_pair(np.zeros(left.shape), left / left[:, 2:])
    assert_allclose(depth, left[:, 2], rtol=1e-9)
    colors = []
    for view in (0, 1):
        u, v = np.floor(tracks.pixels[tracks.views == view] + 0.5).astype(int).T
        colors.append(made.shots[0].images[view][v, u].astype(float))
    assert_array_equal(tracks.colors, np.rint(np.mean(colors, axis=0)))


def test_the_number_of_points_and_their_choice():
    few, other, again = (tracks_of(BENT, most=50, seed=seed) for seed in (0, 1, 0))
    assert len(few) == 50
    assert_array_equal(few.points, again.points)
    assert len(np.unique([*few.points, *other.points], axis=0)) > 90


def test_a_dense_workspace_has_the_true_depths_and_normals(colmap):
    folder = colmap / "plain" / "stereo"
    for view, truth in enumerate(FLAT.truths):
        name = f"im{view}.png.geometric.bin"
        depth, normal = pycolmap.DepthMap(), pycolmap.NormalMap()
        depth.read(folder / "depth_maps" / name)
        normal.read(folder / "normal_maps" / name)
        expected = np.where(truth.hit, truth.depth, 0).astype(np.float32)
        assert_array_equal(depth.to_array(), expected)
        in_camera = truth.normal @ PLAIN_RIG.world_from_cams[view][:3, :3]
        # pycolmap returns the numbers in the order of the file, one plane after the other (src/colmap/mvs/mat.h).
        planes = normal.to_array().reshape(3, *truth.hit.shape)
        assert_allclose(planes, np.moveaxis(in_camera, -1, 0), atol=1e-6)
        assert (in_camera[truth.hit][:, 2] < 0).any()
    assert (folder / "fusion.cfg").read_text().splitlines() == [
        f"im{i}.png" for i in range(6)
    ]
    assert not (colmap / "bent" / "stereo").exists()


def test_colmaps_fusion_of_the_workspace_gives_the_surfaces(colmap, tmp_path):
    # Normals of a plane agree exactly, so the limit in degrees may be tight.
    options = pycolmap.StereoFusionOptions(
        min_num_pixels=2, num_threads=1, max_normal_error=0.05
    )
    fused = pycolmap.stereo_fusion(tmp_path, colmap / "plain", options=options)
    points = np.array([point.xyz for point in fused.points3D.values()])
    assert len(points) > 1000
    ids = (scene.FLOOR, scene.BALL, scene.CARD)
    away = [
        np.abs(scene.distance_from_surface(points, np.full(len(points), number)))
        for number in ids
    ]
    # A fused point is the median of points that are up to a pixel apart, 2 m / 60 px.
    assert np.min(away, axis=0).max() < 2 / 60


def test_images_are_beside_the_model(data, colmap):
    for view in range(len(RIG)):
        with Image.open(colmap / "bent" / "images" / f"im{view}.png") as image:
            assert_array_equal(np.array(image), data[0].image(view))


@pytest.mark.parametrize("folder", ["sparse", "sparse/0"])
def test_twinlens_reads_the_models_back(colmap, folder):
    back = read_colmap(colmap / "bent" / folder)
    assert back.names == tuple(f"im{view}.png" for view in range(len(RIG)))
    for view, camera in enumerate(RIG.cameras):
        assert_allclose(back.rig.cameras[view].K, camera.K, rtol=1e-14)
        assert back.rig.cameras[view].distortion == camera.distortion
        pose = RIG.world_from_cams[view]
        assert_allclose(back.rig.world_from_cams[view], pose, atol=1e-12)


def test_write_colmap_with_points(tmp_path):
    tracks = tracks_of(BENT, most=100)
    write_colmap(tmp_path, RIG, tracks=tracks)
    model = pycolmap.Reconstruction(tmp_path)
    for number, point in model.points3D.items():
        assert_allclose(point.xyz, tracks.points[number - 1], rtol=1e-14)
        assert_array_equal(point.color, tracks.colors[number - 1])
    assert model.compute_num_observations() == len(tracks.views)
    back = read_colmap(tmp_path).rig
    assert [camera.distortion for camera in back.cameras] == [
        camera.distortion for camera in RIG.cameras
    ]


def test_a_single_view_has_no_points():
    pair = scene.ring([PLAIN, PLAIN])
    made = scene.sample(pair)
    alone = Rig(pair.cameras[:1], pair.world_from_cams[:1])
    images = made.shots[0].images
    assert len(find_tracks(alone, made.truths.__getitem__, images.__getitem__)) == 0


def test_a_sample_without_truth_is_refused(data, tmp_path):
    folder = shutil.copytree(data[1].folder, tmp_path / "s")
    (folder / "truth2.exr").unlink()
    with pytest.raises(FileError, match=r"truth2\.exr"):
        export([open_sample(folder)], tmp_path / "out", "colmap")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("to", ["colmap", "nerfstudio"])
def test_wide_fisheyes_are_refused(tmp_path, to):
    sample = stored(tmp_path / "s", scene.sample(scene.ring([PLAIN] * 2)))
    wide = {"fx": 20.0, "fy": 20.0, "distortion": {"type": "KannalaBrandt"}}
    with edited(sample.folder) as record:
        record["rig"]["cameras"][1] |= wide
    assert sample.rig.cameras[1].is_wide
    with pytest.raises(InputError, match="s: view 1 sees 90 degrees or more"):
        export([sample], tmp_path / "out", to)
