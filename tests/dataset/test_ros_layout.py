"""The export mcap, written by rosbags and read back by mcap with mcap-ros2-support, and once by rosbags."""

from dataclasses import replace
from pathlib import Path

import cv2
import mcap.reader
import numpy as np
import pytest
from mcap_ros2.decoder import DecoderFactory
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from tests.dataset import turning_scene as scene
from tests.dataset.dataset_scene import images, sample, stored, unrectified
from twinlens.camera import BrownConrady, Camera, KannalaBrandt
from twinlens.camera.layouts import toed_in
from twinlens.dataset.export import export
from twinlens.dataset.layouts import Source
from twinlens.dataset.ros_layout import mcap as mcap_files
from twinlens.geometry import inverse, look_at, rigid

PLAIN = Camera(64, 48, 60.0, 58.0, 31.0, 24.5)
BENT = PLAIN.replace(distortion=BrownConrady(-0.1, 0.02, 1e-3, -2e-3, 0.003), fx=61.0)
RATIONAL = PLAIN.replace(
    distortion=BrownConrady(-0.1, 0.02, 1e-3, -2e-3, 0.003, 0.05, -0.01, 0.002)
)
ROUND = PLAIN.replace(distortion=KannalaBrandt(0.05, -0.02, 0.01, -1e-3))
POSE = look_at((2.0, 0, 1.0), scene.CENTRE)
TOED = toed_in([BENT, RATIONAL], 0.3, 2.0, POSE)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    deep = sample()
    deep = replace(
        deep, shots=(replace(deep.shots[0], images=images(deep.rig, 3, np.uint16)),)
    )
    return [
        stored(folder / "pair", sample()),
        stored(folder / "deep", deep),
        stored(folder / "toed", scene.sample(TOED)),
        stored(folder / "ring", scene.sample(scene.ring([ROUND, PLAIN, BENT]))),
    ]


@pytest.fixture(scope="module")
def messages(data, tmp_path_factory):
    """The messages of each sample by topic, read with mcap."""
    out = tmp_path_factory.mktemp("ros") / "out"
    export(data, out, "mcap")
    decoded = [{} for _ in data]
    with (out / "bag-00000" / "bag-00000.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            second, rest = divmod(message.log_time, 10**9)
            assert rest == 0
            assert channel.topic not in decoded[second - 1]
            decoded[second - 1][channel.topic] = content
    return decoded


def pixels_of(image, dtype, channels=3):
    shape = (image.height, image.width, channels)
    assert image.step == image.width * channels * np.dtype(dtype).itemsize
    return np.frombuffer(bytes(image.data), dtype).reshape(shape)


def matrix(values, *shape):
    return np.array(values).reshape(shape)


def test_every_sample_has_its_second_and_its_topics(data, messages):
    for k, (stored_sample, topics) in enumerate(zip(data, messages, strict=True)):
        kinds = ("image_raw", "camera_info", "depth", "points")
        views = range(len(stored_sample.rig))
        assert topics.keys() == {"/tf"} | {
            f"/camera{i}/{kind}" for i in views for kind in kinds
        }
        for topic in topics.keys() - {"/tf"}:
            header = topics[topic].header
            assert (header.stamp.sec, header.stamp.nanosec) == (k + 1, 0)
            view = topic.removeprefix("/camera").partition("/")[0]
            assert header.frame_id == f"camera{view}_optical_frame"


def test_images_and_depths(data, messages):
    for k, (encoding, dtype) in enumerate((("rgb8", np.uint8), ("rgb16", "<u2"))):
        for view in (0, 1):
            image = messages[k][f"/camera{view}/image_raw"]
            assert image.encoding == encoding
            assert_array_equal(pixels_of(image, dtype), data[k].image(view))
            depth = messages[k][f"/camera{view}/depth"]
            assert depth.encoding == "32FC1"
            truth = data[k].truth(view)
            expected = np.where(truth.hit, truth.depth, np.nan).astype(np.float32)
            assert_array_equal(pixels_of(depth, "<f4", 1)[..., 0], expected)
            assert np.isnan(expected).any()


def test_points_are_in_the_axes_of_their_camera(data, messages):
    for stored_sample, topics in zip(data, messages, strict=True):
        for view, pose in enumerate(stored_sample.rig.world_from_cams):
            cloud = topics[f"/camera{view}/points"]
            assert [field.name for field in cloud.fields] == ["x", "y", "z", "rgb"]
            assert [field.offset for field in cloud.fields] == [0, 4, 8, 12]
            assert {field.datatype for field in cloud.fields} == {7}
            assert (cloud.point_step, cloud.row_step) == (16, 16 * cloud.width)
            values = np.frombuffer(bytes(cloud.data), "<f4").reshape(
                cloud.height, cloud.width, 4
            )
            truth = stored_sample.truth(view)
            known = ~np.isnan(values[..., 0])
            assert_array_equal(known, truth.hit)
            world = values[known, :3] @ pose[:3, :3].T + pose[:3, 3]
            assert_allclose(world, truth.position[known], atol=3e-6)
            bits = np.ascontiguousarray(values[..., 3]).view("<u4")
            rgb = np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=-1)
            image = stored_sample.image(view)
            eight = image >> 8 if image.dtype == np.uint16 else image
            assert_array_equal(rgb, eight)


