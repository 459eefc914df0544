"""Each layout is read back by the rules in its documentation; test_torchvision.py reads some with torchvision."""

import io
import json
import re
import tarfile
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from tests.dataset.dataset_scene import (
    LENS,
    images,
    list_samples,
    sample,
    stored,
    unrectified,
)
from twinlens.dataset import Dataset, Sample, Shot, write_pfm, write_sample
from twinlens.dataset.codecs.calib import read_calib
from twinlens.dataset.export import export
from twinlens.dataset.poses import read_colmap
from twinlens.errors import FileError, InputError, OutputError


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i in range(3):
        write_sample(folder / f"s{i}", sample(num_lenses=2, baseline=0.3 + 0.1 * i))
    return Dataset(folder)


@pytest.fixture
def exported(data, tmp_path):
    """Export `data` to a layout; the sizes that `export` returns are those of the files."""

    def run(to, **options):
        out = tmp_path / "out"
        sizes = export(data, out, to, **options)
        for name, size in sizes.items():
            assert (out / name).stat().st_size == size
        return out

    return run


def pixels(path, mode=None):
    with Image.open(path) as image:
        return np.array(image.convert(mode) if mode else image)


def pfm_by_lines(path):
    """torchvision's rules for PFM: three lines; the second matches digits, a space, digits, a newline."""
    with path.open("rb") as file:
        assert file.readline().rstrip() == b"Pf"
        size = re.match(rb"^(\d+)\s(\d+)\s$", file.readline())
        width, height = map(int, size.groups())
        order = "<" if float(file.readline().rstrip()) < 0 else ">"
        values = np.fromfile(file, dtype=order + "f")
    return np.flip(values.reshape(height, width), axis=0)


def kitti_map(path):
    counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert counts.dtype == np.uint16
    return np.where(counts, counts / 256, np.inf)


def sintel_map(path):
    r, g, b = np.moveaxis(pixels(path).astype(float), -1, 0)
    decoded = 4 * r + g / 64 + b / 16384
    return np.where(decoded, decoded, np.inf)


# The left and right images, the disparities, their reader, and its largest error in pixels.
MIDDLEBURY = "Middlebury2014/train/*-perfect"
PAIRS = {
    "carla": (
        "carla-highres/trainingF/*",
        ("im0.png", "im1.png"),
        ("disp0GT.pfm", "disp1GT.pfm"),
        (pfm_by_lines, 0),
    ),
    "middlebury": (
        MIDDLEBURY,
        ("im0.png", "im1.png"),
        ("disp0.pfm", "disp1.pfm"),
        (pfm_by_lines, 0),
    ),
    "eth3d": (
        "ETH3D",
        ("two_view_training/*/im0.png", "two_view_training/*/im1.png"),
        ("two_view_training_gt/*/disp0GT.pfm",),
        (pfm_by_lines, 0),
    ),
    "kitti2015": (
        "Kitti2015/training",
        ("image_2/*_10.png", "image_3/*_10.png"),
        ("disp_occ_0/*.png", "disp_occ_1/*.png"),
        (kitti_map, 0.5 / 256),
    ),
    "sceneflow": (
        "SceneFlow/FlyingThings3D",
        ("frames_cleanpass/*/*/*/left/*.png", "frames_cleanpass/*/*/*/right/*.png"),
        ("disparity/*/*/*/left/*.pfm", "disparity/*/*/*/right/*.pfm"),
        (pfm_by_lines, 0),
    ),
    "sintel": (
        "Sintel/training",
        ("final_left/*/*.png", "final_right/*/*.png"),
        ("disparities/*/*.png",),
        (sintel_map, 0.5 / 16384),
    ),
}


