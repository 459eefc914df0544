"""PNG with 8 or 16 bits per channel, grey or RGB, lossless; and other image formats that users pass, read only.

Pillow reads PNG but cannot write 16-bit RGB, so the writer is here: Paeth filter on every row, then run lengths and
Huffman codes only (`Z_RLE`), which is faster than a string search and as small on noisy images. The bytes depend on the
pixels only: no time, no text. docs/decisions/codecs.md compares the alternatives.

Source: PNG specification, 3rd ed., W3C 2025, chapters 5, 7.2 (byte order), 9 (filters) and 11.2 (critical chunks).
"""

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.storage import Where
from twinlens.errors import FileError, InputError
from twinlens.pictures import decode_sixteen_bits

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB, _ALPHA_BIT = 0, 2, 4
_PAETH = 4
_DEFLATE_RATIO = 1032  # the most bytes that one deflated byte can encode
_MAX_PIXELS = 80_000_000  # Pillow warns of a decompression bomb slightly above
_CONVERSIONS = {
    "1": "L",
    "L": "L",
    "P": "RGB",
    "RGB": "RGB",
    "YCbCr": "RGB",
    "CMYK": "RGB",
}
_SIXTEEN_BIT_MODES = ("I;16", "I;16B", "I")
# Not PostScript, which Pillow passes to Ghostscript.
_FORMATS = ["PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM"]


def encode_png(pixels: Pixels) -> bytes:
    """Encode uint8 or uint16 pixels, (H, W) grey or (H, W, 3) RGB. Raises InputError for anything else."""
    array = np.asarray(pixels)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        raise InputError(f"a PNG holds uint8 or uint16 pixels, got {array.dtype}")
    if (
        array.ndim not in (2, 3)
        or 0 in array.shape
        or (array.ndim == 3 and array.shape[2] != 3)
    ):
        raise InputError(
            f"a PNG holds (H, W) or (H, W, 3) pixels, got shape {array.shape}"
        )
    height, width = array.shape[:2]
    if width * height > _MAX_PIXELS:
        raise InputError(
            f"a PNG holds at most {_MAX_PIXELS} pixels, got {width} x {height}"
        )
    color, channels = (_GREY, 1) if array.ndim == 2 else (_RGB, 3)
    header = struct.pack(
        ">IIBBBBB", width, height, 8 * array.dtype.itemsize, color, 0, 0, 0
    )
    big_endian = np.ascontiguousarray(array, array.dtype.newbyteorder(">"))
    rows = big_endian.view(np.uint8).reshape(height, -1)
    filtered = _paeth_filtered(rows, channels * array.dtype.itemsize)
    deflate = zlib.compressobj(
        1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE
    )
    body = deflate.compress(filtered.tobytes()) + deflate.flush()
    chunks = (_chunk(b"IHDR", header), _chunk(b"IDAT", body), _chunk(b"IEND", b""))
    return _SIGNATURE + b"".join(chunks)


def decode_png(data: bytes, name: str = "PNG data") -> Pixels:
    """Decode a PNG to uint8 or uint16 pixels, (H, W) or (H, W, 3).

    Palettes become RGB, fewer than 8 bits become 8, an opaque alpha channel is dropped. Raises FileError that begins
    with `name` for a damaged or partly transparent file, or one with more than 80 million pixels.
    """
    if len(data) < 33 or data[:8] != _SIGNATURE or data[12:16] != b"IHDR":
        raise FileError(f"{name}: not a PNG")
    width, height, depth, color = struct.unpack(">IIBB", data[16:26])
    if not 0 < width * height <= _MAX_PIXELS:
        raise FileError(
            f"{name}: a PNG must have 1 to {_MAX_PIXELS} pixels, got {width} x {height}"
        )
    # Checked before memory is allocated for the pixels.
    if width * height * depth > 8 * _DEFLATE_RATIO * len(data):
        raise FileError(
            f"{name}: {len(data)} bytes cannot hold {width} x {height} pixels; the file is damaged"
        )
    if depth == 16 and color & _ALPHA_BIT:
        raise FileError(
            f"{name}: has 16 bits and an alpha channel; save it without the alpha channel"
        )
    _check_chunks(data, name)
    try:
        if depth == 16 and color == _RGB:
            return decode_sixteen_bits(data)
        return _decode(data, name)
    except FileError:
        raise
    # Pillow raises half a dozen types, depending on where the damage is.
    except Exception as error:
        raise FileError(
            f"{name}: not a readable PNG; the file is damaged ({error})"
        ) from None


