"""OpenCV's matchers behind the same two words, `match(left, right)`; they come with the extra opencv."""

from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def _refusing(cv2: Any, name: str) -> Iterator[None]:
    """What OpenCV refuses, and a number that no C int holds, as one line of ours."""
    try:
        yield
    except (cv2.error, ValueError, OverflowError) as problem:
        raise InputError(f"OpenCV's {name} refuses this: {' '.join(str(problem).split())[:200]}") from None


def _from_sixteenths(fixed: Image, low: int) -> Disparity:
    return np.where(fixed < low * SIXTEENTHS, np.inf, fixed / SIXTEENTHS).astype(np.float32)


def _in_sixteens(count: int) -> int:
    """The next multiple of 16."""
    return -(-count // SIXTEENTHS) * SIXTEENTHS


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

    def check_parts(self) -> None:
        """MissingExtraError if OpenCV is not there."""
        _opencv()

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        if self.block_size >= min(images[0].shape):
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs a larger image than that")
        with _refusing(cv2, "StereoBM"):
            matcher = cv2.StereoBM.create(_in_sixteens(self.num_disparities), self.block_size)
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

    def check_parts(self) -> None:
        """MissingExtraError if OpenCV is not there."""
        _opencv()

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        self._check_width(images[0].shape[1])
        with _refusing(cv2, "StereoSGBM"):
            matcher = cv2.StereoSGBM.create(
                minDisparity=self.min_disparity,
                numDisparities=_in_sixteens(self.num_disparities),
                blockSize=self.block_size,
                P1=8 * self.block_size**2,
                P2=32 * self.block_size**2,
                uniquenessRatio=self.uniqueness,
                mode=getattr(cv2, MODES[self.mode]),
            )
            return _from_sixteenths(matcher.compute(*images), self.min_disparity)

    def _check_width(self, width: int) -> None:
        """StereoSGBM matches only columns from which the whole range is inside, and its 3-way mode does not ask."""
        low, high = min(self.min_disparity, 0), max(self.min_disparity + _in_sixteens(self.num_disparities), 0)
        if width + low - high <= self.block_size // 2:
            raise InputError(
                f"OpenCV's StereoSGBM matches images wider than {high - low + self.block_size // 2} pixels over this "
                f"range with this block_size; this one is {width} wide: search fewer num_disparities"
            )
