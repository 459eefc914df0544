"""The export nerfstudio, read by the rules of the parser of its data, which needs torch.

The rules, from nerfstudio/data/dataparsers/nerfstudio_dataparser.py and docs/quickstart/data_conventions.md of version
1.1: frames are sorted by their file; a value of the intrinsics is that of the file, or else that of the frame, and
distortion is a group; the camera model is the file's; if one of the lists train, val and test is there, all must be;
depths are multiplied by 0.001, 0 is unknown; the ray of a pixel goes through its centre: x right, y up, -z forward.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset import turning_scene as scene
from tests.dataset.dataset_scene import stored
from twinlens.calibrations import read_rig
from twinlens.camera import BrownConrady, Camera, KannalaBrandt
from twinlens.dataset.export import export
from twinlens.dataset.tracks import find_tracks
from twinlens.errors import InputError

PLAIN = Camera(64, 48, 60.0, 58.0, 31.0, 24.5)
BENT = PLAIN.replace(distortion=BrownConrady(-0.1, 0.02, 1e-3, -2e-3, 0.003))
ROUND = PLAIN.replace(distortion=KannalaBrandt(0.05, -0.02, 0.01, -1e-3))
OTHER = BENT.replace(fx=66.0, width=72, distortion=BrownConrady(0.05))
RIGS = {
    "plain": scene.ring([PLAIN] * 9),
    "bent": scene.ring([BENT, OTHER, PLAIN]),
    "round": scene.ring([ROUND] * 3),
}
INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h")
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
MODELS = {
    "OPENCV": "perspective",
    "PINHOLE": "perspective",
    "OPENCV_FISHEYE": "fisheye",
}


@dataclass
class Frame:
    """What the parser keeps of a frame."""

    file: Path
    depth_file: Path
    values: dict
    model: str
    camera_to_world: np.ndarray


def parse(folder, split):
    """The frames of a split, by the rules of the parser."""
    table = json.loads((folder / "transforms.json").read_text())
    frames = sorted(table["frames"], key=lambda frame: Path(frame["file_path"]))
    lists = [f"{name}_filenames" in table for name in ("train", "val", "test")]
    assert all(lists) or not any(lists)
    chosen = set(table[f"{split}_filenames"])
    assert chosen <= {frame["file_path"] for frame in frames}
    parsed = []
    for frame in frames:
        values = {key: (table if key in table else frame)[key] for key in INTRINSICS}
        at = table if any(key in table for key in DISTORTION) else frame
        values |= {key: at.get(key, 0.0) for key in DISTORTION}
        if frame["file_path"] in chosen:
            parsed.append(
                Frame(
                    folder / frame["file_path"],
                    folder / frame["depth_file_path"],
                    values,
                    MODELS[table.get("camera_model", "OPENCV")],
                    np.array(frame["transform_matrix"]),
                )
            )
    return parsed


def seen_by(frame, points):
    """Pixels (N, 2) and depths (N,) of world points (N, 3), by OpenCV with the values of the parser.

    Pixels are counted from the corner: the ray of the first one goes through (0.5, 0.5).
    """
    values, pose = frame.values, frame.camera_to_world
    in_camera = (points - pose[:3, 3]) @ pose[:3, :3]
    in_opencv = in_camera * [1, -1, -1]  # x right, y down, z forward
    K = np.array(
        [
            [values["fl_x"], 0, values["cx"]],
            [0, values["fl_y"], values["cy"]],
            [0, 0, 1.0],
        ]
    )
    zero = np.zeros(3)
    if frame.model == "fisheye":
        d = np.array([values[key] for key in ("k1", "k2", "k3", "k4")])
        px, _ = cv2.fisheye.projectPoints(in_opencv[:, None], zero, zero, K, d)
    else:
        d = np.array([values[key] for key in ("k1", "k2", "p1", "p2", "k3")])
        px, _ = cv2.projectPoints(in_opencv, zero, zero, K, d)
    return px[:, 0], in_opencv[:, 2]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    return {name: stored(folder / name, scene.sample(RIGS[name])) for name in RIGS}


@pytest.fixture(scope="module")
def exported(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("nerfstudio") / "out"
    export(list(data.values()), out, "nerfstudio")
    return out


@pytest.mark.parametrize("name", RIGS)
def test_the_pixels_and_depths_of_the_true_points_are_those_of_the_files(
    data, exported, name
):
    trained, tested = (parse(exported / name, split) for split in ("train", "test"))
    frames = {frame.file.name: frame for frame in (*trained, *tested)}
    assert len(frames) == len(RIGS[name])
    for view, truth in enumerate(scene.truths(RIGS[name])):
        frame = frames[f"im{view}.png"]
        depth = np.load(frame.depth_file) * 1e-3
        assert_array_equal(depth > 0, truth.hit)
        pixels, z = seen_by(frame, truth.position[truth.hit])
        assert_allclose(depth[truth.hit], z, rtol=1e-6)  # float32
        v, u = np.nonzero(truth.hit)
        assert_allclose(pixels, np.stack([u, v], axis=-1) + 0.5, rtol=0, atol=1e-6)
        with Image.open(frame.file) as image:
            assert_array_equal(np.array(image), data[name].image(view))


def test_the_field_of_view_is_that_of_the_focal_length(exported):
    table = json.loads((exported / "plain" / "transforms.json").read_text())
    assert table["camera_angle_x"] == pytest.approx(2 * math.atan(64 / 2 / 60.0))
    assert table["camera_angle_y"] == pytest.approx(2 * math.atan(48 / 2 / 58.0))
    frames = json.loads((exported / "bent" / "transforms.json").read_text())["frames"]
    assert frames[1]["camera_angle_x"] == pytest.approx(2 * math.atan(72 / 2 / 66.0))


def test_every_eighth_view_is_held_out(exported):
    held_out = ["im0", "im8"]
    trained = [f"im{i}" for i in range(1, 8)]
    splits = {"train": trained, "val": held_out, "test": held_out}
    for split, names in splits.items():
        assert [frame.file.stem for frame in parse(exported / "plain", split)] == names
        assert len(parse(exported / "bent", split)) == 3  # too few to hold one out


def test_points_are_those_of_the_tracks(data, exported):
    folder = exported / "bent"
    table = json.loads((folder / "transforms.json").read_text())
    cloud = trimesh.load(folder / table["ply_file_path"])
    tracks = find_tracks(RIGS["bent"], data["bent"].truth, data["bent"].image)
    assert len(tracks) > 100
    assert_allclose(cloud.vertices, tracks.points, atol=1e-6)
    assert_array_equal(cloud.colors[:, :3], tracks.colors)


def test_twinlens_reads_the_rig_back(exported):
    for name, rig in RIGS.items():
        back = read_rig(exported / name / "transforms.json")
        assert back.names[0] == "images/im0.png"
        for view in range(len(rig)):
            camera, expected = back.rig.cameras[view], rig.cameras[view]
            assert_allclose(camera.K, expected.K)
            assert camera.distortion == expected.distortion
            assert_allclose(back.rig.world_from_cams[view], rig.world_from_cams[view])


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ([PLAIN, ROUND], "s: has views of OPENCV and OPENCV_FISHEYE"),
        (
            [PLAIN, BENT.replace(distortion=BrownConrady(k4=0.01))],
            "s: transforms.json cannot hold k4",
        ),
    ],
)
def test_what_nerfstudio_cannot_hold_is_refused(tmp_path, cameras, message):
    sample = stored(tmp_path / "s", scene.sample(scene.ring(cameras)))
    with pytest.raises(InputError, match=message):
        export([sample], tmp_path / "out", "nerfstudio")
    assert not (tmp_path / "out").exists()
