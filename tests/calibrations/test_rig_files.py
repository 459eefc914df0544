"""Rigs in other programs' files: round trips, axis conventions, and invalid files."""

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.calibrations.calibration_files import (
    KALIBR,
    opencv_file,
    same,
    write_ros,
)
from tests.rigs import DISTORTIONS, random_rig
from twinlens import geometry
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.camera.layouts import arc, line
from twinlens.dataset.poses import (
    read_colmap,
    read_kalibr,
    read_opencv,
    read_ros,
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


@pytest.mark.parametrize("first", [0, 2])
def test_opencv_yaml_round_trip(rig, tmp_path, first):
    views = slice(first, first + 2)
    pair = Rig(rig.cameras[views], rig.world_from_cams[views])
    write_opencv(tmp_path / "pair.yml", pair)
    same(pair, read_opencv(tmp_path / "pair.yml"))


def test_opencv_reads_our_file_and_we_read_its(rig, tmp_path):
    pair = Rig(
        [rig.cameras[1], rig.cameras[3]], [rig.world_from_cams[i] for i in (1, 3)]
    )
    ours, theirs = tmp_path / "ours.yml", tmp_path / "theirs.yml"
    write_opencv(ours, pair)
    source = cv2.FileStorage(str(ours), cv2.FILE_STORAGE_READ)
    names = ("M1", "D1", "M2", "D2", "R", "T")
    values = {name: source.getNode(name).mat() for name in names}
    source.release()
    assert np.array_equal(values["M2"], pair.cameras[1].K)
    assert np.allclose(values["T"][:, 0], pair.b_from_a(0, 1)[:3, 3])
    opencv_file(theirs, **values)
    back = read_opencv(theirs, size=(640, 480))
    same(Rig(pair.cameras, [np.eye(4), pair.b_from_a(1, 0)]), back)


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize(
    "names", [("M", "D"), ("K", "D"), ("cameraMatrix", "distCoeffs")]
)
def test_files_that_opencv_writes_are_read(rig, tmp_path, suffix, names):
    """In all three forms, with the size in one file and R, T in another."""
    pair = Rig(
        [rig.cameras[1], rig.cameras[3]], [rig.world_from_cams[i] for i in (1, 3)]
    )
    second_from_first = pair.b_from_a(0, 1)
    inside, outside = (tmp_path / f"{name}.{suffix}" for name in ("in", "ex"))
    size = {"image_width": 640, "image_height": 480, "camera_name": "the left one"}
    tables = {}
    for i, camera in enumerate(pair.cameras, 1):
        tables[f"{names[0]}{i}"] = camera.K
        tables[f"{names[1]}{i}"] = np.array([camera.distortion.coefficients])
    opencv_file(inside, **tables, **size)
    pose = second_from_first[:3]
    opencv_file(outside, R=pose[:, :3].copy(), T=pose[:, 3:].copy())
    back = read_opencv(inside, extrinsics=outside)
    same(Rig(pair.cameras, [np.eye(4), pair.b_from_a(1, 0)]), back)


def test_two_files_of_opencv_in_one_are_read(tmp_path):
    """Joined as they are, each with its head; OpenCV 2 writes no space before a tag."""
    pair = line(CAMERA, 2, 0.1)
    path = tmp_path / "pair.yml"
    write_opencv(path, pair)
    head, body = path.read_text().split("---\n")
    inside, outside = body[: body.index("R:")], body[body.index("R:") :]
    joined = f"{head}---\n{inside}...\n{head}---\n{outside}"
    path.write_text(joined.replace(": !!opencv", ":!!opencv"))
    same(pair, read_opencv(path))


@pytest.mark.parametrize(
    "text",
    [
        "M1: {rows: , cols: 3, data: [1]}",
        "M1: {rows: .inf, cols: 3, data: [1]}",
        f"M1: [{'9' * 400}]",
        "M1: &a [*a]",
        "a: &a [1, 2]\nM1: [*a, *a]",
        f"M1: [{'1, ' * 20000}1]",
        "M1: " + "[" * 3000,
        "M1: !!python/object/apply:os.system [ls]",
    ],
)
def test_odd_yaml_is_one_error(tmp_path, text):
    (tmp_path / "pair.yml").write_text(f"%YAML:1.0\n---\n{text}\nR: [1]\nT: [1]\n")
    with pytest.raises(FileError, match=r"pair\.yml: ") as caught:
        read_opencv(tmp_path / "pair.yml", size=(640, 480))
    assert "\n" not in str(caught.value)


def test_a_ros_pair_is_the_rig_that_opencv_rectified(tmp_path):
    """R and P of both files are OpenCV's, from a verged pair; the poses come back from them alone."""
    left = Camera(640, 480, 500.0, 502.0, 320.0, 240.0, BrownConrady(-0.2, 0.05, 1e-3))
    right = Camera(640, 480, 510.0, 511.0, 318.0, 241.0, BrownConrady(-0.2, 0.05))
    turn = Rotation.from_euler("xyz", [0.6, -2.5, 1.1], degrees=True).as_matrix()
    right_from_left = geometry.rigid(turn, [-0.12, 0.003, 0.001])
    r0, r1, p0, p1, *_ = cv2.stereoRectify(
        left.K, np.zeros(5), right.K, np.zeros(5), (640, 480), turn,
        right_from_left[:3, 3:].copy(), flags=cv2.CALIB_ZERO_DISPARITY,
    )  # fmt: skip
    for name, camera, r, p in (("left", left, r0, p0), ("right", right, r1, p1)):
        write_ros(tmp_path / f"{name}.yaml", camera, r, p)
    wanted = Rig([left, right], [np.eye(4), geometry.inverse(right_from_left)])
    same(wanted, read_ros(tmp_path / "left.yaml", tmp_path / "right.yaml"))
    with pytest.raises(FileError, match=r"left\.yaml: .* has no baseline"):
        read_ros(tmp_path / "right.yaml", tmp_path / "left.yaml")


def test_a_kalibr_chain_is_read(tmp_path):
    (tmp_path / "chain.yaml").write_text(KALIBR)
    back = read_kalibr(tmp_path / "chain.yaml")
    assert back.names == ("/cam0/image_raw", "cam1")
    first, second = back.rig.cameras
    assert first.distortion == BrownConrady(-0.28, 0.07, 0.0002, 1.7e-05)
    assert second.distortion == KannalaBrandt(-0.01, 0.02, -0.003, 0.001)
    assert (second.fx, second.cy, second.width) == (457.587, 255.238, 752)
    # The second camera is to the right: its centre is -R^T t.
    centre = back.rig.world_from_cams[1][:3, 3]
    assert np.allclose(centre, [0.11, 0, 0], atol=2e-3)
    turned = Rotation.from_matrix(back.rig.b_from_a(0, 1)[:3, :3]).as_rotvec()
    assert np.allclose(turned, [-0.0010, -0.0040, 0.0017], atol=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("pinhole", "omni", "cam0: unknown camera_model 'omni'"),
        ("radtan", "fov", "cam0: unknown distortion_model 'fov'"),
        ("458.654", ".nan", "cam0: intrinsics is not finite: it has nan"),
        (
            "[752, 480]",
            "[752.5, 480]",
            "cam0: resolution must be the width and the height",
        ),
        (
            "[0.0017, 0.99999",
            "[0.0017, 0.98",
            "cam1: T_cn_cnm1 must hold .* differ .* by 0.0",
        ),
        ("  T_cn_cnm1:", "  T_imu:", "cam1 has no T_cn_cnm1"),
        ("cam0:", "left:", "has no cam0"),
        ("cam0:", "cam0: [", "cannot be read"),
    ],
)
def test_what_is_wrong_in_a_kalibr_chain_is_said(tmp_path, old, new, says):
    path = tmp_path / "chain.yaml"
    path.write_text(KALIBR.replace(old, new, 1))
    with pytest.raises(FileError, match=rf"chain\.yaml: {says}") as caught:
        read_kalibr(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("decimals", [3, 4, 5, 8])
def test_rotations_of_few_digits_are_made_orthonormal(tmp_path, decimals):
    """Within what the digits explain; the nearest rotation is within the rounding of the one that was written."""
    rng = np.random.default_rng(decimals)
    for turn in Rotation.random(50, random_state=rng).as_matrix():
        pose = geometry.check_rigid(geometry_of(np.round(turn, decimals)), "pose")
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.abs(pose[:3, :3] - turn).max() < 1.5 * 10.0**-decimals


@pytest.mark.parametrize("form", ["{:.3g}", "{:.4g}", "{:.5g}", "{:g}", "{:.4e}"])
def test_rotations_of_few_significant_digits_are_made_orthonormal(form):
    """As C++ streams (six significant digits), MATLAB and %g print them: small entries have more decimals."""
    rng = np.random.default_rng(7)
    for turn in Rotation.from_rotvec(0.06 * rng.normal(size=(200, 3))).as_matrix():
        written = [[float(form.format(value)) for value in row] for row in turn]
        pose = geometry.check_rigid(geometry_of(written), "pose")
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        # Rounding moves an entry by half a unit of its last digit, at most 5 of the digit after it.
        digits = {"{:.3g}": 3, "{:.4g}": 4, "{:.5g}": 5, "{:g}": 6, "{:.4e}": 5}[form]
        assert np.abs(pose[:3, :3] - turn).max() < 1.5 * 10.0**-digits


def geometry_of(rotation):
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose


def test_a_rotation_that_its_digits_do_not_explain_is_refused_with_the_figure():
    turn = Rotation.from_euler("x", 20, degrees=True).as_matrix()
    for wrong, says in (
        (np.round(turn, 2), "differ from orthonormal ones by"),
        (np.round(turn, 5) * 1.001, "by 0.002, more than the"),
        (turn * 1.001, "by 0.002, more than the 1e-06"),
        # Four significant digits round 0.9397 by 0.00005 at most.
        (np.round(turn + np.diag([0, 4e-4, 0]), 4), "more than the 0.0002 that"),
        (np.diag([1.0, 1.0, -1.0]), "mirror image"),
    ):
        with pytest.raises(InputError, match=says):
            geometry.check_rigid(geometry_of(wrong), "pose")


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
    written = (tmp_path / "cameras.txt").read_text()
    assert written.startswith("1 PINHOLE 640 480 700.0 690.0 310.75 241.5\n")


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


def test_a_camera_angle_is_read_where_no_focal_length_is_given(tmp_path):
    path = tmp_path / "t.json"
    angle = {"w": 800, "h": 600, "camera_angle_x": np.radians(60)}
    path.write_text(json.dumps(angle | {"frames": [FRAME]}))
    (camera,) = read_transforms(path).rig.cameras
    assert pytest.approx(Camera.from_fov(800, 600, 60).K) == camera.K
    both = SIZE | {"fl_y": 710, "camera_angle_x": 0, "camera_angle_y": 1.0}
    path.write_text(json.dumps(both | {"frames": [FRAME]}))
    (camera,) = read_transforms(path).rig.cameras
    assert (camera.fx, camera.fy) == (700, 710)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"frames": [FRAME], "w": 640, "h": 480}, "has no fl_x"),
        ({}, "has no frames"),
        ([], "not a valid transforms.json"),
        (
            {
                **SIZE,
                "frames": [{**FRAME, "transform_matrix": (2 * np.eye(4)).tolist()}],
            },
            "transform_matrix must",
        ),
        (
            {**SIZE, "frames": [FRAME], "camera_model": "EQUIRECTANGULAR"},
            "EQUIRECTANGULAR",
        ),
        ({**SIZE, "frames": [FRAME], "k4": 0.1}, "k4"),
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
        ("data: [ 700.0", "data: [ .Nan", "M1 is not finite: it has nan"),
        (
            "D2: !!opencv-matrix\n   rows: 1\n   cols: 5",
            "D2: !!opencv-matrix\n   rows: 5\n   cols: 2",
            "D2 is not a matrix of 5x2 numbers",
        ),
        ("fisheye1: 0", "fisheye1: 1", "4 coefficients"),
        ("data: [ 700.0, 0.0", "data: [ 700.0, 0.5", "without skew"),
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
