"""Concentric rings that make up a list of disk apertures: which there are, their samples, who shares their paths."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from twinlens.camera import Camera, Lens

STRATIFIED_FALL = 1.3
"""The variance of n stratified samples falls as n^-1.5 where edges make it (Mitchell, Consequences of Stratified
Sampling in Graphics, 1996) and as n^-1 where noise in many dimensions does. On the bundled scenes it lies between: at
1.1, where outer rings get 24 samples for 64, the lenses of cards err 1.4 times as much as at 1.3, where they get 32."""

LANDING_LOSS = 1.15
"""About how much variance the samples of a pixel gain by landing in several: 1.2 on cards at the narrowest aperture."""


@dataclass(frozen=True)
class Ring:
    """Aperture radii between `inner` and `outer` metres, the vergences that need it, and its samples a pixel."""

    inner: float
    outer: float
    vergences: tuple[float, ...]
    spp: int

    @property
    def area(self) -> float:
        """outer^2 - inner^2: area over pi. A pinhole's ring has none, and is its lens's only one."""
        return self.outer**2 - self.inner**2


def samples_that_land(spp: int) -> int:
    """How many shared samples are worth `spp` of a pixel's own.

    >>> samples_that_land(64), samples_that_land(1)
    (71, 1)
    """
    return int(spp * LANDING_LOSS ** (1 / STRATIFIED_FALL))


def plan_rings(lenses: Sequence[Lens], spp: int, fall: float = STRATIFIED_FALL) -> list[Ring]:
    """Rings between the radii, innermost first, with the fewest samples that give every lens its direct error.

    n samples have the variance s^2 / n^fall. With weights w = area/(area of the lens) a lens has sum w^2 of that over
    its rings, and should have s^2 / spp^fall: going outwards, each ring takes just what its lens still needs.
    """
    fewest = min(2, spp)  # two halves tell the error
    rings: list[Ring] = []
    inner = 0.0
    for outer in sorted({0.5 * lens.aperture_diameter for lens in lenses}):
        wanted = sorted({lens.vergence for lens in lenses if 0.5 * lens.aperture_diameter >= outer > 0})
        weight = (outer**2 - inner**2) / outer**2 if outer else 1.0
        spent = sum((ring.area / outer**2) ** 2 / ring.spp**fall for ring in rings if outer)
        count = math.ceil((weight**2 / (spp**-fall - spent)) ** (1 / fall) - 1e-9)
        rings.append(Ring(inner, outer, tuple(wanted or [0.0]), max(fewest, count)))
        inner = outer
    return rings


def share_of(ring: Ring, lens: Lens) -> float:
    """The part of a lens's open area that a ring makes up."""
    radius = 0.5 * lens.aperture_diameter
    if radius == 0:
        return float(ring.outer == 0)
    return ring.area / radius**2 if ring.outer <= radius else 0.0


@dataclass(frozen=True)
class Sheaf:
    """Vergences of a ring that share their paths. `middle` is where the paths are drawn: shifts are smallest there."""

    vergences: tuple[float, ...]
    margin: tuple[int, int]

    @property
    def middle(self) -> float:
        """Midway, in 1/m."""
        return 0.5 * (self.vergences[0] + self.vergences[-1])


def sheaves(ring: Ring, camera: Camera) -> list[Sheaf]:
    """The ring's vergences, parted wherever two sets of paths on less film cost less than one on more.

    Shared paths start on film padded by the largest shift on every side. A bare hole among lenses may need more
    padding than its own image takes.
    """
    return _parted(tuple(ring.vergences), ring.outer, camera)


def _parted(vergences: tuple[float, ...], radius: float, camera: Camera) -> list[Sheaf]:
    half_range = 0.5 * (vergences[-1] - vergences[0]) * radius
    whole = Sheaf(vergences, (math.ceil(half_range * camera.fx), math.ceil(half_range * camera.fy)))
    if len(vergences) == 1:
        return [whole]
    gaps = [b - a for a, b in itertools.pairwise(vergences)]
    cut = gaps.index(max(gaps)) + 1
    parts = _parted(vergences[:cut], radius, camera) + _parted(vergences[cut:], radius, camera)
    return [whole] if _film(whole, camera) <= sum(_film(part, camera) for part in parts) else parts


def _film(sheaf: Sheaf, camera: Camera) -> int:
    return (camera.width + 2 * sheaf.margin[0]) * (camera.height + 2 * sheaf.margin[1])
