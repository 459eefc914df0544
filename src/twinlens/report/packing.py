"""Compact encodings of disparity maps, texts and images for embedding in a page.

A map becomes 16-bit steps of 1/16 px, differences along rows, low bytes before high bytes, zlib, base64. The page
decodes it by itself, because privacy modes of browsers alter pixels read back from images.
"""

import base64
import io
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

STEP = 1 / 16
UNKNOWN = 65535


@dataclass(frozen=True)
class Packed:
    """An encoded map: value = offset + code * step in pixels, code 65535 unknown; every `stride`-th pixel."""

    width: int
    height: int
    stride: int
    offset: float
    step: float
    data: str

    def document(self) -> dict[str, Any]:
        """Keys as the page's script expects them."""
        rest = {name: getattr(self, name) for name in ("stride", "offset", "step", "data")}
        return {"w": self.width, "h": self.height, **rest}


def stride_for(width: int, max_width: int) -> int:
    """The smallest stride with at most `max_width` pixels in a row.

    >>> stride_for(640, 800), stride_for(2964, 800)
    (1, 4)
    """
    return -(-width // max_width)


def pack(disp: NDArray[np.floating[Any]], stride: int = 1, step: float = STEP) -> Packed:
    """Encode an (H, W) disparity map, +inf unknown. Values beyond 65534 steps saturate.

    >>> packed = pack(np.array([[1.0, 2.5, np.inf]], np.float32))
    >>> unpack(packed).tolist()
    [[1.0, 2.5, inf]]
    """
    thin = np.asarray(disp[::stride, ::stride], np.float64)
    known = np.isfinite(thin)
    offset = float(np.floor(thin[known].min())) if known.any() else 0.0
    steps = np.clip(np.rint((np.where(known, thin, offset) - offset) / step), 0, UNKNOWN - 1)
    codes = np.where(known, steps, UNKNOWN).astype(np.uint16)
    differences = np.diff(codes, axis=1, prepend=np.uint16(0)).ravel()
    planes = (differences & 255).astype(np.uint8).tobytes() + (differences >> 8).astype(np.uint8).tobytes()
    text = base64.b64encode(zlib.compress(planes, 6)).decode("ascii")
    return Packed(thin.shape[1], thin.shape[0], stride, offset, step, text)


def unpack(packed: Packed) -> NDArray[np.float64]:
    """Decode as the page's script does: (H, W) pixels, +inf unknown."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed.data)), np.uint8).astype(np.uint16)
    low, high = planes.reshape(2, packed.height, packed.width)
    codes = np.cumsum(low | (high << 8), axis=1, dtype=np.uint16)
    return np.where(codes == UNKNOWN, np.inf, packed.offset + codes * packed.step)


def pack_text(text: str) -> str:
    """Compress a text for download from the page: zlib, base64.

    >>> zlib.decompress(base64.b64decode(pack_text("a,b"))).decode()
    'a,b'
    """
    return base64.b64encode(zlib.compress(text.encode("utf-8", "replace"), 6)).decode("ascii")


def image_uri(image: NDArray[Any], stride: int = 1, quality: int = 82) -> str:
    """An (H, W[, 3]) 8- or 16-bit image as a WebP data URI, averaged over `stride` x `stride` pixels."""
    picture = Image.fromarray((image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image)
    if stride > 1:
        picture = picture.reduce(stride)
    out = io.BytesIO()
    picture.save(out, format="WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode("ascii")
