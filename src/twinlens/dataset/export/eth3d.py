"""ETH3D's low-resolution two-view layout: images and calibration in one tree, left truth in another.

`cameras.txt` and `images.txt` are COLMAP's: there the centre of the first pixel is (0.5, 0.5), so principal points are
half a pixel larger than twinlens's, and a pose takes world coordinates to the camera's.

Source: https://www.eth3d.net/documentation; COLMAP, documentation of its output format.
"""

from collections.abc import Iterable, Iterator

from scipy.spatial.transform import Rotation

from twinlens import geometry
from twinlens.camera import Rig
from twinlens.dataset.codecs.calib import encode_calib
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.export.source import Source


def eth3d(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """ETH3D/two_view_training/<name>/ and ETH3D/two_view_training_gt/<name>/ (disp0GT.pfm, mask0nocc.png)."""
    for source in sources:
        sample = source.sample
        scene, truth = (f"ETH3D/two_view_training{part}/{source.name}" for part in ("", "_gt"))
        yield f"{scene}/im0.png", source.image(0)
        yield f"{scene}/im1.png", source.image(1)
        yield f"{scene}/calib.txt", encode_calib(source.sample.calibration).encode()
        yield f"{scene}/cameras.txt", _cameras(sample.rig).encode()
        yield f"{scene}/images.txt", _images(sample.rig).encode()
        yield f"{truth}/disp0GT.pfm", encode_pfm(source.disparity(0))
        yield f"{truth}/mask0nocc.png", encode_png(sample.mask_nonocc(0))


def _cameras(rig: Rig) -> str:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]: fx, fy, cx, cy"]
    for i, camera in enumerate(rig.cameras[:2]):
        numbers = (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5)
        lines.append(f"{i} PINHOLE {camera.width} {camera.height} " + " ".join(repr(float(x)) for x in numbers))
    return "\n".join(lines) + "\n"


def _images(rig: Rig) -> str:
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for i, world_from_cam in enumerate(rig.world_from_cams[:2]):
        cam_from_world = geometry.inverse(world_from_cam)
        x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat()
        numbers = (w, x, y, z, *cam_from_world[:3, 3])
        lines += [f"{i} " + " ".join(repr(float(number)) for number in numbers) + f" {i} im{i}.png", ""]
    return "\n".join(lines) + "\n"
