"""The layouts of stereo pairs, and `Source`, the sample that a layout exports. `export` has the table of all layouts.

A layout yields (relative name, content) of every file of one sample; WebDataset and Parquet, of all samples, have a few
large files. What a layout cannot hold, such as a disparity beyond its range or a missing view, is an error that names
the sample. The same samples give the same bytes: archives have no time and no owner.

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
import re
import tarfile
from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
)
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.channels import (
    CHANNELS,
    DISPARITY,
    IMAGE,
    MASK,
    PIXELS,
    encode_channels,
    view_files,
)
from twinlens.dataset.codecs.calib import Calibration, encode_calib
from twinlens.dataset.codecs.colmap import (
    colmap_camera,
    colmap_pose,
)
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import read_bytes
from twinlens.dataset.stored import StoredSample
from twinlens.dataset.visibility import VISIBLE, Disparity
from twinlens.errors import FileError, InputError, MissingExtraError

Files = Iterator[tuple[str, bytes]]

SIGNED_LAYOUTS = ("exr", "parquet", "webdataset")
"""The layouts of pairs that can hold negative disparities."""

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
FILE_BYTES = 256 * 1024 * 1024
"""The size at which a file of many samples ends."""
_DEFAULT_SPLIT = "train"
"""The split of Hugging Face's datasets for samples without one."""
_COPY = re.compile(r"(\[\d+\])+$")
_NUMBER = re.compile(r"-\d+$")
_END = bytes(2 * tarfile.BLOCKSIZE)
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


@dataclass(frozen=True)
class Source:
    """A sample to export: number `index` of its dataset, with the images of lens number `lens`.

    `objects` are the names of the objects to export, without the numbers of copies; None for all. `about` is what the
    recipe says of the dataset, empty where it is not known.
    """

    sample: StoredSample
    index: int
    lens: int = 0
    objects: frozenset[str] | None = None
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The sample's name as one folder name: train/0001 becomes train-0001."""
        return self.sample.name.replace("/", "-")

    @property
    def split(self) -> str:
        """The name of the sample's split, or nothing."""
        return str(self.sample.row.get("info", {}).get("split") or "")

    def exports(self, name: str, names: Collection[str]) -> bool:
        """Whether to export the object of that name; `names` are those of all objects of its scene."""
        return self.objects is None or category(name, names) in self.objects

    def image(self, i: int) -> bytes:
        """View i as an 8-bit PNG: the sample's file, or its 16 bits rounded to 8."""
        shot = self.sample.lens(self.lens)
        pixels = shot.image(i)
        if pixels.dtype == np.uint8:
            return read_bytes(shot.path(IMAGE.name(i)))
        return encode_png(np.round(pixels / 257.0).astype(np.uint8))

    def disparity(self, i: int, most: float = np.inf, least: float = 0.0) -> Disparity:
        """View i's disparity. Raises InputError unless its known values are in the range of the layout.

        Readers of layouts that could store a sign take the absolute value, so negative values are rejected there too.
        """
        disparity = self.sample.disparity(i)
        finite = disparity[np.isfinite(disparity)]
        if finite.size and not (finite.min() >= least and finite.max() <= most):
            limits = "0 or more" if np.isinf(most) else f"0 to {most:.6g}"
            raise InputError(
                f"{self.sample.name}: has disparities from {finite.min():.6g} to {finite.max():.6g} px, and this layout"
                f" holds {limits}; layouts without this limit: {', '.join(SIGNED_LAYOUTS)}"
            )
        return disparity

    def calib(self) -> bytes:
        """The sample's calib.txt."""
        return encode_calib(self.sample.calibration).encode()

    def record(self) -> bytes:
        """The sample's sample.json, empty if it has none."""
        if self.sample.has("sample.json"):
            return read_bytes(self.sample.folder / "sample.json")
        return b""

    def files(
        self,
        disparity_name: Callable[[int], str] = DISPARITY.name,
        least: float = 0.0,
    ) -> Files:
        """Images, disparities and masks of both views, and calib.txt, with Middlebury's names."""
        for view in (0, 1):
            yield IMAGE.name(view), self.image(view)
        for view in (0, 1):
            disparity = self.disparity(view, least=least)
            yield disparity_name(view), encode_pfm(disparity)
        for view in (0, 1):
            yield MASK.name(view), encode_png(self.sample.mask_nonocc(view))
        yield "calib.txt", self.calib()


def category(name: str, names: Collection[str]) -> str:
    """The name of an object without the number of a copy; `names` are those of all objects of its scene.

    [3] is the number of a copy, and the name before it is kept as it is written. A name without it that ends in -2 is
    another copy where the name before that is in the scene too, as families name their objects.

    >>> [category(name, ["nut", "nut-2", "bolt-10"]) for name in ("nut", "nut-2", "nut[3]", "bolt-10")]
    ['nut', 'nut', 'nut', 'bolt-10']
    >>> category("nut-2[0]", ["nut", "nut-2[0]"])
    'nut-2'
    """
    whole = _COPY.sub("", name)
    if whole != name:
        return whole
    written = {_COPY.sub("", other) for other in names}
    while (stem := _NUMBER.sub("", whole)) != whole and stem in written:
        whole = stem
    return whole


