"""Rigs in other programs' files: round trips, axis conventions, and invalid files."""

import json

import cv2
import numpy as np
import pytest

from tests.rigs import DISTORTIONS, random_rig
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.camera.layouts import arc, line
from twinlens.dataset.poses import (
    read_colmap,
    read_opencv,
    read_transforms,
    write_colmap,
    write_opencv,
    write_transforms,
)
from twinlens.errors import FileError, InputError

CAMERA = Camera(640, 480, 700.0, 690.0, 310.25, 241.0)
POSE = geometry.look_at([1, 2, 3], [4, 5, 3.5])


@pytest.fixture(scope="module")
def rig():
    """One camera of every distortion model, with random poses."""
    made, _ = random_rig(np.random.default_rng(4), count=4)
    models = (*DISTORTIONS, BrownConrady(0.01, 0.02, 1e-4, 2e-4, 0.003))
    cameras = [
        camera.replace(distortion=model)
        for camera, model in zip(made.cameras, models, strict=True)
    ]
    return Rig(cameras, made.world_from_cams)


def same(a, b):
    for mine, its in zip(a.cameras, b.cameras, strict=True):
        assert (mine.width, mine.height, mine.distortion) == (
            its.width,
            its.height,
            its.distortion,
        )
        assert pytest.approx(its.K, abs=1e-12) == mine.K
    assert np.allclose(a.world_from_cams, b.world_from_cams, rtol=0, atol=1e-12)


def test_colmap_round_trip(rig, tmp_path):
    write_colmap(tmp_path, rig, ["a.png", "b/c d.png", "e", "f"])
    back = read_colmap(tmp_path)
    same(rig, back.rig)
    assert back.names == ("a.png", "b/c d.png", "e", "f")
    assert (tmp_path / "points3D.txt").read_text() == ""


def test_transforms_round_trip(rig, tmp_path):
    write_transforms(tmp_path / "transforms.json", rig)
    back = read_transforms(tmp_path / "transforms.json")
    same(rig, back.rig)
    assert back.names == ("im0.png", "im1.png", "im2.png", "im3.png")


@pytest.mark.parametrize(("a", "b"), [(0, 1), (2, 3)])
def test_opencv_yaml_round_trip(rig, tmp_path, a, b):
    pair = Rig(
        [rig.cameras[i] for i in (a, b)], [rig.world_from_cams[i] for i in (a, b)]
    )
    write_opencv(tmp_path / "pair.yml", pair)
    same(pair, read_opencv(tmp_path / "pair.yml"))


def test_opencv_reads_our_file_and_we_read_its(rig, tmp_path):
    pair = Rig(
        [rig.cameras[1], rig.cameras[3]], [rig.world_from_cams[i] for i in (1, 3)]
    )
    ours, theirs = tmp_path / "ours.yml", tmp_path / "theirs.yml"
    write_opencv(ours, pair)
    source, target = (
        cv2.FileStorage(str(ours), cv2.FILE_STORAGE_READ),
        cv2.FileStorage(str(theirs), cv2.FILE_STORAGE_WRITE),
    )
    for name in ("M1", "D1", "M2", "D2", "R", "T"):
        target.write(name, source.getNode(name).mat())
    assert np.array_equal(source.getNode("M2").mat(), pair.cameras[1].K)
    assert np.allclose(source.getNode("T").mat()[:, 0], pair.b_from_a(0, 1)[:3, 3])
    source.release()
    target.release()
    back = read_opencv(theirs, size=(640, 480))
    same(Rig(pair.cameras, [np.eye(4), pair.b_from_a(1, 0)]), back)


def test_colmap_quaternions_transform_from_world_to_camera(tmp_path):
    """By the rotation formula v + 2 q x (q x v + w v), not by matrices."""
    write_colmap(tmp_path, arc(CAMERA, 3, 2.0, 90, POSE))
    line_of = (tmp_path / "images.txt").read_text().splitlines()[0].split()
    w, *q = (float(word) for word in line_of[1:5])
    shift = np.array(line_of[5:8], dtype=float)
    point = np.array([0.3, -0.7, 1.1])
    turned = point + 2 * np.cross(q, np.cross(q, point) + w * point)
    pose = arc(CAMERA, 3, 2.0, 90, POSE).world_from_cams[0]
    assert np.allclose(
        turned + shift, geometry.transform_points(geometry.inverse(pose), point)
    )
    assert (tmp_path / "cameras.txt").read_text().splitlines()[
        0
    ] == "1 PINHOLE 640 480 700.0 690.0 310.75 241.5"


