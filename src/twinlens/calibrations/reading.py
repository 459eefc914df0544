"""A rig from a calibration file, whose program is recognised by what the file holds."""

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from twinlens.calibrations.middlebury import decode_calib, is_calib
from twinlens.calibrations.rig_files import (
    FilePath,
    NamedRig,
    has_size,
    is_camera_info,
    read_colmap,
    read_euroc,
    read_kalibr,
    read_opencv,
    read_ros,
    read_transforms,
)
from twinlens.calibrations.rig_tables import (
    LENGTH_UNITS,
    named_files,
    read_own,
)
from twinlens.calibrations.storages import read_storage, read_text
from twinlens.camera import Rig
from twinlens.errors import FileError, InputError

COLMAP_FILES = ("cameras.txt", "images.txt")
COLMAP_BINARY_FILES = ("cameras.bin", "images.bin")
FORMS = (
    "OpenCV's stereo files (YAML, XML, JSON), ROS camera_info of both cameras, Kalibr's camchain, "
    "EuRoC's sensor.yaml of both cameras, COLMAP's cameras.txt with images.txt (or .bin), transforms.json, "
    "Middlebury's calib.txt"
)
"""What `read_rig` reads."""


_FAR_APART = 10.0
"""Metres between the cameras of a pair above which the file's lengths are more likely in millimetres."""
_CLOSE_TOGETHER = 1e-3
"""Metres below which the baseline of a calib.txt is more likely in metres than in millimetres, its unit."""


class LengthWarning(UserWarning):
    """The lengths of a calibration are probably in another unit; the message says how to state it."""


def read_rig(
    *paths: FilePath,
    length_unit: Literal["m", "cm", "mm"] = "m",
    size: tuple[int, int] | None = None,
    fisheye: bool = False,
) -> NamedRig:
    """The rig in a calibration file of another program, or in two files that belong together.

    paths : one file; or two: intrinsics and extrinsics of OpenCV, left and right camera_info of ROS or sensor.yaml of
        EuRoC, cameras.txt and images.txt of COLMAP, or its cameras.bin and images.bin. A folder stands for the two of
        COLMAP in it. A .toml file is a rig's file of ours that needs no scene: that of `write_rig`, or one that names a
        calibration file, with its length unit, size and model.
    length_unit : of the file's lengths. Those of a calib.txt are millimetres by its format.
    size : (width, height) of the images, for a file of OpenCV or a transforms.json without it.
    fisheye : whether an OpenCV file, which does not state it, has the coefficients of `cv2.fisheye`.

    Poses are world_from_cam, where the world is the first camera's frame unless the file has one. Raises FileError for
    a file that is none of these, or not valid.
    """
    rig_files = [Path(path) for path in paths if Path(path).suffix.lower() == ".toml"]
    if rig_files and len(paths) > 1:
        raise FileError(f"{rig_files[0]}: a rig in a .toml file has no second file")
    calibration = named_files(rig_files[0]) if rig_files else None
    if calibration is not None:
        inner, stated = calibration
        settings = {"size": size, "length_unit": length_unit, "fisheye": fisheye}
        return read_rig(*inner, **settings | stated)
    files = [file for path in paths for file in calibration_files(Path(path))]
    if not files:
        raise InputError("a rig needs a calibration file")
    read = _read(files, size, fisheye)
    first = read.rig.cameras[0]
    if size is not None and size != (first.width, first.height):
        raise FileError(
            f"{files[0]}: its images have {first.width}x{first.height} pixels, not the stated {size[0]}x{size[1]}"
        )
    if read.has_unit and length_unit != "m":
        raise FileError(
            f"{files[0]}: its lengths are millimetres by its format; leave length_unit out"
        )
    metres = LENGTH_UNITS[length_unit]
    poses = [pose.copy() for pose in read.rig.world_from_cams]
    for pose in poses:
        pose[:3, 3] *= metres
    return replace(read, rig=Rig(read.rig.cameras, poses))


def calibration_files(path: Path) -> list[Path]:
    """The files that `path` stands for: those of COLMAP's model for its folder, or else the path itself."""
    if not path.is_dir():
        return [path]
    binary = [path / name for name in COLMAP_BINARY_FILES]
    if not (path / COLMAP_FILES[0]).is_file() and binary[0].is_file():
        return binary
    files = [path / name for name in COLMAP_FILES]
    if missing := [file.name for file in files if not file.is_file()]:
        raise FileError(
            f"{path}: a folder must have {' and '.join(COLMAP_FILES)} of COLMAP, and has no "
            f"{' and no '.join(missing)}; "
            f"or name a file of {FORMS}"
        )
    return files


