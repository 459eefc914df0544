"""The kind of a picture, and its stored values: Pillow reads 16 bits per channel of PNG with 8 unless they are grey.

Sources: PNG specification, 3rd ed., W3C 2025, chapters 7.2 (byte order) and 11.2.1 (IHDR); Truevision TGA file format
specification, version 2.0, 1991.
"""

import io
import os
import re
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FIRST_BYTES = {
    "PNG": re.compile(rb"\x89PNG"),
    "JPEG": re.compile(rb"\xff\xd8\xff"),
    "WEBP": re.compile(rb"RIFF.{4}WEBP", re.DOTALL),
    "BMP": re.compile(rb"BM"),
    "TIFF": re.compile(rb"II[*+]\0|MM\0[*+]"),
    # A .tga file has no mark: palette or none, one of six types, and bits per pixel. It is the last to be tried.
    "TGA": re.compile(
        rb".[\x00\x01][\x01-\x03\x09-\x0b].{13}[\x08\x0f\x10\x18\x20]", re.DOTALL
    ),
}
_GREY, _RGB, _GREY_ALPHA, _RGB_ALPHA = 0, 2, 4, 6
_SILENCING = threading.Lock()
_BITS_PER_SAMPLE = 258  # a tag of TIFF
_PHOTOMETRIC = 262  # a tag of TIFF; 0 is white as 0
_COLOUR = slice(24, 26)  # bits per channel and colour type of IHDR
_CHECKED, _CHECKSUM = slice(12, 29), slice(29, 33)


def kind_of_picture(data: bytes) -> str | None:
    """The kind of a picture by its first bytes, as Pillow names it, such as PNG or TIFF; None for others."""
    kinds = (kind for kind, start in _FIRST_BYTES.items() if start.match(data))
    return next(kinds, None)


def has_sixteen_bits(png: bytes) -> bool:
    """Whether a file is a PNG picture of 16 bits per channel."""
    return png.startswith(_SIGNATURE) and png[24:25] == b"\x10"


@contextmanager
def silent() -> Iterator[None]:
    """Discard what libraries print about damaged pictures, to sys.stdout and to file descriptor 2."""
    with _SILENCING, Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        stderr = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


@contextmanager
def opened(data: bytes, kind: str) -> Iterator[Any]:
    """The picture of Pillow of a kind. What libtiff prints is discarded, and so would be a warning in the meantime."""
    with (
        silent() if kind == "TIFF" else nullcontext(),
        Image.open(io.BytesIO(data), formats=[kind]) as image,
    ):
        yield image


def stored_values(
    image: Any, data: bytes, mode: str
) -> NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]:
    """The values (H, W, C) of a picture that Pillow has opened from `data`.

    mode : "RGB" or "RGBA", to which values of 8 bits are converted. Others, of 16 bits and floats, have the channels of
        the file. Raises ValueError for integers of 12 and of 32 bits.
    """
    if has_sixteen_bits(data):
        return decode_sixteen_bits(data)
    if image.mode.startswith("I;16"):
        return _sixteen_bits_of_tiff(image)
    if image.mode == "F":
        return np.asarray(image, np.float32)[..., None]
    if image.mode == "I":
        raise ValueError("it has integers of 32 bits; save it with 8 or 16 bits")
    return np.asarray(image.convert(mode))


def _sixteen_bits_of_tiff(image: Any) -> NDArray[np.uint16]:
    """The grey levels (H, W, 1). Pillow leaves those of 12 bits unscaled, and those with white as 0 as they are."""
    tags = getattr(image, "tag_v2", {})
    bits = max(tags.get(_BITS_PER_SAMPLE, (16,)))
    if bits != 16:
        raise ValueError(f"it has {bits} bits per channel; save it with 8 or 16 bits")
    values = np.asarray(image).astype(np.uint16)[..., None]
    is_white_zero = tags.get(_PHOTOMETRIC) == 0
    return np.uint16(65535) - values if is_white_zero else values


def lost_of_tiff(image: Any) -> list[str]:
    """What `stored_values` leaves out of a picture of Pillow, with what is done instead."""
    lost = []
    bits = getattr(image, "tag_v2", {}).get(_BITS_PER_SAMPLE, (8,))
    if len(bits) > 1 and max(bits) > 8:
        lost.append(f"{max(bits)} bits per channel (8)")
    if getattr(image, "n_frames", 1) > 1:
        lost.append("pages after the first")
    return lost


def decode_sixteen_bits(png: bytes) -> NDArray[np.uint16]:
    """The values (H, W, C) of a PNG picture of 16 bits per channel: grey, RGB, or one of them with alpha.

    Raises the errors of Pillow for damaged files.
    """
    kind = png[25]
    if kind == _GREY:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            return np.asarray(image).astype(np.uint16)[..., None]
    if kind == _GREY_ALPHA:
        return _grey_with_alpha(png)
    mode = {_RGB: "RGB", _RGB_ALPHA: "RGBA"}[kind]
    # Pillow unpacks one byte of two: the high one or, with the other byte order, the low one.
    high, low = (_unpacked(png, f"{mode};16{order}") for order in "BL")
    return (high << np.uint16(8)) | low


def _unpacked(png: bytes, rawmode: str) -> NDArray[np.uint16]:
    with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
        image.tile = [tile._replace(args=rawmode) for tile in image.tile]
        return np.array(image).astype(np.uint16)


def _grey_with_alpha(png: bytes) -> NDArray[np.uint16]:
    """Four bytes a pixel, decoded as a picture of four channels of 8 bits, which has the same filters."""
    header = bytearray(png)
    header[_COLOUR] = bytes([8, _RGB_ALPHA])
    header[_CHECKSUM] = struct.pack(">I", zlib.crc32(header[_CHECKED]))
    with Image.open(io.BytesIO(header), formats=["PNG"]) as image:
        pairs = np.array(image).astype(np.uint16)
    return (pairs[..., 0::2] << np.uint16(8)) | pairs[..., 1::2]
