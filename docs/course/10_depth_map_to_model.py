r"""
From depth maps to a 3D model
=============================

A depth map and its camera give a point in space for each pixel:

.. math::

    Z = \frac{f B}{d}, \qquad X = \frac{(u - c_x) Z}{f}, \qquad Y = \frac{(v - c_y) Z}{f}

One depth map has holes behind the objects. Several are fused to one surface: the signed distances of all views are
averaged in a grid of cells, and the surface is where the mean is 0 (Curless and Levoy 1996). The depth maps here are
those of the truth; ``view_of_disparity`` takes those of a matcher. Near is bright. The cells enclose the objects, so
that the fused model has no wall.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.camera.layouts import arc
from twinlens.reconstruction import (
    integrate,
    points_of,
    sampled,
    surface_of,
    view_of_truth,
)
from twinlens.reconstruction.picture import orbit, splat

scene = tl.load_scene("spheres")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = arc(
    camera, count=5, radius=2.3, angle_deg=110, world_from_middle=scene.world_from_left
)
radiances = tl.render(scene, rig, spp=8, denoise=True)
images = [
    (255 * (image / np.percentile(image, 97)).clip(0, 1) ** 0.45).astype(np.uint8)
    for image in radiances
]
truths = tl.ground_truth(scene, rig)
views = [
    view_of_truth(truth, rig, i, image)
    for i, (truth, image) in enumerate(zip(truths, images, strict=True))
]

# %%
# Fuse the five views in cells of 1 cm, and look at both models from the side.

bounds = [[-1.0, -0.9, -0.05], [1.1, 0.7, 0.85]]  # metres
surface = surface_of(integrate(views, cell=0.01, bounds=bounds))
side = orbit(scene.world_from_left, target=[0, 0.1, 0.3], angle_deg=-35, rise_deg=-15)

figure, axes = plt.subplots(2, 2, figsize=(5.6, 4.6))
panels = {
    "middle camera": images[2],
    "its depth map": truths[2].depth,
    "one depth map, from the side": splat(points_of(views[2]), camera, side),
    "five depth maps, from the side": splat(
        sampled(surface, spacing=0.004), camera, side
    ),
}
for axis, (title, image) in zip(axes.flat, panels.items(), strict=True):
    axis.imshow(image, cmap="viridis_r")
    axis.set_title(title)
    axis.axis("off")
plt.show()
