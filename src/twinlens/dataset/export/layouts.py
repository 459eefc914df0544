"""Folder layouts of public stereo datasets, one function each: (relative name, content) of every file.

Sources: Middlebury, https://vision.middlebury.edu/stereo/data/scenes2014/; ETH3D, https://www.eth3d.net/documentation,
and COLMAP's output format; KITTI, Menze and Geiger, Object scene flow for autonomous vehicles, 2015, and readme.txt of
its development kit; SceneFlow, Mayer et al., A large dataset to train convolutional networks for disparity, optical
flow, and scene flow estimation, 2016; Sintel, http://sintel.is.tue.mpg.de/stereo; torchvision.datasets.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinlens import geometry
from twinlens.camera import Rig
from twinlens.dataset.codecs.calib import Calibration
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source, fixed_point
from twinlens.dataset.visibility import VISIBLE

Files = Iterator[tuple[str, bytes]]

_MIDDLEBURY_MARKER = "Middlebury2014/train/Adirondack-is-not-here.txt"
_MIDDLEBURY_NOTE = b"""The scenes in this folder were made with twinlens; none is one of Middlebury's.
torchvision's Middlebury2014Stereo opens a folder only if the name of an entry begins with the name of a published
scene. This file is that entry.
"""
_KITTI_SCALE, _SINTEL_SCALE = 256.0, 16384.0
_POINTS3D = b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"


def middlebury(sources: Iterable[Source]) -> Files:
    """Middlebury2014/train/<name>-perfect/: im0 im1 .png, disp0 disp1 .pfm, mask0nocc mask1nocc .png, calib.txt."""
    yield _MIDDLEBURY_MARKER, _MIDDLEBURY_NOTE
    for source in sources:
        yield from _middlebury_scene(source, f"Middlebury2014/train/{source.name}-perfect", "disp{}.pfm")


def carla(sources: Iterable[Source]) -> Files:
    """carla-highres/trainingF/<name>/: as `middlebury`, with disp0GT.pfm and disp1GT.pfm, as in MiddEval3."""
    for source in sources:
        yield from _middlebury_scene(source, f"carla-highres/trainingF/{source.name}", "disp{}GT.pfm")


def _middlebury_scene(source: Source, folder: str, disparity: str) -> Files:
    for i in (0, 1):
        yield f"{folder}/im{i}.png", source.image(i)
        yield f"{folder}/{disparity.format(i)}", encode_pfm(source.disparity(i))
        yield f"{folder}/mask{i}nocc.png", source.mask(i)
    yield f"{folder}/calib.txt", source.calib


def eth3d(sources: Iterable[Source]) -> Files:
    """ETH3D/two_view_training/<name>/ and ETH3D/two_view_training_gt/<name>/ (disp0GT.pfm, mask0nocc.png).

    cameras.txt, images.txt and an empty points3D.txt form a COLMAP model.
    """
    for source in sources:
        scene, truth = (f"ETH3D/two_view_training{part}/{source.name}" for part in ("", "_gt"))
        yield f"{scene}/im0.png", source.image(0)
        yield f"{scene}/im1.png", source.image(1)
        yield f"{scene}/calib.txt", source.calib
        yield f"{scene}/cameras.txt", _colmap_cameras(source.sample.rig).encode()
        yield f"{scene}/images.txt", _colmap_images(source.sample.rig).encode()
        yield f"{scene}/points3D.txt", _POINTS3D
        yield f"{truth}/disp0GT.pfm", encode_pfm(source.disparity(0))
        yield f"{truth}/mask0nocc.png", source.mask(0)


def _colmap_cameras(rig: Rig) -> str:
    """COLMAP's first pixel has its centre at (0.5, 0.5): principal points are half a pixel larger."""
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]: fx, fy, cx, cy"]
    for i, camera in enumerate(rig.cameras[:2]):
        numbers = (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5)
        lines.append(f"{i} PINHOLE {camera.width} {camera.height} " + " ".join(repr(float(x)) for x in numbers))
    return "\n".join(lines) + "\n"


def _colmap_images(rig: Rig) -> str:
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for i, world_from_cam in enumerate(rig.world_from_cams[:2]):
        cam_from_world = geometry.inverse(world_from_cam)
        x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat()
        numbers = (w, x, y, z, *cam_from_world[:3, 3])
        lines += [f"{i} " + " ".join(repr(float(number)) for number in numbers) + f" {i} im{i}.png", ""]
    return "\n".join(lines) + "\n"


