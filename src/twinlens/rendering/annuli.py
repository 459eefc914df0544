"""Concentric annuli that compose a list of disk apertures: their radii, sample counts and vergences."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Paraxial
from twinlens.geometry import Float

Shares = Callable[[NDArray[np.float32]], Float]
"""Weights (n, K) of samples in K images, from their points (n, 2) of the aperture in metres."""

SHARING_COST = 1.11  # factor in samples that compensates for errors that pixels share


@dataclass(frozen=True)
class ApertureAnnulus:
    """Aperture radii between `inner` and `outer` metres, the vergences that use it, and its samples per pixel."""

    inner: float
    outer: float
    vergences: tuple[float, ...]
    spp: int

    @property
    def middle(self) -> float:
        """The vergence at which paths are traced, 1/m: the middle one, where shifts are smallest."""
        return 0.5 * (self.vergences[0] + self.vergences[-1])

    def film_size(self, camera: Camera) -> tuple[int, int]:
        """(width, height) of the film where paths start: the image with a margin of the largest shift on every side."""
        largest = (self.vergences[-1] - self.middle) * self.outer
        margin_x = math.ceil(largest * camera.fx)
        margin_y = math.ceil(largest * camera.fy)
        return camera.width + 2 * margin_x, camera.height + 2 * margin_y


def area_fraction(annulus: ApertureAnnulus, radius: float) -> float:
    """The fraction of the area of an aperture that an annulus covers; a radius of 0 is a pinhole."""
    if annulus.outer > radius:
        return 0.0
    return (annulus.outer**2 - annulus.inner**2) / radius**2 if radius else 1.0


def plan_annuli(lenses: Sequence[Paraxial], spp: int) -> list[ApertureAnnulus]:
    """Annuli between the radii, innermost first, with samples that give every lens the error of `spp`.

    An annulus that is the fraction w of the disk of area a within its outer radius gets w spp samples. In units of one
    sample's variance, that of a lens of area A is then the sum of (w a / A)^2 / (w spp), at most 1 / spp as a <= A.
    """
    annuli: list[ApertureAnnulus] = []
    inner = 0.0
    for outer in sorted({0.5 * lens.aperture_diameter for lens in lenses}):
        used = set()
        for lens in lenses:
            radius = 0.5 * lens.aperture_diameter
            if radius == outer or radius > outer > 0:
                used.add(lens.vergence)
        fraction = 1 - (inner / outer) ** 2 if outer else 1.0
        # The error is estimated from two halves.
        count = max(min(2, spp), int(SHARING_COST * spp * fraction))
        annuli.append(ApertureAnnulus(inner, outer, tuple(sorted(used)), count))
        inner = outer
    return annuli


def split_vergences(annulus: ApertureAnnulus, camera: Camera) -> list[ApertureAnnulus]:
    """The annulus, or parts of its vergences where two sets of paths need less film than one.

    A bare aperture among lenses may need a wider margin than its own image has pixels.
    """
    if len(annulus.vergences) == 1:
        return [annulus]
    cut = int(np.argmax(np.diff(annulus.vergences))) + 1
    low = replace(annulus, vergences=annulus.vergences[:cut])
    high = replace(annulus, vergences=annulus.vergences[cut:])
    parts = [*split_vergences(low, camera), *split_vergences(high, camera)]
    needed = sum(math.prod(part.film_size(camera)) for part in parts)
    return parts if needed < math.prod(annulus.film_size(camera)) else [annulus]
