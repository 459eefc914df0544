"""Crops, stereo flips and batches, against the closed-form scene seen by other cameras."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.dataset import dataset_scene
from twinlens.camera import Rig
from twinlens.dataset import Dataset, collate, crop, stereo_flip, write_sample
from twinlens.errors import InputError

PAIR = dataset_scene.rig()
W, H = PAIR.cameras[0].width, PAIR.cameras[0].height
IMAGES = (
    "depth",
    "position",
    "normal",
    "shading_normal",
    "visible",
    "object_id",
    "material_id",
    "material_kind",
)


def quantities(rig, images=None):
    """What a stored sample of the scene has, in float64, with images of random values."""
    images = images or dataset_scene.images(rig, seed=1)
    sample = {"name": "s", "baseline": rig.baseline(), "doffs": rig.doffs()}
    sample["ndisp"] = 20
    for i, truth in enumerate(dataset_scene.truths(rig)):
        sample |= {
            f"im{i}": images[i],
            f"disp{i}": truth.disparity,
            f"mask{i}_nonocc": truth.mask_nonocc(),
            f"K{i}": rig.cameras[i].K,
            f"world_from_cam{i}": rig.world_from_cams[i],
        }
        sample |= {f"{name}{i}": getattr(truth, name) for name in IMAGES}
    return sample


SAMPLE = quantities(PAIR)


def assert_same(actual, expected):
    assert set(actual) == set(expected)
    for name, value in expected.items():
        if name != "name":
            assert_allclose(actual[name], value, rtol=1e-6, atol=1e-5, err_msg=name)


def window_of(rig, x, y, width, height):
    cameras = [
        c.replace(width=width, height=height, cx=c.cx - x, cy=c.cy - y)
        for c in rig.cameras
    ]
    return Rig(cameras, rig.world_from_cams)


@pytest.mark.parametrize(
    "window",
    [
        (0, 0, W, H),
        (0, 0, 20, 10),
        (W - 30, H - 25, 30, 25),
        (13, 7, 40, 33),
        (50, 20, 1, 1),
    ],
)
def test_a_crop_is_the_scene_seen_by_the_smaller_cameras(window):
    x, y, width, height = window
    images = [SAMPLE[f"im{i}"][y : y + height, x : x + width] for i in (0, 1)]
    expected = quantities(window_of(PAIR, *window), images)
    assert_same(crop(SAMPLE, *window), expected)


def test_a_stereo_flip_is_the_pair_of_the_mirrored_scene(monkeypatch):
    """The scene of `dataset_scene`, in the frame of its left camera, as the mirrored right camera sees it."""
    flipped = stereo_flip(SAMPLE)
    baseline = PAIR.baseline()
    cameras = [c.replace(cx=W - 1 - c.cx) for c in reversed(PAIR.cameras)]
    rig = Rig(cameras, [flipped["world_from_cam0"], flipped["world_from_cam1"]])
    assert rig.is_rectified()
    assert rig.baseline() == pytest.approx(baseline)
    wall = dataset_scene.WALL / (1 - dataset_scene.WALL[0] * baseline)
    (left, right), rows, z = dataset_scene.CARD
    monkeypatch.setattr(dataset_scene, "WALL", wall * [-1, 1, 1])
    monkeypatch.setattr(
        dataset_scene, "CARD", ((baseline - right, baseline - left), rows, z)
    )
    expected = quantities(rig, [SAMPLE["im1"][:, ::-1], SAMPLE["im0"][:, ::-1]])
    normals = [name for name in SAMPLE if "normal" in name]
    for name in normals:  # `dataset_scene` has -z of the camera for all
        assert_allclose(flipped[name], expected[name], atol=1e-6)
    assert_same(flipped, expected)


def test_two_flips_restore_the_sample():
    assert_same(stereo_flip(stereo_flip(SAMPLE)), SAMPLE)


def test_a_crop_of_the_flip_is_the_flip_of_the_mirrored_crop():
    assert_same(
        crop(stereo_flip(SAMPLE), 10, 5, 30, 20),
        stereo_flip(crop(SAMPLE, W - 40, 5, 30, 20)),
    )


@pytest.mark.parametrize("window", [(3, 2, 20, 10), (3, 2, 1, 10), (3, 2, 1, 1)])
def test_arrays_are_contiguous_copies(window):
    before = {name: np.copy(value) for name, value in SAMPLE.items()}
    sample = stereo_flip(crop(SAMPLE, *window))
    for name, value in sample.items():
        if isinstance(value, np.ndarray):
            assert value.flags.c_contiguous, name
            assert min(value.strides) > 0, name
            assert value.dtype == SAMPLE[name].dtype, name
            value[...] = 0
    for name, value in before.items():
        assert_array_equal(SAMPLE[name], value)


def test_images_of_other_lenses_are_exchanged():
    sample = {
        "lens10.im0": np.zeros((2, 3)),
        "lens10.im1": np.arange(6.0).reshape(2, 3),
    }
    assert stereo_flip(sample)["lens10.im0"].tolist() == [[2, 1, 0], [5, 4, 3]]
    assert crop(sample, 1, 0, 2, 1)["lens10.im1"].tolist() == [[1, 2]]


@pytest.mark.parametrize(
    ("change", "names", "message"),
    [
        (lambda s: crop(s, W - 9, 0, 10, 4), ["im0"], rf"crop of 10 x 4 pixels at \({W - 9}, 0\) is not inside im0"),
        (lambda s: crop(s, -1, 0, 10, 4), ["im0"], r"not inside im0 of 64 x 48 pixels"),
        (lambda s: crop(s, 0, 0, 0, 4), ["im0"], "not inside"),
        (lambda s: crop(s, 0, 0, 8, 4), ["mask1_nonocc", "disp0"], "mask1_nonocc needs disp1"),
        (lambda s: crop(s, 0, 0, 8, 4), ["visible0"], "visible0 needs disp0"),
        (stereo_flip, ["im0", "im1", "disp0"], "flip of disp0 needs disp1"),
        (stereo_flip, ["K0", "K1"], "flip of K1 needs the width of its view; select im1"),
        (lambda s: crop({"im2": s["im0"]}, 0, 0, 8, 4), ["im0"], "views 0 and 1, not of im2"),
    ],
)  # fmt: skip
def test_what_cannot_be_exact_is_rejected(change, names, message):
    sample = {name: SAMPLE[name] for name in names}
    with pytest.raises(InputError, match=message):
        change(sample)


def test_a_batch_stacks_arrays_and_keeps_their_types():
    samples = [{**SAMPLE, "name": str(k), "known": True} for k in range(3)]
    batch = collate(iter(samples))
    assert batch["name"] == ["0", "1", "2"]
    assert batch["im0"].shape == (3, H, W, 3)
    for name, value in SAMPLE.items():
        if isinstance(value, np.ndarray):
            assert batch[name].dtype == value.dtype
            assert_array_equal(batch[name][2], value)
    assert batch["ndisp"].tolist() == [20, 20, 20]
    assert (batch["baseline"].dtype, batch["known"].dtype) == (np.float64, np.bool_)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (
            {"im0": SAMPLE["im0"][1:], "name": "b"},
            r"im0 is uint8 \(48, 64, 3\) in sample 'a' and uint8 \(47, 64, 3\) in sample 'b'",
        ),
        ({"im0": SAMPLE["im0"], "name": "b", "disp0": 1.0}, "only one has disp0"),
    ],
)
def test_a_batch_of_different_samples_is_an_error(other, message):
    with pytest.raises(InputError, match=message):
        collate([{"im0": SAMPLE["im0"], "name": "a"}, other])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for i in range(5):
        write_sample(folder / f"s{i}", dataset_scene.sample())
    return folder


def test_indices_names_and_masks_choose_samples(folder):
    data = Dataset(folder)
    mapped = data.select("name").map(lambda quantities: quantities["name"])
    for chosen, names in (
        ([3, -1, 3], ["s3", "s4", "s3"]),
        (np.array([4, 0]), ["s4", "s0"]),
        (["s2", "s1"], ["s2", "s1"]),
        (np.array([True, False, False, True, False]), ["s0", "s3"]),
        ([], []),
        (slice(3, None), ["s3", "s4"]),
    ):
        assert list(data[chosen].names) == names
        assert list(mapped[chosen]) == names
    assert data[np.int64(2)].name == mapped[np.int64(2)] == mapped["s2"] == "s2"
    for wrong, message in (
        ([5], "has 5 samples"),
        ([True, False], "has 5 samples"),
        (1.5, "a slice or a 1-D array"),
        (np.zeros((2, 2), int), "a slice or a 1-D array"),
        (["s1", "s11"], "did you mean 's1'"),
    ):
        with pytest.raises(InputError, match=message):
            data[wrong]


def test_stored_samples_are_cropped_and_stacked(folder):
    data = Dataset(folder)
    batch = collate(data.map(lambda sample: crop(sample, 3, 4, 32, 24))[1:4])
    assert batch["name"] == ["s1", "s2", "s3"]
    assert_array_equal(batch["disp0"][0], data[1].disp0[4:28, 3:35])
    assert collate(data[:2])["im1"].shape == (2, 48, 64, 3)


def test_arrays_of_projectors_are_cropped_and_flipped_along_the_image():
    rng = np.random.default_rng(2)
    sample = {
        "projector_pixels0": rng.random((3, H, W, 2)),
        "lit0": rng.random((3, H, W)) < 0.5,
        "lit1": rng.random((3, H, W)) < 0.5,
    }
    window = crop(sample, 5, 2, 20, 10)
    for name in ("projector_pixels0", "lit0"):
        assert_array_equal(window[name], sample[name][:, 2:12, 5:25])
    flipped = stereo_flip({name: sample[name] for name in ("lit0", "lit1")})
    assert_array_equal(flipped["lit0"], sample["lit1"][..., ::-1])
    pixels = sample["projector_pixels0"]
    with pytest.raises(InputError, match="a flip cannot mirror projector_pixels"):
        stereo_flip(dict.fromkeys(("projector_pixels0", "projector_pixels1"), pixels))