def test_the_nerf_matrix_has_y_up_and_z_backward(tmp_path):
    write_transforms(tmp_path / "t.json", Rig([CAMERA], [POSE]))
    frame = json.loads((tmp_path / "t.json").read_text())["frames"][0]
    matrix = np.array(frame["transform_matrix"])
    assert np.allclose(
        matrix[:3, 2], np.subtract([1, 2, 3], [4, 5, 3.5]) / np.linalg.norm([3, 3, 0.5])
    )
    assert matrix[2, 1] > 0.9
    assert np.allclose(matrix[:, 0], POSE[:, 0])
    assert (frame["cx"], frame["cy"], frame["fl_y"]) == (310.75, 241.5, 690.0)


def test_transforms_with_a_camera_angle_are_read(tmp_path):
    frames = [{"file_path": "./r_0", "transform_matrix": np.eye(4).tolist()}]
    table = {"camera_angle_x": np.radians(60), "w": 800, "h": 600, "frames": frames}
    (tmp_path / "t.json").write_text(json.dumps(table))
    camera = read_transforms(tmp_path / "t.json").rig.cameras[0]
    wanted = Camera.from_fov(800, 600, 60)
    assert pytest.approx(wanted.K) == camera.K


COLMAP_CAMERAS = {
    "SIMPLE_PINHOLE 640 480 700 320 240": None,
    "SIMPLE_RADIAL 640 480 700 320 240 -0.1": BrownConrady(-0.1),
    "RADIAL 640 480 700 320 240 -0.1 0.02": BrownConrady(-0.1, 0.02),
    "OPENCV 640 480 700 700 320 240 -0.1 0.02 0.001 0.002": BrownConrady(
        -0.1, 0.02, 0.001, 0.002
    ),
    "RADIAL_FISHEYE 640 480 700 320 240 0.01 0.002": KannalaBrandt(0.01, 0.002),
}


@pytest.mark.parametrize(("text", "model"), COLMAP_CAMERAS.items())
def test_colmap_models_are_read(tmp_path, text, model):
    (tmp_path / "cameras.txt").write_text(f"# comment\n7 {text}\n")
    (tmp_path / "images.txt").write_text(
        "# one\n3 1 0 0 0 0 0 0 7 b.png\n10 20 -1\n2 1 0 0 0 1 0 0 7 a.png\n\n"
    )
    back = read_colmap(tmp_path)
    assert back.names == ("a.png", "b.png")
    assert back.rig.cameras[0] == Camera(640, 480, 700.0, 700.0, 319.5, 239.5, model)
    assert back.rig.world_from_cams[0][:3, 3].tolist() == [-1, 0, 0]


@pytest.mark.parametrize(
    ("cameras", "images", "says"),
    [
        ("1 PINHOL 640 480 1 1 1 1", "1 1 0 0 0 0 0 0 1 a", "did you mean 'PINHOLE'"),
        ("1 PINHOLE 640 480 1 1 1", "1 1 0 0 0 0 0 0 1 a", "4 parameters, got 3"),
        ("1 PINHOLE 640 480 7 7 1 1", "1 1 0 0 0 0 0 0 2 a", "camera 2"),
        ("1 PINHOLE 640 480 7 7 1 1", "1 0 0 0 0 0 0 0 1 a", "line 1 must read ID QW"),
        ("1 PINHOLE 640 480 7 7 1 1", "1 1 0 0 0 0 0 1", "line 1 must read ID QW"),
        (
            "1 PINHOLE 640 480 7 7 1 1",
            "1 1 0 0 0 nan 0 0 1 a",
            "line 1 must read ID QW",
        ),
        ("1 PINHOLE 640 480 7 7 1 1", "# none", "has no images"),
        ("1", "", "line 1 must read ID MODEL"),
    ],
)
def test_invalid_colmap_models_raise(tmp_path, cameras, images, says):
    (tmp_path / "cameras.txt").write_text(cameras)
    (tmp_path / "images.txt").write_text(images)
    with pytest.raises(FileError, match=says) as caught:
        read_colmap(tmp_path)
    assert "\n" not in str(caught.value)


