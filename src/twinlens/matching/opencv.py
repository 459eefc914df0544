"""OpenCV's matchers behind the same two words, `match(left, right)`; they come with the extra opencv."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.errors import InputError, MissingExtraError, unknown
from twinlens.matching.checks import check_block_size, whole
from twinlens.matching.images import Disparity, Image, pair
from twinlens.matching.supports import levels

SIXTEENTHS = 16  # OpenCV's fixed point, and the multiple its ranges come in
MODES = {"default": "STEREO_SGBM_MODE_SGBM", "hh": "STEREO_SGBM_MODE_HH", "3way": "STEREO_SGBM_MODE_SGBM_3WAY"}


def _opencv() -> Any:
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("OpenCV is not installed; pip install 'twinlens[opencv]'") from None
    return cv2


def _eight_bit(left: Any, right: Any) -> tuple[Image, Image]:
    one, other = levels(*pair(left, right))
    return one.astype(np.uint8), other.astype(np.uint8)


def _from_sixteenths(fixed: Image, low: int) -> Disparity:
    return np.where(fixed < low * SIXTEENTHS, np.inf, fixed / SIXTEENTHS).astype(np.float32)


@dataclass(frozen=True)
class OpenCVBlock:
    """OpenCV's StereoBM: SAD of clipped Sobel images or, prefilter=False, of its locally normalised images.

    num_disparities is rounded up to a multiple of 16, block_size is 5 or more; images become 8-bit grey. texture and
    uniqueness are OpenCV's textureThreshold and uniquenessRatio; 0 is off.
    """

    block_size: int = 9
    num_disparities: int = 64
    min_disparity: int = 0
    prefilter: bool = True
    texture: int = 10
    uniqueness: int = 15

    def __post_init__(self) -> None:
        if check_block_size("block_size", self.block_size) < 5:
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs 5 or more")
        whole("texture", self.texture, 0)
        whole("uniqueness", self.uniqueness, 0)
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        if self.block_size >= min(images[0].shape):
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs a larger image than that")
        matcher = cv2.StereoBM.create(-(-self.num_disparities // SIXTEENTHS) * SIXTEENTHS, self.block_size)
        matcher.setMinDisparity(self.min_disparity)
        matcher.setTextureThreshold(self.texture)
        matcher.setUniquenessRatio(self.uniqueness)
        if not self.prefilter:
            matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_NORMALIZED_RESPONSE)
            matcher.setPreFilterSize(5)
            matcher.setPreFilterCap(63)
        return _from_sixteenths(matcher.compute(*images), self.min_disparity)


@dataclass(frozen=True)
class OpenCVSemiGlobal:
    """OpenCV's StereoSGBM. mode: "default" (5 paths), "hh" (8 paths) or "3way".

    num_disparities is rounded up to a multiple of 16; images become 8-bit grey; P1 and P2 are 8 and 32 block_size^2.
    """

    block_size: int = 3
    num_disparities: int = 64
    min_disparity: int = 0
    mode: str = "default"
    uniqueness: int = 0

    def __post_init__(self) -> None:
        check_block_size("block_size", self.block_size)
        whole("uniqueness", self.uniqueness, 0)
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        if self.mode not in MODES:
            raise unknown("mode", str(self.mode), MODES)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        matcher = cv2.StereoSGBM.create(
            minDisparity=self.min_disparity,
            numDisparities=-(-self.num_disparities // SIXTEENTHS) * SIXTEENTHS,
            blockSize=self.block_size,
            P1=8 * self.block_size**2,
            P2=32 * self.block_size**2,
            uniquenessRatio=self.uniqueness,
            mode=getattr(cv2, MODES[self.mode]),
        )
        return _from_sixteenths(matcher.compute(*images), self.min_disparity)
