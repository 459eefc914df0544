"""Export as ROS 2 bags in MCAP files, by the library rosbags. `export` has the table of all layouts.

Sample k of the export is at second k + 1: time 0 means "the latest" in tf. The axes of ROS's optical frames are ours: x
right, y down, z forward.

Sources: common_interfaces of ROS 2, sensor_msgs/msg/{Image,CameraInfo,PointCloud2}.msg; REP 103 and 104 (frames and
CameraInfo), 117 and 118 (unknown depths are NaN); https://mcap.dev/spec.
"""

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinlens.camera import Camera, KannalaBrandt, Rig
from twinlens.camera.rectification import rectify
from twinlens.camera.truth import Truth
from twinlens.dataset.layouts import FILE_BYTES, Source
from twinlens.dataset.pictures import rgb8
from twinlens.errors import InputError, import_extra
from twinlens.geometry import Float, inverse, transform_points

_BAG_VERSION = 8  # read by Iron and later; Humble reads the .mcap file
_WORLD = "world"
_FLOAT32 = 7  # PointField.FLOAT32
_FIELDS = ("x", "y", "z", "rgb")
_POINT = np.dtype([("position", "<f4", 3), ("bgr0", "u1", 4)])
_ENCODINGS = {
    (np.uint8, 3): "rgb8",
    (np.uint8, 1): "mono8",
    (np.uint16, 3): "rgb16",
    (np.uint16, 1): "mono16",
    (np.float32, 1): "32FC1",
}
"""ROS's name of an image by its dtype and its number of channels."""


def mcap(
    sources: Iterable[Source], bag_bytes: int = FILE_BYTES
) -> Iterator[tuple[str, bytes]]:
    """bag-00000/ and so on: bag-00000.mcap and metadata.yaml; a bag ends with the sample that reaches `bag_bytes`.

    Of each view i: /camera<i>/image_raw, camera_info, depth (32FC1, metres) and points, and its frame in /tf, below
    the frame "world". Raises MissingExtraError without rosbags, FileError without truth.
    """
    rosbag2 = import_extra("rosbags.rosbag2", "ros")
    typesys = import_extra("rosbags.typesys", "ros")
    types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    waiting = iter(sources)
    source = next(waiting, None)
    number = 0
    while source is not None:
        name = f"bag-{number:05d}"
        with tempfile.TemporaryDirectory(prefix="twinlens-") as temporary:
            bag = _Bag(rosbag2, types, Path(temporary) / name)
            while source is not None and bag.num_bytes < bag_bytes:
                bag.add(source)
                source = next(waiting, None)
            bag.writer.close()
            for file in (f"{name}.mcap", "metadata.yaml"):
                yield f"{name}/{file}", (Path(temporary) / name / file).read_bytes()
        number += 1


