"""The protocols against a naive reference, and against each other."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.scoring import scoring_loops as naive
from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.scoring import PROTOCOLS, evaluate, sparsification
from twinlens.scoring.protocols import interpolate_background

INF = np.float32(np.inf)
SEEDS = st.integers(0, 2**32 - 1)
CALIBRATION = Calibration(
    (90.0, 80.0, 5.5, 4.0), (90.0, 80.0, 8.5, 4.0), 0.2, 12, 12, 3.0
)


def random_case(seed, shape=None, holes=None):
    """A truth and an estimate with gaps, outliers, exact values, and errors exactly at the thresholds."""
    rng = np.random.default_rng(seed)
    shape = shape or tuple(rng.integers(1, 14, 2))
    gt = (rng.integers(0, 16 * 30, shape) / 16).astype(np.float32)
    errors = [0, 0.25, 0.5, 1, 2, 3, 4, -0.5, -2, -30, 40, 0.3, 1e-3]
    disp = (gt + rng.choice(errors, shape)).astype(np.float32)
    if holes is None:
        holes = rng.choice([0.0, 0.3, 1.0], p=[0.3, 0.6, 0.1])
    disp[rng.random(shape) < holes] = INF
    if rng.random() < 0.5:
        disp[rng.integers(shape[0])] = INF
    gt[rng.random(shape) < rng.choice([0.0, 0.2])] = INF
    return disp, gt, rng.choice(np.uint8([0, 128, 255]), shape)


def assert_same(scores, expected):
    assert set(scores) == set(expected)
    for name, value in expected.items():
        value = pytest.approx(value, rel=1e-9, abs=1e-9, nan_ok=True)
        assert scores[name] == value, name


def assert_equal_to_loops(scores, loop, disp, gt, mask, *options):
    """In both regions."""
    visible = mask if mask.dtype == bool else mask == 255
    everywhere = np.ones_like(visible)
    for region, pixels in ((scores.all, everywhere), (scores.nonocc, visible)):
        if region.evaluated:
            expected = loop(disp.tolist(), gt.tolist(), pixels, *options)
            assert_same(region, expected)


@given(seed=SEEDS, ndisp=st.integers(1, 40), isint=st.booleans())
@settings(max_examples=100, deadline=None)
def test_every_protocol_equals_the_loops(seed, ndisp, isint):
    case = disp, _, _ = random_case(seed)
    calibration = CALIBRATION.replace(isint=isint)
    middlebury = evaluate(*case, ndisp, calibration=calibration)
    assert_equal_to_loops(middlebury, naive.middlebury, *case, ndisp, isint)
    eth3d = evaluate(*case, ndisp, protocol="eth3d", calibration=calibration)
    assert_equal_to_loops(eth3d, naive.eth3d, *case)
    kitti = evaluate(*case, ndisp, protocol="kitti2015", calibration=calibration)
    assert_equal_to_loops(kitti, naive.kitti, *case)
    assert [s.rounded for s in (middlebury, eth3d, kitti)] == [isint, False, False]
    given_ones = np.where(disp >= 0, disp, INF)
    filled = interpolate_background(given_ones)
    np.testing.assert_array_equal(filled, naive.fill(disp.tolist()))


@pytest.mark.parametrize("scale", [2, 4])
@given(seed=SEEDS, rounded=st.booleans())
@settings(max_examples=30, deadline=None)
def test_middlebury_takes_a_smaller_map(scale, seed, rounded):
    small, _, _ = random_case(seed, (3, 5))
    _, gt, mask = random_case(seed + 1, (3 * scale, 5 * scale))
    scores = evaluate(small, gt, mask, 20, round_disparity=rounded)
    options = 20, rounded, scale
    assert_equal_to_loops(scores, naive.middlebury, small, gt, mask, *options)


def test_middlebury_counts_estimates_above_1000_ndisp_as_invalid():
    gt = np.full((1, 4), 10, np.float32)
    disp = np.array([[10, 60, 12000, 12001]], np.float32)
    scores = evaluate(disp, gt, gt > 0, 12)
    assert scores.all["invalid"] == 25
    assert_equal_to_loops(scores, naive.middlebury, disp, gt, gt > 0, 12)


@pytest.mark.parametrize("sign", [1, -1])
def test_d1_of_every_png_value_with_an_error_of_exactly_5_percent(sign):
    """KITTI's devkit compares a float32 ratio with a double limit, and 0.05 in float32 is above 0.05 in double."""
    codes = np.arange(15_380, 62_401, 20)[None]  # 5% is above 3 px
    gt = (codes / 256).astype(np.float32)
    disp = gt + gt.dtype.type(sign) * codes // 20 / gt.dtype.type(256)
    assert evaluate(disp, gt, protocol="kitti2015").all["D1"] == 100
    nearer = disp - np.float32(sign / 256)
    assert evaluate(nearer, gt, protocol="kitti2015").all["D1"] == 0


def test_every_protocol_measures_what_it_lists():
    disp, gt, mask = random_case(5, (12, 12), 0.2)
    comparing = {name: rules for name, rules in PROTOCOLS.items() if rules.needs_truth}
    for name, protocol in comparing.items():
        scores = evaluate(disp, gt, mask, 30, protocol=name, calibration=CALIBRATION)
        assert set(scores.all) == set(protocol.metrics) - set(protocol.auc_metrics)
        options = {"protocol": name, "calibration": CALIBRATION}
        scores = evaluate(disp, gt, confidence=np.ones(gt.shape), **options)
        assert set(scores.all) == set(protocol.metrics)
        assert protocol.headline in protocol.metrics


