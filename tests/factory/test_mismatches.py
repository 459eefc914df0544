"""Mismatches of recipes: one draw for each camera after the first, none for the views of a light field."""

import json

import numpy as np
import pytest

from tests.factory_recipes import write_recipe
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.verify import verify_sample
from twinlens.errors import InputError
from twinlens.factory import (
    make,
    recipe_from_table,
    rectified_sample,
    remake,
)
from twinlens.factory.camera_text import parse_mismatch
from twinlens.factory.settings import ANY_SCENE, sensor_for
from twinlens.scenes import load_scene, rig_from_table
from twinlens.sensor import Mismatch, Sensor

LINE = {"layout": "line", "count": 4, "spacing": 0.05}
ONE = {"layout": "line", "count": 1}
LIGHT_FIELD = {"layout": "light_field", "n": 3, "aperture_mm": 12.0}
BASE = {
    "seed": 1,
    "count": 2,
    "scenes": ["cards"],
    "width": 48,
    "height": 36,
    "spp": 1,
    "denoise": False,
}


def sensor(rig, seed=5, **table):
    """The sensor of a sample with the seed."""
    drawn = {"rig": rig, **({"sensor": table} if table else {})}
    return sensor_for(rig_from_table(rig, ANY_SCENE, 48, 36), drawn, seed)


def test_each_camera_after_the_first_has_its_own_draw():
    """That of the second camera is the one of a pair."""
    pair = sensor({"baseline": 0.1}, mismatch="typical").mismatch
    assert pair == Mismatch.draw("typical", 5)
    drawn = sensor(LINE, mismatch={"level": "typical", "blur_px": 0.25}).mismatch
    assert len(drawn) == 3
    assert drawn[0] == Mismatch.draw("typical", 5, blur_px=0.25)
    for name in ("gain", "shading_right", "pitch_px", "stray_direction_deg"):
        assert len({getattr(draw, name) for draw in drawn}) == 3, name
    assert {draw.blur_px for draw in drawn} == {0.25}
    assert len(set(sensor(LINE).mismatch)) == 3  # the default is typical


def test_cameras_differ_as_much_as_those_of_a_pair():
    """Draws of 300 rigs: the spread of the level, and no correlation between cameras."""
    rigs = [sensor(LINE, seed, mismatch="typical").mismatch for seed in range(300)]
    gains = np.array([[camera.gain for camera in rig] for rig in rigs])
    assert gains.std(axis=0) == pytest.approx([0.01] * 3, rel=0.12)
    assert np.abs(np.corrcoef(gains.T) - np.eye(3)).max() < 0.2


def test_a_seed_gives_all_samples_the_same_cameras():
    first, second = (
        sensor(LINE, seed, mismatch={"level": "typical", "seed": 3}).mismatch
        for seed in (1, 2)
    )
    assert first == second == sensor(LINE, 3, mismatch="typical").mismatch


def test_values_without_a_level_are_those_of_all_cameras_after_the_first():
    assert sensor(LINE, mismatch={"gain": 1.1}).mismatch == Mismatch(gain=1.1)
    assert (
        sensor(LINE, mismatch="none").mismatch
        == sensor(LINE, preset="ideal").mismatch
        == Mismatch()
    )


def test_a_list_has_the_mismatch_of_each_camera():
    stated = ["typical", {"gain": 1.1}, {"level": "calibrated", "seed": 8}]
    drawn = sensor(LINE, mismatch=stated).mismatch
    assert drawn[:2] == (Mismatch.draw("typical", 5), Mismatch(gain=1.1))
    assert drawn[2].level == "calibrated"


@pytest.mark.parametrize(
    ("rig", "mismatch", "message"),
    [
        (LINE, ["typical", "none"], "of the sensor must be 3, one for each .* got 2"),
        (LINE, [{"gain": 0}] * 3, r"sensor.mismatch\[0\]"),
        (LIGHT_FIELD, "typical", "sensor.mismatch: the views of a light field are of"),
        (ONE, {"roll_px": 1}, "sensor.mismatch: the rig has one camera, and only"),
    ],
)
def test_mismatches_that_do_not_fit_the_rig(rig, mismatch, message):
    with pytest.raises(InputError, match=rf"^recipe\.toml: .*{message}"):
        recipe_from_table({**BASE, "rig": rig, "sensor": {"mismatch": mismatch}})


def test_the_views_of_a_light_field_are_of_one_camera():
    """The option draws as a recipe does."""
    assert sensor(LIGHT_FIELD).mismatch == sensor(ONE).mismatch == Mismatch()
    rig = rig_from_table({}, ANY_SCENE, 48, 36)
    assert sensor_for(rig, {}, 5, LIGHT_FIELD).mismatch == Mismatch()
    with pytest.raises(
        InputError, match="--mismatch 'typical': the views of a light field"
    ):
        parse_mismatch("typical", 4, 9, "light_field")
    assert parse_mismatch("none", 4, 9, "light_field") == Mismatch()
    with pytest.raises(InputError, match="--mismatch 'roll_px=1': the rig has one"):
        parse_mismatch("roll_px=1", 4, 1)
    drawn = sensor(LINE, mismatch={"level": "typical", "blur_px": 0.25}).mismatch
    assert parse_mismatch("typical,blur_px=0.25", 5, 4) == drawn


def test_a_sample_records_the_mismatch_of_each_camera_and_is_made_again(tmp_path):
    """The rig that takes the images, the photos, the record and `rectified_sample` have the same mismatches."""
    mismatch = {"level": "consumer", "distortion_px": 0}
    table = {**BASE, "scenes": ["tiny"], "rig": LINE, "sensor": {"mismatch": mismatch}}
    recipe = recipe_from_table(table, write_recipe(tmp_path))
    sample = make(recipe, 0)
    rig, exposures = sample.rig, sample.shots[0].record["exposures"]
    files = sample_files(sample)
    record = json.loads(files["sample.json"])
    drawn = Sensor.from_record(record["record"]["sensor"]).mismatch
    assert len(set(drawn)) == 3
    seed = record["record"]["spec"]["seed"]
    assert drawn == sensor_for(rig.nominal, recipe.drawn, seed).mismatch
    first = exposures[0]
    for i, mismatch in enumerate(drawn, start=1):
        moved = mismatch.misalign(rig.nominal).world_from_cams[i]
        assert np.array_equal(rig.world_from_cams[i], moved)
        taken = exposures[i]
        assert Mismatch(**taken["sensor"]["mismatch"]) == mismatch
        assert taken["gain"] == pytest.approx(first["gain"] * mismatch.gain)
        level = first["black_level_dn"] + mismatch.black_level
        assert taken["black_level_dn"] == pytest.approx(level)
    scene = load_scene(tmp_path / "tiny")
    assert sample_files(remake(record, scene)) == files
    write_sample(tmp_path / "made", sample)
    stored = Dataset(tmp_path / "made")[0]
    assert verify_sample(stored) == []
    rectified = rectified_sample(stored, scene, left=1, right=3, pictures="render")
    assert Sensor.from_record(rectified.record["sensor"]).mismatch == drawn[2]