class _Bag:
    """A bag that is being written; `num_bytes` counts its messages before compression."""

    def __init__(self, rosbag2: Any, types: Any, folder: Path) -> None:
        self.writer = rosbag2.Writer(
            folder,
            version=_BAG_VERSION,
            storage_plugin=rosbag2.StoragePlugin.MCAP,
        )
        self.writer.set_compression(
            rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD
        )
        self.writer.open()
        self.num_bytes = 0
        self._types = types
        self._connections: dict[str, Any] = {}

    def add(self, source: Source) -> None:
        """Write the messages of a sample."""
        rig = source.sample.rig
        second = source.index + 1
        transforms = [
            self._transform(second, view, rig.world_from_cams[view])
            for view in range(len(rig))
        ]
        kind = "tf2_msgs/msg/TFMessage"
        self._write("/tf", kind, second, transforms=transforms)
        for view, info in enumerate(_camera_infos(rig)):
            self._add_view(source, view, info)

    def _add_view(self, source: Source, view: int, info: dict[str, Any]) -> None:
        """Write the messages of a view, whose CameraInfo has these fields."""
        sample = source.sample
        truth = sample.truth(view)
        image = sample.lens(source.lens).image(view)
        depth = np.where(truth.hit, truth.depth, np.nan).astype(np.float32)
        points = _points(truth, sample.rig.world_from_cams[view], image)
        region = self._made("sensor_msgs/msg/RegionOfInterest", **_WHOLE)
        messages = (
            ("image_raw", "Image", _image(image)),
            ("depth", "Image", _image(depth)),
            ("camera_info", "CameraInfo", {**info, "roi": region}),
            ("points", "PointCloud2", {**points, "fields": self._fields()}),
        )
        second = source.index + 1
        header = self._header(second, _frame(view))
        for topic, kind, values in messages:
            topic, kind = f"/camera{view}/{topic}", f"sensor_msgs/msg/{kind}"
            self._write(topic, kind, second, header=header, **values)

    def _fields(self) -> list[Any]:
        """The fields of a point of `_POINT`."""
        kind = "sensor_msgs/msg/PointField"
        return [
            self._made(kind, name=name, offset=4 * i, datatype=_FLOAT32, count=1)
            for i, name in enumerate(_FIELDS)
        ]

    def _made(self, kind: str, **values: Any) -> Any:
        """A message, or a part of one."""
        return self._types.types[kind](**values)

    def _header(self, second: int, frame: str) -> Any:
        stamp = self._made("builtin_interfaces/msg/Time", sec=second, nanosec=0)
        return self._made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _transform(self, second: int, view: int, world_from_cam: Float) -> Any:
        """The pose of a camera in the world."""
        shift = dict(zip("xyz", world_from_cam[:3, 3].tolist(), strict=True))
        turn = Rotation.from_matrix(world_from_cam[:3, :3]).as_quat().tolist()
        pose = self._made(
            "geometry_msgs/msg/Transform",
            translation=self._made("geometry_msgs/msg/Vector3", **shift),
            rotation=self._made(
                "geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True))
            ),
        )
        return self._made(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(second, _WORLD),
            child_frame_id=_frame(view),
            transform=pose,
        )

    def _write(self, topic: str, kind: str, second: int, **values: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(
                topic, kind, typestore=self._types
            )
        message = self._types.serialize_cdr(self._made(kind, **values), kind)
        self.writer.write(self._connections[topic], second * 10**9, message)
        self.num_bytes += len(message)


_WHOLE = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
"""The region of interest of a whole image."""


def _frame(view: int) -> str:
    return f"camera{view}_optical_frame"


def _image(pixels: NDArray[Any]) -> dict[str, Any]:
    """The fields of an Image, rows from the top."""
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
    return {
        "height": height,
        "width": width,
        "encoding": _ENCODINGS[pixels.dtype.type, channels],
        "is_bigendian": 0,
        "step": len(data) // height,
        "data": data,
    }


def _points(truth: Truth, world_from_cam: Float, image: NDArray[Any]) -> dict[str, Any]:
    """The fields of a PointCloud2 but its `fields`: a point for each pixel, camera axes, NaN where unknown."""
    height, width = truth.depth.shape
    world = np.where(truth.hit[..., None], truth.position, np.nan)
    points = np.zeros((height, width), _POINT)
    points["position"] = transform_points(inverse(world_from_cam), world)
    # rgb is 0x00RRGGBB in the bits of a float: blue is the first byte.
    points["bgr0"][..., :3] = rgb8(image)[..., ::-1]
    return {
        "height": height,
        "width": width,
        "is_bigendian": False,
        "point_step": _POINT.itemsize,
        "row_step": _POINT.itemsize * width,
        "data": np.frombuffer(points.tobytes(), np.uint8),
        "is_dense": False,
    }


def _camera_infos(rig: Rig) -> list[dict[str, Any]]:
    """The fields of the CameraInfo of each view but its region of interest.

    R and P of the first two views are those of the rectified pair, with -fx baseline in the last column of the right
    P. Those of other views, and of a pair that has no rectification, change nothing: R is 1 and P is K.
    """
    rotations = [np.eye(3)] * len(rig)
    projections = [np.hstack([camera.K, np.zeros((3, 1))]) for camera in rig.cameras]
    if len(rig) > 1:
        rotations[:2], projections[:2] = _rectified(rig)
    return [
        {
            "height": camera.height,
            "width": camera.width,
            **_distortion(camera),
            "k": camera.K.ravel(),
            "r": rotation.ravel(),
            "p": projection.ravel(),
            "binning_x": 0,
            "binning_y": 0,
        }
        for camera, rotation, projection in zip(
            rig.cameras, rotations, projections, strict=True
        )
    ]


def _rectified(rig: Rig) -> tuple[list[Float], list[Float]]:
    """R (3, 3) and P (3, 4) of the first two views."""
    pair = rig.pair(0, 1)
    rotations = [np.eye(3), np.eye(3)]
    cameras, baseline = pair.cameras, pair.baseline()
    if not pair.is_rectified():
        try:
            result = rectify(pair, fit="opencv")
        except InputError:
            # Cameras behind each other, or with nothing in common, have no rectified pair.
            cameras, baseline = pair.cameras, 0.0
        else:
            rotations = [result.rotation(side) for side in (0, 1)]
            cameras = result.rectified_rig.cameras
    shifts = [0.0, 0.0 - cameras[1].fx * baseline]
    projections = []
    for camera, shift in zip(cameras, shifts, strict=True):
        projections.append(np.hstack([camera.K, [[shift], [0.0], [0.0]]]))
    return rotations, projections


def _distortion(camera: Camera) -> dict[str, Any]:
    """ROS's name of the distortion, and its coefficients: OpenCV's, as many as the name has."""
    if camera.distortion is None:
        return {"distortion_model": "plumb_bob", "d": np.zeros(5)}
    coefficients = np.array(camera.distortion.coefficients)
    if isinstance(camera.distortion, KannalaBrandt):
        return {"distortion_model": "equidistant", "d": coefficients}
    if coefficients[5:].any():
        return {"distortion_model": "rational_polynomial", "d": coefficients}
    return {"distortion_model": "plumb_bob", "d": coefficients[:5]}
