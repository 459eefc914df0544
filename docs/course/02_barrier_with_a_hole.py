r"""
A barrier with a hole
=====================

A barrier in front of the film lets light pass through one small hole only. Each point of the film now sees one small
part of the scene, and an image appears. Through a hole of diameter A, at distance D from the film, a point at depth Z
lights a disk of diameter c on the film:

.. math::

    c = A \left( 1 + \frac{D}{Z} \right)

A smaller hole gives a sharper and darker image: the light on the film is proportional to (A / D)^2. The images are
drawn upright here, and each has its own exposure. The white bar has the length c for Z = 1.5 m.
"""

import matplotlib.pyplot as plt

import twinlens as tl

film_distance = 0.05  # D, metres
diameters = (0.006, 0.002)  # A, metres
depth = 1.5  # Z, metres

scene = tl.load_scene("tabletop")
camera = tl.Camera.from_fov(240, 180, scene.fov_x_deg)
rig = tl.Rig([camera], [scene.world_from_left])

figure, (sketch, *pictures) = plt.subplots(
    1, 3, figsize=(5.6, 1.9), width_ratios=(1, 1.4, 1.4)
)
for height, colour in ((0.8, "tab:red"), (0.0, "tab:green"), (-0.8, "tab:blue")):
    for hole in (-0.05, 0.05):
        sketch.plot(
            [-2, -0.8, 0],
            [height, hole, hole + (hole - height) * 0.8 / 1.2],
            color=colour,
            linewidth=0.8,
        )
    sketch.plot(-2, height, "o", color=colour)
sketch.plot(
    [-0.8, -0.8], [0.08, 1.1], "k", [-0.8, -0.8], [-1.1, -0.08], "k", linewidth=2
)
sketch.plot([0, 0], [-1.1, 1.1], "k", linewidth=4)
sketch.set_title("scene, barrier, film")
sketch.axis("off")

for picture, diameter in zip(pictures, diameters):
    (film,) = tl.render(
        scene, rig, tl.BareAperture(diameter, film_distance), spp=64, denoise=True
    )
    blur = diameter * (1 + film_distance / depth)
    blur_px = blur * camera.fx / film_distance  # a pixel is film_distance / fx wide
    picture.imshow((film / film.max()).clip(0, 1) ** (1 / 2.2))
    picture.plot([120 - blur_px / 2, 120 + blur_px / 2], [168, 168], "k", linewidth=6)
    picture.plot([120 - blur_px / 2, 120 + blur_px / 2], [168, 168], "w", linewidth=3)
    picture.set_title(
        f"A = {1000 * diameter:g} mm\nc = {1000 * blur:.1f} mm = {blur_px:.0f} px"
    )
    picture.axis("off")
plt.show()
