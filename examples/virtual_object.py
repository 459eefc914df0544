"""A ball that is not there, put into the photographs of both eyes: hidden by what is before it, and out of focus.

    photographs + true depths -> the room as a black mesh -> the ball rendered with that mesh, through the same lens
    photograph * (1 - coverage) + ball

What the ball covers of a pixel, occlusion and defocus together, is rendered exactly, with the mesh in the way. What is
approximate: the photograph's own light is taken as behind the ball wherever both share a pixel's blur, the ball throws
no shadow, and it is lit by two lamps of its own, not by the room.

Run it: ``python examples/virtual_object.py virtual_object.png``.
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
    """A scene, two eyes, a lens that is sharp on the foreground, and where the ball is to be: half behind the jug."""
    scene = tl.load_scene("tabletop")
    rig = tl.Rig.stereo(tl.Camera.from_fov(*size, scene.fov_x_deg), scene.baseline, scene.world_from_left)
    place = rig.unproject(0, [0.56 * size[0], 0.36 * size[1]], DEPTH)
    return scene, rig, tl.ThinLens(aperture_diameter=0.02, focus_distance=1.3), place


def ball(place: NDArray[np.float64], shine: float | None = None) -> SceneObject:
    """The ball; with `shine` it is a lamp of that radiance, every way alike."""
    pose = np.diag([RADIUS, RADIUS, RADIUS, 1.0])
    pose[:3, 3] = place
    lamp = None if shine is None else {"type": "area", "radiance": Color((shine,) * 3)}
    return SceneObject("ball", {"type": "sphere"}, "paint", pose, emitter=lamp)


def in_the_way(scene: tl.Scene, rig: tl.Rig, finer: int = 3) -> list[Surface]:
    """What stands in the scene, as the two eyes' depths have it: a mesh each, cut where depth jumps.

    Such a mesh ends up to a pixel inside what it shows: the depths are cast with `finer` times the pixels.
    """
    fine = tl.Rig([_finer(camera, finer) for camera in rig.cameras], rig.world_from_cams)
    return [mesh_of(view_of_truth(truth, fine, i)) for i, truth in enumerate(tl.ground_truth(scene, fine))]


def _finer(camera: tl.Camera, times: int) -> tl.Camera:
    """The same view on `times` as many pixels a side."""
    cx, cy = ((c + 0.5) * times - 0.5 for c in (camera.cx, camera.cy))
    size = camera.width * times, camera.height * times
    return tl.Camera(*size, camera.fx * times, camera.fy * times, cx, cy)


def insert(
    photos: Images, rig: tl.Rig, lens: Lens, walls: list[Surface], things: tuple[SceneObject, SceneObject], spp: int
) -> tuple[Images, Images]:
    """(photographs with the ball, what the ball covers of each pixel, 0 to 1): linear float32 (H, W, 3) each.

    `things` are the ball as it is to be seen, and as a black lamp of radiance 1.
    """
    blinds = tuple(
        SceneObject(f"wall-{i}", Mesh(wall.vertices, wall.faces.astype(np.uint32)), "black")
        for i, wall in enumerate(walls)
    )
    seen, lamp = things
    dark = tl.Scene("dark", (*blinds, lamp), {"black": BLACK, "paint": BLACK}, rig.world_from_cams[0], (0.5, 5.0))
    lit = replace(dark, objects=(*blinds, seen), materials={"black": BLACK, "paint": PAINT}, lights=LAMPS)
    covered, own = (tl.render(scene, rig, lens, spp) for scene in (dark, lit))
    return [photo * (1 - c) + light for photo, c, light in zip(photos, covered, own, strict=True)], covered


def main(path: str) -> None:
    scene, rig, lens, place = stage()
    photos = tl.render(scene, rig, lens, spp=64)
    mixed, _ = insert(photos, rig, lens, in_the_way(scene, rig), (ball(place), ball(place, 1.0)), spp=64)
    shown = tl.Sensor.preset("ideal").expose_rig(mixed, rig=rig, lens=lens, seed=0)
    Image.fromarray(np.concatenate([photo.image for photo in shown], axis=1)).save(path)
    print(f"{path}: the ball is {rig.cameras[0].fx * rig.baseline() / DEPTH:.1f} px apart in the two eyes")


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["virtual_object.png"])
