"""A scene set up for a study: its rig, its truth, and how a pair of radiances becomes scores.

scene, size -> rig, truth, ndisp
radiance -> sensor -> pictures -> matchers -> scores, region by region
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Rig, film_distance
from twinlens.camera.truth import Truth
from twinlens.factory import default_rig
from twinlens.matching import parse_method
from twinlens.optics import circle_of_confusion_px, middle_focus
from twinlens.rendering import ground_truth, render
from twinlens.scenes import Scene, load_scene
from twinlens.scoring import Pair, Scores, evaluate, region_masks
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.table import Column

Image = NDArray[Any]
Float = NDArray[np.float64]

SCORES = (
    Column("totbad2", "%", "wrong by > 2 px or unknown"),
    Column("totbad1", "%", "wrong by > 1 px or unknown"),
    Column("avgerr", "px", "mean error"),
)
"""The columns of a table that `score_columns` fills."""

_STREAM = 7


def stream(seed: int, *key: int) -> int:
    """A seed of its own for each draw of a study, derived from the study's seed and the numbers that name the draw."""
    return int(np.random.SeedSequence(seed, spawn_key=(_STREAM, *key)).generate_state(1)[0])


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene with the rig that looks at it, and the truth of the left view, cast once."""

    scene: Scene
    rig: Rig

    @staticmethod
    def of(
        name: str, width: int, height: int, *, fov_x_deg: float | None = None, baseline: float | None = None,
        pixel_pitch_um: float | None = None,
    ) -> "Stage":  # fmt: skip
        """The scene of this name with the pair it was composed for; field of view, baseline and pitch may differ."""
        scene = load_scene(name)
        rig = default_rig(scene, width, height, fov_x_deg, baseline)
        if pixel_pitch_um is not None:
            cameras = tuple(camera.replace(pixel_pitch_um=pixel_pitch_um) for camera in rig.cameras)
            rig = Rig(cameras, rig.world_from_cams)
        return Stage(scene, rig)

    @cached_property
    def truth(self) -> Truth:
        """Of the left view."""
        return ground_truth(self.scene, self.rig)[0]

    @property
    def camera(self) -> Camera:
        """The left one."""
        return self.rig.cameras[0]

    @property
    def middle_focus(self) -> float:
        """The depth at the middle of the scene's disparities, metres."""
        return middle_focus(*self.scene.depth_range)

    @cached_property
    def ndisp(self) -> int:
        """Disparities to search: a tenth more than the largest true one, a multiple of 16."""
        known = self.truth.disparity[np.isfinite(self.truth.disparity)]
        return 16 * int(np.ceil((1.1 * float(known.max()) + 1) / 16))

    def film_distance(self, lens: Lens) -> float:
        """From lens to film, metres."""
        return film_distance(self.camera, lens)

    def blur(self, lens: Lens) -> Float:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        depth = np.where(np.isfinite(self.truth.depth), self.truth.depth, 1e9)
        return circle_of_confusion_px(depth, lens.aperture_diameter, self.camera.fx, lens.vergence)

    def photograph(self, lens: Lens, spp: int, seed: int) -> list[NDArray[np.float32]]:
        """Radiance of both views through one lens."""
        return list(render(self.scene, self.rig, lens, spp, seed))

    def expose(
        self, radiance: Sequence[Image], lens: Lens, seed: int, sensor: Sensor | None = None,
        exposure: Exposure | None = None,
    ) -> tuple[Image, Image]:  # fmt: skip
        """The pictures of both views."""
        shots = (sensor or Sensor()).expose_pair(*radiance, rig=self.rig, lens=lens, seed=seed, exposure=exposure)
        return shots[0].image, shots[1].image

    def match(self, pictures: Sequence[Image], method: str) -> NDArray[np.float32]:
        """The left view's disparity by one matcher, over this scene's range."""
        return parse_method(method)(pictures[0], pictures[1], num_disparities=self.ndisp)

    def score(
        self,
        disparity: Image,
        pictures: Sequence[Image],
        regions: Sequence[str] = (),
        lens: Lens | None = None,
    ) -> Scores:
        """By the rules of Middlebury v3; of each region that the pair can tell."""
        pair = self._pair(pictures, lens)
        masks = region_masks(pair, [name for name in regions if name not in ("all", "nonocc")])
        return evaluate(
            disparity, self.truth.disparity, mask_nonocc=self.truth.visible, ndisp=self.ndisp, regions=masks
        )

    def errors(
        self, pictures: Sequence[Image], methods: Sequence[str], lens: Lens | None = None
    ) -> Mapping[str, dict[str, float]]:
        """For every matcher, what studies report: see `score_columns`; non-occluded pixels, Middlebury v3."""
        return {
            method: score_columns(self.score(self.match(pictures, method), pictures, lens=lens)) for method in methods
        }

    def _pair(self, pictures: Sequence[Image], lens: Lens | None) -> Pair:
        blur = None if lens is None else np.abs(self.blur(lens)).astype(np.float32)
        visible = np.where(self.truth.visible, np.uint8(255), np.uint8(0))
        return Pair(self.scene.name, pictures[0], pictures[1], self.truth.disparity, visible, self.ndisp, blur0=blur)


def score_columns(scores: Scores, region: str = "nonocc") -> dict[str, float]:
    """The numbers of a region that a study's table has: totbad1, totbad2 (percent) and avgerr (px)."""
    made = scores.regions[region]
    return {"totbad1": made["totbad1.0"], "totbad2": made["totbad2.0"], "avgerr": made["avgerr"]}
