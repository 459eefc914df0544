import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, write_pfm, write_png, write_sample
from twinlens.dataset.codecs.calib import write_calib
from twinlens.dataset.statistics import (
    KEY,
    mixed_counts,
    quantiles,
    statistics,
    stored_statistics,
)
from twinlens.scoring import motorcycle

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60)


def test_statistics_are_those_of_the_truth():
    sample = dataset_scene.sample(num_lenses=2)
    truth = sample.truths[0]
    measured = statistics(sample)
    finite = np.isfinite(truth.disparity)
    for name, values in (
        ("disparity", truth.disparity[finite]),
        ("depth", truth.depth[truth.hit]),
    ):
        assert measured[name][0] == pytest.approx(values.min(), rel=1e-4)
        assert measured[name][16] == pytest.approx(np.median(values), rel=1e-4)
        assert measured[name][-1] == pytest.approx(values.max(), rel=1e-4)
    # The blur at infinity decides between two lenses that differ only in focus: c = A fx (1/z - 1/f).
    far = (
        0.02
        * 70.0
        * np.abs(1 / truth.depth[truth.hit] - 1 / sample.shots[1].lens.focus_distance)
    )
    assert measured["blur_px"][1][-1] == pytest.approx(far.max(), rel=1e-4)
    mask = truth.mask_nonocc()
    assert measured["occluded"] == pytest.approx((mask == 128).mean(), abs=1e-5)
    assert measured["visible"] + measured["occluded"] + measured[
        "unknown"
    ] == pytest.approx(1, abs=2e-5)
    assert (measured["size"], measured["cameras"], measured["lenses"]) == (
        [64, 48],
        2,
        2,
    )


def test_missing_statistics_are_computed(tmp_path):
    sample = dataset_scene.sample(num_lenses=2)
    write_sample(tmp_path / "s", sample)
    with dataset_scene.edited(tmp_path / "s") as record:
        measured = record.pop(KEY)
    assert measured == statistics(sample)
    stored = stored_statistics(Dataset(tmp_path)[0])
    for name in ("disparity", "depth"):
        assert_allclose(stored.pop(name), measured.pop(name), rtol=1e-4)
    assert_allclose(
        stored.pop("blur_px"), measured.pop("blur_px"), rtol=2e-3, atol=1e-6
    )
    assert stored == measured


def test_edited_statistics_are_not_trusted(tmp_path):
    sample = dataset_scene.sample()
    write_sample(tmp_path / "s", sample)
    expected = statistics(sample)
    for wrong in ({}, {**expected, "depth": ["far"]}):
        with dataset_scene.edited(tmp_path / "s") as record:
            record[KEY] = wrong
        depth = stored_statistics(Dataset(tmp_path)[0])["depth"]
        assert depth == pytest.approx(expected["depth"], rel=1e-4)


def test_plain_folders(tmp_path):
    pair = motorcycle()
    write_png(tmp_path / "m" / "im0.png", pair.im0)
    assert stored_statistics(Dataset(tmp_path)[0]) == {
        "size": [741, 500],
        "cameras": 2,
        "lenses": 1,
    }
    write_pfm(tmp_path / "m" / "disp0GT.pfm", pair.disp0)
    write_calib(tmp_path / "m" / "calib.txt", pair.calibration)
    measured = stored_statistics(Dataset(tmp_path)[0])
    assert measured["blur_px"] == []
    nearest = pair.calibration.depth(np.float32(measured["disparity"][-1]))
    assert measured["depth"][0] == pytest.approx(float(nearest), rel=1e-3)


@given(st.lists(NUMBERS, min_size=1, max_size=5))
def test_mixtures_keep_every_sample(many):
    kept = [quantiles(values) for values in many]
    low, high = min(part[0] for part in kept), max(part[-1] for part in kept)
    counts = mixed_counts(np.linspace(low - 1e-9, high + 1, 23), kept)
    assert counts.sum() == pytest.approx(len(many))
    assert (counts >= -1e-12).all()


def test_mixtures_are_histograms_of_the_values():
    rng = np.random.default_rng(0)
    values = [rng.normal(0, 1, 100_000), rng.uniform(1, 3, 100_000)]
    edges = np.linspace(-6, 6, 13)
    true = sum(np.histogram(part, edges)[0] / part.size for part in values)
    assert_allclose(mixed_counts(edges, map(quantiles, values)), true, atol=0.03)
