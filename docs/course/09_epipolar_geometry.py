r"""
Epipolar lines and planes
=========================

A point and the centres of two cameras span an epipolar plane. The plane intersects each image in a line, so the match
of a pixel lies on a known line. With homogeneous pixels q = (u, v, 1) and the fundamental matrix F of the pair:

.. math::

    q_\text{right}^\top F \, q_\text{left} = 0

    l_\text{right} = F \, q_\text{left} \qquad \text{(the line in the right image)}

The cameras of this pair are verged: they look at one point. Rectification rotates each about its centre until the
epipolar lines are rows of the images. Then a match differs in u only. The rectified images are
shifted to the middle of their fields of view, so that their principal points differ and a disparity may be negative:

.. math::

    Z = \frac{f B}{d + c_{x,\text{right}} - c_{x,\text{left}}}
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.camera.layouts import toed_in
from twinlens.geometry.epipolar import epipolar_lines

scene = tl.load_scene("cards")
camera = tl.Camera.from_fov(320, 240, fov_x_deg=55)
verged = toed_in(
    camera, baseline=0.8, distance=1.4, world_from_middle=scene.world_from_left
)
radiances = tl.render(scene, verged, spp=16, denoise=True)
images = [
    (radiance / np.percentile(radiance, 98)).clip(0, 1) ** 0.45
    for radiance in radiances
]

pixels = np.array(
    [[130, 205], [165, 115], [150, 35], [262, 150]]
)  # (u, v) in the left image
points = tl.ground_truth(scene, verged)[0].position[pixels[:, 1], pixels[:, 0]]
colors = ["#D55E00", "#0072B2", "#E69F00", "#CC79A7"]

# %%
# Both pairs: images, matches of the four points, and their epipolar lines; and the epipolar planes of the verged pair,
# which all contain the baseline.

rectification = tl.rectify(verged, zero_doffs=False)
rectified = rectification.rectified_rig
pairs = {
    "verged": (verged, images),
    "rectified": (rectified, [rectification.warp(i, images[i]) for i in (0, 1)]),
}

figure = plt.figure(figsize=(5.6, 7.2))
grid = figure.add_gridspec(3, 2, height_ratios=(1, 1, 1.3))
for row, (name, (rig, pictures)) in enumerate(pairs.items()):
    left, right = rig.project(0, points), rig.project(1, points)
    F = tl.fundamental_matrix(rig)
    lines = epipolar_lines(F.T, right), epipolar_lines(F, left)
    for side, (match, title) in enumerate(
        zip((left, right), ("left", "right"), strict=True)
    ):
        axis = figure.add_subplot(grid[row, side])
        axis.imshow(pictures[side])
        for (a, b, c), (u, v), color in zip(lines[side], match, colors, strict=True):
            ends = np.array([-0.5, 319.5])
            axis.plot(ends, -(a * ends + c) / b, color=color)  # a u + b v + c = 0
            axis.plot(u, v, "o", color=color, markeredgecolor="white")
        axis.set(title=f"{name}, {title}", xlim=(-0.5, 319.5), ylim=(239.5, -0.5))
        axis.axis("off")
    print(f"{name}: v_left - v_right =", np.round(left[:, 1] - right[:, 1], 1), "px")

axis = figure.add_subplot(grid[2, :], projection="3d")
centres = [pose[:3, 3] for pose in verged.world_from_cams]
for point, color in zip(points, colors, strict=True):
    axis.plot_trisurf(*np.array([*centres, point]).T, color=color, alpha=0.35)
    axis.plot(*np.array([centres[0], point, centres[1]]).T, color=color)
    axis.plot(*point[:, None], "o", color=color)
axis.plot(*np.array(centres).T, "k")
corners = [[0, 0], [319, 0], [319, 239], [0, 239], [0, 0]]
for i, name in enumerate(("left", "right")):
    axis.plot(*verged.unproject(i, corners, 0.25).T, "k", linewidth=1)
    axis.text(*centres[i] - [0, 0.1, 0.05], name)
axis.set_box_aspect(np.ptp(np.vstack([points, centres]), axis=0), zoom=1.5)
axis.view_init(elev=30, azim=-70)
axis.set_axis_off()
axis.set_title("epipolar planes of the verged pair")
plt.show()
