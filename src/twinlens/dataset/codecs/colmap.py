"""COLMAP's files: models of cameras, images and points as text and in binary, and the maps of a dense workspace.

Pixels are counted from the image's corner: the centre of the first one is at (0.5, 0.5). Cameras, images and points are
numbered from 1. Binary files are little-endian.

Source: https://colmap.github.io/format.html and .../cameras.html.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from twinlens.calibrations.colmap_binary import MODELS
from twinlens.calibrations.rig_files import COLMAP_MODELS, CORNER
from twinlens.camera import Camera, KannalaBrandt, Rig
from twinlens.dataset.tracks import Tracks
from twinlens.geometry import Float, inverse

_POINT2D = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
_ERROR_PX = 0.0  # the reprojection error of points: observations are projections
_TRACK = np.dtype([("image", "<u4"), ("index", "<u4")])


class _Model(NamedTuple):
    """A camera in COLMAP's terms. Images with equal ones share a camera."""

    name: str
    width: int
    height: int
    parameters: tuple[float, ...]

    @property
    def text(self) -> str:
        """``MODEL WIDTH HEIGHT PARAMS``."""
        numbers = " ".join(map(repr, self.parameters))
        return f"{self.name} {self.width} {self.height} {numbers}"


def colmap_camera(camera: Camera) -> str:
    """``MODEL WIDTH HEIGHT PARAMS``."""
    return _model_of(camera).text


def colmap_pose(world_from_cam: Float) -> str:
    """``QW QX QY QZ TX TY TZ`` of cam_from_world."""
    return " ".join(map(repr, _pose_of(world_from_cam)))


def encode_colmap_text(
    rig: Rig, names: Sequence[str], tracks: Tracks
) -> dict[str, bytes]:
    """cameras.txt, images.txt and points3D.txt of a rig, one image name per camera, and its tracks."""
    lines = {
        "cameras": _camera_lines(rig),
        "images": _image_lines(rig, names, tracks),
        "points3D": _point_lines(tracks),
    }
    files = {}
    for name, lines_of_file in lines.items():
        text = "".join(f"{line}\n" for line in lines_of_file)
        files[f"{name}.txt"] = text.encode()
    return files


def _camera_lines(rig: Rig) -> Iterator[str]:
    for model, number in _numbered_models(rig).items():
        yield f"{number} {model.text}"


def _image_lines(rig: Rig, names: Sequence[str], tracks: Tracks) -> Iterator[str]:
    """Two lines for each image: its pose, and its observations."""
    numbers_of_models = _numbered_models(rig)
    for view, observed in enumerate(_observations_by_view(rig, tracks)):
        pose = colmap_pose(rig.world_from_cams[view])
        camera = numbers_of_models[_model_of(rig.cameras[view])]
        yield f"{view + 1} {pose} {camera} {names[view]}"
        items = [f"{x!r} {y!r} {number}" for x, y, number in observed.tolist()]
        yield " ".join(items)


def _point_lines(tracks: Tracks) -> Iterator[str]:
    for number, point, color, track in _points(tracks):
        position = " ".join(map(repr, point))
        rgb = " ".join(map(str, color))
        items = [f"{image} {index}" for image, index in track.tolist()]
        yield f"{number} {position} {rgb} {_ERROR_PX} {' '.join(items)}"


def encode_colmap_binary(
    rig: Rig, names: Sequence[str], tracks: Tracks
) -> dict[str, bytes]:
    """cameras.bin, images.bin and points3D.bin, with the same content as `encode_colmap_text`."""
    parts = {
        "cameras": _camera_parts(rig),
        "images": _image_parts(rig, names, tracks),
        "points3D": _point_parts(tracks),
    }
    return {f"{name}.bin": b"".join(content) for name, content in parts.items()}


def _camera_parts(rig: Rig) -> Iterator[bytes]:
    numbers_of_models = _numbered_models(rig)
    yield struct.pack("<Q", len(numbers_of_models))
    for model, number in numbers_of_models.items():
        kind = MODELS.index(model.name)
        yield struct.pack("<IiQQ", number, kind, model.width, model.height)
        yield np.array(model.parameters, "<f8").tobytes()


