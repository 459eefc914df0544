"""A rig from the files of other programs, recognised by what they hold, as scenes, recipes and commands read it."""

import json

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.calibrations.calibration_files import (
    KALIBR,
    opencv_file,
    same,
    write_ros,
)
from twinlens import geometry
from twinlens.calibrations import read_rig, rig_table
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.errors import FileError, InputError
from twinlens.scenes import Scene, rig_from_table

LEFT = Camera(640, 480, 500.0, 502.0, 320.0, 240.0, BrownConrady(-0.2, 0.05, 1e-3))
RIGHT = Camera(640, 480, 510.0, 511.0, 318.0, 241.0, BrownConrady(-0.2, 0.05))
TURN = cv2.Rodrigues(np.radians([0.6, -2.5, 1.1]))[0]
SHIFT = np.array([-0.12, 0.003, 0.001])
PAIR = Rig([LEFT, RIGHT], [np.eye(4), geometry.inverse(geometry.rigid(TURN, SHIFT))])
POSE = geometry.look_at([1, 2, 3], [4, 5, 3.5])
SCENE = Scene("stage", (), {}, POSE, (1.0, 3.0))


def intrinsics():
    distortions = [
        np.array([camera.distortion.coefficients]) for camera in PAIR.cameras
    ]
    return {"M1": LEFT.K, "D1": distortions[0], "M2": RIGHT.K, "D2": distortions[1]}


def files_of(kind, folder):
    """The rig PAIR in the files of a program, as OpenCV or a person writes them."""
    size = {"image_width": 640, "image_height": 480}
    moved = {"R": TURN, "T": SHIFT[:, None]}
    if kind in ("yml", "xml", "json"):
        return [opencv_file(folder / f"s.{kind}", **intrinsics(), **moved, **size)]
    if kind == "two of OpenCV":
        inner = opencv_file(folder / "in.yml", **intrinsics(), **size)
        return [opencv_file(folder / "ex.yml", **moved), inner]
    if kind == "ROS":
        r0, r1, p0, p1, *_ = cv2.stereoRectify(
            LEFT.K, np.zeros(5), RIGHT.K, np.zeros(5), (640, 480), TURN, SHIFT[:, None]
        )
        write_ros(folder / "l.yaml", LEFT, r0, p0)
        write_ros(folder / "r.yaml", RIGHT, r1, p1)
        return [folder / "l.yaml", folder / "r.yaml"]
    ending = ENDINGS[kind]
    tl.write_rig(folder / f"rig{ending}", PAIR)
    return [folder / f"rig{ending}"]


ENDINGS = {"COLMAP": "", "NeRF": ".json", "our OpenCV": ".yaml", "our own": ".toml"}
KINDS = ("yml", "xml", "json", "two of OpenCV", "ROS", *ENDINGS)


@pytest.mark.parametrize("kind", KINDS)
def test_the_rig_of_every_program_is_the_same(kind, tmp_path):
    paths = files_of(kind, tmp_path)
    same(PAIR, tl.read_rig(*paths).rig)


@pytest.mark.parametrize("kind", ["yml", "ROS", "NeRF"])
def test_a_table_puts_the_rig_of_a_file_at_the_scenes_viewpoint(kind, tmp_path):
    paths = [str(path) for path in files_of(kind, tmp_path)]
    file = paths if len(paths) > 1 else paths[0]
    rig = rig_from_table({"file": file}, SCENE, 64, 48)
    same(Rig(PAIR.cameras, [POSE @ pose for pose in PAIR.world_from_cams]), rig)
    moved = rig_from_table(
        {"file": file, "position": [0, 0, 1], "look_at": [1, 0, 1]}, SCENE, 64, 48
    )
    assert np.allclose(moved.world_from_cams[0][:3, 3], [0, 0, 1])
    assert np.allclose(moved.b_from_a(0, 1), PAIR.b_from_a(0, 1))


def test_a_written_rig_is_read_where_it_stood(tmp_path):
    placed = Rig(PAIR.cameras, [POSE @ pose for pose in PAIR.world_from_cams])
    tl.write_rig(tmp_path / "rig.json", placed)
    table = {"file": str(tmp_path / "rig.json"), "poses": "world"}
    same(placed, rig_from_table(table, SCENE, 64, 48))


