"""Export of datasets to the layouts of other readers, all in the dict `LAYOUTS`.

A folder layout yields (relative name, content) of every file of one sample; WebDataset and Parquet have a few large
files. What a layout cannot hold, such as a disparity beyond its range or a missing view, is an error that names the
sample. docs/format.md lists what each layout keeps. The same samples give the same bytes: archives have no time and no
owner.

Sources: Middlebury, https://vision.middlebury.edu/stereo/data/scenes2014/; ETH3D, https://www.eth3d.net/documentation,
and COLMAP's output format; KITTI, Menze and Geiger, Object scene flow for autonomous vehicles, 2015, and readme.txt of
its development kit; SceneFlow, Mayer et al., A large dataset to train convolutional networks for disparity, optical
flow, and scene flow estimation, 2016; Sintel, http://sintel.is.tue.mpg.de/stereo; torchvision.datasets;
https://github.com/webdataset/webdataset, "The WebDataset Format"; POSIX.1-2001, pax; Apache Parquet; Hugging Face
datasets, "Image" feature: a struct of `bytes` and `path`.
"""

import io
import itertools
import json
import tarfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import twinlens
from twinlens.dataset.aperture_layouts import dpdd, eslf, fod500, hci4d
from twinlens.dataset.codecs.calib import Calibration, encode_calib
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.dataset import MANIFEST
from twinlens.dataset.files import check_replaceable, read_bytes, write_folder
from twinlens.dataset.object_layouts import bop, category, coco
from twinlens.dataset.poses import colmap_camera, colmap_pose
from twinlens.dataset.storage import RemotePath, Where, place
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import VISIBLE, Disparity
from twinlens.errors import InputError, MissingExtraError, OutputError, check_known

Files = Iterator[tuple[str, bytes]]

SIGNED_LAYOUTS = ("parquet", "webdataset")
"""The layouts that can hold negative disparities."""

UNRECTIFIED_LAYOUTS = ("bop", "coco", "dpdd", "eslf", "fod500", "hci4d")
"""The layouts without the disparity of a pair, which need no rectified one."""

OBJECT_LAYOUTS = ("bop", "coco", "kitti2015")
"""The layouts with masks of objects."""

MIDDLEBURY_FOLDER = "Middlebury2014/train"
_MIDDLEBURY_MARKER = f"{MIDDLEBURY_FOLDER}/Adirondack-is-not-here.txt"
_MIDDLEBURY_NOTE = b"""The scenes in this folder were made with twinlens; none is one of Middlebury's.
torchvision's Middlebury2014Stereo opens a folder only if the name of an entry begins with the name of a published
scene. This file is that entry.
"""
_KITTI_SCALE, _SINTEL_SCALE = 256.0, 16384.0
_COLMAP_HEADERS = {
    "cameras": "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]: fx, fy, cx, cy\n",
    "images": "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n",
    "points3D": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n",
}
_FILE_BYTES = 256 * 1024 * 1024
_END = bytes(2 * tarfile.BLOCKSIZE)
IMAGES = ("im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc")
NUMBERS = (
    "width",
    "height",
    "fx",
    "fy",
    "cx0",
    "cx1",
    "cy",
    "baseline",
    "doffs",
    "ndisp",
)
NOTE = "EXPORT.md"
_FIRST_LINE = "# Exported by twinlens"


