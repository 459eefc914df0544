"""The regions a board can report, by name: which function of `regions`, applied to which arrays of a sample.

A region that needs what a sample does not have (a mask, a blur map, material kinds) is left out for it.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import unknown
from twinlens.scoring import regions as made
from twinlens.scoring.checks import Mask, mask_of
from twinlens.scoring.pair import Pair


@dataclass(frozen=True)
class Region:
    """A named part of the image; `mask` gives it for a sample, or None where the sample lacks what it `needs`."""

    name: str
    text: str
    mask: Callable[[Pair], Mask | None]


def _nonocc(sample: Pair) -> Mask | None:
    mask = sample.mask0_nonocc
    return None if mask is None else mask_of("mask0_nonocc", mask, sample.disp0.shape)


def _inside_nonocc(inner: Callable[[Pair], Mask | None]) -> Callable[[Pair], Mask | None]:
    def mask(sample: Pair) -> Mask | None:
        seen, part = _nonocc(sample), inner(sample)
        return None if seen is None or part is None else seen & part

    return mask


def _occluded(sample: Pair) -> Mask | None:
    return None if sample.mask0_nonocc is None else made.occluded(sample.mask0_nonocc)


def _grey_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """The image in 256 levels, which the limit of textureless is stated in."""
    return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image


def _textureless(sample: Pair) -> Mask | None:
    """A column alone has no neighbours to differ from."""
    return None if sample.im0.shape[1] < 2 else made.textureless(_grey_levels(sample.im0))


def _blurred(sample: Pair) -> Mask | None:
    return None if sample.blur0 is None else made.out_of_focus(sample.blur0)


def _material(kind: str) -> Callable[[Pair], Mask | None]:
    def mask(sample: Pair) -> Mask | None:
        return None if sample.material_kind0 is None else made.of_material(sample.material_kind0, kind)

    return mask


REGIONS: Mapping[str, Region] = MappingProxyType(
    {
        region.name: region
        for region in (
            Region("all", "every pixel with known truth", lambda s: np.ones(s.disp0.shape, np.bool_)),
            Region("nonocc", "seen by both cameras", _nonocc),
            Region("occluded", "known, but hidden from or outside the right view", _occluded),
            Region(
                "textureless",
                "non-occluded; mean squared horizontal difference over 3x3 below 16 (Middlebury 2002)",
                _inside_nonocc(_textureless),
            ),
            Region(
                "discontinuity",
                "non-occluded; within 9x9 of a disparity jump of 2 px or more (Middlebury 2002)",
                _inside_nonocc(lambda s: made.discontinuity(s.disp0)),
            ),
            Region(
                "out-of-focus",
                f"blur circle wider than {made.BLUR_LIMIT_PX:g} px",
                _blurred,
            ),
            Region(
                "near",
                "the upper third of the range of true disparities",
                lambda s: made.distance_bands(s.disp0)[0],
            ),
            Region(
                "mid", "the middle third of the range of true disparities", lambda s: made.distance_bands(s.disp0)[1]
            ),
            Region(
                "far",
                "the lower third of the range of true disparities",
                lambda s: made.distance_bands(s.disp0)[2],
            ),
            *(Region(kind, f"{kind} materials", _material(kind)) for kind in MATERIAL_KINDS[1:]),
        )
    }
)
"""Every region by name."""


def region_masks(sample: Pair, names: Iterable[str]) -> dict[str, Mask]:
    """The masks of those regions that the sample can tell, in the order asked for.

    Raises
    ------
    InputError
        An unknown name; the nearest is suggested.
    """
    masks = {}
    for name in names:
        if name not in REGIONS:
            raise unknown("region", name, REGIONS)
        mask = REGIONS[name].mask(sample)
        if mask is not None:
            masks[name] = mask
    return masks
