"""Calibrations in forms that people write beside those of the programs' samples, and files that must not be mixed."""

import json

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.calibrations.calibration_files import opencv_file, same
from tests.calibrations.test_reading import (
    LEFT,
    PAIR,
    POSE,
    SHIFT,
    TURN,
    intrinsics,
)
from twinlens import geometry
from twinlens.calibrations import read_rig
from twinlens.camera import KannalaBrandt, Rig
from twinlens.errors import FileError, InputError

MOVED = {"R": TURN, "T": SHIFT[:, None]}


@pytest.mark.parametrize("name", ["imageSize", "image_size", "size"])
@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_a_size_of_opencv_under_the_names_of_people(tmp_path, name, ending):
    """cv2 writes the two numbers as a sequence, as C++ does with a cv::Size."""
    path = tmp_path / f"stereo.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (intrinsics() | MOVED).items():
        storage.write(key, value)
    storage.startWriteStruct(name, cv2.FileNode_SEQ)
    storage.write("", LEFT.width)
    storage.write("", LEFT.height)
    storage.endWriteStruct()
    storage.release()
    same(PAIR, read_rig(path).rig)


def test_base64_is_named(tmp_path):
    path = tmp_path / "stereo.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE_BASE64)
    for key, value in (intrinsics() | MOVED).items():
        storage.write(key, value)
    storage.release()
    with pytest.raises(FileError, match=r"stereo\.yml: M1 is stored in base64"):
        read_rig(path, size=(640, 480))


def test_a_flag_that_is_no_number_is_named(tmp_path):
    path = tmp_path / "pair.yml"
    tl.write_rig(path, PAIR)
    path.write_text(path.read_text().replace("fisheye2: 0", "fisheye2: []"))
    with pytest.raises(FileError, match=r"fisheye2 must be one number, got 0"):
        read_rig(path)


def test_two_files_of_opencv_are_cameras_and_a_pose(tmp_path):
    """Two whole calibrations are not mixed, whichever comes first, nor is one read with the pose of another."""
    size = {"image_width": 640, "image_height": 480}
    whole = opencv_file(tmp_path / "whole.yml", **intrinsics(), **MOVED, **size)
    other = opencv_file(tmp_path / "other.yml", **intrinsics(), **MOVED, **size)
    pose = opencv_file(tmp_path / "pose.yml", **MOVED)
    inner = opencv_file(tmp_path / "inner.yml", **intrinsics(), **size)
    same(PAIR, read_rig(inner, pose).rig)
    for files, says in (
        ((whole, other), r"other\.yml: of two files of OpenCV, .* both have cameras"),
        ((inner, other), r"other\.yml: of two files of OpenCV, .* both have cameras"),
        ((pose, pose), r"pose\.yml: of two files of OpenCV, .* none has cameras"),
        ((whole, pose), r"whole\.yml: has R and T already; leave .*pose\.yml out"),
        ((pose, whole), r"whole\.yml: has R and T already; leave .*pose\.yml out"),
    ):
        with pytest.raises(FileError, match=says):
            read_rig(*files)


FRAME = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
MOVED_FRAME = {"file_path": "b.png", "transform_matrix": np.eye(4)[:3].tolist()}
SYNTHETIC = {"camera_angle_x": 0.8, "frames": [FRAME, MOVED_FRAME]}


def test_transforms_without_a_size_and_with_three_rows(tmp_path):
    """As Blender scripts write them; f = w / (2 tan(angle / 2)), and the centre of the image is at (w - 1) / 2."""
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(SYNTHETIC))
    with pytest.raises(FileError, match=r"frames\[0\]: has no w and h, .* --size"):
        read_rig(path)
    rig = read_rig(path, size=(800, 600)).rig
    assert rig.cameras[0].fx == pytest.approx(400 / np.tan(0.4))
    assert (rig.cameras[0].cx, rig.cameras[0].cy) == (399.5, 299.5)
    # OpenGL's axes are x right, y up, z backward.
    assert np.allclose(rig.world_from_cams[1], np.diag([1.0, -1, -1, 1]))


def test_a_fisheye_flag_is_used_and_not_warned_of(tmp_path, recwarn):
    path = tmp_path / "transforms.json"
    table = {"w": 640, "h": 480, "fl_x": 300.0, "k1": 0.02, "is_fisheye": True}
    path.write_text(json.dumps({**table, "frames": [FRAME]}))
    assert read_rig(path).rig.cameras[0].distortion == KannalaBrandt(0.02)
    assert not recwarn.list


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        ([FRAME, 1], r"frames\[1\]: must be a table, got 1"),
        (
            [FRAME, {**FRAME, "fl_x": "wide"}],
            r"frames\[1\]: fl_x must be numbers, got 'wide'",
        ),
        (
            [FRAME, {**FRAME, "transform_matrix": [1, 2]}],
            r"frames\[1\]: transform_matrix must be 4x4 numbers, got 2",
        ),
        ([{**FRAME, "k1": []}], r"frames\[0\]: k1 must be one number, got 0"),
        ([{**FRAME, "cx": [1, 2]}], r"frames\[0\]: cx must be one number, got 2"),
        ([FRAME, {"file_path": "b"}], r"frames\[1\]: has no transform_matrix"),
        ([FRAME, {**FRAME, "w": 64.5}], r"frames\[1\]: w, h must be the width"),
        (
            [{**FRAME, "is_fisheye": True, "camera_model": "OPENCV"}],
            r"frames\[0\]: is_fisheye is true, but camera_model is OPENCV",
        ),
    ],
)
def test_a_wrong_frame_is_named(tmp_path, frames, says):
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({"w": 640, "h": 480, "fl_x": 300.0, "frames": frames}))
    with pytest.raises(FileError, match=says):
        read_rig(path)


