"""A user's program that uses the public names with their types. It is type-checked, never run."""

import numpy as np
from numpy.typing import NDArray

import twinlens as tl

scene: tl.Scene = tl.load_scene("staircase")
camera = tl.Camera.from_fov(640, 480, fov_x_deg=50)
rig: tl.Rig = tl.Rig.stereo(
    camera, baseline=0.10, world_from_left=scene.world_from_left
)
lens = tl.ThinLens(aperture_diameter=0.01, focus_distance=2.0)
left, right = tl.render(scene, rig, lens, spp=64, seed=0)
truth: list[tl.Truth] = tl.ground_truth(scene, rig)
depth: NDArray[np.float64] = truth[0].depth
spin = tl.Motion(object="ball", angular_velocity_deg=(0, 0, 90))
moving = scene.moving(spin)
still: tl.Scene = moving.at(0.4)
answer = tl.correspondence(
    moving, rig.moving(tl.Motion(velocity=(1, 0, 0))), (0, 0.0), (1, 0.4)
)
flow: NDArray[np.float64] = answer.flow
grid = tl.render_lens_grid(scene, rig, [lens, tl.Pinhole()], spp=64, seed=0)
photo = tl.Sensor().expose(left, camera=camera, lens=lens, seed=0)
disparity: NDArray[np.float32] = tl.match(
    photo.image, photo.image, method="zncc", block_size=9, num_disparities=64
)
scores = tl.evaluate(
    disparity, truth[0].disparity, mask_nonocc=truth[0].visible, ndisp=64
)
bad: float = scores.nonocc["bad2.0"]
similarity: float = tl.zncc(np.ones((3, 3)), np.ones((3, 3)))

data = tl.Dataset("out/")
count: int = len(data)
stored: NDArray[np.float32] = data[0].disp0
first: tl.Dataset = data[np.arange(3)]
cropped: dict[str, object] = tl.dataset.crop(data[0], 0, 0, 64, 48)
batch = tl.collate(
    data.select("im0", "im1", "disp0", "disp1").map(tl.dataset.stereo_flip)[[1, 2]]
)

task = tl.RigTask(
    640,
    480,
    pixel_pitch_um=5.0,
    depth_range=(1.0, 4.0),
    fov_x_deg=(50, 70),
    depth_error=0.02,
)
plan = tl.plan_rig(task)
baseline: float = plan.best.baseline if plan.best is not None else 0.0
costs: NDArray[np.float64] = tl.cost_curve(
    photo.image, photo.image, 20, 10, ["sad", "zncc"]
)["sad"].costs

matcher = tl.StereoMatcher(cost="zncc", block_size=7, num_disparities=32)
other: NDArray[np.float32] = matcher.match(photo.image, photo.image)


class Flat:
    """A matcher of the user's own."""

    name = "flat"

    def match(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        *,
        num_disparities: int,
        min_disparity: int,
    ) -> NDArray[np.float32]:
        return np.full(left.shape[:2], min_disparity + num_disparities / 2, np.float32)


flat: NDArray[np.float32] = tl.match(
    photo.image, photo.image, method=Flat(), num_disparities=8
)
same: NDArray[np.float32] = tl.match(photo.image, photo.image, method=matcher)
board = tl.scoring.run_benchmark(tl.scoring.open_pairs(["out"]), [Flat()])
scored = tl.scoring.run_benchmark(data, [Flat(), "sgm", "zncc:block_size=15"])
agreement = tl.agreement("board", board)
table = tl.study("texture", methods=("zncc",), seeds=1, width=320)

names: list[str] = list(tl.bundled_scenes())
functions = tl.scoring.evaluate, tl.matching.match, tl.geometry.look_at
