"""`cost_curve`: the costs of one pixel as functions of disparity, as the matchers minimise them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError, check_int, format_value
from twinlens.matching.confidence import rivals
from twinlens.matching.contract import DEFAULT_DISPARITIES, check_image_size
from twinlens.matching.images import pair
from twinlens.matching.matcher import StereoMatcher
from twinlens.matching.methods import parse_methods


@dataclass(frozen=True)
class CostCurve:
    """The cost of each candidate of a pixel (u, v), lower is better.

    matcher: the matcher that minimises it. disparities: (N,) int64, pixels. costs: (N,) float64 in the units of
    `StereoMatcher.cost_volume`, +inf for a candidate without a partner in the right image. winner: the disparity of
    the lowest cost; of equal costs the smallest. rival: that of the lowest local minimum two or more disparities from
    the winner. None if there is no such candidate. disparity: the winner with the sub-pixel fit, +inf without a winner.
    """

    u: int
    v: int
    matcher: StereoMatcher
    disparities: NDArray[np.int64]
    costs: NDArray[np.float64]
    winner: int | None
    rival: int | None
    disparity: float

    def cost_at(self, disparity: float) -> float:
        """The cost of the candidate nearest to this disparity; +inf outside the range, and for +inf."""
        if not np.isfinite(disparity) or not len(self.disparities):
            return np.inf
        place = round(disparity) - int(self.disparities[0])
        return float(self.costs[place]) if 0 <= place < len(self.costs) else np.inf


def cost_curve(
    left: Any,
    right: Any,
    u: int,
    v: int,
    methods: str
    | StereoMatcher
    | Sequence[str | StereoMatcher]
    | Mapping[str, StereoMatcher] = ("zncc",),
    *,
    num_disparities: int = DEFAULT_DISPARITIES,
    min_disparity: int = 0,
) -> dict[str, CostCurve]:
    """The costs of the left pixel (u, v), column and row, as functions of disparity.

    They come from the computation that `match` runs: the curve's disparity is that of the method's map before the
    steps that refine maps (uniqueness, texture, lr_check, speckles, median, fill).

    Parameters
    ----------
    left, right : array (H, W) or (H, W, 3)
        Rectified images, as for `match`.
    methods
        Texts such as "sad:block_size=15", also comma-separated, or `StereoMatcher` objects, or objects by name, for
        several of one cost: {"small": StereoMatcher("sad", 5)}. Only twinlens's own methods have cost curves.
    num_disparities, min_disparity
        The search range in pixels, of methods that do not specify it themselves.

    Returns
    -------
    dict
        A `CostCurve` by the method's name: the given one, its text, or the cost of an object.

    Raises InputError for a pixel outside the image, other methods, and what `match` raises.

    >>> right = np.random.default_rng(0).integers(0, 256, (20, 40), dtype=np.uint8)
    >>> curve = cost_curve(np.roll(right, 3, axis=1), right, 20, 10, ["sad:block_size=5"], num_disparities=8)
    >>> curve["sad:block_size=5"].winner, float(curve["sad:block_size=5"].costs[3])
    (3, 0.0)
    """
    search = {"num_disparities": num_disparities, "min_disparity": min_disparity}
    images = pair(left, right)
    height, width = images[0].shape
    check_int("u", u, 0, width - 1)
    check_int("v", v, 0, height - 1)
    matchers = _named_matchers(methods, search)
    curves = {}
    for name, matcher in matchers.items():
        check_image_size(matcher, images[0].shape)
        curves[name] = _curve(matcher, *images, int(u), int(v))
    return curves


def _named_matchers(methods: Any, search: dict[str, int]) -> dict[str, StereoMatcher]:
    """The matchers by name. Raises InputError for names that are not unique, and for other methods than twinlens's."""
    pairs: list[tuple[str, Any]] = []
    if isinstance(methods, Mapping):
        pairs = list(methods.items())
    else:
        single = isinstance(methods, str | StereoMatcher)
        for method in [methods] if single else methods:
            pairs += _with_names(method, search)
    if not pairs:
        raise InputError("no method is named")
    names = [name for name, _ in pairs]
    for name, matcher in pairs:
        if not isinstance(matcher, StereoMatcher):
            raise InputError(
                f"{name} has no cost curve; use a method of twinlens, such as zncc or sgm"
            )
        if names.count(name) > 1:
            remedy = 'small=zncc:block_size=5, or objects by name: {"small": StereoMatcher(...), ...}'
            raise InputError(
                f"two methods are named {name!r}; give them names, such as {remedy}"
            )
    return dict(pairs)


def _with_names(method: Any, search: dict[str, int]) -> list[tuple[str, Any]]:
    """(name, matcher) of each method of a text, or of an object, which is named after its cost."""
    if isinstance(method, str):
        return [(spec.name, spec.matcher(**search)) for spec in parse_methods([method])]
    return [(str(getattr(method, "cost", format_value(method))), method)]


def _curve(
    matcher: StereoMatcher, left: NDArray[Any], right: NDArray[Any], u: int, v: int
) -> CostCurve:
    disparities = matcher.min_disparity + np.arange(matcher.num_disparities)
    costs = np.full(len(disparities), np.inf)
    winner, rival, disparity = None, None, np.inf
    search = matcher.search(left, right)
    if search.count > 0:
        # The search leaves out candidates that no pixel of the image can have.
        first = search.low - matcher.min_disparity
        costs[first : first + search.count], place, disparity = search.winner_at(u, v)
        if np.isfinite(disparity):
            winner = search.low + place
            is_rival = rivals(costs, np.asarray(first + place))
            rival_costs = np.where(is_rival, costs, np.inf)
            if np.isfinite(rival_costs).any():
                rival = int(disparities[np.argmin(rival_costs)])
    return CostCurve(u, v, matcher, disparities, costs, winner, rival, disparity)
