r"""
A window slides along the scan line
===================================

A template window around a pixel of the left image is compared with the window around (u - d, v) of the right image,
for each disparity d. With the grey levels a and b of two windows, and their means with a bar:

.. math::

    \text{SAD} = \sum |a - b|, \qquad \text{SSD} = \sum (a - b)^2

    \text{NCC} = \frac{\sum a b}{\sqrt{\sum a^2 \sum b^2}}

    \text{ZNCC} = \frac{\sum (a - \bar{a}) (b - \bar{b})}{\sqrt{\sum (a - \bar{a})^2 \sum (b - \bar{b})^2}}

    \text{Jaccard} = \frac{\sum \min(a, b)}{\sum \max(a, b)}

The best d is the minimum of SAD and SSD, and the maximum of the others. The right image here has 30 % less light: SAD,
SSD and Jaccard fail, NCC is invariant to a gain, and ZNCC to a gain and an offset.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl

scene = tl.load_scene("cards")
rig = tl.Rig.stereo(
    tl.Camera.from_fov(320, 240, scene.fov_x_deg), scene.baseline, scene.world_from_left
)
left, right = (
    image.mean(axis=2) for image in tl.render(scene, rig, spp=16, denoise=True)
)
right = 0.7 * right

u, v, half, count = (
    140,
    84,
    5,
    40,
)  # centre of the template; windows of 11x11 pixels; disparities 0 to 39
true = tl.ground_truth(scene, rig)[0].disparity[v, u]
template = left[v - half : v + half + 1, u - half : u + half + 1]
disparities = np.arange(count)
windows = [
    right[v - half : v + half + 1, u - d - half : u - d + half + 1] for d in disparities
]

# %%
# The two images with the template and the scan line, and one curve for each measure. The blue windows are the ends of
# the search, d = 0 and d = 39; the green one is at the true disparity.

figure, axes = plt.subplots(4, 2, figsize=(5.6, 7.2), height_ratios=(1.4, 1, 1, 1))
for axis, image, title in zip(
    axes[0],
    (left, right),
    ("left: template", "right: search along the row"),
    strict=True,
):
    axis.imshow(image**0.45, vmin=0, vmax=np.percentile(left, 99) ** 0.45)
    axis.set(title=title, xlim=(u - 75, u + 45), ylim=(v + 45, v - 45))
    axis.axis("off")
side = 2 * half + 1
axes[0, 0].add_patch(
    plt.Rectangle(
        (u - half - 0.5, v - half - 0.5),
        side,
        side,
        fill=False,
        color="C1",
        linewidth=2,
    )
)
for d, color in ((0, "C0"), (true, "C2"), (count - 1, "C0")):
    corner = u - d - half - 0.5, v - half - 0.5
    axes[0, 1].add_patch(
        plt.Rectangle(corner, side, side, fill=False, color=color, linewidth=2)
    )
axes[0, 1].annotate(
    "", (u - count + 1, v), (u, v), arrowprops={"arrowstyle": "->", "color": "C0"}
)

measures = {
    "SAD": tl.sad,
    "SSD": tl.ssd,
    "NCC": tl.ncc,
    "ZNCC": tl.zncc,
    "Jaccard": tl.jaccard,
}
for axis, (name, measure) in zip(axes[1:].flat, measures.items(), strict=False):
    values = np.array([measure(template, window) for window in windows])
    best = int(values.argmin() if name in ("SAD", "SSD") else values.argmax())
    axis.plot(disparities, values)
    axis.axvline(true, color="C2", linestyle="--")
    axis.plot(best, values[best], "o", color="C3")
    axis.set_title(f"{name}: best d = {best}, true d = {true:.1f}")
    axis.set_yticks([])
    axis.set_ylabel("cost" if name in ("SAD", "SSD") else "similarity")
axes[3, 0].set_xlabel("disparity d (pixels)")
axes[2, 1].set_xlabel("disparity d (pixels)")
axes[3, 1].axis("off")
plt.show()
