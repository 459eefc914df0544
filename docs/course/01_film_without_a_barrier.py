r"""
A film without a barrier
========================

Hold a film in front of a scene, with nothing between them. Each point x of the film receives light from every point of
the scene that is in front of it. The irradiance E of the film is the integral of the radiance L over the directions w,
weighted by the cosine of their angle theta to the axis, and it is nearly the same at all points:

.. math::

    E(x) = \int L(x, w) \cos\theta \; \mathrm{d}w

The film turns grey. twinlens renders it through an opening ten times as wide as its distance from the film, which lets
96 % of the light through. The film has only 40 x 30 pixels, for there is no detail, and 16384 samples per pixel, with
which the renderer's noise is below 1 %.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(40, 30, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
(film,) = tl.render(
    scene, rig, tl.BareAperture(diameter=0.5, film_distance=0.05), spp=16384
)
film = film.mean(axis=2)  # black and white

figure, (sketch, picture) = plt.subplots(1, 2, width_ratios=(1, 1.3))
for height, colour in ((0.8, "tab:red"), (0.0, "tab:green"), (-0.8, "tab:blue")):
    for x in np.linspace(-1, 1, 7):
        sketch.plot([-2, 0], [height, x], color=colour, linewidth=0.6)
    sketch.plot(-2, height, "o", color=colour)
sketch.plot([0, 0], [-1.1, 1.1], "k", linewidth=4)
sketch.text(-2, 1.2, "scene", ha="center")
sketch.text(0, 1.2, "film", ha="center")
sketch.axis("off")
picture.imshow(
    (film / film.mean() / 2) ** (1 / 2.2), vmin=0, vmax=1, interpolation="bilinear"
)
picture.set_title(
    f"the film: its brightness differs by\n{film.std() / film.mean():.0%} from the mean (rms)"
)
picture.axis("off")
plt.show()
