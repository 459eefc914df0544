"""The matching costs by name: the pixel term, the score of a window's sum, and the dtypes in which both are exact.

Every cost is lower-is-better: a similarity becomes 1 - similarity.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_known

V, PARABOLA = "v", "parabola"


@dataclass(frozen=True)
class Cost:
    """A matching cost.

    term: what a pixel adds to its window's sum. scoring: "sum", or the normalisation by statistics of the windows.
    fit: the sub-pixel fit that suits the cost near its minimum. transform: of the images; see
    `images.described`. offset: a constant that the kernels leave out. p1, p2: semi-global penalties for disparity steps
    of one pixel and of more, as parts of the largest possible cost.
    """

    term: str
    scoring: str
    fit: str
    description: str
    transform: str = ""
    offset: float = 0.0
    p1: float = 0.03
    p2: float = 0.13

    @property
    def growth(self) -> int:
        """The power of the window's area to which the cost is proportional: the kernel's ZSSD is n times the sum."""
        return {"sum": 1, "zsad": 1, "zssd": 2}.get(self.scoring, 0)


COSTS: dict[str, Cost] = {
    "sad": Cost("absolute", "sum", V, "sum of absolute differences"),
    "ssd": Cost(
        "square", "sum", PARABOLA, "sum of squared differences", p1=0.002, p2=0.02
    ),
    "ncc": Cost(
        "product",
        "ncc",
        PARABOLA,
        "1 - cosine of the windows' angle: invariant to gain",
        offset=1.0,
    ),
    "zsad": Cost(
        "absolute", "zsad", V, "SAD of mean-free windows: invariant to offset"
    ),
    "zssd": Cost(
        "square",
        "zssd",
        PARABOLA,
        "SSD of mean-free windows: invariant to offset",
        p1=0.0005,
        p2=0.005,
    ),
    "zncc": Cost(
        "product",
        "zncc",
        PARABOLA,
        "1 - correlation coefficient: invariant to gain and offset",
        offset=1.0,
    ),
    "jaccard": Cost("absolute", "jaccard", V, "1 - weighted Jaccard similarity"),
    "census": Cost(
        "hamming",
        "sum",
        V,
        "Hamming distance of census codes: invariant to monotonic change",
        "census",
        p1=0.2,
        p2=0.9,
    ),
    "rank": Cost(
        "absolute",
        "sum",
        V,
        "SAD of rank transforms: invariant to monotonic change",
        "rank",
        p1=0.1,
        p2=0.4,
    ),
    "birchfield_tomasi": Cost(
        "interpolated",
        "sum",
        V,
        "absolute differences, insensitive to sampling",
        "bounds",
    ),
}

MODEL_PREFIX = "onnx:"
DESCRIPTOR = Cost(
    "descriptor",
    "sum",
    PARABOLA,
    "1 - product of a network's descriptors",
    p1=0.2,
    p2=0.9,
)
LEARNED = replace(
    DESCRIPTOR,
    description="descriptors of a trained network smoothed by a guided filter (extra onnx)",
)
LEARNED_NAME = "learned"
LEARNED_FILE = Path(__file__).parent / "weights" / "learned.onnx"


def descriptor_model(name: str) -> str | None:
    """The file of the descriptor network of a cost, `onnx:FILE` or `learned`; None for the costs of `COSTS`.

    >>> descriptor_model("onnx:net.onnx"), descriptor_model("sad")
    ('net.onnx', None)
    """
    if name == LEARNED_NAME:
        return str(LEARNED_FILE)
    return name.removeprefix(MODEL_PREFIX) if name.startswith(MODEL_PREFIX) else None


def find_cost(name: str) -> Cost:
    """The cost of this name, or that of a descriptor network. Raises InputError for other names."""
    model = descriptor_model(name) if isinstance(name, str) else None
    if name == LEARNED_NAME:
        return LEARNED
    if model is None:
        check_known("cost", name, [*COSTS, LEARNED_NAME])
        return COSTS[name]
    if not model.endswith(".onnx"):
        raise InputError(
            f"cost is {name!r}; name an .onnx file, as in cost=onnx:net.onnx"
        )
    return DESCRIPTOR


@dataclass(frozen=True)
class Numbers:
    """The dtypes that hold a cost without loss: window sums of the term, the windows' totals, and scores."""

    sums: type[np.generic]
    totals: type[np.generic]
    scores: type[np.generic]


