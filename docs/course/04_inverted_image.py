r"""
The inverted image
==================

Rays through a small hole go on in straight lines. What is above the axis lands below it, and what is on the left lands
on the right: the image on the film behind the hole is turned by 180 degrees. A point (X, Y, Z) in front of a hole lands
at distance D behind it at:

.. math::

    x = -D \, \frac{X}{Z}, \qquad y = -D \, \frac{Y}{Z}

In formulas and programs the film is therefore thought in front of the hole, where the image is upright and x = D X / Z.
twinlens renders this image, and ``tl.film_image`` turns it.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
(upright,) = tl.render(scene, rig, tl.Pinhole(), spp=16, denoise=True)
upright = (upright / 0.9).clip(0, 1) ** (1 / 2.2)
(truth,) = tl.ground_truth(scene, rig)

# The rim of the jug and a lemon: their pixels, their points in the camera's frame, and x, y on the film.
film_distance = 0.05  # D, metres
pitch = film_distance / camera.fx
pixels = np.array([[205, 60], [46, 176]])
points = camera.unproject(pixels) * truth.depth[pixels[:, 1], pixels[:, 0], None]
film = -film_distance * points[:, :2] / points[:, 2:]

figure, (left, right) = plt.subplots(1, 2, figsize=(5.6, 2.6))
left.imshow(upright)
left.set_title("film in front of the hole, pixels")
half = np.array([camera.width, camera.height]) * pitch / 2 * 1000
right.imshow(tl.film_image(upright), extent=(-half[0], half[0], half[1], -half[1]))
right.set_title("film behind the hole, mm")
for pixel, (x, y), colour in zip(pixels, 1000 * film, ("cyan", "yellow")):
    left.plot(
        *pixel, "o", color=colour, fillstyle="none", markersize=10, markeredgewidth=2
    )
    right.plot(
        x, y, "o", color=colour, fillstyle="none", markersize=10, markeredgewidth=2
    )
    print(f"pixel {pixel} lands on the film at x = {x:.1f} mm, y = {y:.1f} mm")
plt.show()
