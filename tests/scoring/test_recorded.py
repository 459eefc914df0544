"""Lens labels and recorded values of stored samples, also of records that are damaged or of other makers."""

import json

import numpy as np
import pytest

from twinlens.camera import Camera, Pinhole, Rig, ThinLens
from twinlens.dataset import Dataset, Sample, Shot, write_sample
from twinlens.dataset.lens_labels import label_of_table
from twinlens.errors import InputError
from twinlens.scoring import Board, DatasetPairs, Entry
from twinlens.scoring.grouping import MAX_GROUPS
from twinlens.scoring.recorded import recorded_values
from twinlens.scoring.samples import Pair

DRAWN = {
    "rig": {"baseline": 0.07, "misalignment": [{"yaw_deg": 0.1}]},
    "denoise": True,
    "scene": {"objects": {"part": {"cells": [0.5] * 20}}},
    "lenses": [{"kind": "thin", "f_number": 1.4}, {"kind": "thin", "f_number": 4}],
}


def sample_of(folder, record, shots=({}, {})):
    """A sample of two lenses with these records."""
    rig = Rig.stereo(Camera(6, 4, 10.0, 10.0, 2.5, 1.5), baseline=0.07)
    images = (np.zeros((4, 6, 3), np.uint8),) * 2
    lenses = ThinLens(5e-3, 1.5), ThinLens(1.7e-3, 1.5)
    taken = [
        Shot(lens, images, record=shot)
        for lens, shot in zip(lenses, shots, strict=True)
    ]
    write_sample(folder / "s", Sample(rig, tuple(taken), record=record))
    return Dataset(folder)[0]


def labels(sample):
    return [sample.lens(k).label for k in range(sample.num_lenses)]


@pytest.mark.parametrize(
    ("record", "shots", "expected"),
    [
        ({}, ({"label": "f/1.4"}, {"label": "f/4@2"}), ["f/1.4", "f/4@2"]),
        ({"spec": {"drawn": DRAWN}}, ({}, {}), ["f/1.4", "f/4"]),
        ({}, ({}, {}), ["lens 5 mm at 1.5 m", "lens 1.7 mm at 1.5 m"]),
        (
            {"spec": {"drawn": {"lenses": "thin"}}},
            ({"label": 3}, {"label": "a\nb"}),
            ["lens 5 mm at 1.5 m", "lens 1.7 mm at 1.5 m"],
        ),
        (
            {"spec": [1]},
            ({}, {"label": ""}),
            ["lens 5 mm at 1.5 m", "lens 1.7 mm at 1.5 m"],
        ),
    ],
    ids=["recorded", "recipe", "neither", "damaged", "damaged spec"],
)
def test_labels_are_as_the_maker_wrote_them(tmp_path, record, shots, expected):
    assert labels(sample_of(tmp_path, record, shots)) == expected


@pytest.mark.parametrize(
    ("table", "label"),
    [
        ({"kind": "pinhole"}, "pinhole"),
        ({"kind": "thin", "f_number": 2.8, "focus": "near"}, "f/2.8@near"),
        ({"kind": "thin", "aperture_mm": 5.123456, "focus": 1.5}, "thin:5.123@1.5"),
        ({"kind": "hole", "aperture_mm": 0.3, "film_mm": 50}, "hole:0.3@50"),
        (
            {
                "kind": "thin",
                "f_number": 2,
                "shape": {"kind": "mask", "file": "a/b.png"},
            },
            "f/2 mask:a/b.png",
        ),
    ],
)
def test_lenses_are_written_as_on_the_command_line(table, label):
    assert label_of_table(table) == label


def test_drawn_values_have_the_names_of_the_recipe(tmp_path):
    spec = {"kind": "family", "scene": "room", "split": "test", "drawn": DRAWN}
    sample = sample_of(tmp_path, {"spec": spec})
    values = recorded_values(sample, 1)
    assert values == {
        "lens": "f/4",
        "lens_number": 1.0,
        "family": "room",
        "split": "test",
        "baseline": 0.07,
        "rig.baseline": 0.07,
        "rig.misalignment[0].yaw_deg": 0.1,
        "denoise": "true",
        "lens.kind": "thin",
        "lens.f_number": 4.0,
    }


def test_damaged_records_have_no_values(tmp_path):
    sample = sample_of(tmp_path, {"spec": {"drawn": [1]}, "sensor": 7, "scene": 3})
    file = sample.folder / "sample.json"
    table = json.loads(file.read_text())
    table["record"], table["pair"] = [], "none"
    table["shots"][0]["record"] = {"exposures": {}}
    file.write_text(json.dumps(table))
    assert recorded_values(sample) == {
        "lens": "lens 5 mm at 1.5 m",
        "lens_number": 0.0,
    }


def test_pairs_of_several_datasets_record_which(tmp_path):
    image = np.zeros((4, 6, 3), np.uint8)
    pair = Pair("a", image, image, np.ones((4, 6), np.float32), None, 4)
    pairs = DatasetPairs([pair], [pair], labels=["fast", "slow"])
    assert [pair.recorded["dataset"] for pair in pairs] == ["fast", "slow"]
    pairs.check_groups("dataset")
    with pytest.raises(InputError, match="one group"):
        DatasetPairs([pair], labels=["fast"]).check_groups("scene")


def pair_of(name, **options):
    image = np.zeros((4, 6, 3), np.uint8)
    return Pair(name, image, image, np.ones((4, 6), np.float32), None, 4, **options)


def test_recorded_numbers_of_any_type_are_floats():
    recorded = {
        "int": 1,
        "float32": np.float32(0.5),
        "int64": np.int64(3),
        "flag": True,
        "numpy_flag": np.bool_(False),
        "text": "a",
    }
    pair = pair_of("a", recorded=recorded)
    assert pair.recorded == {
        "int": 1.0,
        "float32": 0.5,
        "int64": 3.0,
        "flag": "true",
        "numpy_flag": "false",
        "text": "a",
    }
    numbers = [pair.recorded[name] for name in ("int", "float32", "int64")]
    assert {type(number) for number in numbers} == {float}


def test_scenes_are_those_of_the_board_before_anything_is_run():
    """Samples of one name in two datasets are two scenes, as on the board."""
    pairs = DatasetPairs([pair_of("a")], [pair_of("a")], labels=["x", "y"])
    assert [pair.scene for pair in pairs] == ["x/a", "y/a"]
    pairs.check_groups("scene")


def test_samples_that_the_board_has_count_in_its_groups():
    first = pair_of("a", recorded={"level": 1})
    names = ["a", *(f"b{k}" for k in range(MAX_GROUPS))]
    entries = [
        Entry("m", "m", name, "", "middlebury-v3", 6, 4, 4, None, None)
        for name in names
    ]
    board = Board(entries=tuple(entries), recorded={"a": {"level": 1.0}})
    pairs = DatasetPairs([first])
    with pytest.raises(InputError, match="one group"):
        pairs.check_groups("level")
    pairs.check_groups("level", board)  # the others have no value
    two = DatasetPairs([first, pair_of("c")])
    two.check_groups("scene")
    with pytest.raises(InputError, match=f"makes {MAX_GROUPS + 2} groups"):
        two.check_groups("scene", board)


def test_a_pinhole_is_called_so(tmp_path):
    rig = Rig.stereo(Camera(6, 4, 10.0, 10.0, 2.5, 1.5), baseline=0.07)
    shot = Shot(Pinhole(), (np.zeros((4, 6, 3), np.uint8),) * 2)
    write_sample(tmp_path / "s", Sample(rig, (shot,)))
    assert Dataset(tmp_path)[0].lens(0).label == "pinhole"
