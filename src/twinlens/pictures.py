"""The kind of a picture, and PNG pictures of 16 bits per channel, which Pillow reads with 8 unless they are grey.

Source: PNG specification, 3rd ed., W3C 2025, chapters 7.2 (byte order) and 11.2.1 (IHDR).
"""

import io
import re
import struct
import zlib

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FIRST_BYTES = {
    "PNG": re.compile(rb"\x89PNG"),
    "JPEG": re.compile(rb"\xff\xd8\xff"),
    "WEBP": re.compile(rb"RIFF.{4}WEBP", re.DOTALL),
    "BMP": re.compile(rb"BM"),
}
_GREY, _RGB, _GREY_ALPHA, _RGB_ALPHA = 0, 2, 4, 6
_COLOUR = slice(24, 26)  # bits per channel and colour type of IHDR
_CHECKED, _CHECKSUM = slice(12, 29), slice(29, 33)


def kind_of_picture(data: bytes) -> str | None:
    """The kind of a picture by its first bytes, as Pillow names it: PNG, JPEG, WEBP or BMP; None for others."""
    kinds = (kind for kind, start in _FIRST_BYTES.items() if start.match(data))
    return next(kinds, None)


def has_sixteen_bits(png: bytes) -> bool:
    """Whether a file is a PNG picture of 16 bits per channel."""
    return png.startswith(_SIGNATURE) and png[24:25] == b"\x10"


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