def kitti2015(sources: Iterable[Source]) -> Files:
    """Kitti2015/training/: image_2 image_3, disp_occ_0 disp_occ_1, disp_noc_0 disp_noc_1, obj_map, calib_cam_to_cam.

    A disparity is stored as round(256 d) in 16 bits, 0 for unknown. `disp_occ` holds every known pixel, `disp_noc`
    those visible in both views. KITTI's own ``_1`` maps are of the next point in time; torchvision reads them as the
    right view, which they are here. `obj_map` is 0 (background); KITTI's development kit requires it.
    """
    for source in sources:
        number = f"{source.index:06d}"
        for i in (0, 1):
            disparity = source.disparity(i, 65535 / _KITTI_SCALE)
            visible = np.where(source.sample.mask_nonocc(i) == VISIBLE, disparity, np.inf).astype(np.float32)
            yield f"Kitti2015/training/image_{2 + i}/{number}_10.png", source.image(i)
            for name, values in (("disp_occ", disparity), ("disp_noc", visible)):
                counts = fixed_point(values, _KITTI_SCALE).astype(np.uint16)
                yield f"Kitti2015/training/{name}_{i}/{number}_10.png", encode_png(counts)
        background = np.zeros(source.sample.disparity(0).shape, np.uint8)
        yield f"Kitti2015/training/obj_map/{number}_10.png", encode_png(background)
        yield f"Kitti2015/training/calib_cam_to_cam/{number}.txt", _kitti_calibration(source.sample.calibration)


def _kitti_calibration(calibration: Calibration) -> bytes:
    """S_rect, R_rect and P_rect = K [I | t] of cameras 02 and 03; t_x is minus the baseline for the right camera."""
    lines = []
    for name, k, shift in (("02", calibration.K0, 0.0), ("03", calibration.K1, -calibration.baseline)):
        projection = k @ np.hstack([np.eye(3), [[shift], [0.0], [0.0]]])
        size = [calibration.width, calibration.height]
        for key, values in (("S_rect", size), ("R_rect", np.eye(3).ravel()), ("P_rect", projection.ravel())):
            lines.append(f"{key}_{name}: " + " ".join(f"{value:.12e}" for value in values))
    return ("\n".join(lines) + "\n").encode()


def sceneflow(sources: Iterable[Source]) -> Files:
    """SceneFlow/FlyingThings3D/{frames_cleanpass,disparity}/TRAIN/A/<number>/{left,right}/0006.{png,pfm}.

    One frame per scene (0006, the first of every original scene), and a calib.txt, which the original does not have.
    """
    root = "SceneFlow/FlyingThings3D"
    for source in sources:
        scene = f"TRAIN/A/{source.index:04d}"
        for i, side in enumerate(("left", "right")):
            yield f"{root}/frames_cleanpass/{scene}/{side}/0006.png", source.image(i)
            yield f"{root}/disparity/{scene}/{side}/0006.pfm", encode_pfm(source.disparity(i))
        yield f"{root}/disparity/{scene}/calib.txt", source.calib


def sintel(sources: Iterable[Source]) -> Files:
    """Sintel/training/{clean,final}_{left,right}, disparities, occlusions, outofframe: <name>/frame_0001.png.

    d = 4 R + G/64 + B/16384 px, so RGB is a 24-bit count of 1/16384 px. A mask is 255 where the left pixel is occluded
    (`occlusions`) or leaves the frame of the right view (`outofframe`). Unknown pixels have disparity 0 and are marked
    occluded.
    """
    for source in sources:
        frame = f"{source.name}/frame_0001.png"
        for i, side in enumerate(("left", "right")):
            image = source.image(i)
            yield f"Sintel/training/clean_{side}/{frame}", image
            yield f"Sintel/training/final_{side}/{frame}", image
        disparity = source.disparity(0, (2**24 - 1) / _SINTEL_SCALE)
        counts = fixed_point(disparity, _SINTEL_SCALE)
        rgb = np.stack([counts >> 16, counts >> 8 & 255, counts & 255], axis=-1).astype(np.uint8)
        outside = np.isfinite(disparity) & (np.arange(disparity.shape[1]) - disparity < -0.5)
        occluded = (source.sample.mask_nonocc(0) != VISIBLE) & ~outside
        yield f"Sintel/training/disparities/{frame}", encode_png(rgb)
        yield f"Sintel/training/occlusions/{frame}", _sintel_mask(occluded)
        yield f"Sintel/training/outofframe/{frame}", _sintel_mask(outside)
        yield f"Sintel/training/calib/{source.name}/calib.txt", source.calib


def _sintel_mask(marked: NDArray[np.bool_]) -> bytes:
    return encode_png(np.where(marked, 255, 0).astype(np.uint8))