@dataclass(frozen=True)
class Source:
    """A sample to export: number `index` of its dataset, with the images of lens number `lens`.

    `objects` are the names of the objects to export, without the numbers of copies; None for all.
    """

    sample: StoredSample
    index: int
    lens: int = 0
    objects: frozenset[str] | None = None

    @property
    def name(self) -> str:
        """The sample's name as one folder name: train/0001 becomes train-0001."""
        return self.sample.name.replace("/", "-")

    @property
    def split(self) -> str:
        """The name of the sample's split, or nothing."""
        return str(self.sample.row.get("info", {}).get("split") or "")

    def image(self, i: int) -> bytes:
        """View i as an 8-bit PNG: the sample's file, or its 16 bits rounded to 8."""
        shot = self.sample.lens(self.lens)
        pixels = shot.image(i)
        if pixels.dtype == np.uint8:
            return read_bytes(shot.path(f"im{i}.png"))
        return encode_png(np.round(pixels / 257.0).astype(np.uint8))

    def disparity(self, i: int, most: float = np.inf, least: float = 0.0) -> Disparity:
        """View i's disparity. Raises InputError unless its known values are in the range of the layout.

        Readers of layouts that could store a sign take the absolute value, so negative values are rejected there too.
        """
        disparity = self.sample.disparity(i)
        known = disparity[np.isfinite(disparity)]
        if known.size and not (known.min() >= least and known.max() <= most):
            limits = "0 or more" if np.isinf(most) else f"0 to {most:.6g}"
            raise InputError(
                f"{self.sample.name}: has disparities from {known.min():.6g} to {known.max():.6g} px, and this layout"
                f" holds {limits}; layouts without this limit: {', '.join(SIGNED_LAYOUTS)}"
            )
        return disparity

    def calib(self) -> bytes:
        """The sample's calib.txt."""
        return encode_calib(self.sample.calibration).encode()

    def record(self) -> bytes:
        """The sample's sample.json, empty if it has none."""
        return (
            read_bytes(self.sample.folder / "sample.json")
            if self.sample.has("sample.json")
            else b""
        )

    def files(self, disparity: str = "disp{}.pfm", least: float = 0.0) -> Files:
        """Images, disparities and masks of both views, and calib.txt, with Middlebury's names."""
        yield from ((f"im{i}.png", self.image(i)) for i in (0, 1))
        yield from (
            (disparity.format(i), encode_pfm(self.disparity(i, least=least)))
            for i in (0, 1)
        )
        yield from (
            (f"mask{i}nocc.png", encode_png(self.sample.mask_nonocc(i))) for i in (0, 1)
        )
        yield "calib.txt", self.calib()


def middlebury(source: Source) -> Files:
    """Middlebury2014/train/<name>-perfect/: im0 im1 .png, disp0 disp1 .pfm, mask0nocc mask1nocc .png, calib.txt."""
    if source.index == 0:
        yield _MIDDLEBURY_MARKER, _MIDDLEBURY_NOTE
    yield from (
        (f"{MIDDLEBURY_FOLDER}/{source.name}-perfect/{name}", data)
        for name, data in source.files()
    )


def carla(source: Source) -> Files:
    """carla-highres/trainingF/<name>/: as `middlebury`, with disp0GT.pfm and disp1GT.pfm, as in MiddEval3."""
    files = source.files("disp{}GT.pfm")
    yield from (
        (f"carla-highres/trainingF/{source.name}/{name}", data) for name, data in files
    )


def eth3d(source: Source) -> Files:
    """ETH3D/two_view_training/<name>/ and ETH3D/two_view_training_gt/<name>/ (disp0GT.pfm, mask0nocc.png).

    cameras.txt, images.txt and an empty points3D.txt form a COLMAP model.
    """
    scene, truth = (
        f"ETH3D/two_view_training{part}/{source.name}" for part in ("", "_gt")
    )
    rig, model = source.sample.rig, dict(_COLMAP_HEADERS)
    for i in (0, 1):
        yield f"{scene}/im{i}.png", source.image(i)
        model["cameras"] += f"{i} {colmap_camera(rig.cameras[i])}\n"
        model["images"] += (
            f"{i} {colmap_pose(rig.world_from_cams[i])} {i} im{i}.png\n\n"
        )
    yield f"{scene}/calib.txt", source.calib()
    yield from ((f"{scene}/{name}.txt", text.encode()) for name, text in model.items())
    yield f"{truth}/disp0GT.pfm", encode_pfm(source.disparity(0))
    yield f"{truth}/mask0nocc.png", encode_png(source.sample.mask_nonocc(0))


