"""A sample in memory, and its files as pure functions of arrays (docs/format.md describes the files).

`sample_files` encodes without touching the disk, so a thread can encode one sample while the next is rendered;
`write_sample` writes atomically.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import twinlens
from twinlens.camera import Lens, Rig, dual_pixel_disparity
from twinlens.camera.truth import MATERIAL_KINDS, Truth
from twinlens.dataset.codecs.calib import Calibration, encode_calib, tidy
from twinlens.dataset.codecs.exr import encode_exr
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.ply import encode_ply
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import check_replaceable, write_folder
from twinlens.dataset.quantities import KEY, statistics
from twinlens.dataset.record import encode_json, plain
from twinlens.dataset.storage import MARK, RemotePath, Where, place
from twinlens.dataset.truth_files import encode_truth
from twinlens.errors import InputError

KIND, VERSION = "twinlens-sample", 1

CONVENTIONS = {
    "camera_frame": "x right, y down, z forward; metres",
    "pixel_centres": "at integers: the image spans -0.5 to width - 0.5; arrays are [y, x], row 0 at the top",
    "disparity": "u_left - u_right in pixels; z = fx * baseline / (d + doffs); unknown is +inf",
    "depth": "z along the optical axis; +inf where nothing was hit",
    "world_from_cams": "4x4, a point's world coordinates from its camera coordinates",
    "dp-disp": "u in dp-left - u in dp-right, pixels: positive before the plane of focus; unknown is +inf",
    "mask_nonocc": "255 visible in both views, 128 occluded or out of frame, 0 unknown",
    "ids": "0 nothing hit, else 1 + index into the list of names",
    "objects": "per view; pixel boxes are u, v, width, height, all 0 if empty; silhouettes are COCO's run-length code",
    "blur_circle_px": "signed diameter, aperture_diameter * fx * (1/z - vergence); positive before the plane of focus",
}


@dataclass(frozen=True, eq=False)
class Shot:
    """One image per camera of the rig, through one lens.

    lens : Lens
    images : one uint8 or uint16 (H, W, 3) or (H, W) array per camera.
    radiances : one float32 (H, W, 3) linear array per camera, or None to store none.
    record : plain data on how the images were taken (spp, sensor, exposure, ...).
    halves : of dual pixels: the left and the right image of each camera, as `images`; or None.
    """

    lens: Lens
    images: tuple[NDArray[Any], ...]
    radiances: tuple[NDArray[np.float32], ...] | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    halves: tuple[tuple[NDArray[Any], NDArray[Any]], ...] | None = None


@dataclass(frozen=True, eq=False)
class Sample:
    """The content of one sample folder: a rig, its truth, and the shots taken with it.

    rig : takes the images. Truth and calibration are those of `rig.nominal`.
    shots : one per lens. The first is the folder's im0 and im1; the others go to lens-1, lens-2, ...
    truths : one per camera, or empty.
    ndisp : bound of the disparities, 0 <= d < ndisp; None: from the truth.
    record : plain data on how the sample was made (seed, scene, backend, versions, ...).
    models : triangles to store, by the name in `ObjectTruth.model`: vertices float (V, 3), metres, and faces (F, 3).

    Raises InputError if an array does not fit the rig.
    """

    rig: Rig
    shots: tuple[Shot, ...]
    truths: tuple[Truth, ...] = ()
    ndisp: int | None = None
    record: Mapping[str, Any] = field(default_factory=dict)
    models: Mapping[str, tuple[NDArray[Any], NDArray[Any]]] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        if not self.shots:
            raise InputError("a sample needs one or more shots")
        groups: dict[str, Any] = {
            "truths": [truth.depth for truth in self.truths] or None
        }
        for k, shot in enumerate(self.shots):
            groups |= {
                f"images of shot {k}": shot.images,
                f"radiances of shot {k}": shot.radiances,
            }
            groups |= {
                f"{half} halves of shot {k}": images
                for half, images in _halves(shot).items()
            }
        for what, arrays in groups.items():
            if arrays is not None and len(arrays) != len(self.rig):
                raise InputError(
                    f"{what}: got {len(arrays)}, but the rig has {len(self.rig)} cameras"
                )
            for i, (array, camera) in enumerate(
                zip(arrays or (), self.rig.cameras, strict=False)
            ):
                if array.shape[:2] != (camera.height, camera.width):
                    size = f"{camera.width} x {camera.height}"
                    raise InputError(
                        f"{what}: camera {i} is {size}, its array is {array.shape}"
                    )

    @property
    def is_rectified(self) -> bool:
        """Whether the first two cameras are a rectified pair, which calib.txt can describe."""
        return len(self.rig) > 1 and self.rig.nominal.is_rectified()


def sample_files(sample: Sample) -> dict[str, bytes]:
    """All files of the sample, relative name -> content. The same sample gives the same bytes."""
    files: dict[str, bytes] = {}
    for k, shot in enumerate(sample.shots):
        files |= {
            f"{lens_folder(k)}im{i}.png": encode_png(image)
            for i, image in enumerate(shot.images)
        }
        for i, radiance in enumerate(shot.radiances or ()):
            channels = dict(zip("RGB", np.moveaxis(radiance, -1, 0), strict=True))
            files[f"{lens_folder(k)}radiance{i}.exr"] = encode_exr(channels)
        for half, images in _halves(shot).items():
            files |= {
                f"{lens_folder(k)}dp-{half}{i}.png": encode_png(image)
                for i, image in enumerate(images)
            }
    rig = sample.rig.nominal
    for i, truth in enumerate(sample.truths):
        files[f"truth{i}.exr"] = encode_truth(
            truth, rig.cameras[i], sample.shots[0].lens
        )
        if rig.partner(i) is not None:
            files[f"mask{i}nocc.png"] = encode_png(truth.mask_nonocc())
        if rectified_pair(rig, i) is not None:
            files[f"disp{i}.pfm"] = encode_pfm(truth.disparity)
        for k, shot in enumerate(sample.shots):
            if shot.halves is not None:
                disparity = dual_pixel_disparity(truth, rig.cameras[i], shot.lens)
                files[f"{lens_folder(k)}dp-disp{i}.pfm"] = encode_pfm(disparity)
    if sample.is_rectified:
        files["calib.txt"] = encode_calib(_calibration(sample)).encode()
    for name, (vertices, faces) in sample.models.items():
        files[f"models/{name}.ply"] = encode_ply(vertices, faces)
    files["sample.json"] = encode_json(_record(sample))
    return files


def write_sample(
    folder: Where, sample: Sample, overwrite: bool = False
) -> dict[str, str]:
    """Write the sample as `folder`, atomically; returns relative name -> SHA-256 of its files, sorted by name.

    Raises OutputError if the folder cannot be written, or exists (unless `overwrite` is set and it is a sample or
    empty); nothing is left behind. Raises InputError if an array does not fit its file format.
    """
    folder = place(folder)
    if overwrite and not isinstance(
        folder, RemotePath
    ):  # `fill_remote` checks remote ones
        check_replaceable(folder, (folder / MARK).is_file(), "a sample")
    files = sample_files(sample)
    write_folder(folder, files, overwrite)
    return {name: hashlib.sha256(files[name]).hexdigest() for name in sorted(files)}


def rectified_pair(rig: Rig, i: int) -> tuple[int, int] | None:
    """The left and right camera of the pair of view i and its partner, if that pair is rectified."""
    partner = rig.partner(i)
    if partner is None:
        return None
    pair = (min(i, partner), max(i, partner))
    return pair if rig.is_rectified(*pair) else None


def lens_folder(k: int) -> str:
    """The folder of shot k, with its slash; the first shot is in the sample's own."""
    return f"lens-{k}/" if k else ""