def _image_parts(rig: Rig, names: Sequence[str], tracks: Tracks) -> Iterator[bytes]:
    numbers_of_models = _numbered_models(rig)
    yield struct.pack("<Q", len(rig))
    for view, observed in enumerate(_observations_by_view(rig, tracks)):
        pose = _pose_of(rig.world_from_cams[view])
        camera = numbers_of_models[_model_of(rig.cameras[view])]
        yield struct.pack("<I7dI", view + 1, *pose, camera)
        yield names[view].encode() + b"\0"
        yield struct.pack("<Q", len(observed)) + observed.tobytes()


def _point_parts(tracks: Tracks) -> Iterator[bytes]:
    yield struct.pack("<Q", len(tracks))
    for number, point, color, track in _points(tracks):
        yield struct.pack("<Q3d3Bd", number, *point, *color, _ERROR_PX)
        yield struct.pack("<Q", len(track)) + track.tobytes()


def encode_colmap_map(values: ArrayLike) -> bytes:
    """A depth map (H, W) or a normal map (H, W, 3) of a dense workspace: float32, one channel after the other."""
    array = np.asarray(values, "<f4")
    channels = array[..., None] if array.ndim == 2 else array
    height, width, count = channels.shape
    planes = np.ascontiguousarray(np.moveaxis(channels, -1, 0))
    return f"{width}&{height}&{count}&".encode() + planes.tobytes()


def _model_of(camera: Camera) -> _Model:
    """The smallest of COLMAP's models that has the distortion of the camera."""
    values = {
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx + CORNER,
        "cy": camera.cy + CORNER,
    }
    name = "PINHOLE"
    if camera.distortion is not None:
        values |= asdict(camera.distortion)
        name = "OPENCV"
        if isinstance(camera.distortion, KannalaBrandt):
            name = "OPENCV_FISHEYE"
        elif any(values[key] for key in ("k3", "k4", "k5", "k6")):
            name = "FULL_OPENCV"
    parameters = tuple(float(values[key]) for key in COLMAP_MODELS[name].split())
    return _Model(name, camera.width, camera.height, parameters)


def _numbered_models(rig: Rig) -> dict[_Model, int]:
    """The number of each camera in the file, from 1."""
    models = dict.fromkeys(map(_model_of, rig.cameras))
    return {model: number for number, model in enumerate(models, 1)}


def _pose_of(world_from_cam: Float) -> list[float]:
    """Quaternion (w, x, y, z) and translation of cam_from_world."""
    cam_from_world = inverse(world_from_cam)
    x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat().tolist()
    return [w, x, y, z, *cam_from_world[:3, 3].tolist()]


def _observations_by_view(rig: Rig, tracks: Tracks) -> list[NDArray[np.void]]:
    """The observations of each view, pixel and number of the point, as arrays of `_POINT2D`."""
    observed = np.zeros(len(tracks.views), _POINT2D)
    observed["x"], observed["y"] = (tracks.pixels + CORNER).T
    observed["point"] = tracks.numbers + 1
    ends = np.searchsorted(tracks.views, np.arange(1, len(rig)))
    return np.split(observed, ends)


def _points(
    tracks: Tracks,
) -> Iterator[tuple[int, list[float], list[int], NDArray[np.void]]]:
    """Number, position, colour, and track of each point, an array of `_TRACK`."""
    track = np.zeros(len(tracks.views), _TRACK)
    track["image"] = tracks.views + 1
    # Observations are ordered by view: an index counts from the first one of the view.
    starts = np.searchsorted(tracks.views, tracks.views)
    track["index"] = np.arange(len(tracks.views)) - starts
    by_point = np.argsort(tracks.numbers, kind="stable")
    ends = np.searchsorted(tracks.numbers[by_point], np.arange(1, len(tracks)))
    parts = np.split(track[by_point], ends)
    rows = zip(tracks.points.tolist(), tracks.colors.tolist(), parts, strict=False)
    for number, (point, color, part) in enumerate(rows, 1):
        yield number, point, color, part