def kitti2015(source: Source) -> Files:
    """Kitti2015/training/: image_2 image_3, disp_occ_0 disp_occ_1, disp_noc_0 disp_noc_1, obj_map, calib_cam_to_cam.

    A disparity is stored as round(256 d) in 16 bits, 0 for unknown. `disp_occ` holds every known pixel, `disp_noc`
    those visible in both views. KITTI's own ``_1`` maps are of the next point in time; torchvision reads them as the
    right view, which they are here. `obj_map` has the `object_id` of the objects that were chosen, and 0 (background)
    elsewhere; KITTI's development kit requires it.
    """
    root, number = "Kitti2015/training", f"{source.index:06d}"
    for i in (0, 1):
        counts = _fixed_point(
            source.disparity(i, 65535 / _KITTI_SCALE), _KITTI_SCALE
        ).astype(np.uint16)
        visible = np.where(
            source.sample.mask_nonocc(i) == VISIBLE, counts, np.uint16(0)
        )
        yield f"{root}/image_{2 + i}/{number}_10.png", source.image(i)
        yield f"{root}/disp_occ_{i}/{number}_10.png", encode_png(counts)
        yield f"{root}/disp_noc_{i}/{number}_10.png", encode_png(visible)
    yield (
        f"{root}/obj_map/{number}_10.png",
        encode_png(_kitti_objects(source, counts.shape)),
    )
    yield (
        f"{root}/calib_cam_to_cam/{number}.txt",
        _kitti_calibration(source.sample.calibration),
    )


def sceneflow(source: Source) -> Files:
    """SceneFlow/FlyingThings3D/{frames_cleanpass,disparity}/TRAIN/A/<number>/{left,right}/0006.{png,pfm}.

    One frame per scene (0006, the first of every original scene), and a calib.txt, which the original does not have.
    """
    root, scene = "SceneFlow/FlyingThings3D", f"TRAIN/A/{source.index:04d}"
    for i, side in enumerate(("left", "right")):
        yield f"{root}/frames_cleanpass/{scene}/{side}/0006.png", source.image(i)
        yield (
            f"{root}/disparity/{scene}/{side}/0006.pfm",
            encode_pfm(source.disparity(i)),
        )
    yield f"{root}/disparity/{scene}/calib.txt", source.calib()


def sintel(source: Source) -> Files:
    """Sintel/training/{clean,final}_{left,right}, disparities, occlusions, outofframe: <name>/frame_0001.png.

    d = 4 R + G/64 + B/16384 px, so RGB is a 24-bit count of 1/16384 px. A mask is 255 where the left pixel is occluded
    (`occlusions`) or leaves the frame of the right view (`outofframe`). Unknown pixels have disparity 0 and are marked
    occluded.
    """
    root, frame = "Sintel/training", f"{source.name}/frame_0001.png"
    for i, side in enumerate(("left", "right")):
        for kind in ("clean", "final"):
            yield f"{root}/{kind}_{side}/{frame}", source.image(i)
    disparity = source.disparity(0, (2**24 - 1) / _SINTEL_SCALE)
    counts = _fixed_point(disparity, _SINTEL_SCALE)
    rgb = np.stack([counts >> 16, counts >> 8 & 255, counts & 255], axis=-1).astype(
        np.uint8
    )
    outside = np.isfinite(disparity) & (
        np.arange(disparity.shape[1]) - disparity < -0.5
    )
    occluded = (source.sample.mask_nonocc(0) != VISIBLE) & ~outside
    yield f"{root}/disparities/{frame}", encode_png(rgb)
    yield (
        f"{root}/occlusions/{frame}",
        encode_png(np.where(occluded, np.uint8(255), np.uint8(0))),
    )
    yield (
        f"{root}/outofframe/{frame}",
        encode_png(np.where(outside, np.uint8(255), np.uint8(0))),
    )
    yield f"{root}/calib/{source.name}/calib.txt", source.calib()


def webdataset(
    sources: Iterable[Source], shard_bytes: int = _FILE_BYTES
) -> Iterator[tuple[str, bytes]]:
    """shard-000000.tar and so on; a shard ends with the sample that reaches `shard_bytes`.

    Files of a sample follow each other under a common key: ``train/0001.im0.png`` is entry "im0.png" of sample
    train/0001. A key ends at the first dot, so "." in a sample's name is written as "%2E", and "%" as "%25".
    """
    number, stream = 0, io.BytesIO()
    for source in sources:
        key = source.sample.name.replace("%", "%25").replace(".", "%2E")
        for name, data in itertools.chain(
            source.files(least=-np.inf), [("json", source.record())]
        ):
            header = tarfile.TarInfo(f"{key}.{name}")
            header.size, header.mode = len(data), 0o644
            if data:
                stream.write(
                    header.tobuf(tarfile.PAX_FORMAT)
                    + data
                    + bytes(-len(data) % tarfile.BLOCKSIZE)
                )
        if stream.tell() >= shard_bytes:
            yield f"shard-{number:06d}.tar", stream.getvalue() + _END
            number, stream = number + 1, io.BytesIO()
    if stream.tell():
        yield f"shard-{number:06d}.tar", stream.getvalue() + _END