def _halves(shot: Shot) -> dict[str, Sequence[NDArray[Any]]]:
    """The images of the left and of the right halves of dual pixels, one per camera; empty for other sensors."""
    return (
        {}
        if shot.halves is None
        else dict(zip(("left", "right"), zip(*shot.halves, strict=True), strict=True))
    )


def _calibration(sample: Sample) -> Calibration:
    known = [
        truth.disparity[np.isfinite(truth.disparity)] for truth in sample.truths[:2]
    ]
    values = np.concatenate([*known, np.empty(0, np.float32)])
    if not values.size:
        return Calibration.from_rig(sample.rig.nominal, sample.ndisp)
    low, high = math.floor(values.min()), math.ceil(values.max())
    ndisp = sample.ndisp or max(high + 1, 1)
    return Calibration.from_rig(sample.rig.nominal, ndisp).replace(
        vmin=float(low), vmax=float(high)
    )


def _record(sample: Sample) -> dict[str, Any]:
    rig = sample.rig.nominal
    first = sample.truths[0] if sample.truths else None
    return {
        "format": KIND,
        "version": VERSION,
        "twinlens": twinlens.__version__,
        "conventions": CONVENTIONS,
        "rig": plain(sample.rig),
        "rectified": sample.is_rectified,
        "pair": {"baseline": tidy(rig.baseline()), "doffs_px": rig.doffs()}
        if len(rig) > 1
        else None,
        "shots": [
            {
                "folder": lens_folder(k) or "./",
                "lens": plain(shot.lens),
                "record": plain(shot.record),
            }
            for k, shot in enumerate(sample.shots)
        ],
        "object_names": first.object_names if first else (),
        "material_names": first.material_names if first else (),
        "material_kinds": MATERIAL_KINDS,
        "objects": [plain(truth.objects) for truth in sample.truths],
        KEY: statistics(sample),
        "record": plain(sample.record),
    }
