"""Concentric rings that make up a list of disk apertures: which there are, their samples, and points on them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from twinlens.camera import Lens
from twinlens.rendering.backends import mitsuba

FEWEST_PASSES = 2
"""A ring's standard error is read off the differences of its passes."""

STRATIFIED_FALL = 1.25
"""The variance of n stratified samples falls as n^-1.5 where edges make it (Mitchell, Consequences of Stratified
Sampling in Graphics, 1996) and as n^-1 where noise in many dimensions does: midway."""


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


def plan_rings(lenses: Sequence[Lens], spp: int, fall: float = STRATIFIED_FALL) -> list[Ring]:
    """Rings between the radii, innermost first, with the fewest samples that give every lens its direct error.

    n samples in FEWEST_PASSES passes have the variance s^2 FEWEST_PASSES^(fall - 1) / n^fall, a direct image has
    s^2 / spp^fall. With weights w = area/(area of the lens) a lens has sum w^2 of that over its rings: going outwards,
    each ring takes just what its lens still needs.
    """
    radii = sorted({0.5 * lens.aperture_diameter for lens in lenses})
    fewest = min(FEWEST_PASSES, spp)
    split = fewest ** (fall - 1)
    rings: list[Ring] = []
    inner = 0.0
    for outer in radii:
        wanted = sorted({lens.vergence for lens in lenses if 0.5 * lens.aperture_diameter >= outer > 0})
        weight = (outer**2 - inner**2) / outer**2 if outer else 1.0
        spent = sum((ring.area / outer**2) ** 2 * split / ring.spp**fall for ring in rings if outer)
        count = math.ceil((weight**2 * split / (spp**-fall - spent)) ** (1 / fall) - 1e-9)
        rings.append(Ring(inner, outer, tuple(wanted or [lenses[0].vergence]), max(fewest, count)))
        inner = outer
    return rings


def share_of(ring: Ring, lens: Lens) -> float:
    """The part of a lens's open area that a ring makes up."""
    radius = 0.5 * lens.aperture_diameter
    if radius == 0:
        return float(ring.outer == 0)
    return ring.area / radius**2 if ring.outer <= radius else 0.0


def sample_ring(ring: Ring, square: Any) -> tuple[Any, Any]:
    """Points uniform on the ring, metres: the concentric map with its squared radius laid between the two radii."""
    import drjit as dr

    from twinlens.camera.warp import concentric
    from twinlens.rendering.warp import DrJitMath

    mi = mitsuba()
    inner2, area = (dr.opaque(mi.Float, value) for value in (ring.inner**2, ring.area))
    xp: Any = DrJitMath()
    radius, turn = concentric(square.x, square.y, xp)
    radius = xp.sqrt(inner2 + area * radius * radius)
    return radius * xp.cos(2 * math.pi * turn), radius * xp.sin(2 * math.pi * turn)
