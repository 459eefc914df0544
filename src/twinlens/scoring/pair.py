"""What the benchmark needs of a sample, a `Pair` in memory that has it, and the fingerprint that resume goes by."""

import hashlib
import math
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

    It may also have `calibration` (errors in metres), `blur0` (H, W) in pixels and `material_kind0` (H, W) (regions),
    and `min_disparity`, the first disparity to search, a whole number.
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

    The disparities to search are min_disparity to min_disparity + ndisp - 1; min_disparity is 0 but for rigs whose
    principal points differ (doffs != 0). aliases: under which other names a submission's map of it may come; the first
    is the one to recommend.

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
    min_disparity: int = 0
    aliases: tuple[str, ...] = ()

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
        if not float(self.min_disparity).is_integer():
            raise InputError(f"min_disparity is {self.min_disparity}: expected a whole number of pixels")

    @property
    def search(self) -> dict[str, int]:
        """What a method is told: ndisp, and min_disparity where it is not 0."""
        first = int(self.min_disparity)
        return {"ndisp": int(self.ndisp)} | ({"min_disparity": first} if first else {})


def load_pair(sample: Sample) -> Pair:
    """The sample as a `Pair`: every attribute read once, what is optional left out where it cannot be had.

    Raises
    ------
    FileError, InputError
        Something needed is missing or does not fit.
    """
    if isinstance(sample, Pair):
        return sample
    calibration, truth = optional(lambda: getattr(sample, "calibration", None)), sample.disp0
    first = getattr(sample, "min_disparity", None)
    ndisp, low = (sample.ndisp, first) if first is not None else search_range(sample.ndisp, calibration, truth)
    return Pair(
        sample.name,
        sample.im0,
        sample.im1,
        truth,
        sample.mask0_nonocc,
        ndisp,
        calibration,
        optional(lambda: getattr(sample, "blur0", None)),
        optional(lambda: getattr(sample, "material_kind0", None)),
        low,
    )


def search_range(bound: int, calibration: Calibration | None, truth: Disparity) -> tuple[int, int]:
    """(ndisp, min_disparity) of a stored sample whose disparities are below `bound`: how many to search, from where.

    The first is 0 unless the calibration's vmin, or without one the truth, says that there are negative ones.

    >>> search_range(4, None, np.array([[-1.5, 3.0]])), search_range(4, None, np.array([[1.0, np.inf]]))
    ((6, -2), (4, 0))
    """
    low = None if calibration is None else calibration.vmin
    if low is None or not math.isfinite(low):
        low = float(np.min(truth, initial=0.0))
    first = max(min(math.floor(low), 0), -truth.shape[1])  # beyond the image's width there is nothing to search
    return bound - first, first


def optional(read: Callable[[], Any]) -> Any:
    """What `read` gives, or None where the file it needs is missing."""
    try:
        return read()
    except FileError:
        return None


def fingerprint(sample: Pair) -> str:
    """SHA-256 of all that a score depends on: images, truth, mask, search, calibration and the maps that regions need.

    >>> image, truth = np.zeros((1, 1), np.uint8), np.ones((1, 1), np.float32)
    >>> a, b = Pair("a", image, image, truth, None, 4), Pair("b", image, image, truth, None, 4)
    >>> fingerprint(a) == fingerprint(b), fingerprint(a) == fingerprint(Pair("a", image, image, truth, None, 5))
    (True, False)
    """
    digest = hashlib.sha256(f"{sample.search} {sample.calibration}".encode())
    for array in (sample.im0, sample.im1, sample.disp0, sample.mask0_nonocc, sample.blur0, sample.material_kind0):
        if array is None:
            digest.update(b"none")
        else:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
