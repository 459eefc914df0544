"""KITTI 2015: 16-bit disparity images and one calibration file a pair.

Disparity d is stored as round(256 d), 0 meaning none, so it ends at 255.99 px. `disp_occ` holds every known pixel,
`disp_noc` those that both views see. KITTI's own `_1` maps belong to the next point in time; readers that take them for
the right view (torchvision's) find the right view's here.

Source: Menze and Geiger, Object scene flow for autonomous vehicles, 2015; readme.txt of its development kit.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source, scaled

_SCALE = 256.0
_LARGEST = 65535 / _SCALE


def kitti2015(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """Kitti2015/training/: image_2, image_3, disp_occ_0, disp_occ_1, disp_noc_0, disp_noc_1, calib_cam_to_cam."""
    for source in sources:
        number = f"{source.index:06d}"
        for i in (0, 1):
            disparity = source.disparity(i, _LARGEST)
            visible = np.where(source.sample.mask_nonocc(i) == 255, disparity, np.inf).astype(np.float32)
            yield f"Kitti2015/training/image_{2 + i}/{number}_10.png", source.image(i)
            yield f"Kitti2015/training/disp_occ_{i}/{number}_10.png", _image(disparity)
            yield f"Kitti2015/training/disp_noc_{i}/{number}_10.png", _image(visible)
        yield f"Kitti2015/training/calib_cam_to_cam/{number}.txt", _calibration(source.sample.calibration).encode()


def _image(disparity: NDArray[np.float32]) -> bytes:
    return encode_png(scaled(disparity, _SCALE).astype(np.uint16))


def _calibration(calibration: Calibration) -> str:
    """S_rect, R_rect and P_rect = K [I | t] of cameras 02 and 03, t being minus the baseline for the right one."""
    lines = []
    for name, k, shift in (("02", calibration.K0, 0.0), ("03", calibration.K1, -calibration.baseline)):
        projection = k @ np.hstack([np.eye(3), [[shift], [0.0], [0.0]]])
        lines += [
            f"S_rect_{name}: {_row([calibration.width, calibration.height])}",
            f"R_rect_{name}: {_row(np.eye(3).ravel())}",
            f"P_rect_{name}: {_row(projection.ravel())}",
        ]
    return "\n".join(lines) + "\n"


def _row(values: Iterable[float]) -> str:
    return " ".join(f"{value:.12e}" for value in values)
