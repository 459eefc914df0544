"""Conditions on recorded values choose the samples of which they are true."""

import json

import pytest

from tests.dataset.dataset_scene import list_samples, sample
from twinlens.dataset import Dataset, write_sample
from twinlens.errors import InputError
from twinlens.scoring.conditions import (
    Condition,
    chosen,
    parse_condition,
    sample_values,
)

VALUES = {"f": 1.4, "lens": "f/1.4", "night": "true", "code": "007"}


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("f < 2", True),
        ("f<1.4", False),
        ("f<=1.4", True),
        ("f >= 1.5", False),
        ("f>1e0", True),
        ("f = 1.40", True),
        ("f == 1.4", True),
        ("f != 1.4", False),
        ("lens = f/1.4", True),
        ("lens != f/2", True),
        ("night = true", True),
        ("code = 007", True),
        ("code = 7", False),
        ("absent < 3", False),
        ("absent != 3", False),
    ],
)
def test_a_condition_holds(text, holds):
    assert parse_condition(text).holds(VALUES) is holds


def test_a_value_may_have_signs_of_its_own():
    condition = parse_condition("lens = fisheye:bend=0.5")
    assert condition == Condition("lens", "=", "fisheye:bend=0.5")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f", "a condition is NAME"),
        ("< 3", "a condition is NAME"),
        ("f <", "a condition is NAME"),
        ("f ~ 3", "a condition is NAME"),
        ("lens < f/2", "needs a number, got 'f/2'"),
        ("f < nan", "needs a number, got 'nan'"),
    ],
)
def test_what_is_no_condition_is_named(text, message):
    with pytest.raises(InputError, match=message):
        parse_condition(text)


def test_texts_have_no_order():
    with pytest.raises(InputError, match=r"lens is a text, such as 'f/1\.4'"):
        parse_condition("lens < 2").holds(VALUES)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three samples of two lenses; the f-number of the second lens is 1, 2, 3, and the largest disparity 10, 20, 30."""
    home = tmp_path_factory.mktemp("recorded")
    names = [f"s{number}" for number in (1, 2, 3)]
    for number, name in enumerate(names, start=1):
        write_sample(home / name, sample(num_lenses=2))
        path = home / name / "sample.json"
        record = json.loads(path.read_text())
        lenses = [{"kind": "pinhole"}, {"kind": "thin", "f_number": float(number)}]
        record["record"]["spec"] = {"drawn": {"lenses": lenses}, "split": "old"}
        record["record"]["scene"] = f"scene {number}"
        record["statistics"]["disparity"][-1] = 10.0 * number
        path.write_text(json.dumps(record))
    list_samples(home, *names)
    return Dataset(home)


@pytest.mark.parametrize(
    ("texts", "numbers"),
    [
        (["lens.f_number < 2.5"], [0, 1]),
        (["lens.f_number >= 2", "lens.f_number < 3"], [1]),
        (["lens.kind = pinhole"], [0, 1, 2]),
        (["lens.kind = pinhole", "lens.f_number < 9"], []),
        (["scene = scene 3"], [2]),
        (["disparity_max > 10"], [1, 2]),
        (["width = 64", "split = old"], [0, 1, 2]),
    ],
)
def test_samples_are_chosen_by_one_of_their_lenses(data, texts, numbers):
    assert chosen([data], [parse_condition(text) for text in texts]) == [numbers]


def test_an_unknown_name_offers_the_nearest(data):
    with pytest.raises(InputError, match=r"did you mean 'lens.f_number'"):
        chosen([data], [parse_condition("lens.fnumber < 2")])


def test_a_name_that_one_of_the_datasets_has_is_known(data, tmp_path):
    write_sample(tmp_path / "plain/x", sample())
    other = Dataset(tmp_path / "plain")
    conditions = [parse_condition("lens.f_number > 1")]
    assert chosen([other, data], conditions) == [[], [1, 2]]
    with pytest.raises(InputError, match="unknown recorded value"):
        chosen([other], conditions)


def test_values_of_a_plain_folder_are_none(tmp_path):
    write_sample(tmp_path / "x", sample())
    (tmp_path / "x/sample.json").unlink()
    assert sample_values(Dataset(tmp_path)[0]) == {}


def test_the_split_is_that_of_the_dataset(data):
    changed = data[0]
    assert sample_values(changed)["split"] == "old"
    changed.row["info"]["split"] = "new"
    assert sample_values(changed)["split"] == "new"
    del changed.row["info"]["split"]
