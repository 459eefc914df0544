"""The matching costs by name: what a pixel adds to its window, how the sum is scored, and in which numbers it is exact.

Every cost is lower-is-better; a similarity is turned here, once, into 1 - similarity.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

V, PARABOLA = "v", "parabola"


@dataclass(frozen=True)
class Cost:
    """A cost that is a box sum of pixel terms, scored.

    term: "absolute", "square", "product" or "hamming"; scoring: "sum", or the normalisation by the windows' own sums;
    fit: the sub-pixel fit that suits the cost's shape near its minimum; transform: what the images become first.
    """

    term: str
    scoring: str
    fit: str
    description: str
    transform: str = ""


COSTS: dict[str, Cost] = {
    "sad": Cost("absolute", "sum", V, "sum of absolute differences"),
    "ssd": Cost("square", "sum", PARABOLA, "sum of squared differences"),
    "ncc": Cost("product", "ncc", PARABOLA, "1 - normalised cross-correlation (cosine similarity): blind to gain"),
    "zssd": Cost("square", "zssd", PARABOLA, "SSD of mean-free windows: blind to a change of offset"),
    "zncc": Cost("product", "zncc", PARABOLA, "1 - correlation of mean-free windows: blind to gain and offset"),
    "jaccard": Cost("absolute", "jaccard", V, "1 - weighted Jaccard similarity, sum of minima over sum of maxima"),
}


def numbers(cost: Cost, dtype: np.dtype[Any], side: int) -> tuple[type[np.generic], type[np.generic]]:
    """(dtype of window sums, dtype of scores) that hold this cost of images of `dtype` without loss.

    Integer sums may wrap around where the score they end in does not: n S_LR - S_L S_R is at most (n m / 2)^2 for
    values up to m, though its two parts are larger. Floating-point images are summed in float64.
    """
    if dtype.kind == "f":
        return np.float64, np.float64
    area, largest = side * side, int(np.iinfo(dtype).max)
    if cost.term == "product":
        bound = (area * largest) ** 2 // 4 if cost.scoring == "zncc" else area * largest**2
        return (np.int32, np.float32) if bound < 1 << 31 and dtype.itemsize == 1 else (np.int64, np.float64)
    top = {"absolute": largest, "square": largest**2, "hamming": 8 * dtype.itemsize}[cost.term] * area
    if cost.scoring == "zssd":
        wide = np.uint32 if (area * largest) ** 2 < 1 << 32 else np.uint64
        return wide, wide
    sums = next(kind for kind in (np.uint16, np.uint32, np.uint64) if top < np.iinfo(kind).max)
    if cost.scoring == "jaccard":
        return sums, np.float32 if top < 1 << 24 else np.float64
    return sums, sums