def _read(
    files: Sequence[Path], size: tuple[int, int] | None, fisheye: bool
) -> NamedRig:
    first = files[0]
    for pair in (COLMAP_FILES, COLMAP_BINARY_FILES):
        if first.name in pair:
            return _read_colmap(files, pair)
    if first.suffix.lower() == ".toml":
        return NamedRig(*read_own(first))
    if is_calib(read_text(first)):
        return _read_calib(_only(files))
    values = read_storage(first)
    if "camera_matrix" in values or is_camera_info(values):
        return NamedRig(read_ros(*_two(files, "camera_info")), ("left", "right"))
    if "T_BS" in values:
        return read_euroc(*_two(files, "sensor.yaml"))
    if len(files) > 2:
        raise FileError(f"{files[2]}: a rig has at most two files")
    if "frames" in values:
        return read_transforms(_only(files), _size_unless_stored(values, size))
    if "cam0" in values:
        return read_kalibr(_only(files))
    if _has_cameras(values) or {"R", "T"} <= values.keys():
        rig = _opencv_pair(files, values, size, fisheye)
        return NamedRig(rig, ("1", "2"), has_model=False)
    raise FileError(f"{first}: holds no rig that is known; it may be of {FORMS}")


def _read_calib(path: Path) -> NamedRig:
    """The rectified pair of a calib.txt of Middlebury; the world is the left camera's frame."""
    calibration = decode_calib(read_text(path), str(path))
    return NamedRig(
        calibration.rig(), ("cam0", "cam1"), has_unit=True, ndisp=calibration.ndisp
    )


def _read_colmap(files: Sequence[Path], pair: tuple[str, str]) -> NamedRig:
    """The rig of the two files of COLMAP."""
    first, both = files[0], " and ".join(pair)
    if sorted(file.name for file in files) != sorted(pair):
        raise FileError(f"{first}: COLMAP's {both} go together")
    if len({file.parent for file in files}) > 1:
        raise FileError(f"{first}: {both} are in two folders")
    return read_colmap(first.parent, binary=pair == COLMAP_BINARY_FILES)


def _only(files: Sequence[Path]) -> Path:
    if len(files) > 1:
        raise FileError(f"{files[1]}: {files[0].name} is complete without it")
    return files[0]


def _two(files: Sequence[Path], kind: str) -> tuple[Path, Path]:
    """The files of the left and of the right camera, where each file holds one camera."""
    if len(files) != 2:
        raise FileError(
            f"{files[0]}: {kind} is of one camera; give the left file, then the right one"
        )
    left, right = files
    return left, right


def _opencv_pair(
    files: Sequence[Path],
    first: Mapping[str, Any],
    size: tuple[int, int] | None,
    fisheye: bool,
) -> Rig:
    """The pair of one file, or of two in either order, of which `first` are the values of the first."""
    if len(files) == 1:
        return read_opencv(files[0], _size_unless_stored(first, size), None, fisheye)
    second = read_storage(files[1])
    if _has_cameras(first) == _has_cameras(second):
        raise FileError(
            f"{files[1]}: of two files of OpenCV, one has the cameras (M1, M2) and the other R and T; "
            f"{'both have' if _has_cameras(first) else 'none has'} cameras"
        )
    intrinsics, extrinsics = files if _has_cameras(first) else reversed(files)
    stored = first if intrinsics is files[0] else second
    if {"R", "T"} & stored.keys():
        raise FileError(f"{intrinsics}: has R and T already; leave {extrinsics} out")
    size = _size_unless_stored(stored, size)
    return read_opencv(intrinsics, size, extrinsics, fisheye)


def _has_cameras(values: Mapping[str, Any]) -> bool:
    return any(name in values for name in ("M1", "K1", "cameraMatrix1"))


def doubt_of_lengths(named: NamedRig, names: Sequence[str]) -> str:
    """What to do if the lengths of calibration files, `names`, are probably in another unit; empty if they are not."""
    if len(named.rig) < 2:
        return ""
    apart = named.rig.baseline()
    if named.has_unit:
        if apart >= _CLOSE_TOGETHER:
            return ""
        return (
            f"the cameras are {1e3 * apart:.4g} mm apart; if the file's baseline is in metres, write it in "
            f"millimetres: baseline={1e6 * apart:.6g}"
        )
    if apart <= _FAR_APART:
        return ""
    file = names[0] if len(names) == 1 else list(names)
    return (
        f"the first two cameras are {apart:.4g} m apart; if the lengths are millimetres, state it in the table of a "
        f'rig: file = {json.dumps(file)}, length_unit = "mm"'
    )


def warn_of_lengths(named: NamedRig, names: Sequence[str]) -> None:
    """Give a `LengthWarning` if there is a `doubt_of_lengths`."""
    if doubt := doubt_of_lengths(named, names):
        warnings.warn(f"{', '.join(names)}: {doubt}", LengthWarning, stacklevel=3)


def _size_unless_stored(
    values: Mapping[str, Any], size: tuple[int, int] | None
) -> tuple[int, int] | None:
    return None if has_size(values) else size
