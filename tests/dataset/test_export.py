"""Each layout is read back by the rules in its documentation."""

import io
import json
import re
import sys
import tarfile

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, place, write_pfm, write_sample
from twinlens.dataset.codecs.calib import read_calib
from twinlens.dataset.export import LAYOUTS, export
from twinlens.errors import FileError, InputError, MissingExtraError, OutputError


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i in range(3):
        write_sample(
            folder / f"s{i}", dataset_scene.sample(num_lenses=2, baseline=0.3 + 0.1 * i)
        )
    return Dataset(folder)


@pytest.fixture
def exported(data, tmp_path):
    def run(to, **options):
        sizes = export(data, tmp_path / "out", to, **options)
        files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
        assert {
            path.relative_to(tmp_path / "out").as_posix(): path.stat().st_size
            for path in files
        } == sizes
        return tmp_path / "out"

    return run


def pairs(root, left, right=None):
    """Two glob patterns, sorted and paired, as in torchvision."""
    first = sorted(root.glob(left))
    second = sorted(root.glob(right)) if right else [None] * len(first)
    assert len(first) == len(second) > 0
    return list(zip(first, second, strict=True))


def pixels(path, mode=None):
    with Image.open(path) as image:
        return np.array(image.convert(mode) if mode else image)


def rgb(path):
    return pixels(path, "RGB")


def pfm_by_lines(path):
    """torchvision's rules for PFM: three lines; the second matches digits, a space, digits, a newline."""
    with path.open("rb") as file:
        assert file.readline().rstrip() == b"Pf"
        width, height = map(
            int, re.match(rb"^(\d+)\s(\d+)\s$", file.readline()).groups()
        )
        order = "<" if float(file.readline().rstrip()) < 0 else ">"
        values = np.fromfile(file, dtype=order + "f")
    return np.flip(values.reshape(height, width), axis=0)


@pytest.mark.parametrize(
    ("to", "scene", "disparity"),
    [
        ("carla", "carla-highres/trainingF/*", "disp{}GT.pfm"),
        ("middlebury", "Middlebury2014/train/*-perfect", "disp{}.pfm"),
    ],
)
def test_middlebury_and_carla(data, exported, to, scene, disparity):
    root = exported(to)
    images = pairs(root, f"{scene}/im0.png", f"{scene}/im1.png")
    maps = pairs(
        root, f"{scene}/{disparity.format(0)}", f"{scene}/{disparity.format(1)}"
    )
    assert len(images) == len(maps) == 3
    for sample, image, pair in zip(data, images, maps, strict=True):
        for i in (0, 1):
            np.testing.assert_array_equal(rgb(image[i]), sample.image(i))
            np.testing.assert_array_equal(pfm_by_lines(pair[i]), sample.disparity(i))
        folder = image[0].parent
        np.testing.assert_array_equal(
            cv2.imread(str(folder / "mask0nocc.png"), -1), sample.mask0_nonocc
        )
        assert read_calib(folder / "calib.txt") == sample.calibration


def test_middlebury_passes_the_check_for_published_names(exported):
    published = ("Adirondack", "Jadeplant", "Motorcycle", "Piano", "Pipes", "Playroom")
    entries = [
        entry.name
        for entry in (exported("middlebury") / "Middlebury2014" / "train").iterdir()
    ]
    assert any(entry.startswith(published) for entry in entries)


