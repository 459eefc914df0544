"""Insert a virtual ball into both images of a stereo pair, with occlusion and defocus.

    images + true depths -> the room as a black mesh -> the ball rendered with that mesh through the same lens
    image * (1 - coverage) + ball

The coverage, occlusion and defocus together, is rendered exactly. Approximations: where both share a pixel, the image's
light is assumed to come from behind the ball; the ball casts no shadow, and has its own two lights.

Run: ``python examples/virtual_object.py virtual_object.png``.
"""

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import twinlens as tl
from twinlens.camera import Lens
from twinlens.reconstruction import Surface, mesh_of, view_of_truth
from twinlens.scenes import Color, Mesh, SceneObject

RADIUS, DEPTH = 0.11, 2.15  # metres
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
PAINT = {"type": "roughplastic", "alpha": 0.12, "diffuse_reflectance": Color((0.02, 0.25, 0.6))}
LAMPS = {
    "key": {"type": "directional", "direction": np.array([0.5, 0.8, -1.0]), "irradiance": Color((3.0, 2.8, 2.5))},
    "fill": {"type": "directional", "direction": np.array([-0.8, 0.6, -0.2]), "irradiance": Color((0.5, 0.6, 0.8))},
}

Images = list[NDArray[np.float32]]


def stage(size: tuple[int, int] = (400, 300)) -> tuple[tl.Scene, tl.Rig, Lens, NDArray[np.float64]]:
    """The scene, the rig, a lens focused on the foreground, and the position of the ball, half behind the jug."""
    scene = tl.load_scene("tabletop")
    rig = tl.Rig.stereo(tl.Camera.from_fov(*size, scene.fov_x_deg), scene.baseline, scene.world_from_left)
    place = rig.unproject(0, [0.56 * size[0], 0.36 * size[1]], DEPTH)
    return scene, rig, tl.ThinLens(aperture_diameter=0.02, focus_distance=1.3), place


def ball(place: NDArray[np.float64], radiance: float | None = None) -> SceneObject:
    """The ball; with `radiance`, as a uniform area light."""
    pose = np.diag([RADIUS, RADIUS, RADIUS, 1.0])
    pose[:3, 3] = place
    emitter = None if radiance is None else {"type": "area", "radiance": Color((radiance,) * 3)}
    return SceneObject("ball", {"type": "sphere"}, "paint", pose, emitter=emitter)


def room_meshes(scene: tl.Scene, rig: tl.Rig, scale: int = 3) -> list[Surface]:
    """One mesh of the scene per camera, from its depths, cut at depth discontinuities.

    A mesh ends up to a pixel inside its object, so the depths are computed at `scale` times the resolution.
    """
    fine = tl.Rig([_scaled(camera, scale) for camera in rig.cameras], rig.world_from_cams)
    return [mesh_of(view_of_truth(truth, fine, i)) for i, truth in enumerate(tl.ground_truth(scene, fine))]


def _scaled(camera: tl.Camera, scale: int) -> tl.Camera:
    """The same view with `scale` times the width and height."""
    cx, cy = ((c + 0.5) * scale - 0.5 for c in (camera.cx, camera.cy))
    size = camera.width * scale, camera.height * scale
    return tl.Camera(*size, camera.fx * scale, camera.fy * scale, cx, cy)


def insert(
    photos: Images, rig: tl.Rig, lens: Lens, room: list[Surface], balls: tuple[SceneObject, SceneObject], spp: int
) -> tuple[Images, Images]:
    """(images with the ball, coverage of each pixel by the ball, 0 to 1): linear float32 (H, W, 3) each.

    `balls` are the visible ball, and the same ball as a light of radiance 1 for the coverage.
    """
    meshes = tuple(
        SceneObject(f"room-{i}", Mesh(mesh.vertices, mesh.faces.astype(np.uint32)), "black")
        for i, mesh in enumerate(room)
    )
    visible, light = balls
    dark = tl.Scene("dark", (*meshes, light), {"black": BLACK, "paint": BLACK}, rig.world_from_cams[0], (0.5, 5.0))
    lit = replace(dark, objects=(*meshes, visible), materials={"black": BLACK, "paint": PAINT}, lights=LAMPS)
    covered, own = (tl.render(scene, rig, lens, spp) for scene in (dark, lit))
    return [photo * (1 - c) + added for photo, c, added in zip(photos, covered, own, strict=True)], covered


def main(path: str) -> None:
    scene, rig, lens, place = stage()
    photos = tl.render(scene, rig, lens, spp=64)
    mixed, _ = insert(photos, rig, lens, room_meshes(scene, rig), (ball(place), ball(place, 1.0)), spp=64)
    shown = tl.Sensor.preset("ideal").expose_rig(mixed, rig=rig, lens=lens, seed=0)
    Image.fromarray(np.concatenate([photo.image for photo in shown], axis=1)).save(path)
    print(f"{path}: the disparity of the ball is {rig.cameras[0].fx * rig.baseline() / DEPTH:.1f} px")


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["virtual_object.png"])