def test_our_own_file_holds_every_camera(tmp_path):
    cameras = [LEFT, LEFT.replace(distortion=KannalaBrandt(0.01)), RIGHT]
    rig = Rig(cameras, [POSE, POSE, geometry.inverse(POSE)])
    tl.write_rig(tmp_path / "rig.toml", rig)
    table = tl.scenes.read_toml(tmp_path / "rig.toml")
    same(rig, rig_from_table(table, SCENE, 64, 48))


def test_lengths_in_millimetres(tmp_path):
    (path,) = files_of("yml", tmp_path)
    rig = read_rig(path, length_unit="mm").rig
    assert rig.baseline() == pytest.approx(1e-3 * np.linalg.norm(SHIFT))


def test_the_size_is_stated_where_the_file_has_none(tmp_path):
    moved = {"R": TURN, "T": SHIFT[:, None]}
    path = opencv_file(tmp_path / "s.yml", **intrinsics(), **moved)
    same(PAIR, read_rig(path, size=(640, 480)).rig)
    with pytest.raises(FileError, match=r"s\.yml: has no image_width; .* --size"):
        read_rig(path)


def test_a_stated_size_must_be_that_of_the_file(tmp_path):
    (path,) = files_of("yml", tmp_path)
    with pytest.raises(FileError, match="640x480 pixels, not the stated 1280x960"):
        read_rig(path, size=(1280, 960))


def test_a_fisheye_of_opencv_has_to_be_stated(tmp_path):
    """cv2.fisheye projects as the camera that is read; its file does not say that it is of cv2.fisheye."""
    k = np.array([[0.02, -0.003, 1e-3, 2e-4]])
    moved = {"R": TURN, "T": SHIFT[:, None], "image_width": 640, "image_height": 480}
    matrices = {"M1": LEFT.K, "D1": k.T, "M2": RIGHT.K, "D2": k.T}
    path = opencv_file(tmp_path / "s.yml", **matrices, **moved)
    camera = read_rig(path, fisheye=True).rig.cameras[0]
    points = np.array([[0.3, -0.2, 1.0], [1.5, 1.0, 1.0]])
    pixels, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), LEFT.K, k
    )
    assert np.abs(camera.project(points) - pixels[:, 0]).max() < 1e-6
    table = {"file": str(path), "fisheye": True}
    assert rig_from_table(table, SCENE, 64, 48).cameras[1].distortion == KannalaBrandt(*k[0])  # fmt: skip
    assert isinstance(read_rig(path).rig.cameras[0].distortion, BrownConrady)


def test_values_of_the_file_are_not_set_beside_it(tmp_path):
    (path,) = files_of("yml", tmp_path)
    for key, value in {"fx": 500.0, "baseline": 0.2, "cameras": [{}, {}]}.items():
        with pytest.raises(InputError, match=f"rig: '{key}' is in the calibration"):
            rig_from_table({"file": str(path), key: value}, SCENE, 64, 48)
    with pytest.raises(InputError, match="length_unit"):
        rig_from_table({"file": str(path), "length_unit": "inch"}, SCENE, 64, 48)


def test_what_is_not_a_rig_is_one_line(tmp_path):
    files = {
        "one camera_info": [files_of("ROS", tmp_path)[0]],
        "no rig": [opencv_file(tmp_path / "a.yml", values=np.eye(2))],
        "no COLMAP": [tmp_path],
        "not a text": [tmp_path / "picture.yml"],
        "a file too many": [tmp_path / "chain.yaml"] * 2,
        "half of COLMAP": [tmp_path / "cameras.txt"],
    }
    (tmp_path / "picture.yml").write_bytes(b"\x89PNG\r\n\x00\xff")
    (tmp_path / "chain.yaml").write_text(KALIBR)
    for paths in files.values():
        with pytest.raises(FileError) as caught:
            read_rig(*paths)
        assert "\n" not in str(caught.value)
        assert str(paths[-1].parent) in str(caught.value)


def test_the_table_has_the_numbers_of_the_rig():
    table = rig_table(PAIR)
    assert json.loads(json.dumps(table)) == table
    assert table["cameras"][0]["rig_from_cam"] == np.eye(4).tolist()


def test_a_folder_without_the_files_of_colmap_says_what_it_lacks(tmp_path):
    (tmp_path / "cameras.txt").write_text("")
    with pytest.raises(
        FileError, match=r"has no images\.txt; or name a file of OpenCV"
    ):
        read_rig(tmp_path)