def test_kitti(data, exported):
    root = exported("kitti2015") / "Kitti2015" / "training"
    images = pairs(root, "image_2/*_10.png", "image_3/*_10.png")
    occluded = pairs(root, "disp_occ_0/*.png", "disp_occ_1/*.png")
    visible = pairs(root, "disp_noc_0/*.png", "disp_noc_1/*.png")
    for sample, image, all_known, seen in zip(
        data, images, occluded, visible, strict=True
    ):
        for i in (0, 1):
            np.testing.assert_array_equal(rgb(image[i]), sample.image(i))
            truth = sample.disparity(i)
            stored = cv2.imread(str(all_known[i]), cv2.IMREAD_UNCHANGED)
            assert stored.dtype == np.uint16
            np.testing.assert_array_equal(pixels(all_known[i]), stored)
            np.testing.assert_array_equal(stored == 0, np.isinf(truth))
            known = np.isfinite(truth)
            assert np.abs(stored[known] / 256.0 - truth[known]).max() <= 0.5 / 256
            noc = cv2.imread(str(seen[i]), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(noc > 0, sample.mask_nonocc(i) == 255)
            np.testing.assert_array_equal(noc[noc > 0], stored[noc > 0])
        background = cv2.imread(
            str(root / "obj_map" / image[0].name), cv2.IMREAD_UNCHANGED
        )
        assert background.dtype == np.uint8
        assert background.shape == sample.disp0.shape
        assert not background.any()
    assert images[1][0].name == "000001_10.png"


def test_kittis_projection_gives_its_disparity(data, exported):
    text = (
        exported("kitti2015") / "Kitti2015/training/calib_cam_to_cam/000000.txt"
    ).read_text()
    rows = dict(line.split(": ") for line in text.splitlines())
    p2, p3 = (
        np.array(rows[f"P_rect_0{i}"].split(), float).reshape(3, 4) for i in (2, 3)
    )
    truth, known = data[0].truth0, np.isfinite(data[0].disp0)
    camera = data[0].rig.cameras[0]
    points = camera.unproject(camera.pixel_grid())[known] * truth.depth[known][:, None]
    left, right = (
        np.column_stack([points, np.ones(len(points))]) @ p.T for p in (p2, p3)
    )
    d = left[:, 0] / left[:, 2] - right[:, 0] / right[:, 2]
    np.testing.assert_allclose(d, data[0].disp0[known], atol=1e-4)


def test_small_disparities_stay_known_in_kitti(tmp_path):
    sample = dataset_scene.sample()
    for i in (0, 1):
        sample.truths[i].disparity[:] = 0
    write_sample(tmp_path / "in" / "s", sample)
    export(Dataset(tmp_path / "in"), tmp_path / "out", "kitti2015")
    path = tmp_path / "out/Kitti2015/training/disp_occ_0/000000_10.png"
    assert (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) == 1).all()


def test_eth3d(data, exported):
    root = exported("eth3d") / "ETH3D"
    images = pairs(root, "two_view_training/*/im0.png", "two_view_training/*/im1.png")
    maps = pairs(root, "two_view_training_gt/*/disp0GT.pfm")
    for sample, image, (disparity, _) in zip(data, images, maps, strict=True):
        np.testing.assert_array_equal(pfm_by_lines(disparity), sample.disp0)
        mask = pixels(disparity.with_name("mask0nocc.png"))
        np.testing.assert_array_equal(mask, sample.mask0_nonocc)
        assert read_calib(image[0].with_name("calib.txt")) == sample.calibration


def test_eth3ds_colmap_files_project_the_truth_to_its_pixels(data, exported):
    scene = exported("eth3d") / "ETH3D/two_view_training/s0"
    cameras = [
        line.split()
        for line in (scene / "cameras.txt").read_text().splitlines()
        if line[0] != "#"
    ]
    poses = [
        line.split()
        for line in (scene / "images.txt").read_text().splitlines()
        if line and line[0] != "#"
    ]
    assert [pose[9] for pose in poses] == ["im0.png", "im1.png"]
    truth = data[0].truth0
    for i, disparity in ((0, 0.0), (1, truth.disparity)):
        fx, fy, cx, cy = map(float, cameras[i][4:])
        qw, qx, qy, qz, *shift = map(float, poses[i][1:8])
        cam = (
            Rotation.from_quat([qx, qy, qz, qw]).apply(truth.position[truth.hit])
            + shift
        )
        u, v = fx * cam[:, 0] / cam[:, 2] + cx, fy * cam[:, 1] / cam[:, 2] + cy
        rows, columns = np.nonzero(truth.hit)
        # COLMAP's first pixel has its centre at 0.5.
        np.testing.assert_allclose(
            u,
            columns + 0.5 - np.broadcast_to(disparity, truth.hit.shape)[truth.hit],
            atol=1e-3,
        )
        np.testing.assert_allclose(v, rows + 0.5, atol=1e-3)


