"""Trajectories of other programs: the text files of the TUM RGB-D benchmark, which evo and many SLAM programs write.

Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012; the format is stated at
https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

from pathlib import Path

import numpy as np

from twinlens.calibrations.rig_files import FilePath
from twinlens.errors import FileError, InputError, format_value
from twinlens.geometry.motion import Trajectory

_COLUMNS = ("t", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_LARGEST = 1 << 28  # bytes


def read_trajectory(path: FilePath) -> Trajectory:
    """The trajectory of a TUM file: lines `t tx ty tz qx qy qz qw`; # begins a comment.

    Times are those of the file. Raises FileError for a missing file and for a line that cannot be read, with its
    number, and what `Trajectory` refuses.
    """
    file = Path(path)
    rows = [
        _row(file, number, line)
        for number, line in enumerate(_lines(file), 1)
        if line.partition("#")[0].strip()
    ]
    if len(rows) < 2:
        raise FileError(
            f"{file}: a trajectory needs two poses or more, got {len(rows)}"
        )
    table = np.array(rows)
    try:
        return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:])
    except InputError as error:
        raise FileError(f"{file}: {error}") from error


def _lines(file: Path) -> list[str]:
    try:
        if file.stat().st_size > _LARGEST:
            raise FileError(f"{file}: larger than {_LARGEST >> 20} MiB")
        return file.read_text("utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise FileError(f"{file}: no such file") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{file}: not a text file") from error
    except OSError as error:
        raise FileError(f"{file}: {error.strerror or error}") from error


def _row(file: Path, number: int, line: str) -> list[float]:
    """The eight numbers of a line."""
    words = line.partition("#")[0].replace(",", " ").split()
    wanted = f"{len(_COLUMNS)} numbers {' '.join(_COLUMNS)}"
    if len(words) != len(_COLUMNS):
        raise FileError(f"{file}: line {number}: needs {wanted}, got {len(words)}")
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FileError(
            f"{file}: line {number}: needs {wanted}, got {format_value(line)}"
        ) from error
    for name, value in zip(_COLUMNS, values, strict=True):
        if not np.isfinite(value):
            raise FileError(
                f"{file}: line {number}: {name} must be a finite number, got {value}"
            )
    return values
