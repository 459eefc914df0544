r"""
From the world to pixels
========================

A point P of the world becomes a pixel in three steps. The pose of the camera (rotation R_wc and position C) moves it
into the camera's frame: X right, Y down, Z forward. The perspective projection takes it to the film at distance D, and
the pixel pitch p and the principal point (cx, cy) give the pixel:

.. math::

    (X, Y, Z)^\top = R_{cw} (P - C) \qquad \text{(world to camera)}

    x = \frac{D X}{Z}, \quad y = \frac{D Y}{Z} \qquad \text{(camera to film)}

    u = \frac{x}{p} + c_x, \quad v = \frac{y}{p} + c_y \qquad \text{(film to pixels)}

The focal length in pixels is f = D / p, so that u = f X / Z + cx. R_cw is the transpose of R_wc.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
(truth,) = tl.ground_truth(scene, rig)
(image,) = tl.render(scene, rig, tl.Pinhole(), spp=16, denoise=True)

P = truth.position[192, 268]  # on the yellow cube
R_wc, C = scene.world_from_left[:3, :3], scene.world_from_left[:3, 3]
X, Y, Z = R_wc.T @ (P - C)
pitch = camera.pixel_pitch_um * 1e-6
film_distance = camera.fx * pitch
x, y = film_distance * X / Z, film_distance * Y / Z
u, v = x / pitch + camera.cx, y / pitch + camera.cy
steps = [
    f"world   P = ({P[0]:.3f}, {P[1]:.3f}, {P[2]:.3f}) m",
    f"camera  (X, Y, Z) = ({X:.3f}, {Y:.3f}, {Z:.3f}) m",
    f"film    (x, y) = ({1000 * x:.3f}, {1000 * y:.3f}) mm",
    f"pixel   (u, v) = ({u:.1f}, {v:.1f})",
]
print(*steps, sep="\n")

figure = plt.figure(figsize=(5.6, 3.3))
space = figure.add_subplot(projection="3d", zorder=-1, computed_zorder=False)
space.set_position((-0.12, 0.18, 0.7, 0.95))
picture = figure.add_subplot()
picture.set_position((0.58, 0.36, 0.41, 0.6))
colours = (image / 0.9).clip(0, 1) ** (1 / 2.2)
seen = truth.position[::4, ::4].reshape(-1, 3)
near = truth.depth[::4, ::4].ravel() < 1.75  # without the background
space.scatter(*seen[near].T, c=colours[::4, ::4].reshape(-1, 3)[near], s=2, alpha=1)
for axis, colour, name in zip(R_wc.T, ("tab:red", "tab:green", "tab:blue"), "XYZ"):
    space.plot(*np.transpose([C, C + 0.4 * axis]), color=colour)
    space.text(*(C + 0.5 * axis), name, color=colour)
corners = (
    camera.unproject([[0, 0], [319, 0], [319, 239], [0, 239], [0, 0]]) * 0.4 @ R_wc.T
    + C
)
space.plot(*corners.T, color="k", linewidth=1)  # the film, enlarged
space.plot(*np.transpose([C, P]), color="tab:orange")
space.text(*P, "P", color="tab:orange")
space.set(xlim=(-0.6, 0.6), ylim=(-1.5, 0.2), zlim=(0, 0.9))
space.set_box_aspect((1.2, 1.7, 0.9), zoom=0.95)
space.view_init(25, -20)
space.axis("off")
picture.imshow(colours)
picture.plot(
    u, v, "o", color="tab:orange", fillstyle="none", markersize=12, markeredgewidth=2
)
figure.text(0.05, 0.02, "\n".join(steps), family="monospace")
plt.show()
