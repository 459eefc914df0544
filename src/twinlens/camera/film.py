"""The image as it really falls on the film: upside down and reversed, as in a box with a hole."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def film_image(image: NDArray[Any]) -> NDArray[Any]:
    """`image` (H, W, ...) turned by 180 degrees, as it lies on the film seen from behind, looking out of the camera.

    Light crosses in the aperture: a point at (X, Y) of the upright image that twinlens renders (a film in front of the
    hole) meets the film behind it at (-X, -Y). Whoever sits inside the box and faces the film sees it mirrored as well.
    The principal point (cx, cy) comes to (W - 1 - cx, H - 1 - cy). Turned twice, the image is itself again.

    >>> film_image(np.array([[1, 2], [3, 4]])).tolist()
    [[4, 3], [2, 1]]
    """
    return np.ascontiguousarray(image[::-1, ::-1])
