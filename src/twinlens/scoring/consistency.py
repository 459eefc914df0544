"""Measures of disparity maps that need no truth: the right view's map, the warped right image, and other methods.

None of them is an error. A left-right check finds occlusions and ambiguous matches, but confirms a mistake that both
maps share. A residual is low at every disparity of a surface without texture. Methods that agree may be wrong together.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol as Interface

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.geometry import Float
from twinlens.scoring.board import Board, Disagreement
from twinlens.scoring.evaluate import Scores, region_scores, upsampled, upsampling
from twinlens.scoring.metrics import (
    Disparity,
    Mask,
    boolean_mask,
    disparity_map,
    percent,
)
from twinlens.scoring.pair_statistics import grey_levels, warp_right
from twinlens.scoring.protocols import AGREE_PX, CONSISTENCY, PROTOCOLS, Pixels
from twinlens.scoring.samples import Pair


class Maps(Interface):
    """Where a map of (method, sample) is found; None if there is none. A dict and a `MapFolder` are such places."""

    def get(self, key: tuple[str, str], /) -> NDArray[np.floating[Any]] | None: ...


def mirrored(pair: Pair) -> Pair:
    """The pair whose left image is the mirrored right one, and whose right image is the mirrored left one.

    Its disparities have the sign and the range of the pair's: a point at u - d in the right image is at
    W - 1 - u + d in the mirrored one, and at W - 1 - u in the mirrored left image, d further left. It has no truth.
    """
    return replace(
        pair,
        im0=np.ascontiguousarray(pair.im1[:, ::-1]),
        im1=np.ascontiguousarray(pair.im0[:, ::-1]),
        disp0=None,
        mask0_nonocc=None,
        calibration=None,
        blur0=None,
        material_kind0=None,
    )


def of_right_map(left: ArrayLike, right: ArrayLike) -> Float:
    """The right map at the match of each left pixel, the pixel nearest to (u - d, v), float64 (H, W), pixels.

    left, right: (H, W) disparities of the two views in pixels, +inf where unknown. The result is +inf where the right
    map is unknown, and NaN where the left one is or where the match is outside the right image. Where it is equal to
    the left disparity, both views agree.

    >>> of_right_map([[2.0, 1.0, 1.0, np.inf]], [[1.0, 3.0, np.inf, 0.0]])
    array([[nan,  1.,  3., nan]])
    """
    disparities = disparity_map("left", left).astype(np.float64)
    partners = disparity_map("right", right).astype(np.float64)
    height, width = disparities.shape
    has_estimate = np.isfinite(disparities)
    matches = np.rint(np.arange(width) - np.where(has_estimate, disparities, 0.0))
    inside = has_estimate & (matches >= 0) & (matches <= width - 1)
    columns = np.where(inside, matches, 0).astype(np.intp)
    rows = np.arange(height)[:, None]
    return np.where(inside, partners[rows, columns], np.nan)


def photometric_residual(
    im0: NDArray[Any], im1: NDArray[Any], disparity: ArrayLike
) -> Float:
    """|left(u, v) - right(u - d, v)| in grey levels of 0..255, float64 (H, W); NaN without a match in the right image.

    im0, im1: uint8 or uint16 (H, W[, 3]), left and right. Grey levels are 0.299 R + 0.587 G + 0.114 B, 16 bits divided
    by 257; the right image is interpolated by cubic splines. Differences of exposure are not removed: they add to the
    residuals of all methods.
    """
    warped = warp_right(grey_levels(im1), disparity_map("disparity", disparity))
    return np.abs(grey_levels(im0) - warped)


def check_views(
    disp: ArrayLike,
    im0: NDArray[Any],
    im1: NDArray[Any],
    right_disp: ArrayLike | None = None,
    regions: Mapping[str, ArrayLike] | None = None,
) -> Scores:
    """Measure a disparity map without truth: the protocol "consistency".

    Parameters
    ----------
    disp
        (H, W) map of the left view in pixels, +inf where unknown, or one of 1/2 or 1/4 of the size.
    im0, im1
        uint8 or uint16 (H, W[, 3]), left and right image.
    right_disp
        The same method's map of the right view, of the size of `disp`, d = u_left - u_right at the right image's
        pixels; None if there is none. Then the left-right measures are NaN.
    regions
        (H, W) masks by name, as for `evaluate`; by default the whole image, `all`.

    Raises InputError for NaN or -inf in a map, and sizes that do not fit.

    >>> right = np.random.default_rng(0).integers(0, 256, (8, 40), np.uint8)
    >>> scores = check_views(np.full((8, 40), 3.0), np.roll(right, 3, axis=1), right, np.full((8, 40), 3.0))
    >>> scores.all["lr_consistent"], scores.all["confirmed"], round(scores.all["photo_mean"], 9)
    (100.0, 92.5, 0.0)
    """
    rules, shape = PROTOCOLS[CONSISTENCY], im0.shape[:2]
    estimate = disparity_map("disp", disp)
    scale = upsampling(estimate.shape, shape, rules)
    estimate = upsampled(estimate, scale)
    of_right = None
    if right_disp is not None:
        partners = disparity_map("right_disp", right_disp)
        of_right = of_right_map(estimate, upsampled(partners, scale))
    residual = photometric_residual(im0, im1, estimate)
    masks: dict[str, Mask] = {}
    for name, values in (regions or {"all": np.ones(shape, np.bool_)}).items():
        masks[name] = boolean_mask(f"region {name!r}", values, shape)
    truth = np.full(shape, np.inf)
    pixels = Pixels(
        estimate, truth, np.isfinite(estimate), of_right=of_right, residual=residual
    )
    scores = {
        name: region_scores(rules, pixels.at(mask), estimate.size)
        for name, mask in masks.items()
    }
    return Scores(rules, scores, (-np.inf, np.inf), scale, rounded=False)


def apart(first: Disparity, second: Disparity) -> tuple[int, float]:
    """(pixels where both maps have an estimate, percentage of them that differ by more than 1 px).

    >>> apart(np.array([[1.0, 5.0, np.inf]]), np.array([[2.0, 2.0, 2.0]]))
    (2, 50.0)
    """
    both = np.isfinite(first) & np.isfinite(second)
    differences = np.abs(first[both].astype(np.float64) - second[both])
    count = int(np.count_nonzero(both))
    return count, percent(np.count_nonzero(differences > AGREE_PX), count)


def with_disagreements(board: Board, maps: Maps) -> Board:
    """The board with a `Disagreement` of each pair of methods on each sample that is compared without truth.

    maps: the methods' maps, as for a page. Methods without a map of a sample are left out.
    """
    samples = [entry.sample for entry in board.entries if entry.protocol == CONSISTENCY]
    disagreements: list[Disagreement] = []
    for sample in dict.fromkeys(samples):
        disagreements += _disagreements(sample, board.methods, maps)
    return replace(board, disagreements=tuple(disagreements))


def _disagreements(
    sample: str, methods: Sequence[str], maps: Maps
) -> Iterable[Disagreement]:
    available = {name: maps.get((name, sample)) for name in methods}
    computed = {
        name: values for name, values in available.items() if values is not None
    }
    for (first, a), (second, b) in itertools.combinations(computed.items(), 2):
        yield Disagreement(sample, first, second, *apart(a, b))
