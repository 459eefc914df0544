"""Samples of other rigs than a rectified pair: three and four cameras, unrectified cameras, wrong calibrations."""

import shutil

import numpy as np
import pytest

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


def rigs():
    pose = tl.load_scene("cards").world_from_left
    middle = pose @ rigid(np.eye(3), [0.08, 0, 0])
    pair = layouts.line(CAMERA, 2, 0.1, pose)
    return {
        "line": layouts.line(CAMERA, 3, 0.08, pose),
        "grid": layouts.grid(CAMERA, 2, 2, 0.08, 0.08, pose),
        "toed": layouts.toed_in([CAMERA, BENT], 0.16, 1.4, middle),
        "off": misaligned(pair, (ALIGNED, Misalignment(vertical_px=2.0, roll_deg=1.0))),
    }


def sample(rig):
    scene = tl.load_scene("cards")
    truths = tuple(tl.ground_truth(scene, rig.nominal))
    images = tuple(
        np.full((c.height, c.width, 3), 40 * i, np.uint8)
        for i, c in enumerate(rig.cameras)
    )
    return Sample(rig, (Shot(Pinhole(), images),), truths)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("views")
    for name, rig in rigs().items():
        write_sample(folder / name, sample(rig))
    return Dataset(folder)


def test_every_view_has_its_files_and_only_rectified_pairs_have_disparities(dataset):
    rectified = {"line": range(3), "grid": range(4), "toed": (), "off": range(2)}
    for name, rig in rigs().items():
        expected = {"sample.json"}
        for kind in ("im{}.png", "truth{}.exr", "mask{}nocc.png"):
            expected |= {kind.format(i) for i in range(len(rig))}
        expected |= {f"disp{i}.pfm" for i in rectified[name]}
        expected |= {"calib.txt"} if rectified[name] else set()
        assert {path.name for path in dataset[name].folder.iterdir()} == expected


def test_samples_verify_and_read_back_to_the_same_rig(dataset):
    for stored in dataset:
        assert verify_sample(stored) == []
        rig = rigs()[stored.name].nominal
        assert stored.rig.cameras == rig.cameras
        assert all(
            np.array_equal(a, b)
            for a, b in zip(
                stored.rig.world_from_cams, rig.world_from_cams, strict=True
            )
        )


def test_views_0_and_1_are_a_pair(dataset):
    two, three = (sample(rig) for rig in (rigs()["line"].pair(0, 1), rigs()["line"]))
    for i in (0, 1):
        assert np.array_equal(two.truths[i].visible, three.truths[i].visible)
        assert np.array_equal(dataset["line"].disparity(i), two.truths[i].disparity)


def test_a_misaligned_sample_stores_its_calibrated_rig(dataset):
    stored, rig = dataset["off"], rigs()["off"]
    assert stored.rig.is_rectified()
    assert stored.calibration.doffs == 0
    assert stored.photographed_by.cameras == rig.cameras
    assert np.array_equal(
        stored.photographed_by.world_from_cams[1], rig.world_from_cams[1]
    )
    assert dataset["line"].photographed_by.calibrated is None


def test_correspondences_of_stored_views_equal_those_of_the_scene(dataset):
    scene = tl.load_scene("cards")
    for stored in dataset:
        rig = stored.rig
        for source in range(len(rig)):
            for target in set(range(len(rig))) - {source}:
                ours, exact = (
                    stored.correspondence(source, target),
                    tl.correspondence(scene, rig, source, target),
                )
                known = np.isfinite(exact.pixels)
                assert np.array_equal(known, np.isfinite(ours.pixels))
                assert np.abs(ours.pixels[known] - exact.pixels[known]).max() < 1e-4
                far = np.isfinite(exact.disparity)
                assert np.array_equal(far, np.isfinite(ours.disparity))
                assert (
                    np.abs(ours.disparity[far] - exact.disparity[far]).max(initial=0)
                    < 1e-4
                )
                unlike = ours.visible != exact.visible
                assert not (unlike.any() and rig.partner(source) == target)
                assert unlike.mean() < 0.04
                assert all(
                    beside_an_edge(stored.truth(target).object_id, px)
                    for px in exact.pixels[unlike]
                )


def beside_an_edge(ids, pixel):
    """Whether the nine pixels around one show more than one object."""
    u, v = np.floor(pixel + 0.5).astype(int)
    return len(np.unique(ids[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2])) > 1


def spoil_disparity(folder):
    write_pfm(folder / "disp0.pfm", np.ones((36, 48), np.float32))


def shift_disparity(folder):
    write_pfm(folder / "disp3.pfm", read_pfm(folder / "disp3.pfm") + 0.01)


def remove_calibration(folder):
    (folder / "calib.txt").unlink()


def move_camera(folder):
    with dataset_scene.edited(folder) as record:
        record["rig"]["world_from_cams"][2][0][3] += 0.01


def test_damage_is_reported(dataset, tmp_path):
    for rig, change, text in (
        ("toed", spoil_disparity, "disp0.pfm: is a disparity map, but the view is not"),
        ("grid", shift_disparity, "disp3.pfm: "),
        ("line", remove_calibration, "calib.txt: is missing"),
        ("grid", move_camera, "truth2.exr: "),
    ):
        folder = tmp_path / change.__name__
        shutil.copytree(dataset[rig].folder, folder)
        change(folder)
        findings = verify_sample(Dataset(folder)[0])
        assert any(line.startswith(text) for line in findings), findings
