"""A scene with its rig and ground truth, rendered, exposed, matched and scored for studies; self-luminous targets.

Targets are area lights, so that only the camera adds noise to their images.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from twinlens.camera import Camera, Paraxial, Rig, ThinLens
from twinlens.camera.truth import Truth
from twinlens.factory import default_rig
from twinlens.geometry import Float
from twinlens.matching import parse_method
from twinlens.optics import circle_of_confusion_px
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
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Shifts of the right principal point in pixels, to average over sub-pixel positions."""
GLOW: Plugin = {"type": "rgb", "value": 1.0}
_BLACK: Plugin = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
_TEXELS_PER_PIXEL = 2.0
_STREAM = 7


def stream(seed: int, *key: int) -> int:
    """An independent seed for each random draw of a study, from the study's seed and a key for the draw."""
    return derived_seed(seed, _STREAM, *key)


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene, a rig, and the ground truth of the left view.

    denoise: whether photographs are denoised. Those of glowing surfaces are not: guides do not show their texture.
    """

    scene: Scene
    rig: Rig
    denoise: bool = True

    @staticmethod
    def of(
        name: str, width: int, height: int, *, fov_x_deg: float | None = None, baseline: float | None = None,
        pixel_pitch_um: float | None = None,
    ) -> "Stage":  # fmt: skip
        """The scene of this name with its default rig, except for the values that are given."""
        scene = load_scene(name)
        rig = default_rig(scene, width, height, fov_x_deg, baseline)
        if pixel_pitch_um is not None:
            rig = Rig(
                [
                    camera.replace(pixel_pitch_um=pixel_pitch_um)
                    for camera in rig.cameras
                ],
                rig.world_from_cams,
            )
        return Stage(scene, rig)

    @cached_property
    def truth(self) -> Truth:
        """The ground truth of the left view."""
        return ground_truth(self.scene, self.rig, objects=False)[0]

    @property
    def camera(self) -> Camera:
        """The left camera."""
        return self.rig.cameras[0]

    @cached_property
    def ndisp(self) -> int:
        """Number of disparities to search: a multiple of 16, at least 10 % above the largest true one."""
        disparity = self.truth.disparity
        largest = float(disparity[np.isfinite(disparity)].max())
        return 16 * math.ceil((1.1 * largest + 1) / 16)

    def lens(self, focus: float, blur_px: float) -> ThinLens:
        """A lens whose focus, linear in 1/z, is from the far (0) to the near end (1) of the depth range.

        blur_px: the difference of the signed blur circles of both ends.
        """
        near, far = self.scene.depth_range
        diameter = blur_px / (self.camera.fx * (1.0 / near - 1.0 / far))
        return ThinLens(diameter, 1.0 / ((1.0 - focus) / far + focus / near))

    def blur(self, lens: Paraxial) -> Float:
        """The signed blur circle of every left pixel, (H, W), pixels."""
        depth = np.where(np.isfinite(self.truth.depth), self.truth.depth, 1e9)
        return circle_of_confusion_px(
            depth, lens.aperture_diameter, self.camera.fx, lens.vergence
        )

    def photograph(
        self, lens: Paraxial, spp: int, seed: int
    ) -> list[NDArray[np.float32]]:
        """The radiance of both views through one lens."""
        return render(self.scene, self.rig, lens, spp, seed, denoise=self.denoise)

    def expose(
        self, radiance: Sequence[Image], lens: Paraxial, seed: int, sensor: Sensor | None = None,
        exposure: Exposure | None = None,
    ) -> tuple[Image, Image]:  # fmt: skip
        """The digital images of both views; automatic exposure unless one is given."""
        shots = (sensor or Sensor()).expose_pair(
            *radiance, rig=self.rig, lens=lens, seed=seed, exposure=exposure
        )
        return shots[0].image, shots[1].image

    def match(self, pictures: Sequence[Image], method: str) -> NDArray[np.float32]:
        """The left disparity map of one matcher over this scene's disparity range, (H, W)."""
        return parse_method(method).match(
            pictures[0], pictures[1], num_disparities=self.ndisp
        )

    def score(
        self,
        disparity: Image,
        pictures: Sequence[Image],
        regions: Sequence[str] = (),
        lens: Paraxial | None = None,
    ) -> Scores:
        """Middlebury v3 scores of a disparity map, also in these regions; the lens defines the blur."""
        truth, visible = self.truth.disparity, self.truth.visible
        blur = None if lens is None else self.blur(lens)
        left, right = pictures
        pair = Pair(
            self.scene.name, left, right, truth, visible, self.ndisp, blur0=blur
        )
        further = [name for name in regions if name not in ("all", "nonocc")]
        masks = region_masks(pair, further)
        return evaluate(disparity, truth, visible, self.ndisp, regions=masks)

    def errors(
        self, pictures: Sequence[Image], methods: Sequence[str]
    ) -> Mapping[str, dict[str, float]]:
        """The `score_columns` of every matcher."""
        return {
            method: score_columns(self.score(self.match(pictures, method), pictures))
            for method in methods
        }