def parquet(
    sources: Iterable[Source], file_bytes: int = _FILE_BYTES
) -> Iterator[tuple[str, bytes]]:
    """train-00000.parquet and so on; a file ends with the sample that reaches `file_bytes`.

    One row and row group per sample: images and maps as encoded files (PNG, and PFM, which Pillow opens as mode F),
    calibration as columns. Raises MissingExtraError without pyarrow.
    """
    try:
        import pyarrow as pa
        from pyarrow.parquet import ParquetWriter
    except ImportError:
        raise MissingExtraError(
            "exporting to parquet needs pyarrow: pip install 'twinlens[parquet]'"
        ) from None
    schema = _schema(pa)
    number, stream, writer = 0, io.BytesIO(), None
    for source in sources:
        writer = writer or ParquetWriter(
            stream, schema, compression="NONE"
        )  # content is compressed
        writer.write_table(pa.Table.from_pylist([_row(source)], schema=schema))
        if stream.tell() >= file_bytes:
            writer.close()
            yield f"train-{number:05d}.parquet", stream.getvalue()
            number, stream, writer = number + 1, io.BytesIO(), None
    if writer:
        writer.close()
        yield f"train-{number:05d}.parquet", stream.getvalue()


def _folders(layout: Callable[[Source], Files]) -> Callable[[Iterable[Source]], Files]:
    return lambda sources: (file for source in sources for file in layout(source))


FOLDER_LAYOUTS = (
    carla,
    dpdd,
    eslf,
    eth3d,
    hci4d,
    kitti2015,
    middlebury,
    sceneflow,
    sintel,
)
LAYOUTS: dict[str, Callable[[Iterable[Source]], Files]] = {
    **{layout.__name__: _folders(layout) for layout in FOLDER_LAYOUTS},
    "bop": bop,
    "coco": coco,
    "fod500": fod500,
    "parquet": parquet,
    "webdataset": webdataset,
}
"""From samples to (relative name, content) of every file."""


def export(
    dataset: Sequence[StoredSample],
    folder: Where,
    to: str,
    lens: int = 0,
    overwrite: bool = False,
    progress: Callable[[float, str], None] = lambda fraction, name: None,
    objects: Collection[str] = (),
) -> dict[str, int]:
    """Write samples to `folder` in the layout `to`, a key of LAYOUTS.

    The folder appears whole or not at all; it must not exist, unless `overwrite` is set and it is an earlier export or
    empty. EXPORT.md in it lists the samples in order. `lens` selects the images of samples taken through several
    lenses. `progress` is called with the fraction done and the sample's name. `objects` are the names of the objects to
    export, without the numbers of copies, in the OBJECT_LAYOUTS; by default all of them, and none in kitti2015.

    Returns the size in bytes of each file by relative name. Raises InputError for an unknown layout and for a sample
    that the layout cannot hold, FileError for a file that a sample lacks, and OutputError.
    """
    check_known("layout", to, LAYOUTS)
    if objects and to not in OBJECT_LAYOUTS:
        raise InputError(
            f"{to} has no masks of objects; layouts with masks: {', '.join(OBJECT_LAYOUTS)}"
        )
    if not len(dataset):
        raise InputError("export needs one or more samples")
    folder = place(folder)
    around = (
        ()
        if isinstance(folder, RemotePath)
        else (folder.absolute(), *folder.absolute().parents)
    )
    for home in (Path(str(sample.folder)).absolute() for sample in dataset):
        if home in around or (
            home.parent in around and (home.parent / MANIFEST).is_file()
        ):  # it would be more samples
            raise OutputError(
                f"{folder}: is inside the dataset to export; choose a folder outside of it"
            )
    if overwrite:
        own = (folder / NOTE).is_file() and read_bytes(folder / NOTE).startswith(
            _FIRST_LINE.encode()
        )
        check_replaceable(folder, own, "an earlier export")
    sizes: dict[str, int] = {}
    known: set[str] = set()

    def sources() -> Iterator[Source]:
        for i, sample in enumerate(dataset):
            progress(i / len(dataset), sample.name)
            if (
                to not in UNRECTIFIED_LAYOUTS
                and sample.has("sample.json")
                and not sample.has("calib.txt")
            ):
                others = ", ".join(UNRECTIFIED_LAYOUTS)
                raise InputError(
                    f"{sample.name}: is not a rectified pair; layouts for other rigs: {others}"
                )
            if objects and sample.has("sample.json"):
                known.update(
                    category(name) for name in sample.record.get("object_names", [])
                )
            yield Source(sample, i, lens, frozenset(objects) if objects else None)
        for name in objects:
            check_known("object", name, known)

    def files() -> Files:
        names = "".join(f"{i}. {sample.name}\n" for i, sample in enumerate(dataset))
        note = f"{_FIRST_LINE} {twinlens.__version__}\n\nLayout: `{to}`. Samples, in order:\n\n{names}".encode()
        for name, data in itertools.chain(LAYOUTS[to](sources()), [(NOTE, note)]):
            sizes[name] = len(data)
            yield name, data

    write_folder(folder, files(), overwrite)
    return sizes


