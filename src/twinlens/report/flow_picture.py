"""Pictures of optical flow: the colour of a pixel is the direction of its flow, and its saturation the length.

Source: Baker, Scharstein, Lewis, Roth, Black and Szeliski, A database and evaluation methodology for optical flow, IJCV
2011: a wheel of 55 colours, on which flow to the right is red, and flow to the left cyan.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float

_PARTS = (
    (15, 0, 1, True),
    (6, 1, 0, False),
    (4, 1, 2, True),
    (11, 2, 1, False),
    (13, 2, 0, True),
    (6, 0, 2, False),
)
"""Of each part of the wheel: its number of colours, the channel that is full, and another that rises, or falls.

They lead from red to yellow, green, cyan, blue, magenta and back.
"""


def colour_wheel() -> Float:
    """The colours of directions (55, 3), 0 to 1, from the right over below, the left and above back to the right."""
    parts = []
    for count, full, changing, rises in _PARTS:
        share = np.arange(count) / count
        part = np.zeros((count, 3))
        part[:, full] = 1.0
        part[:, changing] = share if rises else 1 - share
        parts.append(part)
    return np.concatenate(parts)


def largest_flow(flow: ArrayLike) -> float:
    """The length in pixels of the longest finite flow of an image (H, W, 2); 0 without any."""
    lengths = np.linalg.norm(np.asarray(flow, dtype=np.float64), axis=-1)
    return float(lengths[np.isfinite(lengths)].max(initial=0.0))


def flow_picture(flow: ArrayLike, largest: float | None = None) -> NDArray[np.uint8]:
    """The colours uint8 (H, W, 3) of a flow (H, W, 2) in pixels, black where it is not finite.

    largest : length in pixels of full saturation; by default that of the longest flow. Longer ones are darker.

    Raises InputError for another shape.
    """
    values = np.asarray(flow, dtype=np.float64)
    if values.ndim != 3 or values.shape[2] != 2:
        raise InputError(f"a flow must have the shape (H, W, 2), got {values.shape}")
    is_known = np.isfinite(values).all(axis=-1)
    u, v = values[is_known].T / (largest or largest_flow(values) or 1.0)
    wheel = colour_wheel()
    # The direction as a place between two colours: the right has 0, below has a quarter of the last number.
    place = np.arctan2(v, u) / (2 * np.pi) % 1.0 * (len(wheel) - 1)
    before = place.astype(int)
    share = (place - np.floor(place))[:, None]
    colour = (1 - share) * wheel[before] + share * wheel[(before + 1) % len(wheel)]
    length = np.hypot(u, v)[:, None]
    faded = 1 - np.minimum(length, 1.0) * (1 - colour)
    picture = np.zeros((*is_known.shape, 3), dtype=np.uint8)
    picture[is_known] = np.rint(255 * np.where(length > 1, 0.75 * colour, faded))
    return picture
