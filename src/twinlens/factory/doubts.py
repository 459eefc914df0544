"""Warnings of results that can hardly be meant: views of nothing, and images that are black or clipped everywhere."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import Sample

_BLACK = 0.02  # of white, as encoded


class ResultWarning(UserWarning):
    """A sample is complete, but of no use; the message names view and likely cause."""


def warn_of_doubts(sample: Sample, name: str) -> None:
    """Give one `ResultWarning` with all `doubts` of a sample of the scene `name`, if there are any."""
    reasons = doubts(sample)
    if reasons:
        warnings.warn(f"{name}: {'; '.join(reasons)}", ResultWarning, stacklevel=3)


def doubts(sample: Sample) -> list[str]:
    """What is doubtful about a sample, with the likely cause; empty for most."""
    reasons = []
    blind = [view for view, truth in enumerate(sample.truths) if not truth.hit.any()]
    if blind:
        reasons.append(
            f"{_views(blind)} no surface, so all pixels are unknown: is the camera turned away from the scene?"
        )
    for k, shot in enumerate(sample.shots):
        lens = f" through lens {k}" if k else ""
        images = list(enumerate(shot.images))
        black = [view for view, image in images if _is_black(image)]
        if black:
            reasons.append(
                f"{_views(black)} nothing but black{lens}: is there a light, and is the exposure long enough?"
            )
        white = [view for view, image in images if _is_clipped(image)]
        if white:
            reasons.append(
                f"{_views(white)} nothing but clipped pixels{lens}: is the exposure too long?"
            )
    return reasons


def _is_black(image: NDArray[Any]) -> bool:
    """Whether no pixel is brighter than noise in the dark is."""
    return bool(image.max() <= _BLACK * np.iinfo(image.dtype).max)


def _is_clipped(image: NDArray[Any]) -> bool:
    return bool((image == np.iinfo(image.dtype).max).all())


def _views(views: list[int]) -> str:
    if len(views) == 1:
        return f"view {views[0]} shows"
    return f"views {', '.join(map(str, views[:-1]))} and {views[-1]} show"
