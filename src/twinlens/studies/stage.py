"""A scene with its rig and ground truth, rendered, exposed, matched and scored for studies; self-luminous targets.

Only the camera adds noise to images of the targets. A plane at twice the distance has a print of twice the size.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.camera import Camera, Lens, Rig, ThinLens
from twinlens.camera.truth import Truth
from twinlens.factory import default_rig
from twinlens.geometry import Float
from twinlens.matching import parse_method
from twinlens.optics import circle_of_confusion_px, middle_focus
from twinlens.rendering import ground_truth, render
from twinlens.scenes import Bitmap, Plugin, Scene, SceneObject, load_scene
from twinlens.scoring import Pair, Scores, evaluate, region_masks
from twinlens.seeds import derived_seed
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.table import Column

Image = NDArray[Any]

SCORES = (
    Column("totbad2", "%", "wrong by > 2 px or unknown"),
    Column("totbad1", "%", "wrong by > 1 px or unknown"),
    Column("avgerr", "px", "mean error"),
)
"""The columns of a table that `score_columns` fills."""
PHASES = (0.0, 0.25, 0.5, 0.75)  # shifts of the right principal point, which average over sub-pixel positions
GLOW: Plugin = {"type": "rgb", "value": 1.0}
_BLACK: Plugin = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_TEXELS_PER_PIXEL = 2.0
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
            rig = Rig([camera.replace(pixel_pitch_um=pixel_pitch_um) for camera in rig.cameras], rig.world_from_cams)
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

    def lens(self, focus: float, blur_px: float) -> ThinLens:
        """The lens focused from the far (0) to the near end (1) of the depth range in 1/z, its ends `blur_px` apart."""
        near, far = self.scene.depth_range
        diameter = blur_px / (self.camera.fx * (1.0 / near - 1.0 / far))
        return ThinLens(diameter, 1.0 / ((1.0 - focus) / far + focus / near))

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


def centred_camera(width: int, height: int, fx: float) -> Camera:
    """A camera with square pixels and a centred principal point."""
    return Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1))


def glowing(name: str, parts: Sequence[tuple[str, Plugin, Float, Any]], depth: float) -> Scene:
    """A scene of black area lights, seen from the origin; parts: (name, shape, world_from_object, radiance)."""
    objects = tuple(
        SceneObject(part, shape, "black", pose, {"type": "area", "radiance": radiance})
        for part, shape, pose, radiance in parts
    )
    span = (0.5 * depth, 2.0 * depth)
    return Scene(name, objects, {"black": _BLACK}, np.eye(4), span, integrator={"type": "path", "max_depth": 2})


def noise_texture(width: int, height: int, scale: float, contrast: float, seed: int) -> Float:
    """White noise smoothed by a Gaussian (s.d. `scale` texels), (height, width): mean 0.5, s.d. 0.5 `contrast`."""
    white = np.random.default_rng(seed).standard_normal((height, width))
    smooth = ndimage.gaussian_filter(white, scale, mode="wrap")
    return np.asarray(np.clip(0.5 + 0.5 * contrast * (smooth - smooth.mean()) / smooth.std(), 0.0, 1.0))


def noise_plane(rig: Rig, depth: float, seed: int, *, scale_px: float = 0.8, contrast: float = 0.5) -> Scene:
    """A plane of `noise_texture` at `depth` (m) that fills both images of a rig at the origin."""
    camera, baseline = rig.cameras[0], rig.baseline(0, 1)
    width = 1.15 * ((camera.width + 32) * depth / camera.fx) + 2 * baseline  # margins of 15 % and 16 pixels
    height = 1.15 * (camera.height + 32) * depth / camera.fx
    columns, rows = (math.ceil(side / (depth / camera.fx / _TEXELS_PER_PIXEL)) for side in (width, height))
    texture = noise_texture(columns, rows, scale_px * _TEXELS_PER_PIXEL, contrast, stream(seed, 100))
    pose = np.diag([0.5 * width, -0.5 * height, -1.0, 1.0])  # turned towards a camera with y down
    pose[:3, 3] = 0.5 * baseline, 0.0, depth
    return glowing("plane", [("plane", {"type": "rectangle"}, pose, Bitmap(texture.astype(np.float32)))], depth)


def noise_planes(camera: Camera, baseline: float, depth: float, seed: int, **texture: float) -> list[Stage]:
    """A `noise_plane` seen by a pair of cameras, with the right principal point at each of the PHASES."""
    rig = Rig.stereo(camera, baseline, np.eye(4))
    scene = noise_plane(rig, depth, seed, **texture)
    rights = [camera.replace(cx=camera.cx + phase) for phase in PHASES]
    return [Stage(scene, Rig((camera, right), rig.world_from_cams)) for right in rights]
