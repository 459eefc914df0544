r"""
Aperture and depth of field
===========================

A lens collects the light of a whole aperture and still gives a sharp image, but only of one depth, the focus distance
Z_f. With aperture diameter A and f in pixels, the blur circle of a point at depth Z has the diameter c, and c is at
most c_max between the near and far limits of the depth of field:

.. math::

    c = A f \left| \frac{1}{Z} - \frac{1}{Z_f} \right|

    \frac{1}{Z_\text{near}} = \frac{1}{Z_f} + \frac{c_\text{max}}{A f}

    \frac{1}{Z_\text{far}} = \frac{1}{Z_f} - \frac{c_\text{max}}{A f}

A wider aperture collects more light and has a smaller depth of field. Lines in the pictures show
its near and far limits; the curves show the blur. At A = 20 mm no object is nearer than the near limit, so that only
the far limit appears.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.optics import circle_of_confusion_px, depth_of_field

focus_distance = 1.5  # Z_f, metres
largest_circle = 2.0  # c_max, pixels

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
(truth,) = tl.ground_truth(scene, rig)
depths = np.linspace(1, 2.6, 200)

figure, axes = plt.subplot_mosaic([["a", "b"], ["blur", "blur"]], figsize=(5.6, 4.6))
for name, diameter, colour in (("a", 0.020, "tab:blue"), ("b", 0.060, "tab:green")):
    lens = tl.ThinLens(diameter, focus_distance)
    (image,) = tl.render(scene, rig, lens, spp=16, denoise=True)
    near, far = depth_of_field(diameter, camera.fx, 1 / focus_distance, largest_circle)
    axes[name].imshow((image / 0.9).clip(0, 1) ** (1 / 2.2))
    for limit, line in ((near, "tab:orange"), (far, "red")):
        axes[name].contour(
            truth.depth < limit, levels=[0.5], colors=line, linewidths=1.5
        )
    axes[name].set_title(f"A = {1000 * diameter:.0f} mm: {near:.2f} m to {far:.2f} m")
    axes[name].axis("off")
    blur = np.abs(
        circle_of_confusion_px(depths, diameter, camera.fx, 1 / focus_distance)
    )
    axes["blur"].plot(depths, blur, color=colour, label=f"A = {1000 * diameter:.0f} mm")
    axes["blur"].axvspan(near, far, color=colour, alpha=0.15)
axes["blur"].axhline(
    largest_circle, color="k", linewidth=0.8, linestyle=":", label="c_max"
)
for line, name in (("tab:orange", "near limit"), ("red", "far limit")):
    axes["a"].plot([], [], color=line, label=name)
figure.legend(
    *axes["a"].get_legend_handles_labels(), loc="outside upper center", ncols=2
)
axes["blur"].set_xlabel("depth Z, m")
axes["blur"].set_ylabel("blur circle c, px")
axes["blur"].set_ylim(0, 10)
axes["blur"].legend(loc="upper left", bbox_to_anchor=(0.38, 1))
plt.show()