def test_eth3ds_colmap_model_is_complete(exported):
    """The three files that COLMAP reads; pycolmap 4.2 opens them."""
    scene = exported("eth3d") / "ETH3D/two_view_training/s0"
    assert all(
        (scene / name).is_file()
        for name in ("cameras.txt", "images.txt", "points3D.txt")
    )
    assert all(
        line.startswith("#")
        for line in (scene / "points3D.txt").read_text().splitlines()
    )
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(str(scene))
    assert (model.num_cameras(), model.num_images(), model.num_points3D()) == (2, 2, 0)


def test_sceneflow(data, exported):
    root = exported("sceneflow") / "SceneFlow" / "FlyingThings3D"
    images = pairs(
        root, "frames_cleanpass/*/*/*/left/*.png", "frames_cleanpass/*/*/*/right/*.png"
    )
    maps = pairs(root, "disparity/*/*/*/left/*.pfm", "disparity/*/*/*/right/*.pfm")
    for sample, image, pair in zip(data, images, maps, strict=True):
        for i in (0, 1):
            np.testing.assert_array_equal(rgb(image[i]), sample.image(i))
            np.testing.assert_array_equal(pfm_by_lines(pair[i]), sample.disparity(i))


def test_sintel(data, exported):
    root = exported("sintel") / "Sintel" / "training"
    images = pairs(root, "final_left/*/*.png", "final_right/*/*.png")
    maps = pairs(root, "disparities/*/*.png")
    for sample, image, (path, _) in zip(data, images, maps, strict=True):
        np.testing.assert_array_equal(rgb(image[1]), sample.im1)
        r, g, b = np.moveaxis(pixels(path).astype(np.float64), -1, 0)
        decoded = 4 * r + g / 64 + b / 16384
        known = np.isfinite(sample.disp0)
        assert np.abs(decoded[known] - sample.disp0[known]).max() <= 0.5 / 16384
        scene, name = path.parent.name, path.name
        masks = [
            pixels(root / kind / scene / name) for kind in ("occlusions", "outofframe")
        ]
        valid = (masks[0] == 0) & (masks[1] == 0)
        np.testing.assert_array_equal(valid, sample.mask0_nonocc == 255)
        leaves = known & (np.arange(64) - np.where(known, sample.disp0, 0) < -0.5)
        np.testing.assert_array_equal(masks[1] > 0, leaves)


def test_webdataset(data, exported):
    root = exported("webdataset", lens=1)
    with tarfile.open(root / "shard-000000.tar") as tar:
        members = tar.getmembers()
        content = {member.name: tar.extractfile(member).read() for member in members}
    assert {member.mtime for member in members} == {0}
    keys = [name.split(".", 1)[0] for name in content]
    assert keys == sorted(keys)
    assert {name.split(".", 1)[1] for name in content} == {
        *(
            "im0.png",
            "im1.png",
            "disp0.pfm",
            "disp1.pfm",
            "mask0nocc.png",
            "mask1nocc.png",
            "calib.txt",
            "json",
        )
    }
    image = pixels(io.BytesIO(content["s2.im0.png"]))
    np.testing.assert_array_equal(image, data[2].lens(1).im0)


def test_webdataset_keys_are_unique(tmp_path):
    names = ("a.b", "a-b", "a/b", "a%2Eb")
    for name in names:
        write_sample(tmp_path / "in" / name, dataset_scene.sample())
    dataset_scene.list_samples(tmp_path / "in", *names)
    export(Dataset(tmp_path / "in"), tmp_path / "out", "webdataset")
    with tarfile.open(tmp_path / "out" / "shard-000000.tar") as tar:
        entries = tar.getnames()
    assert len(set(entries)) == len(entries) == 8 * len(names)
    assert {name.split(".", 1)[0] for name in entries} == {
        "a%2Eb",
        "a-b",
        "a/b",
        "a%252Eb",
    }


def test_shards_are_closed_at_their_size(data):
    from twinlens.dataset.layouts import Source, webdataset

    shards = list(webdataset((Source(s, i) for i, s in enumerate(data)), shard_bytes=1))
    assert [name for name, _ in shards] == [f"shard-{i:06d}.tar" for i in range(3)]


