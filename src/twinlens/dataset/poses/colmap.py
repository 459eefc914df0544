"""COLMAP's text model: a folder with cameras.txt, images.txt and points3D.txt.

A camera is ``ID MODEL WIDTH HEIGHT PARAMS...``. An image is ``ID QW QX QY QZ TX TY TZ CAMERA_ID NAME``, cam_from_world
as a unit quaternion and a translation, followed by a line of 2D points, which is written empty. Axes are the same as
here; pixels are counted from the image's corner, so that cx and cy are larger by 0.5. COLMAP has no length unit: metres
are written and assumed.

Source: https://colmap.github.io/format.html#text-format and .../cameras.html.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from scipy.spatial.transform import Rotation

from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.dataset.files import write_file
from twinlens.dataset.poses.named import HALF_PIXEL, NamedRig, image_names, read_text
from twinlens.errors import FileError, InputError, unknown
from twinlens.geometry import Float, inverse, rigid

MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
}
"""The parameters of each supported camera model, in COLMAP's order."""


def write_colmap(folder: str | os.PathLike[str], rig: Rig, names: Sequence[str] | None = None) -> None:
    """Write the model of `rig`, without points, into `folder`; image names are im0.png ... by default.

    Raises InputError for invalid names, and OutputError.
    """
    cameras = [f"{i} {_camera_text(camera)}" for i, camera in enumerate(rig.cameras, 1)]
    named = enumerate(zip(rig.world_from_cams, image_names(rig, names), strict=True), 1)
    images = [f"{i} {_pose_text(pose)} {i} {name}\n" for i, (pose, name) in named]
    for file, lines in (("cameras", cameras), ("images", images), ("points3D", [])):
        write_file(Path(folder) / f"{file}.txt", "".join(f"{line}\n" for line in lines).encode())


def read_colmap(folder: str | os.PathLike[str]) -> NamedRig:
    """The rig of a model's images, in the order of their ids. Raises FileError."""
    cameras = dict(_cameras(Path(folder) / "cameras.txt"))
    path = Path(folder) / "images.txt"
    found = sorted(_images(path), key=lambda image: image[0])
    if not found:
        raise FileError(f"{path}: has no images")
    missing = [camera for _, _, camera, _ in found if camera not in cameras]
    if missing:
        raise FileError(f"{path}: refers to camera {missing[0]}, which cameras.txt does not have")
    rig = Rig([cameras[camera] for _, _, camera, _ in found], [pose for _, pose, _, _ in found])
    return NamedRig(rig, tuple(name for _, _, _, name in found))


def _camera_text(camera: Camera) -> str:
    values = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx + HALF_PIXEL, "cy": camera.cy + HALF_PIXEL}
    model = "PINHOLE"
    if camera.distortion is not None:
        values |= asdict(camera.distortion)
        model = "OPENCV_FISHEYE" if isinstance(camera.distortion, KannalaBrandt) else "FULL_OPENCV"
    numbers = " ".join(repr(float(values[name])) for name in MODELS[model])
    return f"{model} {camera.width} {camera.height} {numbers}"


def _pose_text(world_from_cam: Float) -> str:
    cam_from_world = inverse(world_from_cam)
    x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat()
    return " ".join(repr(float(number)) for number in (w, x, y, z, *cam_from_world[:3, 3]))


def _cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    for number, line in _lines(path):
        words = line.split()
        if not words:
            continue
        try:
            yield int(words[0]), _camera(words[1], int(words[2]), int(words[3]), [float(word) for word in words[4:]])
        except (ValueError, IndexError) as error:
            raise FileError(f"{path}: line {number} must read ID MODEL WIDTH HEIGHT PARAMS: {error}") from None


def _camera(model: str, width: int, height: int, numbers: list[float]) -> Camera:
    if model not in MODELS:
        raise unknown("COLMAP camera model", model, MODELS)
    if len(numbers) != len(MODELS[model]):
        raise InputError(f"{model} has {len(MODELS[model])} parameters, got {len(numbers)}")
    values = dict(zip(MODELS[model], numbers, strict=True))
    focal = values.pop("f", 0.0)
    fx, fy = values.pop("fx", focal), values.pop("fy", focal)
    cx, cy = values.pop("cx") - HALF_PIXEL, values.pop("cy") - HALF_PIXEL
    if "FISHEYE" in model:
        return Camera(width, height, fx, fy, cx, cy, KannalaBrandt(**values))
    return Camera(width, height, fx, fy, cx, cy, BrownConrady(**values) if any(values.values()) else None)


def _images(path: Path) -> Iterator[tuple[int, Float, int, str]]:
    """(id, world_from_cam, camera id, name) of each image; every second line has its 2D points and may be empty."""
    lines = list(_lines(path))
    while lines and not lines[-1][1].strip():
        lines.pop()
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        try:
            w, x, y, z, *shift = (float(word) for word in words[1:8])
            rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
            yield int(words[0]), inverse(rigid(rotation, shift)), int(words[8]), words[9].strip()
        except (ValueError, IndexError) as error:
            form = "ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            raise FileError(f"{path}: line {number} must read {form}: {error}") from None


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines without comments, numbered from 1."""
    numbered = enumerate(read_text(path).splitlines(), 1)
    return ((number, line) for number, line in numbered if not line.lstrip().startswith("#"))
