"""COCO and BOP exports, read by pycocotools, by the rules of BOP's docs/bop_datasets_format.md, and by bop_toolkit.

BOP's toolkit is not in the package registry: its test runs where https://github.com/thodan/bop_toolkit is installed.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.dataset import dataset_scene
from twinlens import geometry
from twinlens.camera import BrownConrady
from twinlens.camera.masks import decode_mask, encode_mask
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.export import export
from twinlens.dataset.sample import Sample
from twinlens.errors import FileError, InputError

CARD = (
    np.array([[0.0, 0, 0], [0.8, 0, 0], [0.8, 0.55, 0], [0, 0.55, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i in range(2):
        sample = dataset_scene.sample(baseline=0.3 + 0.1 * i)
        models = {"fedcba9876543210": CARD} if i else {}
        write_sample(
            folder / f"s{i}",
            Sample(
                sample.rig, sample.shots, sample.truths, None, sample.record, models
            ),
        )
    return Dataset(folder)


@pytest.fixture
def bop(data, tmp_path):
    export(data, tmp_path / "out", "bop")
    return tmp_path / "out"


def read_json(path):
    return json.loads(path.read_text())


def test_objects_read_back_exactly(data):
    sample = dataset_scene.sample(baseline=0.4)
    for i in (0, 1):
        stored = data[1].truth(i)
        for back, given in zip(stored.objects, sample.truths[i].objects, strict=True):
            for name in (
                "object_id",
                "model",
                "silhouette",
                "pixel_count",
                "box",
                "visible_pixel_count",
                "visible_box",
            ):
                assert getattr(back, name) == getattr(given, name)
            for name in ("cam_from_object", "extent", "corners_px"):
                np.testing.assert_array_equal(getattr(back, name), getattr(given, name))
        np.testing.assert_array_equal(
            stored.silhouette(stored.objects[1]), stored.object_id == 2
        )
        assert (
            stored.silhouette(stored.objects[0]) & (stored.object_id == 2)
        ).sum() > 50


def test_samples_without_objects_are_read_and_not_exported(tmp_path):
    write_sample(tmp_path / "in" / "s", dataset_scene.sample())
    with dataset_scene.edited(tmp_path / "in" / "s") as record:
        del record["objects"]
    assert Dataset(tmp_path / "in")[0].truth0.objects == ()
    for to in ("bop", "coco"):
        with pytest.raises(InputError, match="s: has no poses of objects"):
            export(Dataset(tmp_path / "in"), tmp_path / "out", to)


def test_damaged_objects_are_errors_that_name_the_key(tmp_path):
    write_sample(tmp_path / "in" / "s", dataset_scene.sample())
    path = tmp_path / "in" / "s" / "sample.json"
    record = read_json(path)
    for key, value, message in (
        (
            "cam_from_object",
            [[1, 2]],
            r"objects\[0\]\[1\]: cam_from_object must be a finite 4x4 matrix",
        ),
        ("extent", ["a", 2], r"objects\[0\]\[1\]"),
        ("box", [1, 2, 3], r"objects\[0\]\[1\].*box must have the shape"),
        ("pixel_count", 0, r"objects\[0\]\[1\].*an object must have 1 or more pixels"),
        (
            "pixel_count",
            "many",
            r"objects\[0\]\[1\]\.pixel_count: must be a whole number",
        ),
    ):
        changed = json.loads(json.dumps(record))
        changed["objects"][0][1][key] = value
        path.write_text(json.dumps(changed))
        with pytest.raises(FileError, match=message):
            _ = Dataset(tmp_path / "in")[0].truth0


@pytest.mark.parametrize(
    "text", ["", "0", "~~~~", "0000000000", "\xe9", "o" * 2000, "o" * 1_000_000, "P"]
)
def test_codes_of_other_masks_are_rejected(text):
    with pytest.raises(InputError, match="does not have 9 x 7 pixels"):
        decode_mask(text, 7, 9)


def test_masks_are_coded_as_pycocotools_does():
    coco = pytest.importorskip("pycocotools.mask")
    rng = np.random.default_rng(3)
    for _ in range(200):
        height, width = rng.integers(1, 80, 2)
        mask = (
            np.kron(
                rng.random((height, width)) < rng.random() ** 3,
                np.ones(rng.integers(1, 20, 2)),
            )
            > 0
        )
        code = coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()
        assert encode_mask(mask) == code
        np.testing.assert_array_equal(decode_mask(code, *mask.shape), mask)


@pytest.mark.filterwarnings(
    "ignore:__array__ implementation:DeprecationWarning"
)  # of pycocotools 2.0.11
def test_pycocotools_reads_the_annotations(data, tmp_path):
    coco = pytest.importorskip("pycocotools.coco")
    export(data, tmp_path / "out", "coco")
    read = coco.COCO(tmp_path / "out" / "annotations" / "instances.json")
    assert [each["name"] for each in read.loadCats(read.getCatIds())] == [
        "wall",
        "card",
    ]
    assert len(read.getImgIds()) == 4
    for image in read.loadImgs(read.getImgIds()):
        sample, i = data[(image["id"] - 1) // 2], (image["id"] - 1) % 2
        np.testing.assert_array_equal(
            cv2.imread(tmp_path / "out/images" / image["file_name"])[..., ::-1],
            sample.image(i),
        )
        truth = sample.truth(i)
        found = read.loadAnns(read.getAnnIds(imgIds=image["id"]))
        assert [each["name"] for each in found] == ["wall", "card"]
        for each, thing in zip(found, truth.objects, strict=True):
            visible = read.annToMask(each) > 0
            np.testing.assert_array_equal(visible, truth.object_id == thing.object_id)
            assert each["area"] == visible.sum()
            assert tuple(each["bbox"]) == dataset_scene.box(visible)
            whole = (
                read.annToMask({**each, "segmentation": each["amodal_segmentation"]})
                > 0
            )
            np.testing.assert_array_equal(whole, truth.silhouette(thing))
            assert each["visible_fraction"] == visible.sum() / each["amodal_area"]
            np.testing.assert_array_equal(
                each["cam_from_object"], thing.cam_from_object
            )
    # A detector that finds the annotations has a precision of 1.
    evaluation = pytest.importorskip("pycocotools.cocoeval").COCOeval(
        read,
        read.loadRes(
            [
                {key: each[key] for key in ("image_id", "category_id", "segmentation")}
                | {"score": 1.0}
                for each in read.loadAnns(read.getAnnIds())
            ]
        ),
        "segm",
    )
    for step in (evaluation.evaluate, evaluation.accumulate, evaluation.summarize):
        step()
    assert evaluation.stats[0] == pytest.approx(1)


def test_coco_annotations(data, tmp_path):
    export(data, tmp_path / "out", "coco")
    content = read_json(tmp_path / "out" / "annotations" / "instances.json")
    assert [each["id"] for each in content["annotations"]] == [*range(1, 9)]
    for each in content["annotations"]:
        mask = decode_mask(
            each["segmentation"]["counts"], *each["segmentation"]["size"]
        )
        assert (mask.sum(), dataset_scene.box(mask)) == (
            each["area"],
            tuple(each["bbox"]),
        )
        assert each["area"] <= each["amodal_area"]
        assert len(each["corners_px"]) == 8


def bop_views(data, bop):
    """Of each view: its truth, and its entries in scene_camera, scene_gt and scene_gt_info."""
    for number, sample in enumerate(data):
        scene = bop / "train" / f"{number:06d}"
        files = [
            read_json(scene / f"scene_{name}.json")
            for name in ("camera", "gt", "gt_info")
        ]
        assert all(list(content) == ["0", "1"] for content in files)
        for i in (0, 1):
            entries = (content[str(i)] for content in files)
            yield scene, sample, i, *entries


def mask(scene, kind, i, k):
    path = scene / kind / f"{i:06d}_{k:06d}.png"
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0


def test_bop_cameras_and_depth(data, bop):
    for scene, sample, i, camera, _, _ in bop_views(data, bop):
        truth = sample.truth(i)
        path = scene / "depth" / f"{i:06d}.png"
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        np.testing.assert_array_equal(depth == 0, ~truth.hit)
        error = np.abs(depth * camera["depth_scale"] - truth.depth * 1000)[truth.hit]
        assert error.max() <= 0.5 * camera["depth_scale"] + 1e-3
        np.testing.assert_array_equal(
            np.ravel(sample.rig.cameras[i].K), camera["cam_K"]
        )
        pose = geometry.rigid(
            np.reshape(camera["cam_R_w2c"], (3, 3)),
            np.array(camera["cam_t_w2c"]) / 1000,
        )
        np.testing.assert_allclose(
            pose, geometry.inverse(sample.rig.world_from_cams[i]), atol=1e-12
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
    for scene, sample, i, _, _, infos in bop_views(data, bop):
        truth = sample.truth(i)
        for k, (info, instance) in enumerate(zip(infos, truth.objects, strict=True)):
            whole, visible = (
                mask(scene, kind, i, k) for kind in ("mask", "mask_visib")
            )
            np.testing.assert_array_equal(
                visible, truth.object_id == instance.object_id
            )
            assert info["px_count_all"] == whole.sum()
            assert info["px_count_visib"] == visible.sum()
            assert info["px_count_valid"] == (whole & truth.hit).sum()
            assert info["visib_fract"] == pytest.approx(visible.sum() / whole.sum())
            u, v, width, height = dataset_scene.box(whole)
            assert info["bbox_obj"] == [u, v, width - 1, height - 1]
        assert infos[1]["visib_fract"] == 1


def test_bop_models_are_meshes_in_millimetres(bop):
    trimesh = pytest.importorskip("trimesh")
    assert [path.name for path in (bop / "models").glob("*.ply")] == ["obj_000002.ply"]
    assert (
        (bop / "models/obj_000002.ply")
        .read_bytes()
        .startswith(b"ply\nformat ascii 1.0")
    )
    mesh = trimesh.load_mesh(bop / "models/obj_000002.ply", process=False)
    np.testing.assert_allclose(mesh.vertices, CARD[0] * 1000, atol=1e-3)
    assert len(mesh.faces) == 2


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the toolkit
def test_bop_toolkit_reads_the_export(data, bop):
    """Its loaders, and its own visible masks from the depth image and the depth of the whole object."""
    inout = pytest.importorskip("bop_toolkit_lib.inout")
    from bop_toolkit_lib import misc, visibility

    model = inout.load_ply(bop / "models/obj_000002.ply")
    facts = inout.load_json(bop / "models/models_info.json", keys_to_int=True)[2]
    assert misc.calc_pts_diameter(model["pts"]) == pytest.approx(facts["diameter"])
    for number in range(len(data)):
        scene = bop / "train" / f"{number:06d}"
        cameras, poses = (
            inout.load_scene_camera(scene / "scene_camera.json"),
            inout.load_scene_gt(scene / "scene_gt.json"),
        )
        infos = inout.load_json(scene / "scene_gt_info.json", keys_to_int=True)
        assert list(cameras) == list(poses) == list(infos) == [0, 1]
        for i, camera in cameras.items():
            depth = (
                inout.load_depth(scene / f"depth/{i:06d}.png") * camera["depth_scale"]
            )
            assert inout.load_im(scene / f"rgb/{i:06d}.png").shape == (*depth.shape, 3)
            card = poses[i][1]
            normal = card["cam_R_m2c"][:, 2]
            rays = (
                np.stack([*np.indices(depth.shape)[::-1], np.ones(depth.shape)], -1)
                @ np.linalg.inv(camera["cam_K"]).T
            )
            whole, visible = (
                inout.load_im(scene / f"{name}/{i:06d}_000001.png") > 0
                for name in ("mask", "mask_visib")
            )
            flat = np.where(
                whole, normal @ card["cam_t_m2c"].ravel() / (rays @ normal), 0.0
            )  # depth of the card's plane
            distances = (
                misc.depth_im_to_dist_im_fast(each, camera["cam_K"])
                for each in (depth, flat)
            )
            np.testing.assert_array_equal(
                visibility.estimate_visib_mask_gt(*distances, 1.0), visible
            )
            rows, columns = np.nonzero(visible)
            assert tuple(infos[i][1]["bbox_visib"]) == tuple(
                misc.calc_2d_bbox(columns, rows)
            )


def test_chosen_objects_only(data, tmp_path):
    for to in ("bop", "coco", "kitti2015"):
        export(data, tmp_path / to, to, objects=["card"])
    assert {
        each["name"]
        for each in read_json(tmp_path / "bop/models/models_info.json").values()
    } == {"card"}
    assert [
        len(poses)
        for poses in read_json(tmp_path / "bop/train/000001/scene_gt.json").values()
    ] == [1, 1]
    assert [
        each["name"]
        for each in read_json(tmp_path / "coco/annotations/instances.json")[
            "categories"
        ]
    ] == ["card"]
    objects = cv2.imread(
        tmp_path / "kitti2015/Kitti2015/training/obj_map/000001_10.png",
        cv2.IMREAD_UNCHANGED,
    )
    np.testing.assert_array_equal(
        objects, np.where(data[1].truth0.object_id == 2, 2, 0)
    )
    with pytest.raises(
        InputError,
        match=r"unknown object 'cart'; did you mean 'card'\? \(known: card, wall\)",
    ):
        export(data, tmp_path / "none", "bop", objects=["cart"])
    with pytest.raises(
        InputError,
        match="eth3d has no masks of objects; layouts with masks: bop, coco, kitti2015",
    ):
        export(data, tmp_path / "none", "eth3d", objects=["card"])
    assert not (tmp_path / "none").exists()


def test_kitti_holds_255_objects(tmp_path):
    sample = dataset_scene.sample()
    truth = replace(
        sample.truths[0], object_names=(*(f"rest[{i}]" for i in range(255)), "card")
    )
    write_sample(
        tmp_path / "in" / "s",
        Sample(sample.rig, sample.shots, (truth, sample.truths[1])),
    )
    export(Dataset(tmp_path / "in"), tmp_path / "rest", "kitti2015", objects=["rest"])
    with pytest.raises(
        InputError, match="s: has object 256, and this layout holds 255"
    ):
        export(
            Dataset(tmp_path / "in"), tmp_path / "out", "kitti2015", objects=["card"]
        )


def test_far_depths_get_a_coarser_unit(tmp_path):
    sample = dataset_scene.sample()
    sample.truths[0].depth[0, 0] = 100.0
    write_sample(tmp_path / "in" / "s", sample)
    export(Dataset(tmp_path / "in"), tmp_path / "out", "bop")
    scene = tmp_path / "out/train/000000"
    cameras = read_json(scene / "scene_camera.json")
    assert [cameras[i]["depth_scale"] for i in "01"] == [10.0, 0.1]
    assert cv2.imread(scene / "depth/000000.png", cv2.IMREAD_UNCHANGED)[0, 0] == 10_000


def test_bop_rejects_lens_distortion(tmp_path):
    sample = dataset_scene.sample()
    bent = sample.rig.cameras[0].replace(distortion=BrownConrady(k1=0.01))
    rig = type(sample.rig)((bent, bent), sample.rig.world_from_cams)
    write_sample(tmp_path / "in" / "s", Sample(rig, sample.shots, sample.truths))
    with pytest.raises(
        InputError, match="s: view 0 has lens distortion, which BOP cannot hold"
    ):
        export(Dataset(tmp_path / "in"), tmp_path / "out", "bop")
    assert export(Dataset(tmp_path / "in"), tmp_path / "out", "coco")