def _check_chunks(data: bytes, name: str) -> None:
    """Raise FileError unless every chunk matches its checksum: Pillow ignores some truncated and changed ones."""
    start, kind = len(_SIGNATURE), b""
    while kind != b"IEND":
        # A chunk is a length, a kind, a body, and the CRC of kind and body.
        length = int.from_bytes(data[start : start + 4], "big")
        kind = data[start + 4 : start + 8]
        end = start + 8 + length
        crc = data[end : end + 4]
        expected = zlib.crc32(memoryview(data)[start + 4 : end])
        if len(crc) < 4 or int.from_bytes(crc, "big") != expected:
            raise FileError(
                f"{name}: a chunk does not match its checksum; the file is damaged"
            )
        start = end + 4


def read_png(path: Where) -> Pixels:
    """Read a PNG file: uint8 or uint16, (H, W) or (H, W, 3); see `decode_png`. Raises FileError."""
    return decode_png(read_bytes(path), str(path))


def write_png(path: Where, pixels: Pixels) -> None:
    """Write uint8 or uint16 pixels (H, W) or (H, W, 3). Raises InputError and OutputError."""
    write_file(path, encode_png(pixels))


def read_image(path: Path) -> NDArray[Any]:
    """Read a PNG, JPEG, TIFF, BMP, WebP or PPM image: uint8 or uint16, (H, W) or (H, W, 3).

    Raises FileError for any other file, and for images with alpha or floating-point pixels.
    """
    if path.suffix.lower() == ".png":
        return read_png(path)
    try:
        with Image.open(io.BytesIO(read_bytes(path)), formats=_FORMATS) as image:
            if image.mode in _CONVERSIONS:
                return np.asarray(image.convert(_CONVERSIONS[image.mode]))
            pixels = np.asarray(image) if image.mode in _SIXTEEN_BIT_MODES else None
            if (
                pixels is None
                or pixels.min() < 0
                or pixels.max() > np.iinfo(np.uint16).max
            ):
                raise FileError(
                    f"{path}: image mode {image.mode} is not supported; save it as grey or RGB PNG"
                )
            return pixels.astype(np.uint16)
    except FileError:
        raise
    except (OSError, Image.DecompressionBombError, ValueError) as error:
        reason = (
            "unknown format" if isinstance(error, UnidentifiedImageError) else error
        )
        raise FileError(f"{path}: not a readable image ({reason})") from None


def _paeth_filtered(rows: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Rows (H, B) to (H, B + 1): the filter type, then each byte minus the predictor of left, up and up-left."""
    padded = np.zeros((rows.shape[0] + 1, rows.shape[1] + step), np.int16)
    padded[1:, step:] = rows
    left, up, corner = padded[1:, :-step], padded[:-1, step:], padded[:-1, :-step]
    # Distances of the three neighbours to the linear estimate left + up - corner.
    to_left, to_up = np.abs(up - corner), np.abs(left - corner)
    to_corner = np.abs(left + up - 2 * corner)
    # The nearest neighbour predicts; in a tie left comes before up, and up before the corner.
    predictor = np.where(to_up <= to_corner, up, corner)
    predictor = np.where((to_left <= to_up) & (to_left <= to_corner), left, predictor)
    out = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    out[:, 0] = _PAETH
    np.subtract(rows, predictor.astype(np.uint8), out=out[:, 1:])
    return out


def _chunk(kind: bytes, body: bytes) -> bytes:
    length = struct.pack(">I", len(body))
    crc = struct.pack(">I", zlib.crc32(kind + body))
    return length + kind + body + crc


def _decode(data: bytes, name: str) -> Pixels:
    with Image.open(io.BytesIO(data), formats=["PNG"]) as opened:
        image: Image.Image = opened
        if image.mode in _SIXTEEN_BIT_MODES:
            return np.asarray(image).astype(np.uint16)
        if image.has_transparency_data:
            image = image.convert("RGBA")
            if image.getchannel("A").getextrema()[0] != 255:
                raise FileError(
                    f"{name}: is partly transparent; save it without an alpha channel"
                )
        grey = image.mode in ("1", "L", "LA")
        return np.array(image.convert("L" if grey else "RGB"))
