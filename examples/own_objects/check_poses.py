"""Project the part's mesh by the poses of a sample, compare it with the masks, and draw the poses.

    mount.glb + cam_from_object + K -> pixels -> intersection over union with the object's mask

Run: ``python check_poses.py out/0000000 mount.glb poses.png``.
"""

import sys

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from skimage.draw import polygon

import twinlens as tl
from twinlens.camera import ObjectTruth
from twinlens.dataset import StoredSample, open_sample

PART = "mount"  # name of the object in the recipe
AXIS_MM = 25
AXIS_COLORS = ((220, 30, 30), (30, 170, 30), (40, 80, 255))


def read_mesh(path: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The corners, in the axes that twinlens gives to glTF files, (x, y, z) -> (x, -z, y), and the triangles."""
    mesh = trimesh.load(path).to_geometry()
    return mesh.vertices @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]], mesh.faces


def project(
    camera: tl.Camera, points: NDArray[np.float64], thing: ObjectTruth
) -> NDArray[np.float64]:
    """The pixels (N, 2) of points (N, 3) of an object."""
    return camera.project(
        points @ thing.cam_from_object[:3, :3].T + thing.cam_from_object[:3, 3]
    )


def paint(
    pixels: NDArray[np.float64], faces: NDArray[np.int64], shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """The pixels whose centres are in a triangle."""
    mask = np.zeros(shape, bool)
    for u, v in np.swapaxes(pixels[faces], 1, 2):
        mask[polygon(v, u, shape)] = True
    return mask


def overlaps(sample: StoredSample, path: str) -> dict[str, float]:
    """Intersection over union of the projected mesh and the mask, by name of the copy in the left image."""
    truth, camera = sample.truth0, sample.rig.cameras[0]
    vertices, faces = read_mesh(path)
    found = {}
    for thing in truth.objects:
        name = truth.object_name(thing)
        if name.startswith(PART):
            projected = paint(
                project(camera, vertices, thing), faces, truth.object_id.shape
            )
            mask = truth.silhouette(thing)  # with the parts that other objects hide
            found[name] = np.count_nonzero(projected & mask) / np.count_nonzero(
                projected | mask
            )
    return found


def picture(sample: StoredSample) -> Image.Image:
    """The left image with the axes of each copy of the part, and the visible masks beside it."""
    truth, camera = sample.truth0, sample.rig.cameras[0]
    axes, masks = Image.fromarray(sample.im0), sample.im0 // 3
    draw = ImageDraw.Draw(axes)
    colors = np.random.default_rng(0).integers(
        80, 256, (len(truth.object_names) + 1, 3)
    )
    for thing in truth.objects:
        if truth.object_name(thing).startswith(PART):
            masks[truth.object_id == thing.object_id] = colors[thing.object_id]
            origin, *ends = project(
                camera, np.vstack([np.zeros(3), AXIS_MM / 1000 * np.eye(3)]), thing
            )
            for end, color in zip(ends, AXIS_COLORS, strict=True):
                draw.line([tuple(origin), tuple(end)], color, width=3)
    return Image.fromarray(np.hstack([np.asarray(axes), masks]))


def main(folder: str, mesh: str, output: str) -> None:
    sample = open_sample(folder)
    for name, overlap in overlaps(sample, mesh).items():
        print(f"{name}: IoU {overlap:.4f}")
    picture(sample).quantize(256, dither=Image.Dither.NONE).save(output, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
