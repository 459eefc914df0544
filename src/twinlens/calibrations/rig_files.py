"""Rigs in the files of COLMAP, NeRF programs, OpenCV, ROS and Kalibr, with axes and pixel conventions converted.

COLMAP's model has no length unit: metres are assumed. The ``transform_matrix`` of NeRF's transforms.json is
world_from_cam with OpenGL's camera axes (x right, y up, z backward). Both count pixels from the image's corner: cx and
cy are larger by 0.5. OpenCV's YAML has the names of its stereo calibration sample, ``M1 D1 M2 D2 R T`` (first to second
camera, metres), and ours: ``size1`` ([width, height]) and ``fisheye1`` (1 for the Kannala-Brandt model), the same for
camera 2, and ``world_from_1``, the pose of the pair.

Sources: https://colmap.github.io/format.html#text-format and .../cameras.html; Nerfstudio, "Data conventions";
instant-ngp, docs/nerf_dataset_tips.md; OpenCV, samples/cpp/stereo_calib.cpp, and its documentation of FileStorage.
"""

import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens.calibrations.colmap_binary import binary_cameras, binary_images
from twinlens.calibrations.storages import (
    matrix,
    number,
    numbers,
    read_storage,
    read_text,
)
from twinlens.camera import BrownConrady, Camera, Distortion, KannalaBrandt, Rig
from twinlens.errors import (
    FileError,
    InputError,
    check_known,
    counted,
    format_value,
    located,
    warn_not_used,
)
from twinlens.geometry import Float, check_rigid, inverse, rigid

FilePath = str | os.PathLike[str]

COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
"""The parameters of each supported camera model, in COLMAP's order."""

