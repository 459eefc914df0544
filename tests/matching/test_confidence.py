"""Confidence measures against naive loops and Pandora's ambiguity, and the confidences that matchers return."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.matching import (
    CONFIDENCES,
    StereoMatcher,
    confidence_map,
    match_with_confidence,
)
from twinlens.matching.contract import MatcherFailedError
from twinlens.scoring import motorcycle


def random_volume(seed=0, shape=(4, 12, 7), low=-2):
    """Whole costs with many ties; +inf where u - d is outside the row."""
    volume = np.random.default_rng(seed).integers(0, 12, shape).astype(np.float32)
    partner = np.arange(shape[1])[:, None] - low - np.arange(shape[2])
    volume[:, (partner < 0) | (partner >= shape[1])] = np.inf
    return volume


def rivals_of(costs):
    """The candidates that are two or more from the best."""
    candidates = np.flatnonzero(np.isfinite(costs))
    return candidates[np.abs(candidates - costs.argmin()) >= 2]


def naive_peak_ratio(volume, y, x, low):
    costs = volume[y, x]
    beside = np.pad(costs, 1, constant_values=np.inf)
    minima = [
        costs[j] for j in rivals_of(costs) if costs[j] <= min(beside[j], beside[j + 2])
    ]
    if not minima:
        return 1.0
    return 1 - costs.min() / min(minima) if min(minima) > 0 else 0.0


def naive_curvature(volume, y, x, low):
    costs = volume[y, x]
    beside = np.pad(costs, 1, constant_values=np.inf)
    neighbours = beside[[costs.argmin(), costs.argmin() + 2]]
    neighbours = neighbours[np.isfinite(neighbours)]
    return 2 * (neighbours.mean() - costs.min()) if len(neighbours) else 0.0


def naive_left_right(volume, y, x, low):
    costs = volume[y, x]
    finite = volume[np.isfinite(volume)]
    second = min(costs[rivals_of(costs)], default=finite.max())
    partner = x - (low + costs.argmin())
    of_partner = min(
        volume[y, u, j]
        for u, j in np.ndindex(volume.shape[1:])
        if u - (low + j) == partner
    )
    lowest = costs.min()
    unit = 0.001 * np.ptp(finite)
    return (second - lowest) / (lowest - of_partner + unit)


def naive_entropy(volume, y, x, low):
    costs = volume[y, x]
    weights = [math.exp(-cost) for cost in costs[np.isfinite(costs)]]
    shares = [weight / sum(weights) for weight in weights]
    entropy = -sum(share * math.log(share) for share in shares)
    return -math.log(max(entropy, np.finfo(float).tiny) / math.log(len(costs)))


NAIVE = {
    "peak_ratio": naive_peak_ratio,
    "curvature": naive_curvature,
    "left_right": naive_left_right,
    "entropy": naive_entropy,
}


@pytest.mark.parametrize("name", NAIVE)
@pytest.mark.parametrize("low", [-2, 0, 3])
def test_measures_equal_naive_loops(name, low):
    volume = random_volume(low=low)
    confidence = confidence_map(volume, name, low)
    assert confidence.dtype == np.float32
    for y, x in np.ndindex(confidence.shape):
        expected = 0.0
        if np.isfinite(volume[y, x]).any():
            expected = NAIVE[name](volume, y, x, low)
        assert confidence[y, x] == pytest.approx(expected, rel=1e-5), (y, x)


@pytest.mark.parametrize("count", [2, 16, 64, 400])
def test_a_certain_candidate_has_a_large_finite_entropy_confidence(count):
    """All probability is at one candidate: the entropy is 0, at any number of candidates."""
    volume = np.full((1, 2, count), 1e5, np.float32)
    volume[0, 0, count // 2] = 0  # certain
    volume[0, 1, : count // 2 + 1] = 0  # open between several, but for two candidates
    confidence = confidence_map(volume, "entropy")
    assert np.isfinite(confidence).all()
    assert confidence[0, 0] > confidence[0, 1]


def test_ambiguity_equals_a_naive_sum():
    """Costs in quarters of the range, so that no rounding decides whether one is within a step."""
    volume = random_volume(3, (6, 30, 9), 0)
    volume = np.where(np.isfinite(volume), np.floor(volume / 3), np.inf)
    finite = volume[np.isfinite(volume)]
    unit = (volume - finite.min()) / np.ptp(finite)
    lowest = unit.min(axis=2, keepdims=True)
    counts = np.zeros(volume.shape[:2])
    for eta in np.arange(70) / 100 + 1e-5:
        counts += ((unit <= lowest + eta) | np.isinf(unit)).sum(axis=2)
    low, high = np.percentile(counts, (1, 99))
    expected = 1 - (np.clip(counts, low, high) - low) / (high - low)
    confidence = confidence_map(volume, "ambiguity")
    np.testing.assert_allclose(confidence, expected, atol=1e-6)


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
    volume = matcher.cost_volume(pair.im0, pair.im1)
    confidence = confidence_map(volume, "ambiguity")[50::100, 100:600:150]
    np.testing.assert_allclose(confidence.ravel(), PANDORA[method], atol=1e-6)


@pytest.mark.parametrize("name", CONFIDENCES)
def test_a_volume_without_choice_gives_no_confidence(name):
    """Equal costs everywhere, and pixels without candidates."""
    volume = np.full((3, 8, 5), 2.0, np.float32)
    volume[0] = np.inf
    confidence = confidence_map(volume, name)
    assert (confidence[1:, 4:] == 0).all()
    assert not confidence[0].any()
    assert not confidence_map(np.full((2, 4, 3), np.inf), name).any()


@pytest.mark.parametrize("method", ["sgm", "zncc:lr_check=1", "adaptive"])
def test_the_confidence_is_that_of_the_cost_volume(method):
    right = np.random.default_rng(0).integers(0, 256, (16, 40), dtype=np.uint8)
    images = np.roll(right, 3, axis=1), right
    options = {"num_disparities": 8, "min_disparity": 1}
    answer = match_with_confidence(*images, method, confidence="left_right", **options)
    matcher = tl.matching.parse_method(method).matcher(**options)
    expected = confidence_map(matcher.cost_volume(*images), "left_right", 1)
    np.testing.assert_array_equal(answer.confidence, expected)
    np.testing.assert_array_equal(
        answer.disparity, tl.match(*images, method, **options)
    )
    assert match_with_confidence(*images, method, **options)[1] is None


def test_a_match_without_confidence_computes_none(monkeypatch):
    def computed(*_):
        raise AssertionError("a confidence was computed")

    monkeypatch.setattr("twinlens.matching.matcher.confidence_map", computed)
    image = np.zeros((9, 20), np.uint8)
    matcher = StereoMatcher(confidence="curvature", num_disparities=4)
    text = "sad:confidence=curvature,num_disparities=4"
    matcher.match(image, image)
    tl.match(image, image, text)
    tl.matching.parse_method(text).match(image, image)
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
    matcher = Confident(trust)
    function = tl.matching.METHODS["function"].make(function=matcher.match)
    for method in (matcher, function):
        answer = match_with_confidence(image, image, method)
        np.testing.assert_array_equal(answer.confidence, trust)
        assert answer.confidence.dtype == np.float32
        assert tl.match(image, image, method)[0, 0] == 5


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
    with pytest.raises(MatcherFailedError) as refused:
        tl.match(image, image, Confident(confidence))
    assert refused.value.kind == kind
