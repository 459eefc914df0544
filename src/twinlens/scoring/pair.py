"""What the benchmark needs of a sample, a `Pair` in memory that has it, and the fingerprint that resume goes by."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import Calibration
from twinlens.errors import FileError, InputError
from twinlens.scoring.checks import Disparity, disparity_map, mask_of


class Sample(Protocol):
    """Any object with these attributes is a sample; each is read once.

    im0, im1: uint8 or uint16 (H, W[, 3]), left and right. disp0: float32 (H, W), the left view's true disparity in
    pixels, +inf unknown. mask0_nonocc: uint8 (H, W), 255 visible in both views, or None. ndisp: disparities to search.

    It may also have `calibration` (errors in metres), `blur0` (H, W) in pixels and `material_kind0` (H, W) (regions).
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
        Images that are not 8 or 16 bit or of different sizes, a truth or map that does not fit, no ndisp.
    """

    name: str
    im0: NDArray[Any]
    im1: NDArray[Any]
    disp0: Disparity
    mask0_nonocc: NDArray[np.uint8] | NDArray[np.bool_] | None
    ndisp: int
    calibration: Calibration | None = None
    blur0: NDArray[np.floating[Any]] | None = None
    material_kind0: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        try:
            self._check()
        except InputError as error:
            raise InputError(f"sample {self.name!r}: {error}") from None

    def _check(self) -> None:
        size = disparity_map("disp0", self.disp0).shape
        for name, image in (("im0", self.im0), ("im1", self.im1)):
            if image.dtype not in (np.uint8, np.uint16) or image.shape[:2] != size or image.shape[2:] not in ((), (3,)):
                raise InputError(
                    f"{name} is {image.dtype} {image.shape}: expected uint8 or uint16 {size} or {(*size, 3)}"
                )
        if self.mask0_nonocc is not None:
            mask_of("mask0_nonocc", self.mask0_nonocc, size)
        for name, extra in (("blur0", self.blur0), ("material_kind0", self.material_kind0)):
            if extra is not None and extra.shape != size:
                raise InputError(f"{name} has shape {extra.shape}: expected the truth's, {size}")
        if self.ndisp < 1:
            raise InputError(f"ndisp is {self.ndisp}: expected 1 or more")


def load_pair(sample: Sample) -> Pair:
    """The sample as a `Pair`: every attribute read once, what is optional left out where it cannot be had.

    Raises
    ------
    FileError, InputError
        Something needed is missing or does not fit.
    """
    if isinstance(sample, Pair):
        return sample
    return Pair(
        sample.name,
        sample.im0,
        sample.im1,
        sample.disp0,
        sample.mask0_nonocc,
        sample.ndisp,
        optional(lambda: getattr(sample, "calibration", None)),
        optional(lambda: getattr(sample, "blur0", None)),
        optional(lambda: getattr(sample, "material_kind0", None)),
    )


def optional(read: Callable[[], Any]) -> Any:
    """What `read` gives, or None where the file it needs is missing."""
    try:
        return read()
    except FileError:
        return None


def fingerprint(sample: Pair) -> str:
    """SHA-256 of all that a score depends on: images, truth, mask, ndisp, calibration and the maps that regions need.

    >>> image, truth = np.zeros((1, 1), np.uint8), np.ones((1, 1), np.float32)
    >>> a, b = Pair("a", image, image, truth, None, 4), Pair("b", image, image, truth, None, 4)
    >>> fingerprint(a) == fingerprint(b), fingerprint(a) == fingerprint(Pair("a", image, image, truth, None, 5))
    (True, False)
    """
    digest = hashlib.sha256(f"{int(sample.ndisp)} {sample.calibration}".encode())
    for array in (sample.im0, sample.im1, sample.disp0, sample.mask0_nonocc, sample.blur0, sample.material_kind0):
        if array is None:
            digest.update(b"none")
        else:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
