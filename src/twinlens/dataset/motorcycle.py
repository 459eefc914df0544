"""The real pair that scikit-image includes: Middlebury 2014 Motorcycle at quarter size, with measured left truth.

The calibration is the official one divided by four.

Source: Scharstein et al., High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014;
https://vision.middlebury.edu/stereo/data/scenes2014/.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.visibility import Mask, mask_from_one

_NDISP = 70
_CAM0, _CAM1 = (994.978, 994.978, 311.193, 254.877), (994.978, 994.978, 342.279, 254.877)
CALIBRATION = Calibration(_CAM0, _CAM1, 0.193001, 741, 500, doffs=31.086, ndisp=_NDISP, vmin=7.0, vmax=60.0)


@dataclass(frozen=True, eq=False)
class RealPair:
    """A pair in memory with the truth of its left view; the fields are named as those of a `StoredSample`.

    im0, im1 : uint8 (H, W, 3). disp0 : float32 (H, W), pixels, +inf unknown. mask0_nonocc : uint8 (H, W). ndisp :
    disparities to search, 0 <= d < ndisp.
    """

    name: str
    im0: NDArray[np.uint8]
    im1: NDArray[np.uint8]
    disp0: NDArray[np.float32]
    mask0_nonocc: Mask
    calibration: Calibration
    ndisp: int
    record: dict[str, Any] = field(default_factory=dict)


def motorcycle() -> RealPair:
    """Middlebury 2014 Motorcycle, 741 x 500, from scikit-image's files; the mask is that of `mask_from_one`."""
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    # scikit-image documents NaN for unknown pixels, its file has +inf.
    known = np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32)
    record = {"source": "Middlebury 2014 Motorcycle, a quarter of its size, from scikit-image"}
    return RealPair("motorcycle", left, right, known, mask_from_one(known), CALIBRATION, _NDISP, record)
