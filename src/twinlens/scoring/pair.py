"""What the benchmark needs of a sample, a `Pair` in memory that has it, and the fingerprint that resume goes by."""

import hashlib
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.scoring.checks import Disparity, disparity_map, mask_of


class Sample(Protocol):
    """Any object with these attributes is a sample.

    im0, im1: uint8 (H, W[, 3]), left and right. disp0: float32 (H, W), the left view's true disparity in pixels, +inf
    unknown. mask0_nonocc: uint8 (H, W), 255 visible in both views, or None. ndisp: disparities to search.
    """

    @property
    def name(self) -> str: ...
    @property
    def im0(self) -> NDArray[Any]: ...
    @property
    def im1(self) -> NDArray[Any]: ...
    @property
    def disp0(self) -> Disparity: ...
    @property
    def mask0_nonocc(self) -> NDArray[np.uint8] | NDArray[np.bool_] | None: ...
    @property
    def ndisp(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Pair:
    """A sample in memory, checked where it is made. See `Sample` for the arrays.

    Raises
    ------
    InputError
        Images that are not uint8 or of different sizes, a truth or mask that does not fit, no ndisp.
    """

    name: str
    im0: NDArray[Any]
    im1: NDArray[Any]
    disp0: Disparity
    mask0_nonocc: NDArray[np.uint8] | NDArray[np.bool_] | None
    ndisp: int

    def __post_init__(self) -> None:
        check_sample(self)


def check_sample(sample: Sample) -> None:
    """InputError, naming the sample, if anything of it cannot be scored."""
    try:
        size = disparity_map("disp0", sample.disp0).shape
        for name, image in (("im0", sample.im0), ("im1", sample.im1)):
            if image.dtype != np.uint8 or image.shape[:2] != size or image.shape[2:] not in ((), (3,)):
                raise InputError(f"{name} is {image.dtype} {image.shape}: expected uint8 {size} or {(*size, 3)}")
        if sample.mask0_nonocc is not None:
            mask_of("mask0_nonocc", sample.mask0_nonocc, size)
        if sample.ndisp < 1:
            raise InputError(f"ndisp is {sample.ndisp}: expected 1 or more")
    except InputError as error:
        raise InputError(f"sample {sample.name!r}: {error}") from None


def fingerprint(sample: Sample) -> str:
    """SHA-256 of all that a score depends on: both images, truth, mask and ndisp, with their shapes and dtypes.

    >>> image, truth = np.zeros((1, 1), np.uint8), np.ones((1, 1), np.float32)
    >>> a, b = Pair("a", image, image, truth, None, 4), Pair("b", image, image, truth, None, 4)
    >>> fingerprint(a) == fingerprint(b), fingerprint(a) == fingerprint(Pair("a", image, image, truth, None, 5))
    (True, False)
    """
    digest = hashlib.sha256(f"ndisp {int(sample.ndisp)}".encode())
    for array in (sample.im0, sample.im1, sample.disp0, sample.mask0_nonocc):
        if array is None:
            digest.update(b"none")
        else:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
