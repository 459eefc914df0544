"""What a family of scenes is, and what one scene of it is asked to be.

Every random decision is drawn from a stream named after what it decides (`Request.rng("object", 3, "texture")`), so
that one more texture to choose from moves no object.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twinlens.families.assets import Assets
from twinlens.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class Request:
    """One scene that is wanted: of which seed, how deep, how full, how wide its picture."""

    name: str
    root: np.random.SeedSequence
    assets: Assets
    depth_range: tuple[float, float] | None
    count: int
    aspect: float
    width_px: int

    def counting(self, count: int) -> "Request":
        """The same with this many objects."""
        return replace(self, count=count)

    def rng(self, *part: str | int) -> np.random.Generator:
        """The random stream of one part of the scene; streams of other parts do not move it."""
        key = tuple(zlib.crc32(str(step).encode()) for step in part)
        seeds = np.random.SeedSequence(self.root.entropy, spawn_key=(*self.root.spawn_key, *key))
        return np.random.Generator(np.random.PCG64(seeds))


@dataclass(frozen=True)
class Family:
    """A kind of scene: what it shows, how many objects it has if nobody says, and what composes one."""

    about: str
    object_count: tuple[int, int]
    compose: Callable[[Request], Scene]
    least_ratio: float
    """The least far/near that it can be composed for."""