def middlebury(source: Source) -> Files:
    """Middlebury2014/train/<name>-perfect/: im0 im1 .png, disp0 disp1 .pfm, mask0nocc mask1nocc .png, calib.txt."""
    if source.index == 0:
        yield _MIDDLEBURY_MARKER, _MIDDLEBURY_NOTE
    for name, data in source.files():
        yield f"{MIDDLEBURY_FOLDER}/{source.name}-perfect/{name}", data


def carla(source: Source) -> Files:
    """carla-highres/trainingF/<name>/: as `middlebury`, with disp0GT.pfm and disp1GT.pfm, as in MiddEval3."""
    for name, data in source.files(lambda view: DISPARITY.names(view)[1]):
        yield f"carla-highres/trainingF/{source.name}/{name}", data


def eth3d(source: Source) -> Files:
    """ETH3D/two_view_training/<name>/ and ETH3D/two_view_training_gt/<name>/ (disp0GT.pfm, mask0nocc.png).

    cameras.txt, images.txt and an empty points3D.txt form a COLMAP model.
    """
    scene = f"ETH3D/two_view_training/{source.name}"
    truth = f"ETH3D/two_view_training_gt/{source.name}"
    rig, model = source.sample.rig, dict(_COLMAP_HEADERS)
    for view in (0, 1):
        pose = colmap_pose(rig.world_from_cams[view])
        yield f"{scene}/{IMAGE.name(view)}", source.image(view)
        model["cameras"] += f"{view} {colmap_camera(rig.cameras[view])}\n"
        model["images"] += f"{view} {pose} {view} {IMAGE.name(view)}\n\n"
    yield f"{scene}/calib.txt", source.calib()
    for name, text in model.items():
        yield f"{scene}/{name}.txt", text.encode()
    yield f"{truth}/{DISPARITY.names(0)[1]}", encode_pfm(source.disparity(0))
    yield f"{truth}/{MASK.name(0)}", encode_png(source.sample.mask_nonocc(0))


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


def exr(source: Source) -> Files:
    """<name>/view0.exr ...: all channels of a view but its photographs, in one EXR file with the planes of truth0.exr.

    A linear image that the sample keeps is R, G and B. Raises FileError if some of the files of truth are missing, not
    all.
    """
    sample, shot = source.sample, source.sample.lens(source.lens)
    _check_truth_is_whole(sample)
    for view in range(len(sample.rig)):
        arrays: dict[str, Any] = {}
        for file in view_files():
            path = (shot if file.per_lens else sample).path(file.name(view))
            if path.is_file():
                arrays |= sample.read_file(file, path)
        if "blur_circle_px" in arrays:
            arrays["blur_circle_px"] = shot.blur_circle_px(view)
        maps = {
            CHANNELS[name]: array
            for name, array in arrays.items()
            if CHANNELS[name].dtype != PIXELS
        }
        if not maps:
            raise InputError(f"{sample.name}: has no truth of view {view}")
        yield f"{source.name}/view{view}.exr", encode_channels(maps)


def _check_truth_is_whole(sample: StoredSample) -> None:
    """Raise FileError for a missing file of truth, unless all are: a sample may be made without truth.

    Plain folders have no truth but disparities. Dual pixels, whose truth depends on the lens, are not considered.
    """
    if not sample.has("sample.json"):
        return
    rig = sample.rig
    files = [file for file in view_files() if file.is_truth and not file.per_lens]
    paths = [
        sample.path(file.name(view))
        for view in range(len(rig))
        for file in files
        if file.required(rig, view, False)
    ]
    missing = [path for path in paths if not path.is_file()]
    if missing and len(missing) < len(paths):
        raise FileError(f"{missing[0]}: no such file, but the sample has other truth")


def webdataset(
    sources: Iterable[Source], shard_bytes: int = FILE_BYTES
) -> Iterator[tuple[str, bytes]]:
    """shard-000000.tar and so on; a shard ends with the sample that reaches `shard_bytes`.

    Files of a sample follow each other under a common key: ``train/0001.im0.png`` is entry "im0.png" of sample
    train/0001. A key ends at the first dot, so "." in a sample's name is written as "%2E", and "%" as "%25".
    """
    number, stream = 0, io.BytesIO()
    for source in sources:
        key = source.sample.name.replace("%", "%25").replace(".", "%2E")
        for name, data in (*source.files(least=-np.inf), ("json", source.record())):
            if data:
                stream.write(_tar_entry(f"{key}.{name}", data))
        if stream.tell() >= shard_bytes:
            yield f"shard-{number:06d}.tar", stream.getvalue() + _END
            number, stream = number + 1, io.BytesIO()
    if stream.tell():
        yield f"shard-{number:06d}.tar", stream.getvalue() + _END


