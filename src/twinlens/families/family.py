"""Families of random scenes, and the settings of one scene.

Every random decision has its own stream, named after what it decides: `Request.rng("object", 3, "texture")`. A new
texture in the tables therefore moves no object.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.families.assets import Assets
from twinlens.families.draws import Rng, log_uniform
from twinlens.families.view import View
from twinlens.geometry import Float, look_at
from twinlens.scenes.scene import Scene
from twinlens.seeds import generator


@dataclass(frozen=True, eq=False)
class Request:
    """Settings of one scene: `count` objects, a picture `width_px` wide with width/height = `aspect`."""

    name: str
    root: np.random.SeedSequence
    assets: Assets
    depth_range: tuple[float, float] | None
    count: int
    aspect: float
    width_px: int

    def rng(self, *part: str | int) -> Rng:
        """The random stream of one part of the scene, independent of all others."""
        entropy: Any = self.root.entropy
        return generator(entropy, *self.root.spawn_key, *map(str, part))

    def view(self, eye: Float, target: Float, fov_x_deg: float) -> View:
        """The camera at `eye` (3,) that looks at `target` (3,)."""
        return View(look_at(eye, target), float(fov_x_deg), self.aspect, self.width_px)

    def depth_ratio(self, low: float, high: float) -> float:
        """Far depth over near depth: as requested, or drawn between `low` and `high`."""
        if self.depth_range is not None:
            return self.depth_range[1] / self.depth_range[0]
        return log_uniform(self.rng("depth"), low, high)


@dataclass(frozen=True)
class Family:
    """A kind of scene: a description, the default object count (min, max), and the function that composes a scene."""

    about: str
    object_count: tuple[int, int]
    compose: Callable[[Request], Scene]
    least_ratio: float
    """Smallest far/near that `compose` supports."""