def test_only_middlebury_clips_to_ndisp():
    gt = np.full((2, 2), 10, np.float32)
    disp = np.array([[-50, 10], [10, 500]], np.float32)
    assert evaluate(disp, gt).all["avgerr"] == (10 + 490) / 4
    assert evaluate(disp, gt, ndisp=12, min_disparity=9).all["avgerr"] == (1 + 11) / 4


def test_a_region_is_scored_as_its_mask():
    disp, gt, mask = random_case(12, (9, 9), 0.2)
    scores = evaluate(disp, gt, mask, regions={"seen": mask == 255})
    assert scores.regions["seen"] == scores.nonocc
    assert evaluate(disp, gt, mask == 255).nonocc == scores.nonocc
    inside = np.isfinite(gt) & (mask == 255)
    counts = scores.nonocc.image, scores.nonocc.evaluated, scores.nonocc.estimated
    assert counts == (81, inside.sum(), (inside & np.isfinite(disp)).sum())


FLAT = np.ones((4, 6), np.float32)


def with_one(value):
    array = FLAT.copy()
    array[2, 3] = value
    return array


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (
            (with_one(np.nan), FLAT),
            {},
            r"disp holds NaN at 1 of 24 pixels, the first at x=3, y=2",
        ),
        (("a.pfm", "b.pfm"), {}, "^gt is str: expected an array of real numbers"),
        ((FLAT, with_one(-np.inf)), {"protocol": "eth3d"}, r"gt holds -inf"),
        ((FLAT[:2, :3], FLAT), {"protocol": "kitti2015"}, r"disp has shape \(2, 3\)"),
        ((FLAT[0], FLAT), {}, r"\(6,\): expected \(height, width\)"),
        ((FLAT, FLAT, FLAT), {}, "mask_nonocc holds float32"),
        ((FLAT, FLAT, FLAT[:3] > 0), {}, r"mask_nonocc has shape \(3, 6\)"),
        ((FLAT, FLAT, None, 0), {}, "ndisp is 0"),
        ((FLAT, FLAT), {"min_disparity": np.nan}, "min_disparity is nan"),
        ((FLAT, FLAT), {"protocol": "points"}, "needs the pair's calibration"),
        ((FLAT, FLAT), {"protocol": "midlebury"}, "did you mean 'middlebury-v3'"),
        ((FLAT, FLAT), {"regions": {"all": FLAT > 0}}, "region 'all'"),
        ((FLAT, FLAT), {"confidence": [[1.0]]}, "expected numbers of disp's shape"),
        ((FLAT, FLAT), {"confidence": with_one(np.nan)}, "NaN"),
        # A truth of odd size has no half size.
        (
            (FLAT[:2, :2], np.ones((5, 6))),
            {},
            r"expects \(5, 6\) for a truth of \(5, 6",
        ),
        ((FLAT[:2, :2], np.ones((6, 10))), {}, r"\(6, 10\) or \(3, 5\) for a truth"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, options, message):
    with pytest.raises(InputError, match=message) as error:
        evaluate(*arguments, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("protocol", "limit"), [("middlebury-v3", 2.0), ("eth3d", 1.0)]
)
def test_a_confidence_adds_the_area_of_its_sparsification(protocol, limit):
    rng = np.random.default_rng(2)
    gt, trust = rng.uniform(6, 12, (20, 30)).astype(np.float32), rng.random((20, 30))
    disp = (gt + rng.normal(0, 2, gt.shape)).astype(np.float32)
    disp[rng.random(gt.shape) < 0.2], gt[:2] = INF, INF
    scores = evaluate(disp, gt, protocol=protocol, confidence=trust).all
    finite = np.isfinite(gt) & np.isfinite(disp)
    bad = np.abs(disp[finite].astype(float) - gt[finite]) > limit
    curve = sparsification(trust[finite], bad)
    assert scores[f"auc{limit}"] == pytest.approx(100 * curve.auc)
    assert scores[f"auc{limit}_opt"] == pytest.approx(100 * curve.optimal_auc)
    assert scores.sparsification[-1] == pytest.approx(100 * bad.mean())
    plain = evaluate(disp, gt, protocol=protocol).all
    assert f"auc{limit}" not in plain
    assert not plain.sparsification


def test_a_confidence_of_a_small_map_is_enlarged_but_not_scaled():
    disp, gt, _ = random_case(3, (6, 8), 0.0)
    trust = np.random.default_rng(2).random(gt.shape)
    truth = np.kron(gt * 2, np.ones((2, 2)))
    small = evaluate(disp, truth, confidence=trust).all
    whole = evaluate(
        np.kron(disp * 2, np.ones((2, 2))),
        truth,
        confidence=np.kron(trust, np.ones((2, 2))),
    ).all
    assert small.sparsification == whole.sparsification


def test_printed_scores_are_lines_of_metrics():
    truth = np.full((4, 5), 1.6, np.float32)
    lines = str(evaluate(np.ones((4, 5), np.float32), truth)).splitlines()
    assert lines[1] == "all: 20 of 20 pixels evaluated, 20 estimated"
    assert any(line.split() == ["avgerr", "0.60", "px"] for line in lines)
