"""MPI Sintel's stereo layout: left disparity in the three bytes of an RGB image, and two masks.

d = 4 R + G/64 + B/16384: the 24-bit number RGB counts 1/16384 px and ends at 1024 px. A mask is 255 where the pixel is
occluded (`occlusions`) or seen by the left view alone because it leaves the frame (`outofframe`), and 0 where its
disparity counts; an unknown pixel has disparity 0 and is marked occluded.

Source: http://sintel.is.tue.mpg.de/stereo, README of the stereo training data.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source, scaled
from twinlens.dataset.occlusion import VISIBLE
from twinlens.dataset.stored import Disparity

_SCALE = 16384.0
_LARGEST = (2**24 - 1) / _SCALE
_FRAME = "frame_0001"


def sintel(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """Sintel/training/{clean,final}_{left,right}, disparities, occlusions, outofframe: <name>/frame_0001.png."""
    for source in sources:
        for i, side in enumerate(("left", "right")):
            image = source.image(i)
            for kind in ("clean", "final"):
                yield f"Sintel/training/{kind}_{side}/{source.name}/{_FRAME}.png", image
        disparity = source.disparity(0, _LARGEST)
        hidden = source.sample.mask_nonocc(0) != VISIBLE
        outside = _outside(disparity)
        yield f"Sintel/training/disparities/{source.name}/{_FRAME}.png", encode_png(_rgb(disparity))
        yield f"Sintel/training/occlusions/{source.name}/{_FRAME}.png", _mask(hidden & ~outside)
        yield f"Sintel/training/outofframe/{source.name}/{_FRAME}.png", _mask(outside)
        yield f"Sintel/training/calib/{source.name}/calib.txt", encode_calib(source.sample.calibration).encode()


def _rgb(disparity: Disparity) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    counts = scaled(disparity, _SCALE)
    return np.stack([counts >> 16, counts >> 8 & 255, counts & 255], axis=-1).astype(np.uint8)


def _outside(disparity: Disparity) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    match = np.arange(disparity.shape[1]) - disparity
    return np.isfinite(disparity) & (match < -0.5)


def _mask(marked: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> bytes:
    return encode_png(np.where(marked, 255, 0).astype(np.uint8))
