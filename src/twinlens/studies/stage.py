"""A scene with its rig and ground truth: renders, exposes, matches and scores image pairs for studies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Lens, Rig
from twinlens.camera.truth import Truth
from twinlens.factory import default_rig
from twinlens.matching import parse_method
from twinlens.optics import circle_of_confusion_px, middle_focus
from twinlens.rendering import ground_truth, render
from twinlens.scenes import Scene, load_scene
from twinlens.scoring import Pair, Scores, evaluate, region_masks
from twinlens.seeds import derived_seed
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
    """An independent seed for each random draw of a study, derived from the study's seed and a key for the draw."""
    return derived_seed(seed, _STREAM, *key)


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene, a rig, and the ground truth of the left view."""

    scene: Scene
    rig: Rig

    @staticmethod
    def of(
        name: str, width: int, height: int, *, fov_x_deg: float | None = None, baseline: float | None = None,
        pixel_pitch_um: float | None = None,
    ) -> "Stage":  # fmt: skip
        """The scene of this name with its default rig; field of view, baseline and pixel pitch can be changed."""
        scene = load_scene(name)
        rig = default_rig(scene, width, height, fov_x_deg, baseline)
        if pixel_pitch_um is not None:
            cameras = tuple(camera.replace(pixel_pitch_um=pixel_pitch_um) for camera in rig.cameras)
            rig = Rig(cameras, rig.world_from_cams)
        return Stage(scene, rig)

    @cached_property
    def truth(self) -> Truth:
        """The ground truth of the left view."""
        return ground_truth(self.scene, self.rig)[0]

    @property
    def camera(self) -> Camera:
        """The left camera."""
        return self.rig.cameras[0]

    @property
    def middle_focus(self) -> float:
        """The depth at the middle of the scene's disparity range, metres."""
        return middle_focus(*self.scene.depth_range)

    @cached_property
    def ndisp(self) -> int:
        """Number of disparities to search: a multiple of 16, at least 10 % above the largest true one."""
        known = self.truth.disparity[np.isfinite(self.truth.disparity)]
        return 16 * int(np.ceil((1.1 * float(known.max()) + 1) / 16))

    def blur(self, lens: Lens) -> Float:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        depth = np.where(np.isfinite(self.truth.depth), self.truth.depth, 1e9)
        return circle_of_confusion_px(depth, lens.aperture_diameter, self.camera.fx, lens.vergence)

    def photograph(self, lens: Lens, spp: int, seed: int) -> list[NDArray[np.float32]]:
        """The radiance of both views through one lens."""
        return list(render(self.scene, self.rig, lens, spp, seed))

    def expose(
        self, radiance: Sequence[Image], lens: Lens, seed: int, sensor: Sensor | None = None,
        exposure: Exposure | None = None,
    ) -> tuple[Image, Image]:  # fmt: skip
        """The digital images of both views; automatic exposure unless one is given."""
        shots = (sensor or Sensor()).expose_pair(*radiance, rig=self.rig, lens=lens, seed=seed, exposure=exposure)
        return shots[0].image, shots[1].image

    def match(self, pictures: Sequence[Image], method: str) -> NDArray[np.float32]:
        """The left disparity map of one matcher over this scene's disparity range, (H, W)."""
        return parse_method(method).match(pictures[0], pictures[1], num_disparities=self.ndisp)

    def score(
        self, disparity: Image, pictures: Sequence[Image], regions: Sequence[str] = (), lens: Lens | None = None
    ) -> Scores:
        """Middlebury v3 scores of a disparity map, in each of these regions that the pair defines."""
        blur = None if lens is None else np.abs(self.blur(lens)).astype(np.float32)
        visible = np.where(self.truth.visible, np.uint8(255), np.uint8(0))
        pair = Pair(self.scene.name, pictures[0], pictures[1], self.truth.disparity, visible, self.ndisp, blur0=blur)
        masks = region_masks(pair, [name for name in regions if name not in ("all", "nonocc")])
        return evaluate(
            disparity, self.truth.disparity, mask_nonocc=self.truth.visible, ndisp=self.ndisp, regions=masks
        )

    def errors(self, pictures: Sequence[Image], methods: Sequence[str]) -> Mapping[str, dict[str, float]]:
        """The `score_columns` of every matcher."""
        return {method: score_columns(self.score(self.match(pictures, method), pictures)) for method in methods}


def score_columns(scores: Scores, region: str = "nonocc") -> dict[str, float]:
    """The scores of a region that studies report: totbad1, totbad2 (percent) and avgerr (px)."""
    made = scores.regions[region]
    return {"totbad1": made["totbad1.0"], "totbad2": made["totbad2.0"], "avgerr": made["avgerr"]}
