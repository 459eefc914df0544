"""Warnings of samples that are of no use: views of nothing, and images that are black or clipped everywhere."""

import warnings

from twinlens.dataset import Sample
from twinlens.factory.gates import grey
from twinlens.sensor import Sensor

_BLACK = 0.05  # of white; noise in the dark is below
_WHITE = 0.99


class ResultWarning(UserWarning):
    """A sample is complete, but of no use; the message names view and likely cause."""


def warn_of_doubts(sample: Sample, sensor: Sensor, name: str) -> None:
    """Give one `ResultWarning` with all `doubts` of a sample of the scene `name`, if there are any."""
    reasons = doubts(sample, sensor)
    if reasons:
        warnings.warn(f"{name}: {'; '.join(reasons)}", ResultWarning, stacklevel=2)


def doubts(sample: Sample, sensor: Sensor) -> list[str]:
    """What is doubtful about a sample that `sensor` took, with the likely cause; empty for most."""
    reasons = []
    blind = [view for view, truth in enumerate(sample.truths) if not truth.hit.any()]
    if blind:
        reasons.append(
            f"{_views(blind)} no surface, so all pixels are unknown: is the camera turned away from the scene?"
        )
    for k, shot in enumerate(sample.shots):
        lens = f" through lens {k}" if k else ""
        greys = [grey(image, sensor) for image in shot.images]
        # A sensor's noise, amplified by the automatic exposure, is not black.
        unlit = shot.record.get("unlit_views", [])
        if unlit:
            reasons.append(
                f"{_views(unlit)} no light at all{lens}: is there a light, and does it reach what is seen?"
            )
        black = [
            view
            for view, values in enumerate(greys)
            if values.max() <= _BLACK and view not in unlit
        ]
        if black:
            reasons.append(
                f"{_views(black)} nothing but black{lens}: is there a light, and is the exposure long enough?"
            )
        white = [view for view, values in enumerate(greys) if values.min() >= _WHITE]
        if white:
            reasons.append(
                f"{_views(white)} nothing but clipped pixels{lens}: is the exposure too long?"
            )
    return reasons


def _views(views: list[int]) -> str:
    if len(views) == 1:
        return f"view {views[0]} shows"
    return f"views {', '.join(map(str, views[:-1]))} and {views[-1]} show"