@pytest.mark.parametrize("to", PAIRS)
def test_a_layout_of_pairs_has_the_images_and_disparities(data, exported, to):
    root, photos, maps, (read, error) = PAIRS[to]
    out = exported(to)
    for view, pattern in enumerate(photos):
        paths = sorted(out.glob(f"{root}/{pattern}"))
        for stored_sample, path in zip(data, paths, strict=True):
            assert_array_equal(pixels(path, "RGB"), stored_sample.image(view))
    for view, pattern in enumerate(maps):
        paths = sorted(out.glob(f"{root}/{pattern}"))
        for stored_sample, path in zip(data, paths, strict=True):
            truth = stored_sample.disparity(view)
            assert_allclose(read(path), truth, rtol=0, atol=error)


@pytest.mark.parametrize(
    ("to", "calib", "mask"),
    [
        ("carla", "carla-highres/trainingF/*/calib.txt", "carla-highres/trainingF/*/mask0nocc.png"),
        ("middlebury", f"{MIDDLEBURY}/calib.txt", f"{MIDDLEBURY}/mask0nocc.png"),
        ("eth3d", "ETH3D/two_view_training/*/calib.txt", "ETH3D/two_view_training_gt/*/mask0nocc.png"),
    ],
)  # fmt: skip
def test_layouts_of_middlebury_have_masks_and_calibrations(
    data, exported, to, calib, mask
):
    out = exported(to)
    for i, stored_sample in enumerate(data):
        assert_array_equal(
            pixels(sorted(out.glob(mask))[i]), stored_sample.mask0_nonocc
        )
        assert read_calib(sorted(out.glob(calib))[i]) == stored_sample.calibration


def test_middlebury_passes_torchvisions_check_for_published_names(exported):
    entries = (exported("middlebury") / "Middlebury2014" / "train").iterdir()
    assert any(entry.name.startswith("Adirondack") for entry in entries)


def test_kitti_has_visible_disparities_and_an_empty_map_of_objects(data, exported):
    root = exported("kitti2015") / "Kitti2015" / "training"
    for number, stored_sample in enumerate(data):
        name = f"{number:06d}_10.png"
        for view in (0, 1):
            every, visible = (
                pixels(root / f"disp_{kind}_{view}" / name) for kind in ("occ", "noc")
            )
            is_visible = stored_sample.mask_nonocc(view) == 255
            assert_array_equal(visible, np.where(is_visible, every, 0))
        objects = cv2.imread(str(root / "obj_map" / name), cv2.IMREAD_UNCHANGED)
        assert objects.dtype == np.uint8
        assert_array_equal(objects, np.zeros_like(stored_sample.object_id0))


def test_kittis_projection_gives_its_disparity(data, exported):
    path = exported("kitti2015") / "Kitti2015/training/calib_cam_to_cam/000000.txt"
    rows = dict(line.split(": ") for line in path.read_text().splitlines())
    truth, known = data[0].truth0, np.isfinite(data[0].disp0)
    camera = data[0].rig.cameras[0]
    points = camera.unproject(camera.pixel_grid())[known] * truth.depth[known][:, None]
    homogeneous = np.column_stack([points, np.ones(len(points))])
    u = []
    for name in ("P_rect_02", "P_rect_03"):
        projection = np.array(rows[name].split(), float).reshape(3, 4)
        x, _, w = projection @ homogeneous.T
        u.append(x / w)
    assert_allclose(u[0] - u[1], data[0].disp0[known], atol=1e-4)


def test_small_disparities_stay_known_in_kitti(tmp_path):
    made = sample()
    for truth in made.truths:
        truth.disparity[:] = 0
    export([stored(tmp_path / "s", made)], tmp_path / "out", "kitti2015")
    path = tmp_path / "out/Kitti2015/training/disp_occ_0/000000_10.png"
    assert (pixels(path) == 1).all()


def test_eth3ds_colmap_files_have_the_rig(data, exported):
    model = read_colmap(exported("eth3d") / "ETH3D/two_view_training/s0")
    assert model.names == ("im0.png", "im1.png")
    rig = data[0].rig
    for i in (0, 1):
        assert_allclose(model.rig.cameras[i].K, rig.cameras[i].K)
        assert_allclose(model.rig.world_from_cams[i], rig.world_from_cams[i])


