"""Samples of other rigs than a rectified pair: three and four cameras, unrectified cameras, wrong calibrations."""

import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import twinlens as tl
from tests.dataset import dataset_scene
from twinlens.camera import (
    ALIGNED,
    BrownConrady,
    Camera,
    Misalignment,
    Pinhole,
    layouts,
    misaligned,
)
from twinlens.dataset import Dataset, Sample, Shot, read_pfm, write_pfm, write_sample
from twinlens.dataset.verify import verify_sample
from twinlens.geometry import rigid

CAMERA = Camera(48, 36, 55.0, 55.0, 23.5, 17.5)
BENT = CAMERA.replace(distortion=BrownConrady(-0.1, 0.02), cx=22.0)


SCENE = tl.load_scene("cards")
POSE = SCENE.world_from_left
PAIR = layouts.line(CAMERA, 2, 0.1, POSE)
MIDDLE = POSE @ rigid(np.eye(3), [0.08, 0, 0])
RIGS = {
    "line": layouts.line(CAMERA, 3, 0.08, POSE),
    "grid": layouts.grid(CAMERA, 2, 2, 0.08, 0.08, POSE),
    "toed": layouts.toed_in([CAMERA, BENT], 0.16, 1.4, MIDDLE),
    "off": misaligned(PAIR, (ALIGNED, Misalignment(vertical_px=2.0, roll_deg=1.0))),
}
RECTIFIED = {"line": range(3), "grid": range(4), "toed": (), "off": range(2)}


def sample(rig):
    images = tuple(
        np.full((camera.height, camera.width, 3), 40 * i, np.uint8)
        for i, camera in enumerate(rig.cameras)
    )
    truths = tuple(tl.ground_truth(SCENE, rig.nominal, objects=False))
    return Sample(rig, (Shot(Pinhole(), images),), truths)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    for name, rig in RIGS.items():
        write_sample(folder / name, sample(rig))
    return Dataset(folder)


@pytest.mark.parametrize("name", RIGS)
def test_every_view_has_its_files_and_rectified_pairs_have_disparities(dataset, name):
    expected = {"sample.json"} | {f"disp{i}.pfm" for i in RECTIFIED[name]}
    for i in range(len(RIGS[name])):
        expected |= {f"im{i}.png", f"truth{i}.exr", f"mask{i}nocc.png"}
    expected |= {"calib.txt"} if RECTIFIED[name] else set()
    assert {path.name for path in dataset[name].folder.iterdir()} == expected


def test_samples_verify_and_read_back_to_the_same_rig(dataset):
    for stored in dataset:
        assert verify_sample(stored) == []
        rig = RIGS[stored.name].nominal
        assert stored.rig.cameras == rig.cameras
        assert_array_equal(stored.rig.world_from_cams, rig.world_from_cams)


def test_views_0_and_1_are_a_pair(dataset):
    pair = tl.ground_truth(SCENE, RIGS["line"].pair(0, 1), objects=False)
    for i, truth in enumerate(pair):
        stored = dataset["line"].truth(i)
        assert_array_equal(stored.visible, truth.visible)
        assert_array_equal(stored.disparity, truth.disparity)


def test_a_misaligned_sample_stores_its_calibrated_rig(dataset):
    stored, rig = dataset["off"], RIGS["off"]
    assert stored.rig.is_rectified()
    assert stored.calibration.doffs == 0
    photographed_by = stored.photographed_by
    assert photographed_by.cameras == rig.cameras
    assert_array_equal(photographed_by.world_from_cams, rig.world_from_cams)
    assert dataset["line"].photographed_by.calibrated is None


@pytest.mark.parametrize(
    ("name", "source", "target"),
    [("line", 0, 1), ("line", 2, 0), ("grid", 1, 3), ("toed", 1, 0)],
)
def test_correspondences_of_stored_views_equal_those_of_the_scene(
    dataset, name, source, target
):
    stored, rig = dataset[name], RIGS[name]
    ours = stored.correspondence(source, target)
    exact = tl.correspondence(SCENE, rig, source, target)
    assert_allclose(ours.pixels, exact.pixels, rtol=0, atol=1e-4)
    assert_allclose(ours.disparity, exact.disparity, rtol=0, atol=1e-4)
    assert_allclose(ours.target_disparity, exact.target_disparity, rtol=0, atol=1e-4)
    assert_array_equal(ours.scene_flow, exact.scene_flow)
    unlike = ours.visible != exact.visible
    assert not (unlike.any() and rig.partner(source) == target)
    assert unlike.mean() < 0.04
    ids = stored.truth(target).object_id
    assert all(beside_an_edge(ids, px) for px in exact.pixels[unlike])


def beside_an_edge(ids, pixel):
    """Whether the nine pixels around one show more than one object."""
    u, v = np.floor(pixel + 0.5).astype(int)
    return len(np.unique(ids[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2])) > 1


def test_damage_is_reported(dataset, tmp_path):
    toed, grid = (
        shutil.copytree(dataset[name].folder, tmp_path / name)
        for name in ("toed", "grid")
    )
    write_pfm(toed / "disp0.pfm", np.ones((36, 48), np.float32))
    write_pfm(grid / "disp3.pfm", read_pfm(grid / "disp3.pfm") + 0.01)
    with dataset_scene.edited(grid) as record:
        record["rig"]["world_from_cams"][2][0][3] += 0.01
    (grid / "calib.txt").unlink()
    (finding,) = verify_sample(Dataset(toed)[0])
    assert finding.startswith("disp0.pfm: is a disparity map, but the view is not")
    findings = str(verify_sample(Dataset(grid)[0]))
    for part in ("disp3.pfm: ", "truth2.exr: ", "calib.txt: is missing"):
        assert part in findings
