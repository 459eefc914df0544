"""What a sensor gives back."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class Photo:
    """A picture, uint8 or uint16, (H, W, 3) or (H, W), and the record of how it was exposed: a plain dict."""

    image: Image
    record: dict[str, Any]
