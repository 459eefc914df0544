"""COLMAP's binary models, cameras.bin and images.bin, which its programs write unless text is asked for.

All numbers are little-endian. Source: COLMAP, src/colmap/scene/reconstruction_io_binary.cc, and the numbers of its
camera models in src/colmap/sensor/models.h.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

from twinlens.errors import FileError

MODELS = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"),
    *("OPENCV_FISHEYE", "FULL_OPENCV", "FOV"),
    *("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE"),
)
"""Camera models, in the order of their numbers."""
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<iiQQ")  # id, model, width, height
_IMAGE = struct.Struct("<i4d3di")  # id, quaternion w x y z, translation, camera
_POINT_BYTES = 24  # x, y, and the number of a 3D point
_LARGEST = 1 << 30  # bytes of a file


class _Numbers:
    """The numbers of a file, one after the other."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            if path.stat().st_size > _LARGEST:
                raise FileError(f"{path}: is larger than {_LARGEST >> 20} MiB")
            self._data = path.read_bytes()
        except OSError as error:
            raise FileError(f"{path}: cannot be read ({error.strerror})") from None
        self._start = 0

    def take(self, form: struct.Struct) -> tuple[int | float, ...]:
        """The next numbers. Raises FileError where the file ends."""
        start = self._start
        self.skip(form.size)
        return form.unpack_from(self._data, start)

    def skip(self, count: int) -> None:
        """Pass some bytes. Raises FileError where the file ends."""
        self._start += count
        if self._start > len(self._data):
            raise FileError(f"{self._path}: ends early; is the file complete?")

    def take_name(self) -> str:
        """The text before the next zero. Raises FileError."""
        end = self._data.find(b"\0", self._start)
        name = self._data[self._start : end]
        self.skip(len(name) + 1 if end >= 0 else len(self._data))
        try:
            return name.decode()
        except UnicodeDecodeError:
            raise FileError(
                f"{self._path}: the name of an image is no text: {name[:40]!r}"
            ) from None


def binary_cameras(
    path: Path, parameters: dict[str, str]
) -> Iterator[tuple[int, str, int, int, list[float]]]:
    """(id, model, width, height, numbers) of each camera.

    parameters : the names of the parameters of each supported model. Raises FileError, also for another model.
    """
    numbers = _Numbers(path)
    (count,) = numbers.take(_COUNT)
    for _ in range(int(count)):
        camera, number, width, height = map(int, numbers.take(_CAMERA))
        model = MODELS[number] if 0 <= number < len(MODELS) else f"number {number}"
        if model not in parameters:
            raise FileError(
                f"{path}: camera {camera}: the model {model} is not supported; {', '.join(parameters)} are"
            )
        form = struct.Struct(f"<{len(parameters[model].split())}d")
        yield camera, model, width, height, list(map(float, numbers.take(form)))


def binary_images(path: Path) -> Iterator[tuple[int, int, str, list[float]]]:
    """(id, camera, name, [qw, qx, qy, qz, tx, ty, tz]) of each image. Raises FileError."""
    numbers = _Numbers(path)
    (count,) = numbers.take(_COUNT)
    for _ in range(int(count)):
        image, *pose, camera = numbers.take(_IMAGE)
        name = numbers.take_name()
        (points,) = numbers.take(_COUNT)
        numbers.skip(int(points) * _POINT_BYTES)
        yield int(image), int(camera), name, list(map(float, pose))
