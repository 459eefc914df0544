"""OpenCV's FileStorage YAML of a calibrated pair, with the names of its stereo calibration sample.

``M1 D1 M2 D2`` are K and distortion of the two cameras; ``R`` and ``T`` transform points from the first camera's frame
to the second's, in metres (the unit of other files is not converted). Axes and pixel centres are the same as here.
Additional keys: ``size1``, ``size2`` ([width, height]), ``fisheye1``, ``fisheye2`` (1 for the Kannala-Brandt model) and
``world_from_1``, the pose of the pair.

Source: OpenCV, samples/cpp/stereo_calib.cpp, and its documentation of FileStorage.
"""

import os
import re

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera import BrownConrady, Camera, Distortion, KannalaBrandt, Rig
from twinlens.dataset.files import write_file
from twinlens.dataset.poses.named import read_text
from twinlens.errors import FileError, InputError
from twinlens.geometry import Float, inverse, rigid

Nodes = dict[str, Float]

_MATRIX = re.compile(
    r"^(\w+):\s*!!opencv-matrix\s+rows:\s*(\d+)\s+cols:\s*(\d+)\s+dt:\s*\S+\s+data:\s*\[([^\]]*)\]", re.M
)
_LIST = re.compile(r"^(\w+):\s*\[([^\]]*)\]", re.M)
_NUMBER = re.compile(r"^(\w+):[ \t]*([-+.\w]+)[ \t]*$", re.M)


def write_opencv(path: str | os.PathLike[str], rig: Rig) -> None:
    """Write a pair for `cv2.FileStorage`. Raises InputError unless the rig has two cameras, and OutputError."""
    if len(rig) != 2:
        raise InputError(f"OpenCV's stereo files describe a pair, got {len(rig)} cameras: write COLMAP's text instead")
    text = ["%YAML:1.0", "---"]
    for i, camera in enumerate(rig.cameras, 1):
        text += [f"size{i}: [ {camera.width}, {camera.height} ]"]
        text += [f"fisheye{i}: {int(isinstance(camera.distortion, KannalaBrandt))}"]
        text += [_matrix_text(f"M{i}", camera.K), _matrix_text(f"D{i}", [_coefficients(camera.distortion)])]
    second_from_first = rig.b_from_a(0, 1)
    text += [_matrix_text("R", second_from_first[:3, :3]), _matrix_text("T", second_from_first[:3, 3:])]
    text += [_matrix_text("world_from_1", rig.world_from_cams[0])]
    write_file(path, ("\n".join(text) + "\n").encode())


def read_opencv(path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> Rig:
    """The pair in an OpenCV stereo file; without a pose, the world is the first camera's frame.

    `size` (width, height) is needed for files without it, as OpenCV's intrinsics.yml and extrinsics.yml joined in one
    file. Raises FileError.
    """
    nodes = _nodes(read_text(path))
    try:
        pose = nodes.get("world_from_1", np.eye(4))
        second_from_first = rigid(nodes["R"], nodes["T"].ravel())
        cameras = [_camera(nodes, i, size) for i in (1, 2)]
        return Rig(cameras, [pose, pose @ inverse(second_from_first)])
    except KeyError as error:
        raise FileError(f"{path}: has no {error.args[0]}; it needs M1, D1, M2, D2, R, T and the images' size") from None
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None


def _coefficients(distortion: Distortion | None) -> tuple[float, ...]:
    return (0.0,) * 5 if distortion is None else distortion.coefficients


def _matrix_text(name: str, values: ArrayLike) -> str:
    matrix = np.atleast_2d(np.asarray(values, dtype=np.float64))
    rows, cols = matrix.shape
    lines = ",\n       ".join(", ".join(repr(float(number)) for number in row) for row in matrix)
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {lines} ]"


def _nodes(text: str) -> Nodes:
    """Matrices, lists of numbers and numbers at the top level, by name; other nodes are ignored."""
    nodes: Nodes = {}
    for name, rows, cols, data in _MATRIX.findall(text):
        numbers = _numbers(data)
        if numbers is not None and numbers.size == int(rows) * int(cols):
            nodes[name] = numbers.reshape(int(rows), int(cols))
    for name, data in _LIST.findall(text) + _NUMBER.findall(text):
        numbers = _numbers(data)
        if numbers is not None:
            nodes.setdefault(name, numbers)
    return nodes


def _numbers(data: str) -> Float | None:
    try:
        return np.array([float(word) for word in data.replace(",", " ").split()])
    except ValueError:
        return None


def _camera(nodes: Nodes, i: int, size: tuple[int, int] | None) -> Camera:
    width, height = _size(nodes, i) if size is None else size
    k = nodes[f"M{i}"]
    if k.shape != (3, 3) or k[0, 1] or k[1, 0] or k[2].tolist() != [0, 0, 1]:
        raise InputError(f"M{i} must be a camera matrix fx 0 cx, 0 fy cy, 0 0 1, without skew")
    fx, fy, cx, cy = (float(k[row, column]) for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(width, height, fx, fy, cx, cy, _distortion(nodes, i))


def _size(nodes: Nodes, i: int) -> tuple[int, int]:
    if f"size{i}" in nodes:
        width, height = nodes[f"size{i}"]
        return int(width), int(height)
    return int(nodes["image_width"][0]), int(nodes["image_height"][0])


def _distortion(nodes: Nodes, i: int) -> Distortion | None:
    numbers = [float(number) for number in nodes[f"D{i}"].ravel()]
    if nodes.get(f"fisheye{i}", np.zeros(1))[0]:
        if len(numbers) != 4:
            raise InputError(f"D{i} of a fisheye has 4 coefficients, got {len(numbers)}")
        return KannalaBrandt(*numbers)
    if len(numbers) not in (4, 5, 8, 12, 14) or any(numbers[8:]):
        raise InputError(f"D{i} must hold 4, 5 or 8 coefficients (no thin prism, no tilt), got {numbers}")
    return BrownConrady(*numbers[:8]) if any(numbers) else None