def test_sintels_masks_are_of_occlusions_and_of_the_frame(data, exported):
    root = exported("sintel") / "Sintel" / "training"
    for stored_sample in data:
        occluded, outside = (
            pixels(root / kind / stored_sample.name / "frame_0001.png")
            for kind in ("occlusions", "outofframe")
        )
        visible = stored_sample.mask0_nonocc == 255
        assert_array_equal((occluded == 0) & (outside == 0), visible)
        match = np.arange(64) - stored_sample.disp0  # -inf where unknown
        assert_array_equal(outside > 0, np.isfinite(match) & (match < -0.5))


def read_tar(path):
    """The members of an archive, and their content by name."""
    with tarfile.open(path) as tar:
        members = tar.getmembers()
        return members, {item.name: tar.extractfile(item).read() for item in members}


def test_webdataset(data, exported):
    members, content = read_tar(exported("webdataset", lens=1) / "shard-000000.tar")
    assert {member.mtime for member in members} == {0}
    keys = [name.split(".", 1)[0] for name in content]
    assert keys == sorted(keys)
    views = "im0.png im1.png disp0.pfm disp1.pfm mask0nocc.png mask1nocc.png"
    names = {name.split(".", 1)[1] for name in content}
    assert names == {*views.split(), "calib.txt", "json"}
    image = pixels(io.BytesIO(content["s2.im0.png"]))
    assert_array_equal(image, data[2].lens(1).im0)


def test_webdataset_keys_are_unique(tmp_path):
    names = ("a.b", "a-b", "a/b", "a%2Eb")
    made = sample()
    for name in names:
        write_sample(tmp_path / "in" / name, made)
    list_samples(tmp_path / "in", *names)
    export(Dataset(tmp_path / "in"), tmp_path / "out", "webdataset")
    _, content = read_tar(tmp_path / "out" / "shard-000000.tar")
    assert len(content) == 8 * len(names)
    keys = {name.split(".", 1)[0] for name in content}
    assert keys == {"a%2Eb", "a-b", "a/b", "a%252Eb"}


def test_exr(data, exported):
    root = exported("exr", lens=1)
    for stored_sample in data:
        for view in (0, 1):
            path = str(root / stored_sample.name / f"view{view}.exr")
            planes = OpenEXR.File(path, separate_channels=True).channels()
            expected = {
                "depth": stored_sample[f"depth{view}"],
                "position.Y": stored_sample[f"position{view}"][..., 1],
                "object_id": stored_sample[f"object_id{view}"],
                "disp": stored_sample.disparity(view),
                "mask_nonocc": stored_sample.mask_nonocc(view),
                "blur_circle_px": stored_sample.lens(1).blur_circle_px(view),
            }
            for name, array in expected.items():
                assert_array_equal(planes[name].pixels, array)


def test_exr_needs_all_truth_or_none(tmp_path):
    damaged = stored(tmp_path / "damaged")
    (damaged.folder / "truth0.exr").unlink()
    with pytest.raises(FileError, match=r"damaged.truth0\.exr: no such file"):
        export([damaged], tmp_path / "out", "exr")
    made = sample()
    radiances = tuple(np.float32(image) for image in made.shots[0].images)
    shot = replace(made.shots[0], radiances=radiances)
    without = replace(made, shots=(shot,), truths=())
    export([stored(tmp_path / "without", without)], tmp_path / "out", "exr")
    assert (tmp_path / "out" / "without" / "view0.exr").is_file()


def test_parquet(data, exported):
    table = pytest.importorskip("pyarrow.parquet")
    rows = table.read_table(exported("parquet") / "train-00000.parquet")
    features = json.loads(rows.schema.metadata[b"huggingface"])["info"]["features"]
    assert features["disp0"] == {"_type": "Image"}
    for stored_sample, row in zip(data, rows.to_pylist(), strict=True):
        assert row["name"] == stored_sample.name
        assert row["baseline"] == stored_sample.calibration.baseline
        assert row["ndisp"] == stored_sample.ndisp
        assert json.loads(row["record"]) == stored_sample.record
        for name in ("im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc"):
            array = pixels(io.BytesIO(row[name]["bytes"]))
            assert_array_equal(array, stored_sample[name])


