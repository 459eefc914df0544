"""Checks of numbers, their messages, and the nearest known name."""

import difflib
import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from twinlens.errors import (
    InputError,
    check_int,
    check_number,
    check_triple,
    file_hint,
    nearest,
    unknown,
)


@pytest.mark.parametrize(
    "value",
    [1, 0.5, Fraction(1, 3), np.float32(2), np.float64(3), np.int16(4), np.uint8(5)],
)
def test_real_numbers_of_every_type_are_accepted(value):
    check_number("x", value, "> 0", above=0)
    assert check_triple("x", [value] * 3, "three") == pytest.approx((float(value),) * 3)


@pytest.mark.parametrize(
    "value",
    [
        math.nan,
        math.inf,
        -math.inf,
        True,
        np.True_,
        "1",
        None,
        1j,
        Decimal(1),
        [1.0],
        np.ones(1),
        10**400,
        np.nan,
    ],
    ids=lambda value: f"{type(value).__name__} {value}"[:20],
)
def test_other_values_raise(value):
    with pytest.raises(InputError, match=r"^x must be a number, got "):
        check_number("x", value, "a number")
    with pytest.raises(InputError, match=r"^x must be three"):
        check_triple("x", [1.0, value, 1.0], "three")


def test_above_is_exclusive_and_least_is_inclusive():
    check_number("x", 2.0, "at least 2", least=2)
    for value, bound in ((2.0, {"above": 2}), (np.nextafter(2, 0), {"least": 2})):
        with pytest.raises(InputError):
            check_number("x", value, "more", **bound)


@pytest.mark.parametrize("value", [3, np.int16(3), np.uint8(9)])
def test_integers_of_every_type_are_accepted(value):
    check_int("x", value, 3, 9)


@pytest.mark.parametrize(
    "value", [2, 10, 3.0, True, np.True_, "3", None, math.nan, np.ones(1)]
)
def test_other_values_are_not_integers_in_range(value):
    with pytest.raises(
        InputError, match=r"^x must be a whole number from 3 to 9, got "
    ):
        check_int("x", value, 3, 9)
    with pytest.raises(InputError, match=r"^x must be 1, got "):
        check_int("x", value, 1, 1)


@pytest.mark.parametrize(
    "values",
    [(1.0, 1.0), (1.0,) * 4, (), 1.0, None, "abc", (0.0, 1.0, 1.0), (1.0, -1.0, 1.0)],
)
def test_a_triple_is_three_positive_numbers(values):
    with pytest.raises(InputError, match="three"):
        check_triple("x", values, "three")


def test_a_large_value_is_shortened_to_one_line():
    with pytest.raises(InputError) as refusal:
        check_number("x", np.zeros((50, 50)), "a number")
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 80


SCENES = ("cards", "fence", "staircase", "spheres", "tabletop")
SENSORS = ("ideal", "machine_vision", "phone")
METHODS = (
    "adaptive",
    "census",
    "jaccard",
    "ncc",
    "opencv_bm",
    "sad",
    "sgm",
    "sgm4",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
)
LAYOUTS = (
    "carla",
    "eth3d",
    "kitti2015",
    "middlebury",
    "parquet",
    "sceneflow",
    "sintel",
    "webdataset",
)
KEYS = (
    "aperture_diameter",
    "baseline",
    "fov_x_deg",
    "focus_distance",
    "min_disparity",
    "num_disparities",
    "spp",
)


@pytest.mark.parametrize(
    ("names", "typed"),
    [
        (
            SCENES,
            {
                "stairs": "staircase",
                "Fence": "fence",
                "cards2": "cards",
                "table": "tabletop",
            },
        ),
        (
            SENSORS,
            {
                "phne": "phone",
                "machine": "machine_vision",
                "machine-vision": "machine_vision",
            },
        ),
        (
            METHODS,
            {
                "ZNCC": "zncc",
                "zncd": "zncc",
                "sda": "sad",
                "cencus": "census",
                "zcnn": "zncc",
                "znnc": "zncc",
                "sgmm": "sgm",
                "cesnus": "census",
                "jacrad": "jaccard",
                "opencv": "opencv_bm",
                "sgm8": "sgm",
            },
        ),
        (
            LAYOUTS,
            {
                "kitti": "kitti2015",
                "midlebury": "middlebury",
                "eth3": "eth3d",
                "scene_flow": "sceneflow",
            },
        ),
        (
            KEYS,
            {
                "fov": "fov_x_deg",
                "basline": "baseline",
                "diameter": "aperture_diameter",
                "ssp": "spp",
                "focs": "focus_distance",
            },
        ),
    ],
    ids=("scenes", "sensors", "methods", "layouts", "keys"),
)
def test_a_misspelled_name_has_a_nearest_name(names, typed):
    for name, meant in typed.items():
        assert nearest(name, names) == meant
        message = str(unknown("name", name, names))
        assert message.startswith(
            f"unknown name {name!r}; did you mean {meant!r}? (known: "
        )


@pytest.mark.parametrize(
    ("names", "typed"),
    [
        (SENSORS, "nikon canon sony drone iphone-15-pro"),
        (SCENES, "peace bridge office x"),
        (METHODS, "raft psmnet elas orb mse"),
        (LAYOUTS, "coco tartanair cityscapes colmap nerf"),
        (KEYS, "gamma iso exposure shutter d"),
        (("fence", "staircase"), "car"),
    ],
)
def test_an_unrelated_name_has_no_nearest_name(names, typed):
    for name in ("", *typed.split()):
        assert nearest(name, names) is None
        message = str(unknown("name", name, names))
        assert message.startswith(f"unknown name {name!r} (known: ")


def test_a_very_long_name_is_rejected_by_upper_bounds(monkeypatch):
    compared = []
    monkeypatch.setattr(
        difflib.SequenceMatcher, "ratio", lambda pair: compared.append(pair.b) or 1.0
    )
    assert nearest("zncc" * 25_000, METHODS) is None
    assert nearest("qvxy", METHODS) is None, "nor one that shares no letters"
    assert compared == []
    assert nearest("zncd", ["raft", "zncc"]) == "zncc"
    assert compared


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("calb.txt", "calib.txt"),
        ("CALIB.TXT", "calib.txt"),
        ("camchain.yml", "camchain.yaml"),
        ("part", "parts"),
        ("lfet.png", "left.png"),
        ("depth.pfm", None),
    ],
)
def test_a_missing_file_has_its_nearest_neighbour(tmp_path, typed, meant):
    for name in ("calib.txt", "camchain.yaml", "left.png", "parts", ".depth.pfm"):
        (tmp_path / name).write_text("")
    expected = f"; did you mean {meant!r}?" if meant else ""
    assert file_hint(tmp_path / typed) == expected
    assert file_hint(tmp_path / "nowhere" / typed) == ""
    assert file_hint("s3://bucket/calb.txt") == ""
