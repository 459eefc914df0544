"""The style of the figures of docs/course: sphinx-gallery calls `reset` before it runs a script."""

import contextlib
import warnings
from typing import Any

import matplotlib as mpl

STYLE = {
    "figure.figsize": (
        5.6,
        3.2,
    ),  # narrow, so that the letters are not too small on a phone
    "figure.dpi": 100,
    "figure.facecolor": "white",  # also in the dark theme
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "image.cmap": "gray",
    "image.interpolation": "nearest",
    "lines.linewidth": 1.5,
    "legend.frameon": False,
}

CHANGED = contextlib.ExitStack()  # what the next call undoes


def reset(gallery: dict[str, Any], script: str | None, when: str) -> None:
    """Set the style, and make warnings errors while a script runs."""
    CHANGED.close()
    if when == "before" and script:
        CHANGED.enter_context(mpl.rc_context(STYLE))
        CHANGED.enter_context(warnings.catch_warnings(action="error"))
