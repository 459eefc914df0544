"""Samples of datasets, named methods, and the folder of maps."""

import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest

import twinlens
from twinlens.camera import Camera, Pinhole, Rig, ThinLens
from twinlens.camera.truth import MATERIAL_KINDS, Truth
from twinlens.dataset import Dataset, Sample, Shot, open_sample, write_sample
from twinlens.errors import FileError
from twinlens.matching import parse_method
from twinlens.scoring import (
    DatasetPairs,
    MapFolder,
    load_pair,
    motorcycle,
    open_submission,
    region_masks,
    run_benchmark,
)
from twinlens.scoring.benchmark import spec_of
from twinlens.scoring.samples import Pair
from twinlens.scoring.submission import file_name


def truth(disparity, depth):
    shape = disparity.shape
    vectors = np.zeros((*shape, 3), np.float32)
    ids = np.ones(shape, np.int32)
    kinds = np.full(shape, MATERIAL_KINDS.index("glossy"), np.uint8)
    position = np.zeros((*shape, 3))
    return Truth(
        depth,
        position,
        disparity,
        np.ones(shape, bool),
        vectors,
        vectors,
        ids,
        ids,
        kinds,
        ("wall",),
        ("m",),
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two samples of a wall 2 m away: one with one lens, one with three lenses, two of them equal."""
    rig = Rig.stereo(Camera(24, 16, 100.0, 100.0, 11.5, 7.5), baseline=0.1)
    image = np.random.default_rng(0).integers(0, 255, (16, 24, 3), np.uint8)
    views = [
        truth(np.full((16, 24), 5, np.float32), np.full((16, 24), 2.0))
        for _ in range(2)
    ]
    lenses = [Pinhole(), ThinLens(0.2, 1.0), ThinLens(0.2, 1.0)]
    folder = tmp_path_factory.mktemp("data")
    for name, count in (("one", 1), ("three", 3)):
        shots = tuple(
            Shot(lens, (image + np.uint8(k), image))
            for k, lens in enumerate(lenses[:count])
        )
        record = {"scene": "hall"} if name == "three" else {}
        write_sample(
            folder / name, Sample(rig, shots, tuple(views), ndisp=8, record=record)
        )
    return Dataset(folder)


def test_every_lens_of_a_sample_is_a_pair(dataset):
    pairs = DatasetPairs(dataset)
    names = (
        "one",
        "three · pinhole",
        "three · lens 200 mm at 1 m (1)",
        "three · lens 200 mm at 1 m (2)",
    )
    assert tuple(pairs.aliases) == tuple(p.name for p in pairs) == names
    assert len(pairs) == 4
    assert (pairs[3].im0 - pairs[1].im0 == 2).all()
    assert [p.name for p in pairs[1:2]] == ["three · pinhole"]
    assert [p.scene for p in pairs] == ["one", "hall", "hall", "hall"]


def test_a_pair_has_names_for_its_map(dataset, tmp_path):
    pairs = DatasetPairs(dataset)
    assert open_submission(tmp_path).missing_files(pairs.aliases) == [
        "one.pfm",
        "three/lens-0.pfm",
        "three/lens-1.pfm",
        "three/lens-2.pfm",
    ]
    assert pairs[0].aliases == ()
    assert pairs[1].aliases == ("three/lens-0", "three-lens-0", "three")
    assert pairs[3].aliases == ("three/lens-2", "three-lens-2")


def test_another_sample_of_that_name_comes_first(dataset):
    renamed = [replace(dataset[0], name="three-lens-1"), dataset[1]]
    assert DatasetPairs(renamed)[2].aliases == ("three/lens-1",)


def test_a_stored_pair_brings_calibration_blur_and_materials(dataset):
    pairs = DatasetPairs(dataset)
    assert pairs[0].calibration.baseline == pytest.approx(0.1)
    assert pairs[0].ndisp == 8
    masks = region_masks(pairs[2], ["out-of-focus", "glossy", "mirror"])
    # A wall at 2 m through a 200 mm lens focused at 1 m: 0.2 * 100 * |1/2 - 1| = 10 px of blur.
    assert masks["out-of-focus"].all()
    assert masks["glossy"].all()
    assert not masks["mirror"].any()
    assert not region_masks(pairs[1], ["out-of-focus"])["out-of-focus"].any()


def test_a_stored_sample_itself_can_be_benchmarked(dataset):
    class Five:
        name = "five"

        def match(self, left, right, *, num_disparities, min_disparity):
            return np.full(left.shape[:2], 5, np.float32)

    board = run_benchmark(dataset, [Five()], protocol=["middlebury-v3", "points"])
    assert board.samples == ("one", "three")
    for entry, name in zip(board.entries, ("avgerr", "point_avgerr") * 2, strict=True):
        assert entry.regions["all"][name] == 0


def test_the_real_pair_is_a_sample():
    real = load_pair(motorcycle())
    assert (real.name, real.ndisp, real.im0.shape) == ("motorcycle", 70, (500, 741, 3))
    assert list(region_masks(real, ["nonocc", "occluded", "out-of-focus"])) == [
        "nonocc",
        "occluded",
    ]


def test_methods_are_named_by_text_and_survive_pickling(monkeypatch):
    method = parse_method(" zncc:block_size=5 ")
    again = pickle.loads(pickle.dumps(method))
    assert again == method
    assert again.name == "zncc:block_size=5"
    assert spec_of(again) == spec_of(method)
    assert "block_size=5" in method.spec
    assert parse_method("zncc").spec != method.spec
    assert parse_method("sad:block_size=5").spec != method.spec
    before = method.spec
    monkeypatch.setattr(twinlens, "__version__", "9.9")
    assert method.spec != before


NAMES = [
    "sad",
    "zncc:block_size=21,lr_check=1",
    "../../etc/passwd",
    "a/b",
    "",
    "é",
    "x" * 300,
    "three · pinhole",
    "CON ",
]


def test_maps_round_trip_under_any_name(tmp_path):
    folder = MapFolder(tmp_path / "maps")
    for i, method in enumerate(NAMES):
        for sample in NAMES[:3]:
            folder.keep(method, sample, np.array([[i, np.inf]], np.float32))
    for i, method in enumerate(NAMES):
        assert folder.get((method, NAMES[2])).tolist() == [[i, np.inf]]
    assert folder.get(("none", "none")) is None
    assert all(p.is_relative_to(tmp_path / "maps") for p in tmp_path.rglob("*.pfm"))
    assert len(list(tmp_path.rglob("*.pfm"))) == 3 * len(NAMES)


def test_plain_names_stay_themselves():
    assert [file_name(n) for n in ("sad-9", "SGBM_HH", "census.5=x")] == [
        "sad-9",
        "SGBM_HH",
        "census.5=x",
    ]


def test_a_damaged_map_is_named(tmp_path):
    folder = MapFolder(tmp_path)
    folder.keep("m", "s", np.ones((2, 2), np.float32))
    folder.path("m", "s").write_bytes(b"Pf\n9 9\n-1\n")
    with pytest.raises(FileError, match=r"m\.pfm"):
        folder.get(("m", "s"))


@pytest.mark.parametrize(
    ("disparities", "ndisp", "low", "says"),
    [
        ([20.0, 35.5], 16, 0, "20 to 35.5 px, are beyond the search of 0 to 15"),
        ([-9.0, -4.0], 64, 0, "-9 to -4 px, are beyond the search of 0 to 63"),
        ([3.0, 4.0], 32, 8, "3 to 4 px, are beyond the search of 8 to 39"),
        ([20.0, 10.0], 16, 0, None),
        ([np.inf, np.inf], 16, 0, None),
    ],
)
def test_a_search_without_any_true_disparity_is_said(disparities, ndisp, low, says):
    image = np.zeros((1, 2), np.uint8)
    truth = np.array([disparities], np.float32)

    shelf = Pair("shelf", image, image, truth, None, ndisp, min_disparity=low)
    if says is None:
        shelf.warn_of_search()
        return
    with pytest.warns(UserWarning, match=f"'shelf': all true disparities, {says}"):
        shelf.warn_of_search()


@pytest.mark.parametrize("kept", ["truth0.exr", "disp1.pfm", "mask0nocc.png"])
def test_a_sample_that_lost_its_disparity_is_an_error_and_no_pair_without_truth(
    dataset, tmp_path, kept
):
    shutil.copytree(dataset.path / "one", tmp_path / "one")
    files = [*tmp_path.glob("one/disp*"), *tmp_path.glob("one/mask*")]
    files += tmp_path.glob("one/truth*")
    assert kept in {file.name for file in files}
    for file in files:
        if file.name != kept:
            file.unlink()
    with pytest.raises(FileError, match=r"disp0\.pfm: no such file"):
        load_pair(open_sample(tmp_path / "one"))
    (tmp_path / "one" / kept).unlink()
    assert load_pair(open_sample(tmp_path / "one")).disp0 is None