def test_exr(data, exported):
    root = exported("exr", lens=1)
    for sample in data:
        for view in (0, 1):
            planes = OpenEXR.File(
                str(root / sample.name / f"view{view}.exr"), separate_channels=True
            ).channels()
            expected = {
                "depth": sample[f"depth{view}"],
                "position.Y": sample[f"position{view}"][..., 1],
                "object_id": sample[f"object_id{view}"],
                "disp": sample.disparity(view),
                "mask_nonocc": sample.mask_nonocc(view),
                "blur_circle_px": sample.lens(1).blur_circle_px(view),
            }
            for name, array in expected.items():
                np.testing.assert_array_equal(planes[name].pixels, array)


def test_parquet(data, exported):
    table = pytest.importorskip("pyarrow.parquet")
    rows = table.read_table(exported("parquet") / "train-00000.parquet")
    assert json.loads(rows.schema.metadata[b"huggingface"])["info"]["features"][
        "disp0"
    ] == {"_type": "Image"}
    for sample, row in zip(data, rows.to_pylist(), strict=True):
        assert (row["name"], row["baseline"], row["ndisp"]) == (
            sample.name,
            sample.calibration.baseline,
            sample.ndisp,
        )
        assert json.loads(row["record"]) == sample.record
        for name in ("im0", "im1", "disp0", "disp1", "mask0_nonocc", "mask1_nonocc"):
            np.testing.assert_array_equal(
                pixels(io.BytesIO(row[name]["bytes"])), getattr(sample, name)
            )


