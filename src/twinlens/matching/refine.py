"""What is done to a disparity map after the search. Each step is a plain function and says what it does to density."""

import numpy as np

from .images import Disparity


def consistent(left: Disparity, right: Disparity, tolerance: float) -> Disparity:
    """The left disparities whose partner in the right map agrees within `tolerance` pixels; the others become +inf.

    The partner of (u, v) is the pixel of the right map nearest to (u - d, v); outside the image, or unknown there, the
    pixel is not confirmed. Density falls, mostly in occlusions. Source: Fua, "A parallel stereo algorithm that
    produces dense depth maps and preserves image features", 1993.

    >>> consistent(np.float32([[9, 1, 1]]), np.float32([[1, 1, 1]]), 1.0)
    array([[inf,  1.,  1.]], dtype=float32)
    """
    height, width = left.shape
    known = np.isfinite(left)
    partner = np.rint(np.arange(width) - np.where(known, left, 0.0)).astype(np.int64)
    inside = known & (partner >= 0) & (partner < width)
    other = right[np.arange(height)[:, None], np.clip(partner, 0, width - 1)]
    with np.errstate(invalid="ignore"):
        agree = inside & np.isfinite(other) & (np.abs(left - other) <= tolerance)
    return np.where(agree, left, np.float32(np.inf)).astype(np.float32)
