r"""
Fixed windows, adaptive windows, semi-global matching
=====================================================

The cost of a window is small where its pixels have one disparity. A large fixed window averages much texture, but it
smears over depth edges: its error there is up to half a window wide. Adaptive windows are small near edges and large
on plain surfaces. Semi-global matching has no window: it minimises, along 8 paths through each pixel:

.. math::

    \sum_q \text{cost}(q, d) + P_1 \, (\text{steps of one pixel}) + P_2 \, (\text{larger steps})

The error is bad 2.0: the share of pixels, visible in both images, whose disparity is wrong by more than 2 pixels.

Errors are drawn from black (0) to bright (4 pixels or more); grey pixels are not visible in the right image. Adaptive
windows fail here on the star and on the wood, whose parts look alike.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("cards")
rig = tl.Rig.stereo(
    tl.Camera.from_fov(320, 240, scene.fov_x_deg), scene.baseline, scene.world_from_left
)
radiances = tl.render(scene, rig, spp=16, denoise=True)
left, right = (
    photo.image
    for photo in tl.Sensor().expose_rig(radiances, rig=rig, lens=tl.Pinhole(), seed=0)
)
truth = tl.ground_truth(scene, rig)[0]

methods = {
    "fixed 21x21": "zncc:block_size=21",
    "adaptive up to 21x21": "adaptive:block_size=21",
    "semi-global": "sgm",
}
near, far = scene.depth_range
count = int(rig.cameras[0].fx * rig.baseline() / near) + 2

figure, axes = plt.subplots(4, 2, figsize=(5.6, 8.2))
axes[0, 0].imshow(left)
axes[0, 0].set_title("left image")
heat = plt.get_cmap("magma").with_extremes(
    bad="gray"
)  # gray: not visible in the right image
shades = {"cmap": "viridis", "vmin": 0, "vmax": count}
axes[0, 1].imshow(truth.disparity, **shades)
axes[0, 1].set_title("true disparity")
for row, (name, method) in zip(axes[1:], methods.items(), strict=True):
    disparity = tl.match(left, right, method=method, num_disparities=count)
    scores = tl.evaluate(
        disparity, truth.disparity, mask_nonocc=truth.visible, ndisp=count
    )
    error = np.where(truth.visible, np.abs(disparity - truth.disparity), np.nan)
    row[0].imshow(disparity, **shades)
    row[0].set_title(name)
    row[1].imshow(error, cmap=heat, vmin=0, vmax=4)
    row[1].set_title(f"bad 2.0: {scores.nonocc['bad2.0']:.1f} %")
for axis in axes.flat:
    axis.axis("off")
plt.show()