def score_columns(scores: Scores, region: str = "nonocc") -> dict[str, float]:
    """The columns SCORES of one region."""
    metrics = scores.regions[region]
    return {
        "totbad1": metrics["totbad1.0"],
        "totbad2": metrics["totbad2.0"],
        "avgerr": metrics["avgerr"],
    }


def centred_camera(width: int, height: int, fx: float) -> Camera:
    """A camera with square pixels and a centred principal point."""
    return Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1))


def glowing(
    name: str, parts: Sequence[tuple[str, Plugin, Float, Any]], depth: float
) -> Scene:
    """A scene of black area lights, seen from the origin; parts: (name, shape, world_from_object, radiance)."""
    objects = tuple(
        SceneObject(part, shape, "black", pose, {"type": "area", "radiance": radiance})
        for part, shape, pose, radiance in parts
    )
    span = (0.5 * depth, 2.0 * depth)
    return Scene(
        name,
        objects,
        {"black": _BLACK},
        np.eye(4),
        span,
        integrator={"type": "path", "max_depth": 2},
    )


def noise_texture(
    width: int, height: int, scale: float, contrast: float, seed: int
) -> Float:
    """White noise smoothed by a Gaussian (s.d. `scale` texels), (height, width): mean 0.5, s.d. 0.5 `contrast`."""
    white = np.random.default_rng(seed).standard_normal((height, width))
    smooth = ndimage.gaussian_filter(white, scale, mode="wrap")
    texture = 0.5 + 0.5 * contrast * (smooth - smooth.mean()) / smooth.std()
    return np.asarray(np.clip(texture, 0.0, 1.0))


def noise_planes(
    camera: Camera,
    baseline: float,
    depth: float,
    seed: int,
    *,
    scale_px: float = 0.8,
    contrast: float = 0.5,
) -> list[Stage]:
    """The `noise_plane` at `depth` (m) as a pair sees it, at each of the PHASES."""
    scene = noise_plane(
        camera, baseline, depth, seed, scale_px=scale_px, contrast=contrast
    )
    rights = [camera.replace(cx=camera.cx + phase) for phase in PHASES]
    return [
        Stage(scene, Rig.stereo(camera, baseline, right=right), denoise=False)
        for right in rights
    ]


def noise_plane(
    camera: Camera,
    baseline: float,
    depth: float,
    seed: int,
    *,
    scale_px: float = 0.8,
    contrast: float = 0.5,
) -> Scene:
    """A plane that glows with the `plane_texture`."""
    pose, texture = plane_texture(
        camera, baseline, depth, seed, scale_px=scale_px, contrast=contrast
    )
    return glowing("plane", [("plane", {"type": "rectangle"}, pose, texture)], depth)


def plane_texture(
    camera: Camera,
    baseline: float,
    depth: float,
    seed: int,
    *,
    scale_px: float = 0.8,
    contrast: float = 0.5,
) -> tuple[Float, Bitmap]:
    """`noise_texture`, and the pose of a rectangle at `depth` (m) that fills both images of a pair at the origin."""
    # Margins of 15 % and 16 pixels on each side, and the baseline.
    width = 1.15 * ((camera.width + 32) * depth / camera.fx) + 2 * baseline
    height = 1.15 * (camera.height + 32) * depth / camera.fx
    texel = depth / camera.fx / _TEXELS_PER_PIXEL
    columns, rows = math.ceil(width / texel), math.ceil(height / texel)
    scale = scale_px * _TEXELS_PER_PIXEL
    texture = noise_texture(columns, rows, scale, contrast, stream(seed, 100))
    # A rectangle spans -1 to 1 and looks along +z; it is turned towards a camera with y down.
    pose = np.diag([0.5 * width, -0.5 * height, -1.0, 1.0])
    pose[:3, 3] = 0.5 * baseline, 0.0, depth
    return pose, Bitmap(texture.astype(np.float32))
