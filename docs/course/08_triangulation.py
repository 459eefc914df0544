r"""
Triangulation
=============

Two cameras with parallel axes, a baseline B apart, see a point in the same image row, at different columns. Their
difference, the disparity d, gives the depth: by similar triangles, with the focal length f in pixels:

.. math::

    d = u_\text{left} - u_\text{right}, \qquad Z = \frac{f B}{d}

The ray through the left pixel and the ray through the right pixel meet in the point. A point twice as far away has half
the disparity.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

baseline = 0.25  # B, metres
scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig.stereo(camera, baseline, scene.world_from_left)
images = tl.render(scene, rig, tl.Pinhole(), spp=16, denoise=True)
truth = tl.ground_truth(scene, rig)[0]

left = np.array([[268, 192], [125, 150], [285, 122]])  # cube, bowl, book
right = left - np.stack([truth.disparity[left[:, 1], left[:, 0]], [0, 0, 0]], axis=1)
disparity = left[:, 0] - right[:, 0]
depth = baseline * camera.fx / disparity
points = camera.unproject(left) * depth[:, None]  # in the frame of the left camera
for z, d, true in zip(depth, disparity, truth.depth[left[:, 1], left[:, 0]]):
    print(
        f"Z = {camera.fx:.1f} px x {baseline} m / {d:.2f} px = {z:.3f} m,   ground truth {true:.3f} m"
    )

figure = plt.figure(figsize=(5.6, 4.8))
colours = ("tab:orange", "cyan", "magenta")
for i, (image, pixels, name) in enumerate(
    zip(images, (left, right), ("left", "right"))
):
    axis = figure.add_subplot()
    axis.set_position((0.01 + 0.5 * i, 0.52, 0.48, 0.42))
    axis.imshow((image / 0.9).clip(0, 1) ** (1 / 2.2))
    for pixel, colour in zip(pixels, colours):
        axis.axvline(pixel[0], color=colour, linewidth=0.8, linestyle=":")
        axis.plot(
            *pixel, "o", color=colour, fillstyle="none", markersize=9, markeredgewidth=2
        )
    axis.set_title(f"{name}: u = " + ", ".join(f"{u:.0f}" for u in pixels[:, 0]))
    axis.axis("off")

space = figure.add_subplot(projection="3d", zorder=-1)
space.set_position((-0.1, -0.02, 0.92, 0.6))
film = camera.unproject([[0, 0], [319, 0], [319, 239], [0, 239], [0, 0]]) * 0.2
for centre in ([0, 0, 0], [baseline, 0, 0]):
    x, y, z = (film + centre).T
    space.plot(x, z, -y, color="k", linewidth=1)
    for point, colour in zip(points, colours):
        x, y, z = np.transpose([centre, point])
        space.plot(x, z, -y, color=colour, linewidth=1.2)
space.plot([0, baseline], [0, 0], [0, 0], color="k", linewidth=3)
for i, (x, y, z) in enumerate(points):
    space.plot(
        x,
        z,
        -y,
        "o",
        color=colours[i],
        label=f"d = {disparity[i]:.1f} px\nZ = {depth[i]:.2f} m",
    )
space.set(
    xlabel="X, m",
    ylabel="\nZ, m",
    xlim=(-0.2, 0.8),
    ylim=(0, 2),
    zlim=(-0.3, 0.2),
    xticks=[0, 0.5],
    zticks=[],
)
space.set_box_aspect((1, 2, 0.5), zoom=1.15)
space.view_init(35, -35)
figure.legend(loc="lower right", bbox_to_anchor=(1, 0.08), labelspacing=1)
plt.show()
