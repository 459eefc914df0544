"""COCO and BOP exports, read by pycocotools and by the rules of BOP's docs/bop_datasets_format.md."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from tests.dataset.dataset_scene import box, edited, sample, stored
from twinlens import geometry
from twinlens.camera import BrownConrady, Rig
from twinlens.camera.masks import decode_mask, encode_mask
from twinlens.dataset import Dataset, Manifest, Row, write_manifest, write_sample
from twinlens.dataset.export import export
from twinlens.errors import FileError, InputError

CARD = (
    np.array([[0.0, 0, 0], [0.8, 0, 0], [0.8, 0.55, 0], [0, 0.55, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)
MADE = sample()
WITH_MODEL = replace(sample(baseline=0.4), models={"fedcba9876543210": CARD})


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    return [stored(folder / "s0", MADE), stored(folder / "s1", WITH_MODEL)]


@pytest.fixture(scope="module")
def bop(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("bop") / "out"
    export(data, out, "bop")
    return out


@pytest.fixture(scope="module")
def coco(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("coco") / "out"
    export(data, out, "coco")
    return out


def read_json(path):
    return json.loads(path.read_text())


def test_objects_read_back_exactly(data):
    for view, written in enumerate(WITH_MODEL.truths):
        truth = data[1].truth(view)
        for back, instance in zip(truth.objects, written.objects, strict=True):
            for name, value in vars(instance).items():
                assert_array_equal(getattr(back, name), value)
        wall, card = truth.objects
        is_card = truth.object_id == 2
        assert_array_equal(truth.silhouette(card), is_card)
        assert (truth.silhouette(wall) & is_card).sum() > 50


def test_samples_without_objects_are_read_and_not_exported(tmp_path):
    old = stored(tmp_path / "s")
    with edited(old.folder) as record:
        del record["objects"]
    assert old.truth0.objects == ()
    for to in ("bop", "coco"):
        with pytest.raises(InputError, match="s: has no poses of objects"):
            export([old], tmp_path / "out", to)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("cam_from_object", [[1, 2]], ": cam_from_object must be a finite 4x4 matrix"),
        ("extent", ["a", 2], ""),
        ("pixel_count", 0, ".*an object must have 1 or more pixels"),
    ],
)
def test_damaged_objects_are_errors_that_name_the_key(tmp_path, key, value, message):
    damaged = stored(tmp_path / "s")
    with edited(damaged.folder) as record:
        record["objects"][0][1][key] = value
    with pytest.raises(FileError, match=rf"objects\[0\]\[1\]{message}"):
        _ = damaged.truth0


@pytest.mark.parametrize(
    "text", ["", "0", "~~~~", "0000000000", "\xe9", "o" * 2000, "o" * 1_000_000, "P"]
)
def test_codes_of_other_masks_are_rejected(text):
    with pytest.raises(InputError, match="does not have 9 x 7 pixels"):
        decode_mask(text, 7, 9)


def test_masks_are_coded_as_pycocotools_does():
    coco_masks = pytest.importorskip("pycocotools.mask")
    rng = np.random.default_rng(3)
    for _ in range(200):
        coarse = rng.random(rng.integers(1, 80, 2)) < rng.random() ** 3
        mask = np.kron(coarse, np.ones(rng.integers(1, 20, 2))) > 0
        code = coco_masks.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
        assert encode_mask(mask) == code.decode()
        assert_array_equal(decode_mask(code.decode(), *mask.shape), mask)


@pytest.mark.parametrize(
    ("texts", "description"),
    [
        ({"name": "Two parts"}, "Two parts"),
        ({"name": "Two parts", "description": "On a table."}, "On a table."),
        ({}, "exported by twinlens"),
    ],
)
def test_coco_describes_a_dataset_by_its_name_at_least(tmp_path, texts, description):
    folder = tmp_path / "data"
    hashes = write_sample(folder / "s0", MADE)
    write_manifest(folder, Manifest([Row("s0", hashes)], info={"about": texts}))
    export(Dataset(folder), tmp_path / "out", "coco")
    whole = read_json(tmp_path / "out/annotations/instances.json")
    assert whole["info"]["description"] == description


def test_coco_names_license_creator_and_splits(tmp_path):
    folder = tmp_path / "data"
    rows = []
    for name, made, split in (("s0", MADE, "val"), ("s1", WITH_MODEL, "train")):
        hashes = write_sample(folder / name, made)
        rows.append(Row(name, hashes, {"split": split}))
    texts = {"license": "CC-BY-4.0", "creator": "A lab", "description": "two scenes"}
    write_manifest(folder, Manifest(rows, info={"about": texts}))
    export(Dataset(folder), tmp_path / "out", "coco")
    whole = read_json(tmp_path / "out/annotations/instances.json")
    assert whole["info"] == {"description": "two scenes", "contributor": "A lab"}
    assert whole["licenses"] == [{"id": 1, "name": "CC-BY-4.0", "url": ""}]
    assert {image["license"] for image in whole["images"]} == {1}
    parts = [read_json(tmp_path / f"out/annotations/instances_{split}.json") for split in ("val", "train")]  # fmt: skip
    for key in ("images", "annotations"):
        assert [item for part in parts for item in part[key]] == whole[key]
    for part in parts:
        assert part["categories"] == whole["categories"]
        inside = {image["id"] for image in part["images"]}
        assert {item["image_id"] for item in part["annotations"]} <= inside


# of pycocotools 2.0.11
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_reads_the_annotations(data, coco):
    reader = pytest.importorskip("pycocotools.coco")
    read = reader.COCO(coco / "annotations" / "instances.json")
    categories = read.loadCats(read.getCatIds())
    assert [row["name"] for row in categories] == ["wall", "card"]
    assert read.getImgIds() == [1, 2, 3, 4]
    assert read.getAnnIds() == [*range(1, 9)]
    for image in read.loadImgs(read.getImgIds()):
        number, view = divmod(image["id"] - 1, 2)
        pixels = cv2.imread(coco / "images" / image["file_name"])
        assert_array_equal(pixels[..., ::-1], data[number].image(view))
        truth = data[number].truth(view)
        annotations = read.loadAnns(read.getAnnIds(imgIds=image["id"]))
        assert [row["name"] for row in annotations] == ["wall", "card"]
        for row, instance in zip(annotations, truth.objects, strict=True):
            visible = read.annToMask(row) > 0
            assert_array_equal(visible, truth.object_id == instance.object_id)
            assert row["area"] == visible.sum()
            assert tuple(row["bbox"]) == box(visible)
            amodal = {**row, "segmentation": row["amodal_segmentation"]}
            whole = read.annToMask(amodal) > 0
            assert_array_equal(whole, truth.silhouette(instance))
            assert row["amodal_area"] == whole.sum()
            assert row["visible_fraction"] == visible.sum() / whole.sum()
            assert_array_equal(row["cam_from_object"], instance.cam_from_object)
            assert len(row["corners_px"]) == 8


# of pycocotools 2.0.11
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_a_detector_that_finds_the_annotations_has_a_precision_of_1(coco):
    reader = pytest.importorskip("pycocotools.coco")
    evaluation = pytest.importorskip("pycocotools.cocoeval")
    truth = reader.COCO(coco / "annotations" / "instances.json")
    keys = ("image_id", "category_id", "segmentation")
    detections = [
        {key: row[key] for key in keys} | {"score": 1.0}
        for row in truth.loadAnns(truth.getAnnIds())
    ]
    evaluated = evaluation.COCOeval(truth, truth.loadRes(detections), "segm")
    evaluated.evaluate()
    evaluated.accumulate()
    evaluated.summarize()
    assert evaluated.stats[0] == pytest.approx(1)


def bop_views(data, bop):
    """Of each view: its truth, and its entries in scene_camera, scene_gt and scene_gt_info."""
    for number, stored_sample in enumerate(data):
        scene = bop / "train" / f"{number:06d}"
        files = [
            read_json(scene / f"scene_{name}.json")
            for name in ("camera", "gt", "gt_info")
        ]
        assert all(list(content) == ["0", "1"] for content in files)
        for i in (0, 1):
            entries = (content[str(i)] for content in files)
            yield scene, stored_sample, i, *entries


def mask(scene, kind, i, k):
    path = scene / kind / f"{i:06d}_{k:06d}.png"
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0


def test_bop_cameras_and_depth(data, bop):
    for scene, stored_sample, i, camera, _, _ in bop_views(data, bop):
        truth = stored_sample.truth(i)
        path = scene / "depth" / f"{i:06d}.png"
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        assert_array_equal(depth == 0, ~truth.hit)
        error = np.abs(depth * camera["depth_scale"] - truth.depth * 1000)[truth.hit]
        assert error.max() <= 0.5 * camera["depth_scale"] + 1e-3
        assert_array_equal(np.ravel(stored_sample.rig.cameras[i].K), camera["cam_K"])
        pose = geometry.rigid(
            np.reshape(camera["cam_R_w2c"], (3, 3)),
            np.array(camera["cam_t_w2c"]) / 1000,
        )
        assert_allclose(
            pose, geometry.inverse(stored_sample.rig.world_from_cams[i]), atol=1e-12
        )


def test_bop_poses_project_the_models_onto_the_masks(data, bop):
    info = read_json(bop / "models" / "models_info.json")
    assert [info[key]["name"] for key in ("1", "2")] == ["wall", "card"]
    assert info["2"]["size_x"] == pytest.approx(800)
    assert info["2"]["diameter"] == pytest.approx(np.hypot(800, 550))
    assert "diameter" not in info["1"]
    for scene, _, i, camera, poses, _ in bop_views(data, bop):
        assert [pose["obj_id"] for pose in poses] == [1, 2]
        turn = np.reshape(poses[1]["cam_R_m2c"], (3, 3))
        points = CARD[0] * 1000 @ turn.T + poses[1]["cam_t_m2c"]
        u, v, w = np.reshape(camera["cam_K"], (3, 3)) @ points.T
        # The card's polygon, drawn 16 times as fine, at the pixel centres.
        fine = np.zeros((48 * 16, 64 * 16), np.uint8)
        corners = np.rint(np.stack([u / w, v / w], -1) * 16 * 16).astype(np.int32)
        cv2.fillConvexPoly(fine, corners, 255, shift=4)
        drawn, stored = fine[::16, ::16] > 0, mask(scene, "mask", i, 1)
        assert (drawn & stored).sum() / (drawn | stored).sum() >= 0.99


def test_bop_masks_and_their_figures(data, bop):
    for scene, stored_sample, i, _, _, infos in bop_views(data, bop):
        truth = stored_sample.truth(i)
        for k, (info, instance) in enumerate(zip(infos, truth.objects, strict=True)):
            whole, visible = (
                mask(scene, kind, i, k) for kind in ("mask", "mask_visib")
            )
            assert_array_equal(visible, truth.object_id == instance.object_id)
            assert info["px_count_all"] == whole.sum()
            assert info["px_count_visib"] == visible.sum()
            assert info["px_count_valid"] == (whole & truth.hit).sum()
            assert info["visib_fract"] == pytest.approx(visible.sum() / whole.sum())
            for key, pixels in (("bbox_obj", whole), ("bbox_visib", visible)):
                u, v, width, height = box(pixels)
                assert info[key] == [u, v, width - 1, height - 1]
        assert infos[1]["visib_fract"] == 1


def test_bop_models_are_meshes_in_millimetres(bop):
    assert [path.name for path in (bop / "models").glob("*.ply")] == ["obj_000002.ply"]
    mesh = trimesh.load_mesh(bop / "models/obj_000002.ply", process=False)
    assert_allclose(mesh.vertices, CARD[0] * 1000, atol=1e-3)
    assert len(mesh.faces) == 2


def test_chosen_objects_only(data, tmp_path):
    for to in ("bop", "coco", "kitti2015"):
        export(data, tmp_path / to, to, objects=["card"])
    models = read_json(tmp_path / "bop/models/models_info.json")
    assert {model["name"] for model in models.values()} == {"card"}
    poses = read_json(tmp_path / "bop/train/000001/scene_gt.json")
    assert [len(entries) for entries in poses.values()] == [1, 1]
    annotations = read_json(tmp_path / "coco/annotations/instances.json")
    assert [row["name"] for row in annotations["categories"]] == ["card"]
    path = tmp_path / "kitti2015/Kitti2015/training/obj_map/000001_10.png"
    objects = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    assert_array_equal(objects, np.where(data[1].truth0.object_id == 2, 2, 0))


@pytest.mark.parametrize(
    ("names", "categories"),
    [
        (["nut", "nut-2"], ["nut"]),
        (["nut[0]", "nut[12]"], ["nut"]),
        (["nut", "nut-2[3]"], ["nut", "nut-2"]),
        (["nut[0]", "nut-2[0]"], ["nut", "nut-2"]),
        (["bolt-10", "bolt-12"], ["bolt-10", "bolt-12"]),
        (["bolt-10[0]", "bolt-12[0]"], ["bolt-10", "bolt-12"]),
        (["bolt-10", "bolt-10-2"], ["bolt-10"]),
        (["part-1", "wall"], ["part-1", "wall"]),
    ],
)
def test_a_number_in_a_name_is_that_of_a_copy_only_beside_the_first(
    tmp_path, names, categories
):
    """The two objects of the sample under other names: in COCO, in BOP, and as the user chooses them."""
    truths = [replace(truth, object_names=tuple(names)) for truth in MADE.truths]
    data = [stored(tmp_path / "s", replace(MADE, truths=tuple(truths)))]
    export(data, tmp_path / "coco", "coco")
    table = read_json(tmp_path / "coco" / "annotations" / "instances.json")
    assert [row["name"] for row in table["categories"]] == categories
    export(data, tmp_path / "bop", "bop")
    models = read_json(tmp_path / "bop" / "models" / "models_info.json")
    assert {row["name"] for row in models.values()} == set(categories)
    for name in categories:
        folder = tmp_path / name
        export(data, folder, "coco", objects=[name])
        chosen = read_json(folder / "annotations" / "instances.json")
        assert [row["name"] for row in chosen["categories"]] == [name]


@pytest.mark.parametrize(
    ("to", "name", "message"),
    [
        ("bop", "cart", r"unknown object 'cart'; did you mean 'card'\? \(known: card, wall\)"),
        ("eth3d", "card", "eth3d has no masks of objects; layouts with masks: bop, coco, kitti2015"),
    ],
)  # fmt: skip
def test_objects_that_cannot_be_exported_are_refused(data, tmp_path, to, name, message):
    with pytest.raises(InputError, match=message):
        export(data, tmp_path / "none", to, objects=[name])
    assert not (tmp_path / "none").exists()


def test_objects_outside_of_all_images_are_not_offered(tmp_path):
    """Such as a lamp behind the camera; asked for by its name, it is exported as an empty category."""
    left = replace(MADE.truths[0], object_names=("wall", "card", "lamp"))
    lit = stored(tmp_path / "s", replace(MADE, truths=(left, MADE.truths[1])))
    with pytest.raises(InputError, match=r"'lump' \(known: card, wall\)"):
        export([lit], tmp_path / "none", "bop", objects=["lump"])
    export([lit], tmp_path / "out", "coco", objects=["lamp"])
    instances = read_json(tmp_path / "out/annotations/instances.json")
    assert instances["annotations"] == []


def test_kitti_holds_255_objects(tmp_path):
    names = (*(f"rest[{i}]" for i in range(255)), "card")
    left = replace(MADE.truths[0], object_names=names)
    many = stored(tmp_path / "s", replace(MADE, truths=(left, MADE.truths[1])))
    message = "s: has object 256, and this layout holds 255"
    with pytest.raises(InputError, match=message):
        export([many], tmp_path / "out", "kitti2015", objects=["card"])


def test_far_depths_get_a_coarser_unit(tmp_path):
    far = sample()
    far.truths[0].depth[0, 0] = 100.0
    export([stored(tmp_path / "s", far)], tmp_path / "out", "bop")
    scene = tmp_path / "out/train/000000"
    cameras = read_json(scene / "scene_camera.json")
    assert [cameras[i]["depth_scale"] for i in "01"] == [10.0, 0.1]
    assert cv2.imread(scene / "depth/000000.png", cv2.IMREAD_UNCHANGED)[0, 0] == 10_000


def test_bop_rejects_lens_distortion(tmp_path):
    bent = MADE.rig.cameras[0].replace(distortion=BrownConrady(k1=0.01))
    rig = Rig((bent, bent), MADE.rig.world_from_cams)
    distorted = stored(tmp_path / "s", replace(MADE, rig=rig))
    message = "s: view 0 has lens distortion, which BOP cannot hold"
    with pytest.raises(InputError, match=message):
        export([distorted], tmp_path / "out", "bop")
    assert export([distorted], tmp_path / "out", "coco")
