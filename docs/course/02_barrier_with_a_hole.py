"""
A barrier with a hole
=====================

A barrier in front of the film lets light pass through one small hole only. Each point of the film now sees one small
part of the scene, and an image appears. A hole of diameter A at distance v in front of the film draws a point at depth
z as a disk of diameter c::

    c = A (1 + v/z)

A smaller hole gives a sharper and darker image: its light is proportional to (A/v)^2.

This script needs the LLVM backend.
"""

import matplotlib.pyplot as plt

import twinlens as tl

film_distance = 0.05  # v, metres
scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(320, 240, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])
pitch = film_distance / camera.fx  # width of a pixel on the film

figure, axes = plt.subplots(1, 2)
for axis, diameter in zip(axes, (0.010, 0.002)):
    hole = tl.BareAperture(diameter, film_distance)
    (film,) = tl.render(scene, rig, hole, spp=16, denoise=True)
    blur = diameter * (1 + film_distance / 1.5)
    axis.imshow((film / film.max()).clip(0, 1) ** (1 / 2.2))
    axis.set_title(f"hole of {1000 * diameter:g} mm: a point at 1.5 m is\n"
                   f"{1000 * blur:.1f} mm = {blur / pitch:.0f} pixels wide")  # fmt: skip
    axis.axis("off")
plt.show()
