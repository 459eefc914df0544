r"""
The best size of the hole
=========================

A large hole blurs by geometry: its image of a far point is as wide as the hole. A small hole blurs by diffraction: its
image of a point is the Airy disk, which grows as the hole shrinks. With wavelength lambda and film distance D:

.. math::

    c = A \qquad \text{(geometry)}

    c = \frac{2.44 \, \lambda D}{A} \qquad \text{(diffraction)}

    A = \sqrt{2.44 \, \lambda D} \qquad \text{(best hole)}

At the best hole both are equal. For green light (549 nm) and D = 50 mm it is 0.26 mm wide. Each picture has its own
exposure. Those of the two holes next to the best one, 0.35 mm and 0.15 mm, look almost equally sharp, for the sum of
the two blurs hardly changes there.

The two blurs are simulated one after the other. That is exact for the largest and the smallest holes of the curve;
between them, where the Fresnel number (A/2)^2 / (lambda D) is 0.2 to 50, it is an approximation and twinlens warns: the
true image of a hole near the best one is sharper.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.optics.diffraction import FresnelWarning

warnings.simplefilter("ignore", FresnelWarning)
film_distance = 0.05  # D, metres
wavelength = 549e-9
diameters_mm = (2, 1, 0.6, 0.35, 0.15, 0.07)

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(200, 150, fov_x_deg=20)
rig = tl.Rig([camera], [scene.world_from_left])
holes = [tl.BareAperture(diameter / 1000, film_distance) for diameter in diameters_mm]

figure, axes = plt.subplot_mosaic(
    [[0, 1, 2], [3, 4, 5], ["blur"] * 3], figsize=(5.6, 5.3), height_ratios=(1, 1, 1.1)
)
for i, hole in enumerate(holes):
    (film,) = tl.render(scene, rig, hole, spp=16, denoise=True)
    film = tl.diffract(film, camera, hole)
    axes[i].imshow((film / 0.9).clip(0, 1) ** (1 / 2.2))
    axes[i].set_title(f"{diameters_mm[i]} mm")
    axes[i].axis("off")

diameters = np.geomspace(0.05e-3, 3e-3)
airy = 2.44 * wavelength * film_distance / diameters
blur = axes["blur"]
blur.loglog(1000 * diameters, 1000 * diameters, label="geometry, A")
blur.loglog(1000 * diameters, 1000 * airy, label="diffraction, 2.44 λ D / A")
best_mm = 1000 * np.sqrt(2.44 * wavelength * film_distance)
blur.axvline(best_mm, color="k", linewidth=0.8, linestyle=":")
blur.annotate(
    f"best: {best_mm:.2f} mm", (best_mm, 1.2), (4, 0), textcoords="offset points"
)
blur.set_xticks(diameters_mm, [str(diameter) for diameter in diameters_mm], minor=False)
blur.set_xticks([], minor=True)
blur.set_yticks([0.1, 1], ["0.1", "1"])
blur.set_xlabel("diameter of the hole, mm")
blur.set_ylabel("width of a point, mm")
blur.legend()
plt.show()