CORNER = 0.5
"""Added to cx and cy where pixels are counted from the image's corner."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns our camera axes into OpenGL's, and back."""
_NERF_NAMES = {
    *("frames", "file_path", "transform_matrix", "camera_model", "w", "h"),
    *("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "cx", "cy"),
    *("k1", "k2", "k3", "k4", "p1", "p2", "is_fisheye"),
}
_NERF_NOTES = {
    *("depth_file_path", "ply_file_path"),
    *("train_filenames", "val_filenames", "test_filenames"),
}
"""What a transforms.json says of images and points, not of cameras."""
_NERF_MODELS = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE")


@dataclass(frozen=True, eq=False)
class NamedRig:
    """A rig, and what else its file says.

    names : one image name per camera.
    has_model, has_unit : whether the file states the model of the distortion, and the unit of its lengths.
    ndisp : bound of the disparities of the file's own scene, or None.
    """

    rig: Rig
    names: tuple[str, ...]
    has_model: bool = True
    has_unit: bool = False
    ndisp: int | None = None


def read_colmap(folder: FilePath, binary: bool | None = None) -> NamedRig:
    """The rig of a model's images, in the order of their ids.

    binary : whether to read cameras.bin and images.bin; None is where there is no cameras.txt. Raises FileError.
    """
    folder = Path(folder)
    if binary is None:
        has_text = (folder / "cameras.txt").exists()
        binary = not has_text and (folder / "cameras.bin").exists()
    if binary:
        cameras_path, path = folder / "cameras.bin", folder / "images.bin"
        cameras, unordered = _binary_cameras(cameras_path), _binary_images(path)
    else:
        cameras_path, path = folder / "cameras.txt", folder / "images.txt"
        cameras, unordered = _text_cameras(cameras_path), _text_images(path)
    images = sorted(unordered, key=lambda image: image[0])
    if not images:
        raise FileError(f"{path}: has no images")
    _, used, names, poses = zip(*images, strict=True)
    if missing := [camera for camera in used if camera not in cameras]:
        raise FileError(
            f"{path}: refers to camera {missing[0]}, which {cameras_path.name} does not have"
        )
    return NamedRig(Rig([cameras[camera] for camera in used], poses), names)


def _text_cameras(path: Path) -> dict[int, Camera]:
    """The cameras of cameras.txt by their ids."""
    cameras: dict[int, Camera] = {}
    for line_number, line in _lines(path):
        words = line.split()
        try:
            if words:
                numbers = [float(word) for word in words[4:]]
                cameras[int(words[0])] = _colmap_camera(
                    words[1], int(words[2]), int(words[3]), numbers
                )
        except (ValueError, IndexError) as error:
            raise FileError(
                f"{path}: line {line_number} must read ID MODEL WIDTH HEIGHT PARAMS: {error}"
            ) from None
    return cameras


def _binary_cameras(path: Path) -> dict[int, Camera]:
    """The cameras of cameras.bin by their ids."""
    cameras: dict[int, Camera] = {}
    for identity, model, width, height, values in binary_cameras(path, COLMAP_MODELS):
        try:
            cameras[identity] = _colmap_camera(model, width, height, values)
        except ValueError as error:
            raise FileError(f"{path}: camera {identity}: {error}") from None
    return cameras


def _binary_images(path: Path) -> Iterator[tuple[int, int, str, Float]]:
    """(id, camera id, name, world_from_cam) of each image of images.bin."""
    for identity, camera, name, pose in binary_images(path):
        try:
            yield identity, camera, name, _colmap_pose(pose)
        except ValueError as error:
            raise FileError(f"{path}: image {identity}: {error}") from None


def read_transforms(path: FilePath, size: tuple[int, int] | None = None) -> NamedRig:
    """The rig of a transforms.json, in the order of its frames.

    size : (width, height), for files without w and h. Raises FileError.
    """
    text = read_text(Path(path))
    where = ""
    try:
        table = json.loads(text)
        frames = table["frames"]
        if not frames:
            raise InputError("frames is empty, and a rig needs a camera")
        if size is not None:
            table |= dict(zip(("w", "h"), size, strict=True))
        cameras, poses, image_names = [], [], []
        for i, frame in enumerate(frames):
            where = f"frames[{i}]"
            with located(where):
                cameras.append(_nerf_camera(table, frame))
                poses.append(_nerf_pose(frame))
                image_names.append(str(frame["file_path"]))
        names = {name for keys in (table, *frames) for name in keys}
        warn_not_used(path, sorted(names - _NERF_NAMES - _NERF_NOTES))
        return NamedRig(Rig(cameras, poses), tuple(image_names))
    except KeyError as error:
        place = f"{where}: " if where else ""
        raise FileError(f"{path}: {place}has no {error.args[0]}") from None
    except (ValueError, TypeError, ArithmeticError, RecursionError) as error:
        raise FileError(f"{path}: not a valid transforms.json: {error}") from None


def _nerf_pose(frame: Mapping[str, Any]) -> Float:
    """world_from_cam of a frame. Its last row, 0 0 0 1, may be left out, as in nerfstudio's files."""
    values = numbers(frame["transform_matrix"], "transform_matrix")
    if len(values) == 12:
        values = np.concatenate([values, [0.0, 0.0, 0.0, 1.0]])
    pose = matrix(values, "transform_matrix", 4, 4) @ OPENGL
    return check_rigid(pose, "transform_matrix")


def read_opencv(
    path: FilePath,
    size: tuple[int, int] | None = None,
    extrinsics: FilePath | None = None,
    fisheye: bool = False,
) -> Rig:
    """The pair in an OpenCV stereo file in YAML, XML or JSON; without a pose, the world is the first camera's frame.

    size : (width, height), for files without it.
    extrinsics : the file of R and T where they are in another file, as in OpenCV's sample.
    fisheye : whether the coefficients are those of `cv2.fisheye`, which a file of OpenCV does not state.

    Camera matrices are named M1, K1 or cameraMatrix1, coefficients D1 or distCoeffs1, and the same of camera 2. T is in
    metres. R is a matrix or a rotation vector of `cv2.Rodrigues`, three radians. A matrix of few digits is made
    orthonormal as far as its digits explain (`geometry.check_rigid`). Raises FileError.
    """
    values = read_storage(Path(path))
    if extrinsics is not None:
        values |= read_storage(Path(extrinsics))
    try:
        pose = np.eye(4)
        if "world_from_1" in values:
            pose = matrix(values["world_from_1"], "world_from_1", 4, 4)
        rotation = _opencv_rotation(values["R"])
        second_from_first = rigid(rotation, matrix(values["T"], "T", 1, 3)[0])
        cameras = [_opencv_camera(values, i, size, fisheye) for i in (1, 2)]
        others = values.keys() - _OPENCV_READ - _OPENCV_NOTES
        texts = {name for name in others if isinstance(values[name], str)}
        warn_not_used(path, sorted(others - texts))
        return Rig(cameras, [pose, pose @ inverse(second_from_first)])
    except KeyError as error:
        raise FileError(
            f"{path}: has no {error.args[0]}; it needs M1, D1, M2, D2, R, T and the images' size, "
            "which --size or size= can state, and width and height beside file in the table of a rig"
        ) from None
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None


def _opencv_rotation(value: Any) -> Float:
    """The matrix of R (3, 3), also of a rotation vector: its axis, as long as its angle in radians.

    Raises InputError, also for a vector longer than a full turn, whose unit is probably not the radian.
    """
    stated = numbers(value, "R")
    if len(stated) != 3:
        return matrix(value, "R", 3, 3)
    angle = float(np.linalg.norm(stated))
    if angle > 2 * math.pi:
        raise InputError(
            f"R of three numbers is a rotation vector in radians, got an angle of {angle:.3g}"
        )
    return np.asarray(Rotation.from_rotvec(stated).as_matrix())


def read_ros(left: FilePath, right: FilePath) -> Rig:
    """The pair in two camera_info files of ROS's stereo calibration; the world is the left camera's frame.

    The rectified cameras have parallel axes, so that the second camera's frame follows from the rectifications R and
    the right projection matrix P, whose last column is fx' times the shift in metres. Raises FileError. Source:
    sensor_msgs/CameraInfo.
    """
    cameras, rectified_from_cam = [], []
    shifts = []
    for path in (left, right):
        values = _as_camera_info(read_storage(Path(path)))
        try:
            cameras.append(_ros_camera(values))
            rotation = matrix(
                values["rectification_matrix"], "rectification_matrix", 3, 3
            )
            rectified_from_cam.append(rigid(rotation, np.zeros(3)))
            projection = matrix(values["projection_matrix"], "projection_matrix", 3, 4)
            if not (projection[0, 0] > 0 and projection[1, 1] > 0):
                raise InputError("projection_matrix needs positive focal lengths")
            focal = np.array([projection[0, 0], projection[1, 1], 1.0])
            shifts.append(projection[:, 3] / focal)
            warn_not_used(path, _ros_not_used(values))
        except KeyError as error:
            raise FileError(f"{path}: has no {error.args[0]}") from None
        except ValueError as error:
            raise FileError(f"{path}: {error}") from None
    if not shifts[1].any():
        likely = (
            f"the files are exchanged, {left} is the right camera's"
            if shifts[0].any()
            else "is it the right camera of a pair?"
        )
        raise FileError(
            f"{right}: projection_matrix has no baseline in its last column; {likely}"
        )
    between = rigid(np.eye(3), shifts[1])
    right_from_left = inverse(rectified_from_cam[1]) @ between @ rectified_from_cam[0]
    return Rig(cameras, [np.eye(4), inverse(right_from_left)])


def read_euroc(left: FilePath, right: FilePath) -> NamedRig:
    """The pair in two sensor.yaml files of the EuRoC MAV dataset; the world is the left camera's frame.

    T_BS is body_from_cam. Cameras have the names of their folders. Raises FileError. Source: Burri et al., The EuRoC
    micro aerial vehicle datasets, IJRR 35(10), 2016.
    """
    cameras, body_from_cams = [], []
    for path in (left, right):
        values = read_storage(Path(path))
        try:
            cameras.append(_euroc_camera(values))
            body_from_cam = matrix(values["T_BS"], "T_BS", 4, 4)
            body_from_cams.append(check_rigid(body_from_cam, "T_BS"))
            warn_not_used(path, sorted(values.keys() - _EUROC - _EUROC_NOTES))
        except KeyError as error:
            raise FileError(f"{path}: has no {error.args[0]}") from None
        except ValueError as error:
            raise FileError(f"{path}: {error}") from None
    left_from_right = inverse(body_from_cams[0]) @ body_from_cams[1]
    names = (Path(left).parent.name or "left", Path(right).parent.name or "right")
    return NamedRig(Rig(cameras, [np.eye(4), left_from_right]), names)


def read_kalibr(path: FilePath) -> NamedRig:
    """The rig in a camchain file of Kalibr; the world is the frame of cam0, names are the topics.

    Raises FileError. Source: https://github.com/ethz-asl/kalibr/wiki/yaml-formats.
    """
    values = read_storage(Path(path))
    cameras: list[Camera] = []
    poses = [np.eye(4)]
    names: list[str] = []
    not_used: list[str] = []
    try:
        while (name := f"cam{len(cameras)}") in values:
            table = values[name]
            if not isinstance(table, dict):
                raise InputError(f"{name} must have keys, got {format_value(table)}")
            with located(name):
                if cameras:
                    this_from_last = matrix(table["T_cn_cnm1"], "T_cn_cnm1", 4, 4)
                    checked = check_rigid(this_from_last, "T_cn_cnm1")
                    poses.append(poses[-1] @ inverse(checked))
                cameras.append(_kalibr_camera(table))
                not_used += sorted(f"{name}.{key}" for key in table.keys() - _KALIBR)
            names.append(str(table.get("rostopic", name)))
    except KeyError as error:
        raise FileError(f"{path}: cam{len(cameras)} has no {error.args[0]}") from None
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None
    if not cameras:
        raise FileError(f"{path}: has no cam0")
    names_of_cameras = {f"cam{i}" for i in range(len(cameras))}
    warn_not_used(path, [*sorted(values.keys() - names_of_cameras), *not_used])
    return NamedRig(Rig(cameras, poses[: len(cameras)]), tuple(names))


def _colmap_camera(model: str, width: int, height: int, numbers: list[float]) -> Camera:
    check_known("COLMAP camera model", model, COLMAP_MODELS)
    names = COLMAP_MODELS[model].split()
    if len(numbers) != len(names):
        raise InputError(
            f"{model} has {counted(len(names), 'parameter')}, got {len(numbers)}"
        )
    values = dict(zip(names, numbers, strict=True))
    focal = values.pop("f", 0.0)
    fx, fy = values.pop("fx", focal), values.pop("fy", focal)
    cx, cy = values.pop("cx") - CORNER, values.pop("cy") - CORNER
    if "FISHEYE" in model:
        return Camera(width, height, fx, fy, cx, cy, KannalaBrandt(**values))
    return Camera(
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        BrownConrady(**values) if any(values.values()) else None,
    )


def _text_images(path: Path) -> Iterator[tuple[int, int, str, Float]]:
    """(id, camera id, name, world_from_cam) of each image; every second line has its 2D points and may be empty."""
    lines = list(_lines(path))
    while lines and not lines[-1][1].strip():
        lines.pop()
    for line_number, line in lines[::2]:
        words = line.split(maxsplit=9)
        try:
            pose = _colmap_pose([float(word) for word in words[1:8]])
            yield int(words[0]), int(words[8]), words[9].strip(), pose
        except (ValueError, IndexError) as error:
            form = "ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            raise FileError(
                f"{path}: line {line_number} must read {form}: {error}"
            ) from None


