import numpy as np
import pytest

import twinlens as tl
from twinlens.dataset import sample_files
from twinlens.factory import default_rig, make_sample
from twinlens.sensor import Sensor

LENSES = (tl.Pinhole(), tl.Pinhole(), tl.ThinLens(0.04, 1.2))


@pytest.fixture(scope="module")
def scene():
    return tl.load_scene("cards")


@pytest.fixture(scope="module")
def sample(scene):
    return make_sample(scene, default_rig(scene, 48, 36), LENSES, spp=4, seed=0, keep_radiance=True)


def test_the_rig_is_the_one_the_scene_was_composed_for(scene):
    rig = default_rig(scene, 48, 36)
    assert rig.is_rectified()
    assert rig.baseline() == pytest.approx(scene.baseline)
    assert rig.cameras[0].fov_x_deg == pytest.approx(scene.fov_x_deg)
    assert default_rig(scene, 48, 36, fov_x_deg=30, baseline=0.2).baseline() == pytest.approx(0.2)


def test_every_lens_and_eye_has_noise_of_its_own(sample):
    first, again = sample.shots[0].radiances, sample.shots[1].radiances
    assert not np.array_equal(first[0], again[0])
    noise = [(a - b).ravel() - (a - b).mean() for a, b in zip(first, again, strict=True)]
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 5 / np.sqrt(noise[0].size)


def test_eyes_share_an_exposure_and_lenses_do_not(sample):
    times = [[e["time_s"] for e in shot.record["exposures"]] for shot in sample.shots]
    assert all(left == right for left, right in times)
    assert times[0][0] != times[2][0]


def test_the_record_says_what_is_needed_to_make_it_again(scene, sample):
    record = sample.record
    assert record["scene"] == "cards"
    assert record["seed"] == 0
    assert record["spp"] == 4
    assert {"twinlens", "mitsuba", "drjit", "numpy"} == set(record["versions"])
    again = make_sample(scene, sample.rig, LENSES, spp=record["spp"], seed=record["seed"], keep_radiance=True)
    assert sample_files(again) == sample_files(sample)


def test_another_seed_is_another_photograph_of_the_same_truth(scene, sample):
    other = make_sample(scene, sample.rig, LENSES[:1], spp=4, seed=1)
    assert not np.array_equal(other.shots[0].images[0], sample.shots[0].images[0])
    assert np.array_equal(other.truths[0].depth, sample.truths[0].depth)


def test_the_sensor_is_the_users(scene, sample):
    deep = make_sample(scene, sample.rig, LENSES[:1], spp=1, sensor=Sensor.preset("ideal", bits=16))
    assert deep.shots[0].images[0].dtype == np.uint16


def test_progress_rises_to_one(scene, sample):
    seen = []
    make_sample(scene, sample.rig, LENSES, spp=1, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
