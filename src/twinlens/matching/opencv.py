"""OpenCV's matchers as methods; they need the extra opencv. Images are converted to 8-bit grey."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError, import_extra
from twinlens.matching.contract import (
    Answer,
    RangeMatcher,
)
from twinlens.matching.images import levels, pair
from twinlens.settings import Setting

SIXTEENTHS = 16
"""The unit of OpenCV's fixed-point disparities is 1/16 pixel; the number of disparities is a multiple of 16."""
MODES = {
    "default": "STEREO_SGBM_MODE_SGBM",
    "hh": "STEREO_SGBM_MODE_HH",
    "3way": "STEREO_SGBM_MODE_SGBM_3WAY",
}


@dataclass(frozen=True, kw_only=True)
class _OpenCVMatcher(RangeMatcher):
    """Base of both matchers; `_create` checks the size of the images and makes OpenCV's matcher."""

    num_disparities: Annotated[
        int,
        Setting(
            "Number of disparities to search; rounded up to a multiple of 16.", least=1
        ),
    ] = 64

    def check_parts(self) -> None:
        """MissingExtraError if OpenCV is not installed."""
        import_extra("cv2", "opencv")

    def _create(self, cv2: Any, shape: tuple[int, ...], count: int) -> Any:
        raise NotImplementedError

    def compute(self, left: Any, right: Any) -> Answer:
        """OpenCV's disparities. Raises InputError for options and images that OpenCV refuses."""
        cv2 = import_extra("cv2", "opencv")
        images = [image.astype(np.uint8) for image in levels(*pair(left, right))]
        count = -(-self.num_disparities // SIXTEENTHS) * SIXTEENTHS
        try:
            fixed = self._create(cv2, images[0].shape, count).compute(*images)
        except InputError:
            raise
        except (cv2.error, ValueError, OverflowError) as problem:
            # ValueError and OverflowError are raised for numbers too large for a C int.
            reason = " ".join(str(problem).split())[:200]
            raise InputError(f"OpenCV's StereoMatcher failed: {reason}") from None
        # OpenCV marks unknown pixels with a value below the range.
        unknown = fixed < self.min_disparity * SIXTEENTHS
        disparity = np.where(unknown, np.inf, fixed / SIXTEENTHS)
        return Answer(disparity.astype(np.float32))


@dataclass(frozen=True)
class OpenCVBlock(_OpenCVMatcher):
    """OpenCV's StereoBM: SAD of clipped Sobel images or, with prefilter=False, of locally normalised images."""

    block_size: Annotated[
        int, Setting("Side of the window in pixels; odd, 5 or more.", least=5, odd=True)
    ] = 9
    prefilter: Annotated[
        bool, Setting("true: clipped Sobel images; false: locally normalised images.")
    ] = True
    texture: Annotated[int, Setting("OpenCV's textureThreshold; 0: off.", least=0)] = 10
    uniqueness: Annotated[
        int, Setting("OpenCV's uniquenessRatio in percent; 0: off.", least=0)
    ] = 15

    def _create(self, cv2: Any, shape: tuple[int, ...], count: int) -> Any:
        if self.block_size >= min(shape):
            raise InputError(
                f"block_size is {self.block_size}; OpenCV's StereoBM needs a larger image"
            )
        matcher = cv2.StereoBM.create(count, self.block_size)
        matcher.setMinDisparity(self.min_disparity)
        matcher.setTextureThreshold(self.texture)
        matcher.setUniquenessRatio(self.uniqueness)
        if not self.prefilter:
            matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_NORMALIZED_RESPONSE)
            matcher.setPreFilterSize(5)
            matcher.setPreFilterCap(63)
        return matcher


@dataclass(frozen=True)
class OpenCVSemiGlobal(_OpenCVMatcher):
    """OpenCV's StereoSGBM with P1 = 8 block_size^2 and P2 = 32 block_size^2."""

    block_size: Annotated[
        int, Setting("Side of the window in pixels; odd.", least=1, odd=True)
    ] = 3
    mode: Annotated[
        str, Setting("default: 5 paths; hh: 8 paths; 3way: 3 paths.", choices=MODES)
    ] = "default"
    uniqueness: Annotated[
        int, Setting("OpenCV's uniquenessRatio in percent; 0: off.", least=0)
    ] = 0

    def _create(self, cv2: Any, shape: tuple[int, ...], count: int) -> Any:
        # OpenCV matches only columns for which the whole range is inside; its 3-way mode does not check this.
        columns_right = max(self.min_disparity + count, 0)
        columns_left = -min(self.min_disparity, 0)
        least = columns_right + columns_left + self.block_size // 2
        if shape[1] <= least:
            got = f"got {shape[1]}: use fewer num_disparities"
            raise InputError(
                f"OpenCV's StereoSGBM needs images wider than {least} pixels for these options, {got}"
            )
        area = self.block_size**2
        matcher = cv2.StereoSGBM.create(
            self.min_disparity,
            count,
            self.block_size,
            8 * area,
            32 * area,
            mode=getattr(cv2, MODES[self.mode]),
        )
        matcher.setUniquenessRatio(self.uniqueness)
        return matcher
