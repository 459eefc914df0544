"""Confidence measures against naive loops and Pandora's ambiguity, and the confidences that matchers return."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.matching import (
    CONFIDENCES,
    StereoMatcher,
    confidence_map,
    match_with_confidence,
)
from twinlens.matching.contract import WrongAnswerError
from twinlens.scoring import motorcycle


def random_volume(seed=0, shape=(5, 12, 7), low=-2):
    """Whole costs with many ties; +inf where u - d is outside the row."""
    volume = np.random.default_rng(seed).integers(0, 12, shape).astype(np.float32)
    partner = np.arange(shape[1])[:, None] - low - np.arange(shape[2])
    volume[:, (partner < 0) | (partner >= shape[1])] = np.inf
    return volume


def candidates(row):
    known = [j for j, cost in enumerate(row) if np.isfinite(cost)]
    best = min(known, key=lambda j: row[j])
    return known, best, [j for j in known if abs(j - best) >= 2]


def naive_peak_ratio(volume, y, x, low):
    row = volume[y, x]
    _, best, rivals = candidates(row)
    beside = np.pad(row, 1, constant_values=np.inf)
    minima = [row[j] for j in rivals if row[j] <= beside[j] and row[j] <= beside[j + 2]]
    if not minima:
        return 1.0
    return 1 - row[best] / min(minima) if min(minima) > 0 else 0.0


def naive_curvature(volume, y, x, low):
    row = volume[y, x]
    known, best, _ = candidates(row)
    sides = [row[j] if j in known else None for j in (best - 1, best + 1)]
    first, last = (
        (sides[0] if sides[0] is not None else sides[1]),
        (sides[1] if sides[1] is not None else sides[0]),
    )
    return 0.0 if first is None else first + last - 2 * row[best]


def naive_left_right(volume, y, x, low):
    _, best, rivals = candidates(volume[y, x])
    finite = volume[np.isfinite(volume)]
    second = min((volume[y, x, j] for j in rivals), default=finite.max())
    right = x - (low + best)
    of_right = min(
        volume[y, u, j]
        for u in range(volume.shape[1])
        for j in range(volume.shape[2])
        if u - (low + j) == right
    )
    lowest = volume[y, x, best]
    return (second - lowest) / (
        lowest - of_right + 0.001 * (finite.max() - finite.min())
    )


def naive_entropy(volume, y, x, low):
    known, *_ = candidates(volume[y, x])
    weights = [math.exp(-volume[y, x, j]) for j in known]
    negative = sum(w / sum(weights) * math.log(w / sum(weights)) for w in weights)
    return -math.log(max(-negative, np.finfo(float).tiny) / math.log(volume.shape[2]))


NAIVE = {
    "peak_ratio": naive_peak_ratio, "curvature": naive_curvature, "left_right": naive_left_right,
    "entropy": naive_entropy,
}  # fmt: skip


@pytest.mark.parametrize("name", NAIVE)
@pytest.mark.parametrize("low", [-2, 0, 3])
def test_measures_equal_naive_loops(name, low):
    volume = random_volume(shape=(4, 12, 7), low=low)
    found = confidence_map(volume, name, low)
    assert found.dtype == np.float32
    for y, x in np.ndindex(found.shape):
        known = np.isfinite(volume[y, x]).any()
        assert found[y, x] == pytest.approx(
            NAIVE[name](volume, y, x, low) if known else 0.0, rel=1e-5
        ), (y, x)


def test_ambiguity_equals_a_naive_sum():
    """Costs in quarters of the range, so that no rounding decides whether one is within a step."""
    volume = random_volume(3, (6, 30, 9), 0)
    volume = np.where(np.isfinite(volume), np.floor(volume / 3), np.inf)
    found = confidence_map(volume, "ambiguity")
    finite = volume[np.isfinite(volume)]
    unit = (volume - finite.min()) / (finite.max() - finite.min())
    counts = np.zeros(volume.shape[:2])
    for eta in np.arange(70) / 100 + 1e-5:
        counts += (
            (unit <= unit.min(axis=2, keepdims=True) + eta) | np.isinf(unit)
        ).sum(axis=2)
    low, high = np.percentile(counts, (1, 99))
    np.testing.assert_allclose(
        found, 1 - (np.clip(counts, low, high) - low) / (high - low), atol=1e-6
    )


PANDORA = {
    "census:census_window=5,block_size=1": [
        0.603858, 0.4176685, 0.7671233, 0.6877272, 0.868605, 0.8414873, 0.7366508, 0.794241, 0.7953593, 0.4173889,
        0.6843724, 0.7318982, 0.5183114, 0.636567, 0.8783897, 0.761532, 0.4542913, 0.6986301, 0.5227845, 0.7928432,
    ],
    "zncc:block_size=11": [
        0.7309237, 0.6808568, 0.8829986, 0.6746988, 0.8915663, 0.7807229, 0.7874163, 0.9060241, 0.7863454, 0.870415,
        0.7022758, 0.4821954, 0.4305221, 0.7269076, 0.7866131, 0.8744311, 0.6337349, 0.5421687, 0.6894244, 0.6082999,
    ],
    "sad": [
        0.1456678, 0.0635641, 0.507378, 0.4298146, 0.3643587, 0.199773, 0.2508513, 0.5690503, 0.2943625, 0.4373817,
        0.6772607, 0.4842982, 0.1362088, 0.3991676, 0.2342036, 0.5622399, 0.0374574, 0.0442679, 0.0397276, 0.0575104,
    ],
    "sgm": [
        0.932177, 0.8114299, 0.7404937, 0.8492328, 0.8574605, 0.7538359, 0.9288415, 0.9397376, 0.772515, 0.9032688,
        0.8830332, 0.824105, 0.8610185, 0.6537691, 0.956193, 0.9246164, 0.8425617, 0.9106071, 0.9181677, 0.9488548,
    ],
}  # fmt: skip
"""At rows 50, 150, ... 450 and columns 100, 250, 400, 550 of Motorcycle: Pandora 1.9.0, method "ambiguity", of the same
cost volume with NaN in place of +inf."""


@pytest.mark.slow
@pytest.mark.parametrize("method", PANDORA)
def test_ambiguity_equals_pandoras(method):
    pair = motorcycle()
    matcher = tl.matching.parse_method(method).matcher(**pair.search)
    found = confidence_map(matcher.cost_volume(pair.im0, pair.im1), "ambiguity")
    np.testing.assert_allclose(
        found[50::100, 100:600:150].ravel(), PANDORA[method], atol=1e-6
    )


@pytest.mark.parametrize("name", CONFIDENCES)
def test_a_volume_without_choice_gives_no_confidence(name):
    """Equal costs everywhere, and pixels without candidates."""
    volume = np.full((3, 8, 5), 2.0, np.float32)
    volume[0] = np.inf
    assert (confidence_map(volume, name)[1:, 4:] == 0).all()
    assert not confidence_map(volume, name)[0].any()
    assert not confidence_map(np.full((2, 4, 3), np.inf), name).any()


@pytest.mark.parametrize("name", CONFIDENCES)
def test_right_matches_are_more_confident(name):
    rng = np.random.default_rng(4)
    right = rng.integers(0, 256, (30, 60), dtype=np.uint8)
    right[:, 30:] = 128 + rng.integers(-1, 2, (30, 30))  # hardly any texture
    left = np.clip(
        np.roll(right, 3, axis=1) + rng.integers(-3, 4, right.shape), 0, 255
    ).astype(np.uint8)
    disparity, confidence = match_with_confidence(
        left, right, "sad", num_disparities=12, confidence=name
    )
    bad = np.abs(disparity - 3) > 1
    inside = np.s_[4:-4, 16:-4]
    assert 0.1 < bad[inside].mean() < 0.9
    curve = tl.scoring.sparsification(confidence[inside], bad[inside])
    assert curve.auc < 0.6 * bad[inside].mean()


@pytest.mark.parametrize("method", ["sgm", "zncc:lr_check=1", "adaptive"])
def test_the_confidence_is_that_of_the_cost_volume(method):
    right = np.random.default_rng(0).integers(0, 256, (16, 40), dtype=np.uint8)
    images = np.roll(right, 3, axis=1), right
    options = {"num_disparities": 8, "min_disparity": 1}
    disparity, confidence = match_with_confidence(
        *images, method, confidence="left_right", **options
    )
    matcher = tl.matching.parse_method(method).matcher(**options)
    np.testing.assert_array_equal(
        confidence, confidence_map(matcher.cost_volume(*images), "left_right", 1)
    )
    np.testing.assert_array_equal(disparity, tl.match(*images, method, **options))
    assert match_with_confidence(*images, method, **options)[1] is None


def test_a_match_without_confidence_computes_none(monkeypatch):
    def computed(*_):
        raise AssertionError("a confidence was computed")

    monkeypatch.setattr("twinlens.matching.matcher.confidence_map", computed)
    image = np.zeros((9, 20), np.uint8)
    matcher = StereoMatcher(confidence="curvature", num_disparities=4)
    matcher.match(image, image)
    tl.match(image, image, matcher)
    tl.match(image, image, "sad:confidence=curvature", num_disparities=4)
    tl.matching.parse_method("sad:confidence=curvature,num_disparities=4").match(
        image, image
    )
    with pytest.raises(AssertionError, match="was computed"):
        match_with_confidence(image, image, matcher)


class Confident:
    """Returns a disparity with a confidence."""

    def __init__(self, confidence):
        self.confidence = confidence

    def match(self, left, right, *, num_disparities, min_disparity):
        return np.full(left.shape[:2], 5, np.float32), self.confidence


def test_objects_and_functions_may_return_a_confidence():
    image, trust = np.zeros((4, 6), np.uint8), np.arange(24).reshape(4, 6)
    _, found = match_with_confidence(image, image, Confident(trust))
    np.testing.assert_array_equal(found, trust)
    assert found.dtype == np.float32
    assert tl.match(image, image, Confident(trust))[0, 0] == 5
    assert match_with_confidence(image, image, Confident(None))[1] is None
    function = tl.matching.METHODS["function"].make(
        function=lambda a, b, **_: (np.ones((4, 6)), trust)
    )
    np.testing.assert_array_equal(
        function.match_with_confidence(image, image)[1], trust
    )
    assert function.match(image, image)[0, 0] == 1


@pytest.mark.parametrize(
    ("confidence", "kind"),
    [
        (np.zeros((3, 6)), "wrong-shape"),
        (np.full((4, 6), np.nan), "not-a-number"),
        ("high", "wrong-type"),
    ],
)
def test_wrong_confidences_are_refused(confidence, kind):
    image = np.zeros((4, 6), np.uint8)
    with pytest.raises(WrongAnswerError) as refused:
        tl.match(image, image, Confident(confidence))
    assert refused.value.kind == kind


def test_wrong_names_and_volumes_are_refused():
    with pytest.raises(InputError, match="did you mean 'ambiguity'"):
        StereoMatcher(confidence="ambiguty")
    with pytest.raises(InputError, match="unknown confidence"):
        confidence_map(random_volume(), "none")
    with pytest.raises(InputError, match="height, width, disparities"):
        confidence_map(np.zeros((3, 4)), "curvature")