def _colmap_pose(numbers: list[float]) -> Float:
    """world_from_cam of QW QX QY QZ TX TY TZ, which are of cam_from_world. Raises ValueError."""
    w, x, y, z, *shift = numbers
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    return inverse(rigid(rotation, shift))


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines without comments, numbered from 1."""
    numbered = enumerate(read_text(path).splitlines(), 1)
    return (
        (number, line) for number, line in numbered if not line.lstrip().startswith("#")
    )


def _nerf_camera(shared: Mapping[str, Any], frame: Any) -> Camera:
    """The camera of a frame, whose keys replace those of all frames."""
    if not isinstance(frame, Mapping):
        raise InputError(f"must be a table, got {format_value(frame)}")
    values = {**shared, **frame}
    if not {"w", "h"} <= values.keys():
        raise InputError(
            "has no w and h, the size of its image, which --size or size= can state"
        )
    width, height = _size([values["w"], values["h"]], "w, h")
    fx = _nerf_focal_px(values, "x", width)
    if fx is None:
        raise KeyError("fl_x")
    fy = _nerf_focal_px(values, "y", height)
    cx = _number(values, "cx", width / 2) - CORNER
    cy = _number(values, "cy", height / 2) - CORNER
    distortion = _nerf_distortion(values)
    return Camera(width, height, fx, fx if fy is None else fy, cx, cy, distortion)


def _number(values: Mapping[str, Any], name: str, default: float = 0.0) -> float:
    return number(values.get(name, default), name)


def _nerf_focal_px(values: Mapping[str, Any], axis: str, size: int) -> float | None:
    """The focal length along an axis in pixels, None where neither it nor the field of view is there."""
    if f"fl_{axis}" in values:
        return _number(values, f"fl_{axis}")
    if f"camera_angle_{axis}" not in values:
        return None
    return 0.5 * size / math.tan(0.5 * _number(values, f"camera_angle_{axis}"))


def _nerf_distortion(values: Mapping[str, Any]) -> Distortion | None:
    """The distortion by camera_model, or by is_fisheye in files without one."""
    is_fisheye = bool(values.get("is_fisheye", False))
    model = values.get("camera_model", "OPENCV_FISHEYE" if is_fisheye else "OPENCV")
    check_known("camera_model", model, _NERF_MODELS)
    if is_fisheye and model != "OPENCV_FISHEYE":
        raise InputError(f"is_fisheye is true, but camera_model is {model}")
    k1, k2, k3, k4 = (_number(values, name) for name in ("k1", "k2", "k3", "k4"))
    if model == "OPENCV_FISHEYE":
        return KannalaBrandt(k1, k2, k3, k4)
    if k4:
        raise InputError("k4 of a perspective camera is not supported")
    p1, p2 = _number(values, "p1"), _number(values, "p2")
    if not any((k1, k2, k3, p1, p2)):
        return None
    return BrownConrady(k1, k2, p1, p2, k3)


_SIZES = ("image_size", "imageSize", "img_size", "imgSize", "size")
"""Names that people give the size of both cameras' images, a cv::Size: width, height. OpenCV's samples have none."""


def has_size(values: Mapping[str, Any]) -> bool:
    """Whether a file of OpenCV, or a transforms.json, states the size of its images."""
    return bool(
        {"size1", "image_width", *_SIZES} & values.keys() or {"w", "h"} <= values.keys()
    )


_OPENCV_NAMES = {"M": ("M", "K", "cameraMatrix"), "D": ("D", "distCoeffs")}


def _opencv_camera(
    values: Mapping[str, Any], i: int, size: tuple[int, int] | None, fisheye: bool
) -> Camera:
    if size is None:
        name = next(
            (name for name in (f"size{i}", *_SIZES) if name in values), "image_width"
        )
        image = values[name]
        if name == "image_width":
            image = [image, values["image_height"]]
            name = "image_width, image_height"
        size = _size(image, name)
    names = {
        key: next(
            (f"{name}{i}" for name in spellings if f"{name}{i}" in values), f"{key}{i}"
        )
        for key, spellings in _OPENCV_NAMES.items()
    }
    k = _camera_matrix(values[names["M"]], names["M"])
    stated = _number(values, f"fisheye{i}", int(fisheye))
    distortion = _distortion(values[names["D"]], names["D"], bool(stated))
    return Camera(*size, *k, distortion)


_OPENCV_READ = {
    *(
        f"{name}{i}"
        for names in _OPENCV_NAMES.values()
        for name in names
        for i in (1, 2)
    ),
    *(f"{name}{i}" for name in ("size", "fisheye") for i in (1, 2)),
    *("image_width", "image_height", *_SIZES, "R", "T", "world_from_1"),
}
_OPENCV_NOTES = {
    *("R1", "R2", "P1", "P2", "Q", "E", "F"),
    *("calibration_time", "nframes", "nr_of_frames", "flags", "square_size"),
    *("board_width", "board_height", "avg_reprojection_error", "rms", "error"),
}
"""What follows from the values that are read, and how they were found."""


def _ros_not_used(values: Mapping[str, Any]) -> list[str]:
    """What a camera_info has besides the pose and the camera; binning or a region of all pixels change nothing."""
    parts = []
    for name in sorted(values.keys() - _ROS_READ):
        value = values[name]
        flat = list(value.values()) if isinstance(value, Mapping) else [value]
        if name not in ("binning_x", "binning_y", "roi"):
            parts.append(name)
        elif any(item not in (0, 1, False) for item in flat):
            parts.append(f"{name} (the whole image)")
    return parts


_ROS_MESSAGE = {
    "height": "image_height",
    "width": "image_width",
    "k": "camera_matrix",
    "d": "distortion_coefficients",
    "r": "rectification_matrix",
    "p": "projection_matrix",
}
"""Fields of the message as `ros2 topic echo` prints them (`rostopic echo`: K, D, R, P), and their names in files."""


def is_camera_info(values: Mapping[str, Any]) -> bool:
    """Whether values are those of a camera_info of ROS, as a file has them or as a message is printed."""
    is_message = any({"height", *names} <= values.keys() for names in ("KDRP", "kdrp"))
    return is_message or "projection_matrix" in values


def _as_camera_info(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values with the names that files have; the header of a message, its time, is left out."""
    if "projection_matrix" in values or not is_camera_info(values):
        return dict(values)
    return {
        _ROS_MESSAGE.get(name.lower(), name): value
        for name, value in values.items()
        if name != "header"
    }


