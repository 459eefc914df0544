r"""
Homogeneous coordinates and vanishing points
============================================

With a fourth coordinate, the whole projection is one product with a 3 x 4 matrix. The fourth coordinate of a point is
1. With 0 it is the point at infinity in the direction V, whose image is the vanishing point. The point P and the
direction V are in the frame of the world:

.. math::

    K = \begin{pmatrix} f & 0 & c_x \\ 0 & f & c_y \\ 0 & 0 & 1 \end{pmatrix}, \qquad t = -R_{cw} C

    (u w, \; v w, \; w)^\top = K \, [R_{cw} \,|\, t] \, (P, 1)^\top

    (u w, \; v w, \; w)^\top = K R_{cw} V \qquad \text{(vanishing point)}

Division by w gives the pixel. Parallel lines of the world share their point at infinity, and so their images meet in
one pixel. In homogeneous coordinates the line through pixels q1 and q2 is the cross product q1 x q2, and lines l1 and
l2 meet in l1 x l2. The vanishing points of all horizontal directions lie on the horizon.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("room")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
(image,) = tl.render(scene, rig, tl.Pinhole(), spp=16, denoise=True)

M = camera.K @ np.linalg.inv(scene.world_from_left)[:3]  # K [R_cw | t], 3 x 4


def pixel(point):
    """The pixel of a homogeneous point."""
    u, v, w = M @ point
    return np.array([u / w, v / w])


figure, axis = plt.subplots(figsize=(5.6, 4.2))
axis.imshow((image / np.percentile(image, 98)).clip(0, 1) ** (1 / 2.2))
vanishing = pixel([0, 1, 0, 0])
lines = []
for x in (-1.5, -0.9, -0.3, 0.3, 0.9, 1.5):  # on the floor, along the boards
    near, far = pixel([x, 0, 0, 1]), pixel([x, 2, 0, 1])
    lines.append(np.cross([*near, 1], [*far, 1]))
    axis.plot(*np.transpose([near, far]), color="cyan")
    axis.plot(
        *np.transpose([far, vanishing]), color="cyan", linewidth=0.7, linestyle="--"
    )
meet = np.cross(lines[0], lines[-1])
meet = meet[:2] / meet[2]

horizon = np.cross(M @ [0, 1, 0, 0], M @ [1, 0, 0, 0])  # a u + b v + c = 0
u = np.array([0, 319])
axis.plot(u, -(horizon[0] * u + horizon[2]) / horizon[1], color="yellow", linewidth=1)
axis.plot(*vanishing, "o", color="red")
axis.set_title(f"image of (0, 1, 0, 0): ({vanishing[0]:.1f}, {vanishing[1]:.1f})\n"
               f"first and last line meet in ({meet[0]:.1f}, {meet[1]:.1f})")  # fmt: skip
axis.set(xlim=(0, 319), ylim=(239, 0))
axis.axis("off")
plt.show()