def test_the_frames_are_the_poses(data, messages):
    for stored_sample, topics in zip(data, messages, strict=True):
        poses = stored_sample.rig.world_from_cams
        transforms = topics["/tf"].transforms
        for view, (transform, pose) in enumerate(zip(transforms, poses, strict=True)):
            assert transform.header.frame_id == "world"
            assert transform.child_frame_id == f"camera{view}_optical_frame"
            turn, shift = transform.transform.rotation, transform.transform.translation
            rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
            read = rigid(rotation, [shift.x, shift.y, shift.z])
            assert_allclose(read, pose, atol=1e-12)


def test_the_distortion_models(messages):
    toed = [messages[2][f"/camera{view}/camera_info"] for view in (0, 1)]
    assert [info.distortion_model for info in toed] == [
        "plumb_bob",
        "rational_polynomial",
    ]
    assert_array_equal(toed[0].d, BENT.distortion.coefficients[:5])
    assert_array_equal(toed[1].d, RATIONAL.distortion.coefficients)
    ring = [messages[3][f"/camera{view}/camera_info"] for view in range(3)]
    assert ring[0].distortion_model == "equidistant"
    assert_array_equal(ring[0].d, ROUND.distortion.coefficients)
    assert_array_equal(ring[1].d, np.zeros(5))
    for info, camera in zip(ring, (ROUND, PLAIN, BENT), strict=True):
        assert_array_equal(matrix(info.k, 3, 3), camera.K)
        assert (info.width, info.height) == (64, 48)
    assert_array_equal(matrix(ring[2].r, 3, 3), np.eye(3))
    assert_array_equal(matrix(ring[2].p, 3, 4)[:, :3], BENT.K)


def test_r_and_p_of_a_rectified_pair_are_its_own(data, messages):
    rig = data[0].rig
    for view, shift in enumerate((0.0, -rig.cameras[1].fx * rig.baseline())):
        info = messages[0][f"/camera{view}/camera_info"]
        assert_array_equal(matrix(info.r, 3, 3), np.eye(3))
        p = matrix(info.p, 3, 4)
        assert_array_equal(p[:, :3], rig.cameras[view].K)
        assert_allclose(p[:, 3], [shift, 0, 0])


def test_r_and_p_of_another_pair_are_those_of_opencv(messages):
    infos = [messages[2][f"/camera{view}/camera_info"] for view in (0, 1)]
    (k0, k1), (d0, d1) = [
        [matrix(i.k, 3, 3) for i in infos],
        [np.array(i.d) for i in infos],
    ]
    right_from_left = inverse(TOED.world_from_cams[1]) @ TOED.world_from_cams[0]
    r0, r1, p0, p1, *_ = cv2.stereoRectify(
        k0,
        d0,
        k1,
        d1,
        (64, 48),
        right_from_left[:3, :3],
        right_from_left[:3, 3:].copy(),
        alpha=-1,
    )
    for info, r, p in zip(infos, (r0, r1), (p0, p1), strict=True):
        assert_allclose(matrix(info.r, 3, 3), r, atol=1e-9)
        # OpenCV undistorts the corners of the image, on which the centre depends, in five steps.
        assert_allclose(matrix(info.p, 3, 4), p, atol=0.02)


