"""COLMAP's binary models, against the text that pycolmap wrote of the same model."""

import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.calibrations.calibration_files import same
from twinlens.calibrations import read_rig
from twinlens.errors import FileError

MODEL = Path(__file__).with_name("colmap")
NAMES = ("cameras", "images")


@pytest.fixture
def text():
    return read_rig(MODEL)


def copied(folder, *endings):
    for name in NAMES:
        for ending in endings:
            shutil.copy(MODEL / f"{name}{ending}", folder)
    return folder


def test_a_folder_of_a_binary_model_is_the_rig_of_its_text(tmp_path, text):
    back = read_rig(copied(tmp_path, ".bin"))
    assert back.names == text.names == tuple(f"seq a/{i:03}.png" for i in range(1, 5))
    same(text.rig, back.rig)
    assert len({camera.fx for camera in back.rig.cameras}) == 3


@pytest.mark.parametrize("turned", [1, -1])
def test_the_two_files_may_be_named(tmp_path, text, turned):
    """Also beside text files, which are not read then."""
    copied(tmp_path, ".bin")
    (tmp_path / "cameras.txt").write_text("# of another model\n")
    files = [tmp_path / f"{name}.bin" for name in NAMES][::turned]
    same(text.rig, read_rig(*files).rig)


def test_a_pose_is_the_quaternion_and_translation_of_the_file():
    """By hand: cam_from_world of the second image, from the numbers that stand in images.txt."""
    w, x, y, z = -0.85485783243529923, -0.4652650053733392, -0.22916301232172845, 0.015194567535794602  # fmt: skip
    shift = [-0.21879166393254573, -1.2459109472530652, -0.73226735470345161]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    pose = read_rig(*(MODEL / f"{name}.bin" for name in NAMES)).rig.world_from_cams[1]
    np.testing.assert_allclose(pose[:3, :3].T, rotation, atol=1e-12)
    np.testing.assert_allclose(-rotation @ pose[:3, 3], shift, atol=1e-12)


def with_model(data, number):
    """The first camera has another model."""
    return data[:12] + struct.pack("<i", number) + data[16:]


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("cameras.bin", lambda data: data[:-1], "ends early"),
        ("cameras.bin", lambda data: b"", "ends early"),
        ("cameras.bin", lambda data: b"\xff" * 8 + data[8:], "ends early"),
        ("cameras.bin", lambda data: with_model(data, 7), "camera 1: the model FOV is not supported; .*OPENCV_FISHEYE"),
        ("cameras.bin", lambda data: with_model(data, 99), "camera 1: the model number 99 is not"),
        ("cameras.bin", lambda data: bytes(8), "refers to camera 2, which cameras.bin does not have"),
        ("images.bin", lambda data: data[:40], "ends early"),
        ("images.bin", lambda data: bytes(8), "has no images"),
        ("images.bin", lambda data: data[:12] + bytes(32) + data[44:], "image 1: "),
        ("images.bin", lambda data: data.replace(b"seq a/001", b"seq\xff\xff/001"), "the name of an image is no text"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_binary_model_is_one_line(tmp_path, name, change, says):
    path = copied(tmp_path, ".bin") / name
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(FileError, match=rf"(cameras|images)\.bin: {says}") as caught:
        read_rig(tmp_path)
    assert "\n" not in str(caught.value)


def test_one_file_of_two_is_refused(tmp_path):
    copied(tmp_path, ".bin")
    with pytest.raises(FileError, match=r"COLMAP's cameras\.bin and images\.bin go to"):
        read_rig(tmp_path / "cameras.bin")
    with pytest.raises(FileError, match=r"COLMAP's cameras\.bin and images\.bin go to"):
        read_rig(tmp_path / "images.bin", copied(tmp_path, ".txt") / "cameras.txt")