def test_parquet_without_pyarrow_says_what_to_install(data, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'twinlens\[parquet\]'"):
        export(data, tmp_path / "out", "parquet")
    assert not list(tmp_path.iterdir())


def test_sixteen_bits_become_eight(tmp_path):
    sample = dataset_scene.sample()
    deep = dataset_scene.images(sample.rig, 5, np.uint16)
    shot = dataset_scene.Shot(dataset_scene.LENS, deep)
    write_sample(
        tmp_path / "in" / "s", dataset_scene.Sample(sample.rig, (shot,), sample.truths)
    )
    export(Dataset(tmp_path / "in"), tmp_path / "out", "carla")
    image = rgb(tmp_path / "out/carla-highres/trainingF/s/im1.png").astype(float)
    assert np.abs(image - deep[1] / 65535 * 255).max() <= 0.5


@pytest.mark.parametrize(
    "to", sorted(LAYOUTS.keys() - {"dpdd", "eslf", "exr", "fod500", "hci4d"})
)
def test_a_failure_leaves_nothing(data, tmp_path, to):
    if to == "parquet":
        pytest.importorskip("pyarrow")
    write_sample(tmp_path / "in" / "a", dataset_scene.sample())
    write_sample(tmp_path / "in" / "b", dataset_scene.sample())
    (tmp_path / "in" / "b" / "im1.png").unlink()
    with pytest.raises(FileError, match=r"b.im1\.png: no such file"):
        export(Dataset(tmp_path / "in"), tmp_path / "out", to)
    assert [entry.name for entry in tmp_path.iterdir()] == ["in"]


def test_invalid_requests_are_rejected(data, tmp_path):
    with pytest.raises(
        InputError, match="unknown layout 'kitti'; did you mean 'kitti2015'"
    ):
        export(data, tmp_path / "out", "kitti")
    with pytest.raises(InputError, match="one or more samples"):
        export(data[:0], tmp_path / "out", "carla")
    with pytest.raises(InputError, match="lenses 0 to 1, no lens 2"):
        export(data, tmp_path / "out", "carla", lens=2)
    (tmp_path / "there").mkdir()
    with pytest.raises(OutputError, match="already exists"):
        export(data, tmp_path / "there", "carla")
    assert [entry.name for entry in tmp_path.iterdir()] == ["there"]


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
    write_sample(tmp_path / "in" / "s", dataset_scene.sample())
    write_pfm(tmp_path / "in" / "s" / "disp0.pfm", np.full((48, 64), value, np.float32))
    others = re.escape("layouts without this limit: exr, parquet, webdataset")
    with pytest.raises(InputError, match=f"s: has disparities from .*; {others}$"):
        export(Dataset(tmp_path / "in"), tmp_path / "out", to)


def test_sample_names_that_collide_are_rejected(tmp_path):
    for name in ("a/b", "a-b"):
        write_sample(tmp_path / "in" / name, dataset_scene.sample())
    dataset_scene.list_samples(tmp_path / "in", "a/b", "a-b")
    with pytest.raises(InputError, match="two files would be named"):
        export(Dataset(tmp_path / "in"), tmp_path / "out", "carla")


def test_negative_disparities_stay_where_readers_keep_the_sign(tmp_path):
    write_sample(tmp_path / "in" / "s", dataset_scene.sample())
    write_pfm(tmp_path / "in" / "s" / "disp0.pfm", np.full((48, 64), -1.5, np.float32))
    export(Dataset(tmp_path / "in"), tmp_path / "out", "webdataset")
    with tarfile.open(tmp_path / "out" / "shard-000000.tar") as tar:
        values = np.asarray(
            Image.open(io.BytesIO(tar.extractfile("s.disp0.pfm").read()))
        )
    assert (values == -1.5).all()


def test_an_unrectified_pair_is_rejected(tmp_path):
    sample = dataset_scene.unrectified(dataset_scene.sample())
    write_sample(tmp_path / "in" / "s", sample)
    for to in (name for name in LAYOUTS if LAYOUTS[name].needs_pair):
        with pytest.raises((InputError, FileError)) as caught:
            export(Dataset(tmp_path / "in"), tmp_path / "out", to)
        assert "s: is not a rectified pair; layouts for other rigs: bop, coco" in str(
            caught.value
        ), to
    assert [entry.name for entry in tmp_path.iterdir()] == ["in"]
    for to in ("bop", "coco", "exr"):
        assert export(Dataset(tmp_path / "in"), tmp_path / to, to)


def test_only_an_earlier_export_is_overwritten(data, tmp_path):
    out = tmp_path / "out"
    export(data, out, "kitti2015")
    before = {path.name for path in out.iterdir()}
    assert "2. s2" in (out / "EXPORT.md").read_text()
    with pytest.raises(OutputError, match="already exists"):
        export(data, out, "carla")
    export(data[:1], out, "carla", overwrite=True)
    assert {path.name for path in out.iterdir()} == before - {"Kitti2015"} | {
        "carla-highres"
    }
    for name in ("home", "empty"):
        (tmp_path / name).mkdir()
    (tmp_path / "home" / "EXPORT.md").write_text("# My own\n")
    with pytest.raises(OutputError, match="is not an earlier export"):
        export(data, tmp_path / "home", "carla", overwrite=True)
    assert export(data, tmp_path / "empty", "carla", overwrite=True)


def test_progress_is_reported(data, tmp_path):
    calls = []
    export(
        data,
        tmp_path / "out",
        "carla",
        progress=lambda fraction, name: calls.append((fraction, name)),
    )
    assert calls == [
        (0, "s0"),
        (pytest.approx(1 / 3), "s1"),
        (pytest.approx(2 / 3), "s2"),
    ]


def test_into_a_bucket_and_from_it(tmp_path):
    bucket = place(f"memory:/{tmp_path}")
    write_sample(bucket / "in" / "s", dataset_scene.sample())
    sizes = export(Dataset(bucket / "in"), bucket / "out", "carla")
    assert (bucket / "out").files() == sorted(sizes)
    assert export(Dataset(bucket / "in"), tmp_path / "out", "carla") == sizes


def test_an_export_into_the_dataset_is_rejected(tmp_path):
    folder = tmp_path / "set"
    write_sample(folder / "s0", dataset_scene.sample())
    data = Dataset(folder)
    dataset_scene.list_samples(folder, "s0")
    for inside in (folder / "out", folder / "s0" / "out"):
        with pytest.raises(OutputError, match="is inside the dataset"):
            export(data, inside, "middlebury")
        assert not inside.exists()
    export(data, tmp_path / "other", "middlebury")
