"""The shape of an aperture, inside the unit disk; the lens scales it by its radius.

Coordinates are the camera's (x right, y down), seen from behind the lens, looking out.
"""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Disk:
    """The full circle."""

    name: ClassVar[str] = "disk"
    area_fraction: ClassVar[float] = 1.0


Aperture = Disk

FULL_DISK = Disk()
