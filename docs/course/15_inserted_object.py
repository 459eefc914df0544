r"""
An inserted object
==================

A ball is inserted into both images of a stereo pair that was taken with a wide aperture. It is half behind the jug and
slightly out of focus. The true depths give a black mesh of the room, which is rendered together with the ball through
the same lens. The share s of each pixel that the ball covers, and the new image, are:

.. math::

    s = \text{image of a ball of radiance 1 in the black room}

    \text{new} = (1 - s) \, \text{old} + \text{ball}

The share includes occlusion and defocus. Two things are approximate: where a pixel shows both, the light of the old
image is assumed to come from behind the ball; and the ball, with two lights of its own, casts no shadow.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.reconstruction import mesh_of, view_of_truth
from twinlens.scenes import Color, Mesh, SceneObject

RADIUS, DEPTH = 0.11, 2.15  # metres
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
PAINT = {
    "type": "roughplastic",
    "alpha": 0.12,
    "diffuse_reflectance": Color((0.02, 0.25, 0.6)),
}
LAMPS = {
    "key": {
        "type": "directional",
        "direction": np.array([0.5, 0.8, -1.0]),
        "irradiance": Color((3.0, 2.8, 2.5)),
    },
    "fill": {
        "type": "directional",
        "direction": np.array([-0.8, 0.6, -0.2]),
        "irradiance": Color((0.5, 0.6, 0.8)),
    },
}


def stage(width=320, height=240):
    """The scene, the rig, a lens focused on the foreground, and the position of the ball, half behind the jug."""
    scene = tl.load_scene("tabletop")
    rig = tl.Rig.stereo(
        tl.Camera.from_fov(width, height, scene.fov_x_deg),
        scene.baseline,
        scene.world_from_left,
    )
    place = rig.unproject(0, [0.56 * width, 0.36 * height], DEPTH)
    return scene, rig, tl.ThinLens(aperture_diameter=0.02, focus_distance=1.3), place


def ball(place, radiance=None):
    """The ball; with `radiance`, as a uniform area light."""
    pose = np.diag([RADIUS, RADIUS, RADIUS, 1.0])
    pose[:3, 3] = place
    emitter = (
        None
        if radiance is None
        else {"type": "area", "radiance": Color((radiance,) * 3)}
    )
    return SceneObject("ball", {"type": "sphere"}, "paint", pose, emitter=emitter)


def room_meshes(scene, rig, scale=3):
    """One mesh of the scene per camera, from its depths, cut at depth edges.

    A mesh ends up to a pixel inside its object, so the depths are computed at `scale` times the resolution.
    """
    old = rig.cameras[0]
    cx, cy = ((c + 0.5) * scale - 0.5 for c in (old.cx, old.cy))
    camera = tl.Camera(
        old.width * scale, old.height * scale, old.fx * scale, old.fy * scale, cx, cy
    )
    fine = tl.Rig([camera, camera], rig.world_from_cams)
    return [
        mesh_of(view_of_truth(truth, fine, i))
        for i, truth in enumerate(tl.ground_truth(scene, fine))
    ]


def insert(photos, rig, lens, room, balls, spp):
    """Linear images with the ball, and the share of each pixel that it covers.

    `balls` are the visible ball, and the same ball as a light of radiance 1.
    """
    meshes = tuple(
        SceneObject(
            f"room-{i}", Mesh(mesh.vertices, mesh.faces.astype(np.uint32)), "black"
        )
        for i, mesh in enumerate(room)
    )
    visible, light = balls
    dark = tl.Scene(
        "dark",
        (*meshes, light),
        {"black": BLACK, "paint": BLACK},
        rig.world_from_cams[0],
        (0.5, 5.0),
    )
    lit = replace(
        dark,
        objects=(*meshes, visible),
        materials={"black": BLACK, "paint": PAINT},
        lights=LAMPS,
    )
    covered, own = (tl.render(scene, rig, lens, spp) for scene in (dark, lit))
    return [
        photo * (1 - s) + added
        for photo, s, added in zip(photos, covered, own, strict=True)
    ], covered


# %%
# The pair without and with the ball, and the share.

scene, rig, lens, place = stage()
photos = tl.render(scene, rig, lens, spp=16, denoise=True)
mixed, covered = insert(
    photos,
    rig,
    lens,
    room_meshes(scene, rig, scale=2),
    (ball(place), ball(place, 1.0)),
    spp=32,
)

white = np.percentile(photos, 98)
figure, axes = plt.subplots(2, 2, figsize=(5.6, 4.6))
for axis, image, title in zip(
    axes[0], mixed, ("left, with the ball", "right, with the ball"), strict=True
):
    axis.imshow((image / white).clip(0, 1) ** 0.45)
    axis.set_title(title)
axes[1, 0].imshow((photos[0] / white).clip(0, 1) ** 0.45)
axes[1, 0].set_title("left, before")
axes[1, 1].imshow(covered[0][..., 0], vmin=0, vmax=1)
axes[1, 1].set_title(
    f"share of the ball; d = {rig.cameras[0].fx * rig.baseline() / DEPTH:.1f} px"
)
for axis in axes.flat:
    axis.axis("off")
plt.show()