FRAME = {"file_path": "a", "transform_matrix": np.eye(4).tolist()}
SIZE = {"w": 640, "h": 480, "fl_x": 700}


def test_a_camera_angle_beside_a_focal_length_is_ignored(tmp_path):
    table = {
        **SIZE,
        "frames": [FRAME],
        "camera_angle_x": 0,
        "camera_angle_y": 1.0,
        "fl_y": 710,
    }
    (tmp_path / "t.json").write_text(json.dumps(table))
    (camera,) = read_transforms(tmp_path / "t.json").rig.cameras
    assert (camera.fx, camera.fy) == (700, 710)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"frames": [FRAME], "w": 640, "h": 480}, "has no fl_x"),
        ({"frames": [FRAME], "fl_x": 700}, "has no w"),
        ({}, "has no frames"),
        ([], "not a valid transforms.json"),
        ({**SIZE, "frames": []}, "one pose per camera"),
        (
            {**SIZE, "frames": [{**FRAME, "transform_matrix": [[1, 2], [3, 4]]}]},
            "not a valid transforms.json",
        ),
        (
            {
                **SIZE,
                "frames": [{**FRAME, "transform_matrix": (2 * np.eye(4)).tolist()}],
            },
            "world_from_cams",
        ),
        (
            {**SIZE, "frames": [FRAME], "camera_model": "EQUIRECTANGULAR"},
            "EQUIRECTANGULAR",
        ),
        ({**SIZE, "frames": [FRAME], "k4": 0.1}, "k4"),
        (
            {"w": 640, "h": 480, "frames": [FRAME], "camera_angle_x": 0},
            "not a valid transforms.json",
        ),
    ],
)
def test_invalid_transforms_raise(tmp_path, table, says):
    (tmp_path / "t.json").write_text(json.dumps(table))
    with pytest.raises(FileError, match=says):
        read_transforms(tmp_path / "t.json")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("M1:", "N1:", "has no M1"),
        ("size1: [ 640, 480 ]", "", "has no image_width"),
        (
            "D2: !!opencv-matrix\n   rows: 1\n   cols: 5",
            "D2: !!opencv-matrix\n   rows: 5\n   cols: 2",
            "has no D2",
        ),
        ("fisheye1: 0", "fisheye1: 1", "4 coefficients"),
        ("data: [ 700.0, 0.0", "data: [ 700.0, 0.5", "without skew"),
        ("size1: [ 640, 480 ]", "size1: [ 0, 480 ]", "width"),
    ],
)
def test_invalid_opencv_files_raise(tmp_path, old, new, says):
    path = tmp_path / "pair.yml"
    write_opencv(path, line(CAMERA, 2, 0.1))
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FileError, match=says):
        read_opencv(path)


def test_unsupported_rigs_raise(rig, tmp_path):
    rational = Rig([CAMERA.replace(distortion=BrownConrady(k4=0.01))], [np.eye(4)])
    for refused, says in (
        (lambda: write_opencv(tmp_path / "x.yml", rig), "4 cameras"),
        (lambda: write_transforms(tmp_path / "x.json", rational), "k4"),
        (lambda: write_colmap(tmp_path, rig, ["a"]), "image names"),
        (lambda: write_colmap(tmp_path, rig, ["a"] * 4), "image names"),
        (
            lambda: write_colmap(tmp_path, rig, ["a", "b", "c", "d\n"]),
            "one printable line",
        ),
    ):
        with pytest.raises(InputError, match=says):
            refused()
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("read", [read_opencv, read_transforms, read_colmap])
def test_missing_and_binary_files_raise(read, tmp_path):
    with pytest.raises(FileError, match="no such file"):
        read(tmp_path / "missing")
    path = tmp_path / "cameras.txt"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="not a text file"):
        read(tmp_path if read is read_colmap else path)
