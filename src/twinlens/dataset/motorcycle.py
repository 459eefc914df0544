"""The real pair that scikit-image includes: Middlebury 2014 Motorcycle at quarter size, with measured truth.

The calibration is the official one divided by four (fx 3979.911, cx 1244.772 and 1369.115, cy 1019.507, baseline
193.001 mm; ndisp 280 at full size). Only the left truth is included, so the mask comes from `mask_from_one` and is an
upper bound of what is visible.

Source: Scharstein et al., High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014;
https://vision.middlebury.edu/stereo/data/scenes2014/.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.visibility import Mask, mask_from_one

_CAM0, _CAM1 = (994.978, 994.978, 311.193, 254.877), (994.978, 994.978, 342.279, 254.877)
CALIBRATION = Calibration(_CAM0, _CAM1, 0.193001, 741, 500, doffs=31.086, ndisp=70, vmin=7.0, vmax=60.0)


@dataclass(frozen=True, eq=False)
class RealPair:
    """A pair in memory with the truth of its left view; the fields are named as those of a `StoredSample`.

    im0, im1 : uint8 (H, W, 3). disp0 : float32 (H, W), pixels, +inf unknown. mask0_nonocc : uint8 (H, W).
    """

    name: str
    im0: NDArray[np.uint8]
    im1: NDArray[np.uint8]
    disp0: NDArray[np.float32]
    mask0_nonocc: Mask
    calibration: Calibration
    record: dict[str, Any] = field(default_factory=dict)

    @property
    def ndisp(self) -> int:
        """Disparities to search, 0 <= d < ndisp."""
        return self.calibration.ndisp or int(np.ceil(self.disp0[np.isfinite(self.disp0)].max())) + 1


def motorcycle() -> RealPair:
    """Middlebury 2014 Motorcycle, 741 x 500, from scikit-image's files."""
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    # scikit-image documents NaN for unknown pixels, its file has +inf.
    known = np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32)
    record = {"source": "Middlebury 2014 Motorcycle, a quarter of its size, from scikit-image"}
    return RealPair("motorcycle", left, right, known, mask_from_one(known), CALIBRATION, record)