def numbers(cost: Cost, dtype: np.dtype[Any], side: int) -> Numbers:
    """The dtypes for this cost of images of `dtype`.

    Floating-point images are summed in float64. Totals of uint8 images are float64, in which n S_LR and S_L S_R are
    exact. Those of wider integers are 64-bit integers: both products may wrap around, but not their difference, which
    is at most (n m / 2)^2 for pixel values up to m. Raises InputError for windows whose score does not fit 64 bits:
    ZNCC and ZSSD of 16-bit images, about 256 pixels wide.
    """
    if dtype.kind == "f":
        return Numbers(np.float64, np.float64, np.float64)
    if cost.term == "product":
        return _numbers_of_products(cost, dtype, side)
    area, largest = side * side, int(np.iinfo(dtype).max)
    bytewise = dtype.itemsize == 1
    if cost.scoring == "zssd":
        _check_room(cost, dtype, side, (area * largest) ** 2, 64)
        if bytewise:
            return Numbers(np.uint32, np.float64, np.float64)
        return Numbers(np.uint64, np.uint64, np.uint64)
    bits = 8 * dtype.itemsize  # the largest Hamming distance of two words
    pixel_tops = {"absolute": largest, "square": largest**2, "hamming": bits}
    top = pixel_tops[cost.term] * area
    kinds = np.uint16, np.uint32, np.uint64
    sums = next(kind for kind in kinds if top < np.iinfo(kind).max)
    if cost.scoring == "jaccard":
        # float32 holds whole numbers below 2^24.
        return Numbers(sums, np.float64, np.float32 if top < 1 << 24 else np.float64)
    return Numbers(sums, np.float64, sums)


def _numbers_of_products(cost: Cost, dtype: np.dtype[Any], side: int) -> Numbers:
    """The dtypes for NCC and ZNCC, whose covariance n S_LR - S_L S_R is at most (n m / 2)^2."""
    area, largest = side * side, int(np.iinfo(dtype).max)
    covariance = (area * largest) ** 2 // 4
    bound = covariance if cost.scoring == "zncc" else area * largest**2
    _check_room(cost, dtype, side, bound, 63)
    if dtype.itemsize > 1:
        return Numbers(np.int64, np.int64, np.float64)
    sums = np.int32 if area * largest**2 < 1 << 31 else np.int64
    totals = np.int32 if covariance < 1 << 31 else np.float64
    return Numbers(sums, totals, np.float32)


def _check_room(
    cost: Cost, dtype: np.dtype[Any], side: int, bound: int, bits: int
) -> None:
    """InputError if `bound`, which grows with the fourth power of the side, does not fit."""
    if bound < 1 << bits:
        return
    most = side - 2
    while bound * most**4 // side**4 >= 1 << bits:
        most -= 2
    raise InputError(
        f"block_size is {side}; {cost.description.split(':')[0]!r} of {dtype} images is exact up to {most}: "
        "take a smaller window, or float32 images"
    )


def largest_cost(
    cost: Cost, left: NDArray[Any], right: NDArray[Any], side: int, descriptor: int
) -> float:
    """The largest value of this cost for windows of these images: the unit of p1 and p2."""
    area = side * side
    if cost.term == "descriptor":
        return 2.0 * area
    if cost.scoring in ("zncc", "ncc", "jaccard"):
        return 2.0 if cost.scoring == "zncc" else 1.0
    if cost.transform in ("census", "rank"):
        return float((descriptor**2 - 1) * area)
    if left.dtype.kind == "u":
        span = float(np.iinfo(left.dtype).max)
    else:
        lowest, highest = min(left.min(), right.min()), max(left.max(), right.max())
        span = float(highest) - float(lowest) or 1.0  # 1 where all pixels are equal
    if cost.term == "square":
        # The kernel's ZSSD is n times the sum of squares; differences reach from -span to span.
        return (area * span) ** 2 if cost.scoring == "zssd" else area * span**2
    return area * span
