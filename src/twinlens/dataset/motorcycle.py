"""The real pair that comes along: Middlebury 2014 Motorcycle at a quarter of its size, with its measured truth.

It lies inside the scikit-image wheel, so nothing is downloaded. Its calibration is the official one over four
(fx 3979.911, cx 1244.772 and 1369.115, cy 1019.507, baseline 193.001 mm; ndisp 280 at full size). The left truth alone
is there, so the mask is made from it by `occlusion.mask_from_one`, whose bound it shares: what unmeasured surfaces hide
is not known.

Source: Scharstein et al., High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014;
https://vision.middlebury.edu/stereo/data/scenes2014/.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.occlusion import Mask, mask_from_one

CALIBRATION = Calibration(
    cam0=(994.978, 994.978, 311.193, 254.877),
    cam1=(994.978, 994.978, 342.279, 254.877),
    baseline=0.193001,
    width=741,
    height=500,
    doffs=31.086,
    ndisp=70,
    vmin=7.0,
    vmax=60.0,
)


@dataclass(frozen=True, eq=False)
class RealPair:
    """A pair in memory with measured truth of its left view, under the names of a `StoredSample`.

    im0, im1 : uint8 (H, W, 3). disp0 : float32 (H, W), pixels, +inf unknown. mask0_nonocc : uint8 (H, W), 255 visible
    in both, 128 occluded or out of frame, 0 unknown.
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
    """Middlebury 2014 Motorcycle, 741 x 500, from scikit-image's own files."""
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    # scikit-image's text says NaN marks unknown pixels, its file has +inf: both mean unknown here.
    known = np.where(np.isfinite(disparity), disparity, np.inf).astype(np.float32)
    record = {"source": "Middlebury 2014 Motorcycle, a quarter of its size, from scikit-image"}
    return RealPair("motorcycle", left, right, known, mask_from_one(known), CALIBRATION, record)