_ROS_READ = {
    *("image_width", "image_height", "camera_name", "camera_matrix"),
    *("distortion_model", "distortion_coefficients"),
    *("rectification_matrix", "projection_matrix"),
}
_ROS_MODELS = {
    "plumb_bob": False,
    "rational_polynomial": False,
    "equidistant": True,
    "fisheye": True,
}
"""Distortion models of ROS, and whether they are the Kannala-Brandt fisheye."""


def _ros_camera(values: Mapping[str, Any]) -> Camera:
    size = _size(
        [values["image_width"], values["image_height"]], "image_width, image_height"
    )
    k = _camera_matrix(values["camera_matrix"], "camera_matrix")
    model = values.get("distortion_model", "plumb_bob")
    check_known("distortion_model", model, _ROS_MODELS)
    coefficients = values["distortion_coefficients"]
    distortion = _distortion(
        coefficients, "distortion_coefficients", _ROS_MODELS[model]
    )
    return Camera(*size, *k, distortion)


_EUROC = {
    *("T_BS", "camera_model", "intrinsics", "resolution"),
    *("distortion_model", "distortion_coefficients"),
}
_EUROC_NOTES = {"sensor_type", "comment", "rate_hz"}
_EUROC_MODELS = {
    "radial-tangential": False,
    "radtan": False,
    "equidistant": True,
    "none": False,
}