def _fixed_point(disparity: Disparity, scale: float) -> NDArray[np.uint32]:
    """round(scale d), at least 1; 0 where unknown. A known disparity of 0 therefore becomes 1, that is 1/scale px."""
    known = np.isfinite(disparity)
    counts = np.round(np.where(known, disparity, 0.0).astype(np.float64) * scale)
    return np.where(known, np.maximum(counts, 1), 0).astype(np.uint32)


def _kitti_objects(source: Source, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    if source.objects is None:
        return np.zeros(shape, np.uint8)
    truth = source.sample.truth(0)
    chosen = [
        0,
        *(
            i
            for i, name in enumerate(truth.object_names, start=1)
            if category(name) in source.objects
        ),
    ]
    if max(chosen) > 255:
        raise InputError(
            f"{source.sample.name}: has object {max(chosen)}, and this layout holds 255"
        )
    return np.where(np.isin(truth.object_id, chosen), truth.object_id, 0).astype(
        np.uint8
    )


def _kitti_calibration(calibration: Calibration) -> bytes:
    """S_rect, R_rect and P_rect = K [I | t] of cameras 02 and 03; t_x is minus the baseline for the right camera."""
    lines = []
    shifts = (0.0, -calibration.baseline)
    for name, camera, shift in zip(
        ("02", "03"), calibration.rig().cameras, shifts, strict=True
    ):
        projection = camera.K @ np.hstack([np.eye(3), [[shift], [0.0], [0.0]]])
        size = [calibration.width, calibration.height]
        for key, values in (
            ("S_rect", size),
            ("R_rect", np.eye(3).ravel()),
            ("P_rect", projection.ravel()),
        ):
            lines.append(
                f"{key}_{name}: " + " ".join(f"{value:.12e}" for value in values)
            )
    return ("\n".join(lines) + "\n").encode()


def _schema(pa: Any) -> Any:
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    fields = [("name", pa.string()), *((name, image) for name in IMAGES)]
    fields += [
        (name, pa.int32() if name in ("width", "height", "ndisp") else pa.float64())
        for name in NUMBERS
    ]
    fields.append(("record", pa.string()))
    types = {
        name: {"dtype": str(kind).replace("double", "float64"), "_type": "Value"}
        for name, kind in fields
    }
    features = types | {name: {"_type": "Image"} for name in IMAGES}
    return pa.schema(
        fields, metadata={"huggingface": json.dumps({"info": {"features": features}})}
    )


def _row(source: Source) -> dict[str, Any]:
    sample, calibration = source.sample, source.sample.calibration
    images = [
        {"bytes": data, "path": f"{source.name}/{name}"}
        for name, data in source.files(least=-np.inf)
    ]
    fx, fy, cx0, cy = calibration.cam0
    size = (calibration.width, calibration.height)
    numbers = (
        *size,
        fx,
        fy,
        cx0,
        calibration.cam1[2],
        cy,
        calibration.baseline,
        calibration.doffs,
        sample.ndisp,
    )
    row: dict[str, Any] = {"name": sample.name, "record": source.record().decode()}
    return (
        row
        | dict(zip(IMAGES, images, strict=False))
        | dict(zip(NUMBERS, numbers, strict=True))
    )