def _tar_entry(name: str, data: bytes) -> bytes:
    """A file in a tar archive, without time and owner, padded to whole blocks."""
    header = tarfile.TarInfo(name)
    header.size, header.mode = len(data), 0o644
    padding = bytes(-len(data) % tarfile.BLOCKSIZE)
    return header.tobuf(tarfile.PAX_FORMAT) + data + padding


def parquet(sources: Iterable[Source], file_bytes: int = FILE_BYTES) -> Files:
    """train-00000.parquet and so on; a file ends with the sample that reaches `file_bytes`.

    One row and row group per sample: images and maps as encoded files (PNG, and PFM, which Pillow opens as mode F),
    calibration as columns. A dataset with splits has files of each, and a README.md that names them. Raises
    MissingExtraError without pyarrow.
    """
    files: dict[str, _ParquetFiles] = {}
    has_splits = False
    for source in sources:
        has_splits |= bool(source.split)
        split = re.sub(r"\W", "_", source.split) or _DEFAULT_SPLIT
        files_of_split = files.setdefault(split, _ParquetFiles(split))
        yield from files_of_split.add(_row(source), file_bytes)
    for files_of_split in files.values():
        yield from files_of_split.end()
    if has_splits:
        yield "README.md", _hugging_face_card(files)


class _ParquetFiles:
    """The Parquet files of a split. `add` and `end` yield those that are full."""

    def __init__(self, split: str) -> None:
        message = "exporting to parquet needs pyarrow: pip install 'twinlens[parquet]'"
        try:
            import pyarrow as pa
            from pyarrow.parquet import ParquetWriter
        except ImportError:
            raise MissingExtraError(message) from None
        self._pyarrow, self._open = pa, ParquetWriter
        self._schema = _schema(pa)
        self._split, self._count = split, 0
        self._stream = io.BytesIO()
        self._writer: Any = None

    def add(self, row: Mapping[str, Any], file_bytes: int) -> Files:
        # The encoded files are compressed already.
        self._writer = self._writer or self._open(
            self._stream, self._schema, compression="NONE"
        )
        table = self._pyarrow.Table.from_pylist([row], schema=self._schema)
        self._writer.write_table(table)
        if self._stream.tell() >= file_bytes:
            yield from self.end()

    def end(self) -> Files:
        if self._writer is None:
            return
        self._writer.close()
        name = f"{self._split}-{self._count:05d}.parquet"
        yield name, self._stream.getvalue()
        self._count += 1
        self._stream = io.BytesIO()
        self._writer = None


def _hugging_face_card(splits: Iterable[str]) -> bytes:
    """A dataset card that names the files of each split."""
    lines = ["---", "configs:", "- config_name: default", "  data_files:"]
    for split in splits:
        lines += [f"  - split: {split}", f"    path: {split}-*.parquet"]
    return "\n".join([*lines, "---", ""]).encode()


def _fixed_point(disparity: Disparity, scale: float) -> NDArray[np.uint32]:
    """round(scale d), at least 1; 0 where unknown. A known disparity of 0 therefore becomes 1, that is 1/scale px."""
    finite = np.isfinite(disparity)
    counts = np.round(np.where(finite, disparity, 0.0).astype(np.float64) * scale)
    return np.where(finite, np.maximum(counts, 1), 0).astype(np.uint32)


def _kitti_objects(source: Source, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    if source.objects is None:
        return np.zeros(shape, np.uint8)
    truth = source.sample.truth(0)
    numbered = enumerate(truth.object_names, start=1)
    chosen = [
        number for number, name in numbered if source.exports(name, truth.object_names)
    ]
    if max(chosen, default=0) > 255:
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


def _image_columns() -> list[str]:
    """The columns of images and maps, in the order of `Source.files`."""
    names = itertools.product(("im", "disp", "mask_nonocc"), (0, 1))
    return [CHANNELS[name].quantity(view) for name, view in names]


def _schema(pa: Any) -> Any:
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    images = _image_columns()
    fields = [("name", pa.string()), *((name, image) for name in images)]
    fields += [
        (name, pa.int32() if name in ("width", "height", "ndisp") else pa.float64())
        for name in NUMBERS
    ]
    fields.append(("record", pa.string()))
    types = {
        name: {"dtype": str(kind).replace("double", "float64"), "_type": "Value"}
        for name, kind in fields
    }
    features = types | {name: {"_type": "Image"} for name in images}
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
        | dict(zip(_image_columns(), images, strict=False))
        | dict(zip(NUMBERS, numbers, strict=True))
    )