def _euroc_camera(values: Mapping[str, Any]) -> Camera:
    check_known("camera_model", values["camera_model"], ["pinhole"])
    size = _size(values["resolution"], "resolution")
    fx, fy, cx, cy = matrix(values["intrinsics"], "intrinsics", 1, 4)[0].tolist()
    model = values["distortion_model"]
    check_known("distortion_model", model, _EUROC_MODELS)
    coefficients = values["distortion_coefficients"] if model != "none" else []
    name = "distortion_coefficients"
    distortion = _distortion(coefficients, name, _EUROC_MODELS[model])
    return Camera(*size, fx, fy, cx, cy, distortion)


_KALIBR = {
    *("camera_model", "intrinsics", "distortion_model", "distortion_coeffs"),
    *("resolution", "rostopic", "T_cn_cnm1", "cam_overlaps"),
}
_KALIBR_MODELS = {"radtan": False, "equidistant": True, "none": False}


def _kalibr_camera(table: Mapping[str, Any]) -> Camera:
    check_known("camera_model", table["camera_model"], ["pinhole"])
    size = _size(table["resolution"], "resolution")
    fx, fy, cx, cy = matrix(table["intrinsics"], "intrinsics", 1, 4)[0].tolist()
    model = table.get("distortion_model", "none")
    check_known("distortion_model", model, _KALIBR_MODELS)
    coefficients = table.get("distortion_coeffs", []) if model != "none" else []
    distortion = _distortion(coefficients, "distortion_coeffs", _KALIBR_MODELS[model])
    return Camera(*size, fx, fy, cx, cy, distortion)


