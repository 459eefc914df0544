"""OpenCV's matchers as methods; they need the extra opencv."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError, MissingExtraError, unknown
from twinlens.matching.images import Disparity, Image, pair
from twinlens.matching.options import MinDisparity, check_block_size, check_range, whole, with_range
from twinlens.matching.supports import levels

SIXTEENTHS = 16  # the unit of OpenCV's fixed-point disparities, and the multiple of its ranges
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
    """Turn OpenCV's errors, and Python's for numbers that do not fit a C int, into an InputError of one line."""
    try:
        yield
    except (cv2.error, ValueError, OverflowError) as problem:
        raise InputError(f"OpenCV's {name} refuses this: {' '.join(str(problem).split())[:200]}") from None


def _from_sixteenths(fixed: Image, low: int) -> Disparity:
    return np.where(fixed < low * SIXTEENTHS, np.inf, fixed / SIXTEENTHS).astype(np.float32)


def _in_sixteens(count: int) -> int:
    """The next multiple of 16."""
    return -(-count // SIXTEENTHS) * SIXTEENTHS


class _OpenCVMatcher:
    """What both matchers share: the range, the checks, and the conversion of images and disparities."""

    num_disparities: int
    min_disparity: int

    def check_parts(self) -> None:
        """MissingExtraError if OpenCV is not installed."""
        _opencv()

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """See `options.Matcher.match`."""
        cv2, images = _opencv(), _eight_bit(left, right)
        task = with_range(self, num_disparities, min_disparity)
        name = task._check(images[0].shape)
        with _refusing(cv2, name):
            return _from_sixteenths(task._made(cv2).compute(*images), task.min_disparity)

    def _check(self, shape: tuple[int, ...]) -> str:
        """The matcher's name in OpenCV; InputError for images of this (H, W) that it cannot match."""
        raise NotImplementedError

    def _made(self, cv2: Any) -> Any:
        """OpenCV's matcher."""
        raise NotImplementedError


@dataclass(frozen=True)
class OpenCVBlock(_OpenCVMatcher):
    """OpenCV's StereoBM: SAD of clipped Sobel images or, with prefilter=False, of locally normalised images.

    Images are converted to 8-bit grey.
    """

    block_size: Annotated[int, "Side of the window in pixels; odd, 5 or more."] = 9
    num_disparities: Annotated[int, "Number of disparities to search; rounded up to a multiple of 16."] = 64
    min_disparity: MinDisparity = 0
    prefilter: Annotated[bool, "true: clipped Sobel images; false: locally normalised images."] = True
    texture: Annotated[int, "OpenCV's textureThreshold; 0: off."] = 10
    uniqueness: Annotated[int, "OpenCV's uniquenessRatio in percent; 0: off."] = 15

    def __post_init__(self) -> None:
        if check_block_size("block_size", self.block_size) < 5:
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs 5 or more")
        whole("texture", self.texture, 0)
        whole("uniqueness", self.uniqueness, 0)
        check_range(self.num_disparities, self.min_disparity)

    def _check(self, shape: tuple[int, ...]) -> str:
        if self.block_size >= min(shape):
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs a larger image")
        return "StereoBM"

    def _made(self, cv2: Any) -> Any:
        matcher = cv2.StereoBM.create(_in_sixteens(self.num_disparities), self.block_size)
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
    """OpenCV's StereoSGBM. Images are converted to 8-bit grey; P1 and P2 are 8 and 32 block_size^2."""

    block_size: Annotated[int, "Side of the window in pixels; odd."] = 3
    num_disparities: Annotated[int, "Number of disparities to search; rounded up to a multiple of 16."] = 64
    min_disparity: MinDisparity = 0
    mode: Annotated[str, "default: 5 paths; hh: 8 paths; 3way: 3 paths."] = "default"
    uniqueness: Annotated[int, "OpenCV's uniquenessRatio in percent; 0: off."] = 0

    def __post_init__(self) -> None:
        check_block_size("block_size", self.block_size)
        whole("uniqueness", self.uniqueness, 0)
        check_range(self.num_disparities, self.min_disparity)
        if self.mode not in MODES:
            raise unknown("mode", str(self.mode), MODES)

    def _check(self, shape: tuple[int, ...]) -> str:
        """OpenCV matches only columns for which the whole range is inside; its 3-way mode does not check this."""
        low, high = min(self.min_disparity, 0), max(self.min_disparity + _in_sixteens(self.num_disparities), 0)
        if shape[1] + low - high <= self.block_size // 2:
            raise InputError(
                f"OpenCV's StereoSGBM matches images wider than {high - low + self.block_size // 2} pixels over this "
                f"range with this block_size; this one is {shape[1]} wide: search fewer num_disparities"
            )
        return "StereoSGBM"

    def _made(self, cv2: Any) -> Any:
        return cv2.StereoSGBM.create(
            minDisparity=self.min_disparity,
            numDisparities=_in_sixteens(self.num_disparities),
            blockSize=self.block_size,
            P1=8 * self.block_size**2,
            P2=32 * self.block_size**2,
            uniquenessRatio=self.uniqueness,
            mode=getattr(cv2, MODES[self.mode]),
        )