@pytest.mark.parametrize("kind", ["", ".json", ".yml"])
def test_a_byte_order_mark_changes_nothing(tmp_path, kind):
    """Editors of Windows write one."""
    path = tmp_path / f"rig{kind}"
    tl.write_rig(path, PAIR)
    for file in path.iterdir() if path.is_dir() else [path]:
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    same(PAIR, read_rig(path).rig)


def test_our_own_file_comes_back(tmp_path):
    cameras = [LEFT, LEFT.replace(distortion=KannalaBrandt(0.01)), PAIR.cameras[1]]
    rig = Rig(cameras, [POSE, np.eye(4), geometry.inverse(POSE)])
    path = tmp_path / "rig.toml"
    tl.write_rig(path, rig)
    same(rig, tl.read_rig(path).rig)
    below = path.read_text().replace("layout", "[rig]\nlayout", 1)
    path.write_text(below.replace("[[cameras", "[[rig.cameras"))
    same(rig, tl.read_rig(path).rig)


def test_a_rigs_file_that_names_a_calibration_is_read_with_its_settings(tmp_path):
    k = np.array([[0.02, -0.003, 1e-3, 2e-4]])
    moved = {"R": TURN, "T": 1e3 * SHIFT[:, None], "image_width": 640, "image_height": 480}  # fmt: skip
    matrices = {"M1": LEFT.K, "D1": k, "M2": LEFT.K, "D2": k}
    (tmp_path / "in").mkdir()
    opencv_file(tmp_path / "in" / "stereo.yml", **matrices, **moved)
    path = tmp_path / "rig.toml"
    path.write_text('file = "in/stereo.yml"\nlength_unit = "mm"\nfisheye = true\n')
    rig = read_rig(path).rig
    assert rig.cameras[1].distortion == KannalaBrandt(*k[0])
    assert rig.baseline() == pytest.approx(np.linalg.norm(SHIFT))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("baseline = 0.1", "is a rig without a scene"),
        ('layout = "cameras"\ncameras = [{ fx = 9 }]', r"cameras\[0\]: has no width"),
        ('layout = "cameras"\ncameras = 3', "is a rig without a scene"),
        ('file = "rig.toml"', "a calibration of another program"),
        ("file = 3", "the name of a file, or two names"),
        ('file = "a.yml"\nlength_unit = "inch"', "length_unit"),
        ('file = "a.yml"\nfisheye = 1', "fisheye must be true or false"),
        ('file = "a.yml"', r"a\.yml: no such file"),
        ("file = ", "not valid TOML"),
    ],
)
def test_a_rigs_file_that_needs_a_scene_is_one_line(tmp_path, text, says):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(FileError, match=says) as caught:
        read_rig(path)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_a_camera_of_our_own_file_has_no_unknown_key(tmp_path):
    path = tmp_path / "rig.toml"
    tl.write_rig(path, PAIR)
    for old, new, says in (
        ("fx =", "focal =", r"cameras\[0\]: has no fx"),
        ("k1 =", "k7 =", r"cameras\[0\]: distortion: unknown coefficient 'k7'"),
        ("world_from_cam =", "pose =", r"cameras\[0\]: has 'pose'"),
    ):
        text = path.read_text()
        wrong = tmp_path / "wrong.toml"
        wrong.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=says):
            read_rig(wrong)


@pytest.mark.parametrize("shape", [(3, 1), (1, 3)])
@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
@pytest.mark.parametrize("degrees", [[0.6, -2.5, 1.1], [0, 0, 0], [0, 179.9, 0]])
def test_a_rotation_vector_of_opencv(tmp_path, degrees, ending, shape):
    vector = np.radians(degrees)
    size = {"image_width": 640, "image_height": 480}
    both = {
        name: tl.read_rig(
            opencv_file(tmp_path / f"{name}.{ending}", **intrinsics(), **size, R=R, T=SHIFT[:, None])
        ).rig
        for name, R in (("vector", vector.reshape(shape)), ("matrix", cv2.Rodrigues(vector)[0]))
    }  # fmt: skip
    same(both["matrix"], both["vector"])


def test_a_rotation_vector_in_degrees_is_refused(tmp_path):
    size = {"image_width": 640, "image_height": 480}
    turned = {"R": np.array([[0.6, -20.0, 1.1]]), "T": SHIFT[:, None]}
    path = opencv_file(tmp_path / "s.yml", **intrinsics(), **size, **turned)
    with pytest.raises(FileError, match=r"R of three numbers .* radians, got .* 20"):
        read_rig(path)


@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_packed_files_of_opencv(tmp_path, ending):
    """cv2 packs a file whose name ends in .gz."""
    size = {"image_width": 640, "image_height": 480}
    path = opencv_file(tmp_path / f"s.{ending}.gz", **intrinsics(), **size, **MOVED)
    assert path.read_bytes()[:2] == b"\x1f\x8b"
    same(PAIR, read_rig(path).rig)
    for damage in (path.read_bytes()[:-20], b"", b"M1: 1", path.read_bytes()[:9]):
        path.write_bytes(damage)
        with pytest.raises(FileError, match=rf"s\.{ending}\.gz: ") as caught:
            read_rig(path)
        assert "\n" not in str(caught.value)