def _size(value: Any, name: str) -> tuple[int, int]:
    """(width, height). Raises InputError for other numbers than two whole ones."""
    pair = numbers(value, name)
    if len(pair) != 2 or not (pair == np.round(pair)).all():
        raise InputError(
            f"{name} must be the width and the height in pixels, got {pair.tolist()}"
        )
    return int(pair[0]), int(pair[1])


def _camera_matrix(value: Any, name: str) -> tuple[float, float, float, float]:
    """(fx, fy, cx, cy) of a camera matrix. Raises InputError for other matrices."""
    k = matrix(value, name, 3, 3)
    if k[0, 1] or k[1, 0] or k[2].tolist() != [0, 0, 1]:
        raise InputError(
            f"{name} must be a camera matrix fx 0 cx, 0 fy cy, 0 0 1, without skew"
        )
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])


def _distortion(value: Any, name: str, is_fisheye: bool) -> Distortion | None:
    """The model of coefficients in OpenCV's order. Raises InputError for other numbers of them."""
    coefficients = numbers(value, name).tolist()
    if is_fisheye:
        if len(coefficients) != 4:
            raise InputError(
                f"{name} of a fisheye has 4 coefficients, got {len(coefficients)}"
            )
        return KannalaBrandt(*coefficients)
    if len(coefficients) not in (0, 4, 5, 8, 12, 14) or any(coefficients[8:]):
        raise InputError(
            f"{name} must hold 4, 5 or 8 coefficients (no thin prism, no tilt), got {coefficients}"
        )
    return BrownConrady(*coefficients[:8]) if any(coefficients) else None