def test_sixteen_bits_become_eight(tmp_path):
    made = sample()
    deep = images(made.rig, 5, np.uint16)
    deep_sample = Sample(made.rig, (Shot(LENS, deep),), made.truths)
    export([stored(tmp_path / "s", deep_sample)], tmp_path / "out", "carla")
    image = pixels(tmp_path / "out/carla-highres/trainingF/s/im1.png").astype(float)
    assert np.abs(image - deep[1] / 65535 * 255).max() <= 0.5


@pytest.mark.parametrize("to", ["carla", "webdataset"])
def test_a_failure_leaves_nothing(data, tmp_path, to):
    incomplete = stored(tmp_path / "b")
    (incomplete.folder / "im1.png").unlink()
    with pytest.raises(FileError, match=r"b.im1\.png: no such file"):
        export([data[0], incomplete], tmp_path / "out", to)
    assert [entry.name for entry in tmp_path.iterdir()] == ["b"]


def test_invalid_requests_are_rejected(data, tmp_path):
    for samples, to, options, message in (
        (data[:0], "carla", {}, "one or more samples"),
        (data, "carla", {"lens": 2}, "lenses 0 to 1, no lens 2"),
    ):
        with pytest.raises(InputError, match=message):
            export(samples, tmp_path / "out", to, **options)
    assert not any(tmp_path.iterdir())


# torchvision's PFM classes take the absolute value of what they read.
@pytest.mark.parametrize(
    ("to", "value"),
    [
        ("kitti2015", 256.0),
        ("kitti2015", -1.0),
        ("sintel", 1024.0),
        *((to, -1.0) for to in ("carla", "eth3d", "middlebury", "sceneflow")),
    ],
)
def test_disparities_beyond_a_layout_are_rejected(tmp_path, to, value):
    wrong = stored(tmp_path / "s")
    write_pfm(wrong.folder / "disp0.pfm", np.full((48, 64), value, np.float32))
    others = re.escape("layouts without this limit: exr, parquet, webdataset")
    with pytest.raises(InputError, match=f"s: has disparities from .*; {others}$"):
        export([wrong], tmp_path / "out", to)


def test_negative_disparities_stay_where_readers_keep_the_sign(tmp_path):
    behind = stored(tmp_path / "s")
    write_pfm(behind.folder / "disp0.pfm", np.full((48, 64), -1.5, np.float32))
    export([behind], tmp_path / "out", "webdataset")
    _, content = read_tar(tmp_path / "out" / "shard-000000.tar")
    assert (pixels(io.BytesIO(content["s.disp0.pfm"])) == -1.5).all()


def test_an_unrectified_pair_is_rejected(tmp_path):
    toed_in = stored(tmp_path / "s", unrectified(sample()))
    message = "s: is not a rectified pair; layouts for other rigs: bop, coco"
    with pytest.raises(InputError, match=message):
        export([toed_in], tmp_path / "out", "carla")
    assert export([toed_in], tmp_path / "exr", "exr")


def test_only_an_earlier_export_is_overwritten(data, tmp_path):
    out = tmp_path / "out"
    export(data, out, "kitti2015")
    before = {path.name for path in out.iterdir()}
    with pytest.raises(OutputError, match="already exists"):
        export(data, out, "carla")
    export(data[:1], out, "carla", overwrite=True)
    after = {path.name for path in out.iterdir()}
    assert after == before - {"Kitti2015"} | {"carla-highres"}
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "EXPORT.md").write_text("# My own\n")
    with pytest.raises(OutputError, match="is not an earlier export"):
        export(data, tmp_path / "home", "carla", overwrite=True)


def test_an_export_into_the_dataset_is_rejected(tmp_path):
    folder = tmp_path / "set"
    write_sample(folder / "s0", sample())
    data = Dataset(folder)
    list_samples(folder, "s0")
    inside = folder / "s0" / "out"
    with pytest.raises(OutputError, match="is inside the dataset"):
        export(data, inside, "middlebury")
    assert not inside.exists()
