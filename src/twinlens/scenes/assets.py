"""Files that a scene names: found below the scene's own folder and nowhere else, and read into arrays.

A scene file from a stranger must not make twinlens open other files of the machine, so absolute paths, ``..`` and
symbolic links that lead out of the folder are refused before anything is opened. A file is only ever read as the kind
that its suffix promises: libraries that look at the content instead would hand a renamed file to any of their readers
(Pillow gives PostScript to Ghostscript).
"""

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import FileError
from twinlens.scenes.colors import linear_from_srgb
from twinlens.scenes.table import At, show, text

_MOST_PIXELS = 1 << 27
_MOST_CHANNELS = 64
_PILLOW_FORMATS = {".png": ["PNG"], ".jpg": ["JPEG"], ".jpeg": ["JPEG"]}
_LEAST_SKY = (3, 2)  # rows and columns, Mitsuba's own limit


def asset(at: At, value: Any) -> Path:
    """The path of an existing file below the scene's folder, links resolved. Errors name the key and the remedy."""
    name = text(at, value)
    if not name or "\0" in name or PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or "\\" in name:
        raise at.wrong(f"must be a file name relative to the scene's folder, with forward slashes, got {show(name)}")
    folder = at.source.folder.resolve()
    path = (folder / name).resolve()
    if not path.is_relative_to(folder) or ".." in PurePosixPath(name).parts:
        raise at.wrong(f"{name!r} leads outside the scene's folder; copy it below {folder} and name it from there")
    if not path.is_file():
        raise at.wrong(f"no file {name!r} in {folder}")
    at.source.assets.append(path)
    return path


def read_picture(path: Path, raw: bool = False) -> NDArray[np.float32]:
    """A picture as float32 (H, W, 3), linear: .png .jpg (sRGB unless `raw`), .exr and .hdr (linear as they are).

    Raises FileError when the file is damaged, too large, or of another kind.
    """
    pixels, encoded = _decoded(path)
    if not np.isfinite(pixels).all() or (pixels < 0).any():
        raise FileError(f"{path}: a texture needs finite values >= 0 in every pixel")
    return linear_from_srgb(pixels) if encoded and not raw else pixels


def _decoded(path: Path) -> tuple[NDArray[np.float32], bool]:
    """The picture's values as they are stored, and whether they are sRGB's. Raises FileError."""
    readers = {".png": _read_8bit, ".jpg": _read_8bit, ".jpeg": _read_8bit, ".exr": _read_exr, ".hdr": _read_hdr}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise FileError(f"{path}: pictures may be {', '.join(sorted(readers))}, got {path.suffix!r}")
    try:
        return reader(path)
    except FileError:
        raise
    except Exception as error:  # the libraries raise what they like on damaged files; all of it is this file's fault
        raise FileError(f"{path}: cannot be read as a {path.suffix} picture ({error})") from error


def texture_picture(at: At, value: Any) -> Path:
    """The path of a texture that Mitsuba may read: a whole picture of a known kind and a sensible size, any values."""
    path = asset(at, value)
    _decoded(path)
    return path


def sky_picture(at: At, value: Any) -> Path:
    """The path of an environment map that Mitsuba may read: a whole picture of a known kind, of a sensible size."""
    path = asset(at, value)
    size = read_picture(path).shape[:2]
    if size[0] < _LEAST_SKY[0] or size[1] < _LEAST_SKY[1]:
        raise FileError(f"{path}: an environment map needs 2x3 pixels or more, got {size[1]}x{size[0]}")
    return path


def _check_size(path: Path, width: int, height: int) -> None:
    if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
        raise FileError(f"{path}: a picture has 1 to {_MOST_PIXELS} pixels, this one says {width}x{height}")


def _read_8bit(path: Path) -> tuple[NDArray[np.float32], bool]:
    from PIL import Image

    with Image.open(path, formats=_PILLOW_FORMATS[path.suffix.lower()]) as image:
        _check_size(path, image.width, image.height)
        if image.mode.startswith("I"):
            grey = np.asarray(image, dtype=np.float32) / np.float32(65535)
            return np.repeat(grey[..., None], 3, axis=2), True
        return np.asarray(image.convert("RGB"), dtype=np.float32) / np.float32(255), True


def _read_exr(path: Path) -> tuple[NDArray[np.float32], bool]:
    import OpenEXR

    _check_exr(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.asarray(channel.pixels, dtype=np.float32) for name, channel in file.channels().items()}
    names = "RGB" if {"R", "G", "B"} <= channels.keys() else "YYY"
    if not set(names) <= channels.keys():
        raise FileError(f"{path}: needs the channels R, G, B or Y, it has {', '.join(sorted(channels))}")
    return np.ascontiguousarray(np.stack([channels[name] for name in names], axis=-1)), False


def _check_exr(path: Path) -> None:
    """Refuse from the header alone what would fill the memory: OpenEXR reads every part and channel of a file."""
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        if len(file.parts) != 1:
            raise FileError(f"{path}: needs one part, it has {len(file.parts)}")
        header = dict(file.header())  # closing the file empties its own
    if header["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise FileError(f"{path}: deep pictures are not read; flatten it")
    if len(header["channels"]) > _MOST_CHANNELS:
        raise FileError(f"{path}: {len(header['channels'])} channels are more than {_MOST_CHANNELS}")
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    _check_size(path, right - left + 1, bottom - top + 1)


def _read_hdr(path: Path) -> tuple[NDArray[np.float32], bool]:
    """Radiance RGBE. Source: G. Ward, Real Pixels, Graphics Gems II, 1991."""
    data = path.read_bytes()
    head, _, body = data.partition(b"\n\n")
    size, _, body = body.partition(b"\n")
    words = size.split()
    if not data.startswith(b"#?") or len(words) != 4 or (words[0], words[2]) != (b"-Y", b"+X"):
        raise FileError(f"{path}: not a Radiance picture in the usual -Y +X order")
    height, width = int(words[1]), int(words[3])
    _check_size(path, width, height)
    if b"FORMAT=32-bit_rle_rgbe" not in head:
        raise FileError(f"{path}: needs FORMAT=32-bit_rle_rgbe")
    rgbe = _unpack_rgbe(np.frombuffer(body, dtype=np.uint8), height, width)
    scale = np.where(rgbe[..., 3:] > 0, np.exp2(rgbe[..., 3:].astype(np.float32) - 136), 0)
    return (rgbe[..., :3] * scale).astype(np.float32), False


def _unpack_rgbe(body: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """(H, W, 4) from run-length-encoded scanlines, or from flat pixels where the file is not encoded."""
    if not (8 <= width < 32768 and body[:2].tolist() == [2, 2]):
        return body[: height * width * 4].reshape(height, width, 4)
    out = np.empty((height, 4, width), dtype=np.uint8)
    cursor = 0
    for line in out:
        if body[cursor : cursor + 4].tolist() != [2, 2, width >> 8, width & 255]:
            raise ValueError("a scanline does not start with its width")
        cursor += 4
        for channel in line:
            cursor = _unpack_run(body, cursor, channel)
    return np.moveaxis(out, 1, 2)


def _unpack_run(body: NDArray[np.uint8], cursor: int, channel: NDArray[np.uint8]) -> int:
    done = 0
    while done < channel.size:
        count = int(body[cursor])
        repeat = count > 128
        count -= 128 if repeat else 0
        taken = 1 if repeat else count
        if not 0 < count <= channel.size - done:
            raise ValueError("a run is longer than its scanline")
        channel[done : done + count] = body[cursor + 1 : cursor + 1 + taken]
        done += count
        cursor += 1 + taken
    return cursor
