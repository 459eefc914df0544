r"""
The hard cases of stereo matching
=================================

A matcher assumes that both cameras see the same window. Five things break this: occlusion (a point is seen by one
camera only), no texture (all windows look alike), repetition (several do), reflections (a mirror shows things at
another disparity), and distortion (a slanted surface is narrower in one image). On a surface of slope s = dd/du:

.. math::

    \text{width in the right image} = (1 - s) \times \text{width in the left image}

The truth of each pixel gives the masks of the five cases, and the share of disparities in each that are wrong by more
than 1 pixel. The left edge of the image is an occlusion too: the right camera does not see it. Of the rest, pixels
beside the edges of surfaces are wrong, where the window sees two depths.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.scenes import Bitmap, Color, SceneObject


def panel(name, material, centre, width, height, turn_deg=0.0):
    """A rectangle that faces the camera at the origin, turned about its vertical axis. Axes: x right, y down."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.diag(
        [width / 2, -height / 2, -1]
    )
    pose[:3, 3] = centre
    return SceneObject(name, {"type": "rectangle"}, material, pose)


rng = np.random.default_rng(0)
dots = np.kron(rng.random((160, 160)), np.ones((2, 2))).astype(np.float32)[
    ..., None
] * np.ones(3, np.float32)
bars = np.tile(np.repeat([0.1, 0.8], 16), 12).astype(np.float32)[
    None, :, None
] * np.ones((8, 1, 3), np.float32)
materials = {
    "dots": {"type": "diffuse", "reflectance": Bitmap(0.1 + 0.7 * dots)},
    "bars": {"type": "diffuse", "reflectance": Bitmap(bars)},
    "plain": {"type": "diffuse", "reflectance": Color((0.6, 0.5, 0.3))},
    "mirror": {"type": "conductor", "material": "none"},
}
objects = (
    panel("wall", "dots", (0, 0, 3), 5, 4),
    panel("behind the camera", "dots", (0, 0, -1), 5, 4, turn_deg=180),
    panel("post", "dots", (0, 0, 1.5), 0.25, 2),
    panel("no texture", "plain", (-0.75, -0.5, 2.5), 0.9, 0.75),
    panel("repetition", "bars", (0.75, -0.5, 2.5), 0.9, 0.75),
    panel("reflection", "mirror", (-0.75, 0.5, 2.5), 0.9, 0.75),
    panel("distortion", "dots", (0.4, 0.5, 1.9), 1.4, 0.75, turn_deg=80),
)
scene = tl.Scene(
    "hard cases",
    objects,
    materials,
    np.eye(4),
    (1.4, 3.2),
    lights={"sky": {"type": "constant"}},
)
rig = tl.Rig.stereo(tl.Camera.from_fov(320, 240, fov_x_deg=60), baseline=0.2)
radiances = tl.render(scene, rig, spp=16, denoise=True)
left, right = (
    photo.image
    for photo in tl.Sensor().expose_rig(radiances, rig=rig, lens=tl.Pinhole(), seed=0)
)
truth = tl.ground_truth(scene, rig)[0]
disparity = tl.match(left, right, method="zncc", block_size=9, num_disparities=56)

# %%
# The masks, and the share of wrong disparities in each.

wrong = np.abs(disparity - truth.disparity) > 1  # pixel
masks = {"occlusion": ~truth.visible}
for i, thing in enumerate(objects, start=1):  # object_id counts from 1
    if thing.name in ("no texture", "repetition", "reflection", "distortion"):
        masks[thing.name] = truth.visible & (truth.object_id == i)
masks["the rest"] = ~np.any(list(masks.values()), axis=0)

figure, axes = plt.subplots(2, 2, figsize=(5.6, 5.4))
axes[0, 0].imshow(left)
axes[0, 1].imshow(truth.disparity, cmap="viridis", vmin=0, vmax=56)
axes[1, 0].imshow(disparity, cmap="viridis", vmin=0, vmax=56)
colors = ["#D55E00", "#0072B2", "#E69F00", "#CC79A7", "#009E73", "#DDDDDD"]
painted = np.ones((*left.shape[:2], 3))
for (name, mask), color in zip(masks.items(), colors, strict=True):
    painted[mask] = plt.matplotlib.colors.to_rgb(color)
    axes[1, 1].plot(
        [],
        [],
        "s",
        color=color,
        label=f"{name}: {100 * wrong[mask].mean():.0f} % wrong",
    )
axes[1, 1].imshow(painted)
for axis, title in zip(
    axes.flat, ("left image", "true disparity", "ZNCC 9x9", "the cases"), strict=True
):
    axis.set_title(title)
    axis.axis("off")
figure.legend(loc="outside lower center", ncols=2)
plt.show()
