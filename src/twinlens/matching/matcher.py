"""`StereoMatcher`: a classical stereo matcher, from two images to a refined disparity map and its confidence."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.matching import refine
from twinlens.matching.box import Volume
from twinlens.matching.confidence import confidence_map
from twinlens.matching.contract import Answer
from twinlens.matching.costs import descriptor_model
from twinlens.matching.images import Disparity, Image, clipped_slope, levels, pair
from twinlens.matching.matcher_options import MatcherOptions
from twinlens.matching.networks import check_model, model_hashes
from twinlens.matching.search import Search


@dataclass(frozen=True)
class StereoMatcher(MatcherOptions):
    """A classical stereo matcher: its matching cost, support window, optimisation and refinement.

    The options are those of `MatcherOptions`. The steps run in this order: cost,
    support, optimisation, winner-take-all with sub-pixel fit, uniqueness, texture, lr_check, speckles, median, fill.
    uniqueness, texture, lr_check and speckle_size make pixels unknown.

    Borders: images are padded with their edge pixels (the cross, weighted and guided supports end at the edge instead),
    so every pixel with a candidate u - d inside the right image has a disparity. Windows and ranges may be wider than
    the image. Of equal costs the smallest disparity wins. At the ends of the range there is no sub-pixel fit.

    Accuracy: uint8 and uint16 images are summed exactly, in integers. Only the normalised costs (ncc, zncc,
    jaccard) are rounded, to float32 for uint8 (an error below 1e-6) and float64 otherwise. Floating-point images are
    summed in float64: costs that differ by less than 2^-40 of the largest count as equal. A window of one value has a
    ZNCC cost of 1 with every partner; a window of zeros has an NCC cost of 1, and two of them a Jaccard cost of 0.
    Results do not depend on the number of threads.

    Raises InputError for an option with a wrong value, and for a cost that the support cannot aggregate.

    >>> StereoMatcher(cost="sad", block_size=7).num_disparities
    64
    """

    @property
    def content(self) -> str:
        """The hashes of the files of a descriptor network; "" for other costs."""
        model = descriptor_model(self.cost)
        return "" if model is None else model_hashes(model)

    def check_parts(self) -> None:
        """FileError if there is no such descriptor network, MissingExtraError if onnxruntime is not installed."""
        model = descriptor_model(self.cost)
        if model is not None:
            check_model(model)

    def without_confidence(self) -> Self:
        return self.replace(confidence="none")

    def compute(self, left: Any, right: Any) -> Answer:
        """The refined disparities, and the confidence of the costs if the option names a measure."""
        left, right = pair(left, right)
        disparity = self._disparity(left, right)
        if self.lr_check is not None:
            # Mirrored, the right image becomes a left image: u' = W - 1 - u keeps u_left - u_right.
            swapped = _mirrored(right), _mirrored(left)
            of_right = _mirrored(self._disparity(*swapped, mirrored=True))
            disparity = refine.consistent(disparity, of_right, self.lr_check)
        if self.speckle_size > 0:
            disparity = refine.without_speckles(
                disparity, self.speckle_size, self.speckle_range
            )
        if self.median > 1:
            disparity = refine.median(disparity, self.median)
        if self.fill == "background":
            disparity = refine.filled(disparity)
        if self.confidence == "none":
            return Answer(disparity)
        costs = self.cost_volume(left, right)
        return Answer(
            disparity, confidence_map(costs, self.confidence, self.min_disparity)
        )

    def cost_volume(self, left: Any, right: Any) -> NDArray[np.float32]:
        """The costs (H, W, num_disparities) that the winner-take-all step minimises; +inf without a partner.

        Candidate j has disparity min_disparity + j. Units: those of the measure in `matching.measures`, 1 - similarity
        for similarities; summed over the support's windows; of semi-global matching, the mean over its paths.
        """
        search = self.search(*pair(left, right))
        volume = np.full((*search.left.shape, self.num_disparities), np.inf, np.float32)
        if search.count > 0:
            # The search leaves out candidates that no pixel of the image can have.
            first = search.low - self.min_disparity
            candidates = slice(first, first + search.count)

            def keep(y: int, rows: Volume) -> None:
                volume[y : y + len(rows), :, candidates] = rows[..., : search.count]

            search.costs(0, len(volume), keep)
        return volume

    def search(self, left: Image, right: Image, *, mirrored: bool = False) -> Search:
        """The search of two images as `images.pair` returns them, or `mirrored` ones, which no network describes."""
        if self.cost == "jaccard":
            _check_not_negative(left, right)
        if self.prefilter == "xsobel":
            left, right = (clipped_slope(grey) for grey in levels(left, right))
        return Search(self, left, right, mirrored=mirrored)

    def _disparity(
        self, left: Image, right: Image, *, mirrored: bool = False
    ) -> Disparity:
        """The disparities of the winners that pass the checks of their own costs and windows."""
        winners = self.search(left, right, mirrored=mirrored).winners()
        disparity = winners.disparity
        if self.uniqueness > 0:
            disparity = refine.unique(
                disparity, winners.cost, winners.rival, self.uniqueness
            )
        if self.texture > 0:
            disparity = refine.with_texture(
                disparity, left, self.block_size, self.texture
            )
        return disparity


def _mirrored(image: Any) -> Any:
    return np.ascontiguousarray(image[:, ::-1])


def _check_not_negative(left: Image, right: Image) -> None:
    lowest = min(float(left.min()), float(right.min()))
    if lowest < 0:
        raise InputError(
            f"an image holds {lowest}; the Jaccard similarity is defined for values >= 0"
        )