def test_p_projects_the_rectified_points_to_equal_rows_and_true_depths(messages):
    truth = scene.truths(TOED)[0]
    world = truth.position[truth.visible & truth.hit]
    assert len(world) > 500
    infos = [messages[2][f"/camera{view}/camera_info"] for view in (0, 1)]
    pixels = []
    for info, pose in zip(infos, TOED.world_from_cams, strict=True):
        in_camera = (world - pose[:3, 3]) @ pose[:3, :3]
        rectified = in_camera @ matrix(info.r, 3, 3).T
        image = rectified @ matrix(info.p, 3, 4)[:, :3].T
        pixels.append(image[:, :2] / image[:, 2:])
    left, right = pixels
    assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    # P of both is for points in the rectified axes of the left camera: z = f B / (u_left - u_right + doffs).
    pose = TOED.world_from_cams[0]
    depth = ((world - pose[:3, 3]) @ pose[:3, :3] @ matrix(infos[0].r, 3, 3).T)[:, 2]
    p_left, p_right = (matrix(info.p, 3, 4) for info in infos)
    disparity = left[:, 0] - right[:, 0] + p_right[0, 2] - p_left[0, 2]
    assert_allclose(-p_right[0, 3] / disparity, depth, rtol=1e-9)
    assert -p_right[0, 3] == pytest.approx(0.3 * p_right[0, 0])


def test_k_and_d_give_the_pixels_by_opencv(messages):
    truth = scene.truths(TOED)[0]
    info = messages[2]["/camera0/camera_info"]
    pose = TOED.world_from_cams[0]
    in_camera = (truth.position[truth.hit] - pose[:3, 3]) @ pose[:3, :3]
    zero = np.zeros(3)
    seen, _ = cv2.projectPoints(
        in_camera, zero, zero, matrix(info.k, 3, 3), np.array(info.d)
    )
    assert_allclose(seen[:, 0], TOED.cameras[0].pixel_grid()[truth.hit], atol=1e-6)


def test_cameras_that_face_away_keep_their_images(tmp_path):
    away = stored(tmp_path / "s", unrectified(sample()))
    export([away], tmp_path / "out", "mcap")
    with AnyReader([tmp_path / "out" / "bag-00000"]) as reader:
        connections = [c for c in reader.connections if c.topic.endswith("info")]
        assert len(connections) == 2
        for connection, _, raw in reader.messages(connections):
            info = reader.deserialize(raw, connection.msgtype)
            assert np.isfinite(info.p).all()


def test_rosbags_reads_the_bag_and_its_metadata(data, tmp_path):
    export(data[:2], tmp_path / "out", "mcap")
    with AnyReader([tmp_path / "out" / "bag-00000"]) as reader:
        assert reader.message_count == 2 * (1 + 2 * 4)
        assert (reader.start_time, reader.end_time) == (10**9, 2 * 10**9 + 1)
        images_read = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/camera1/image_raw"
        ]
    for stored_sample, image in zip(data, images_read, strict=False):
        expected = stored_sample.image(1)
        assert_array_equal(
            image.data.view(expected.dtype).reshape(expected.shape), expected
        )


def test_a_bag_ends_with_the_sample_that_reaches_its_size(data):
    sources = [Source(stored_sample, k) for k, stored_sample in enumerate(data[:3])]
    names = [name for name, _ in mcap_files(sources, bag_bytes=1)]
    bags = [f"bag-{k:05d}" for k in range(3)]
    assert names[::2] == [f"{bag}/{bag}.mcap" for bag in bags]
    assert names[1::2] == [f"{bag}/metadata.yaml" for bag in bags]
    once, again = (dict(mcap_files(sources)) for _ in range(2))
    assert once == again
    assert {Path(name).parent.name for name in once} == {"bag-00000"}
