"""The protocols against a naive reference, and against each other."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.scoring import scoring_loops as naive
from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.scoring import PROTOCOLS, evaluate, sparsification
from twinlens.scoring.protocols import interpolate_background

INF = np.float32(np.inf)
CALIBRATION = Calibration(
    (90.0, 80.0, 5.5, 4.0), (90.0, 80.0, 8.5, 4.0), 0.2, 12, 12, 3.0
)


def random_case(seed, height=None, width=None, holes=None):
    """A truth and an estimate with gaps, outliers, exact values, and errors exactly at the thresholds."""
    rng = np.random.default_rng(seed)
    height, width = (
        height or int(rng.integers(1, 14)),
        width or int(rng.integers(1, 14)),
    )
    gt = (rng.integers(0, 16 * 30, (height, width)) / 16).astype(np.float32)
    error = rng.choice(
        [0, 0.25, 0.5, 1, 2, 3, 4, -0.5, -2, -30, 40, 0.3, 1e-3], (height, width)
    )
    disp = (gt + error).astype(np.float32)
    holes = rng.choice([0.0, 0.3, 1.0], p=[0.3, 0.6, 0.1]) if holes is None else holes
    disp[rng.random(gt.shape) < holes] = INF
    if rng.random() < 0.5:
        disp[rng.integers(height)] = INF
    gt[rng.random(gt.shape) < rng.choice([0.0, 0.2])] = INF
    mask = rng.choice(np.array([0, 128, 255], np.uint8), gt.shape)
    return disp, gt, mask


def same(found, wanted):
    assert set(found) == set(wanted)
    for name, value in wanted.items():
        assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-9, nan_ok=True), (
            name
        )


@given(seed=st.integers(0, 2**32 - 1), ndisp=st.integers(1, 40), rounded=st.booleans())
@settings(max_examples=150, deadline=None)
def test_middlebury_equals_the_loops(seed, ndisp, rounded):
    disp, gt, mask = random_case(seed)
    scores = evaluate(disp, gt, mask, ndisp, round_disparity=rounded)
    ones = np.ones(gt.shape, bool)
    same(scores.all, naive.middlebury(disp.tolist(), gt.tolist(), ones, ndisp, rounded))
    same(
        scores.nonocc,
        naive.middlebury(disp.tolist(), gt.tolist(), mask == 255, ndisp, rounded),
    )


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_eth3d_equals_the_loops(seed):
    disp, gt, mask = random_case(seed)
    scores = evaluate(disp, gt, mask, 8, protocol="eth3d")
    if np.isfinite(gt).any():
        same(
            scores.all, naive.eth3d(disp.tolist(), gt.tolist(), np.ones(gt.shape, bool))
        )
    if (np.isfinite(gt) & (mask == 255)).any():
        same(scores.nonocc, naive.eth3d(disp.tolist(), gt.tolist(), mask == 255))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_kitti_equals_the_loops(seed):
    disp, gt, mask = random_case(seed)
    scores = evaluate(disp, gt, mask, 8, protocol="kitti2015")
    same(scores.all, naive.kitti(disp.tolist(), gt.tolist(), np.ones(gt.shape, bool)))
    same(scores.nonocc, naive.kitti(disp.tolist(), gt.tolist(), mask == 255))
    kept = np.where(disp >= 0, disp, INF)
    np.testing.assert_array_equal(
        interpolate_background(kept), naive.fill(disp.tolist())
    )


@pytest.mark.parametrize("scale", [2, 4])
@given(seed=st.integers(0, 2**32 - 1), rounded=st.booleans())
@settings(max_examples=40, deadline=None)
def test_middlebury_takes_a_smaller_map(scale, seed, rounded):
    small, _, _ = random_case(seed, 3, 5)
    _, gt, mask = random_case(seed + 1, 3 * scale, 5 * scale)
    scores = evaluate(small, gt, mask, 20, round_disparity=rounded)
    same(
        scores.nonocc,
        naive.middlebury(small.tolist(), gt.tolist(), mask == 255, 20, rounded, scale),
    )


def test_every_protocol_measures_what_it_lists():
    disp, gt, mask = random_case(5, 12, 12, 0.2)
    for name, protocol in PROTOCOLS.items():
        scores = evaluate(disp, gt, mask, 30, protocol=name, calibration=CALIBRATION)
        assert set(scores.all) == set(protocol.metrics) - set(protocol.auc_metrics)
        scores = evaluate(
            disp,
            gt,
            protocol=name,
            calibration=CALIBRATION,
            confidence=np.ones(gt.shape),
        )
        assert set(scores.all) == set(protocol.metrics)
        assert protocol.name == name
        assert protocol.headline in protocol.metrics


def dense_case(seed=3):
    rng = np.random.default_rng(seed)
    gt = rng.uniform(40, 60, (30, 90)).astype(np.float32)
    return (gt + rng.normal(0, 3, gt.shape)).astype(np.float32), gt


def test_on_dense_maps_inside_the_range_middlebury_and_eth3d_agree():
    disp, gt = dense_case()
    m, e = evaluate(disp, gt, ndisp=90).all, evaluate(disp, gt, protocol="eth3d").all
    assert all(m[name] == e[name] for name in e)
    assert m["invalid"] == 0
    assert all(m[f"totbad{t}"] == m[f"bad{t}"] for t in (0.5, 1.0, 2.0, 4.0))


def test_holes_separate_the_denominators():
    disp, gt = dense_case()
    disp[:, ::3] = INF
    m, e = evaluate(disp, gt, ndisp=90).all, evaluate(disp, gt, protocol="eth3d").all
    assert m["avgerr"] == e["avgerr"]
    assert m["A90"] == e["A90"]
    assert m["bad2.0"] * m.evaluated == pytest.approx(e["bad2.0"] * e.estimated)
    assert m["bad2.0"] < e["bad2.0"] < m["totbad2.0"]
    assert m["coverage"] == e["coverage"] == pytest.approx(100 * 2 / 3)


def test_only_middlebury_clips_to_ndisp():
    gt = np.full((2, 2), 10, np.float32)
    disp = np.array([[-50, 10], [10, 500]], np.float32)
    assert evaluate(disp, gt, ndisp=12).all["avgerr"] == (10 + 2) / 4
    assert evaluate(disp, gt).all["avgerr"] == (10 + 490) / 4
    assert evaluate(disp, gt, ndisp=12, min_disparity=9).all["avgerr"] == (1 + 11) / 4


def test_eth3d_counts_estimates_above_the_image_width_as_invalid():
    gt = np.full((1, 20), 10, np.float32)
    disp = gt.copy()
    disp[0, :4] = [20, 20.5, -20, -20.5]
    scores = evaluate(disp, gt, protocol="eth3d").all
    assert scores["coverage"] == 90
    assert scores["avgerr"] == pytest.approx((10 + 30) / 18)


def test_d1_needs_both_tests():
    gt = np.array([[10, 100, 100, 100]], np.float32)
    disp = np.array([[13.5, 104, 106, 103]], np.float32)
    assert evaluate(disp, gt, protocol="kitti2015").all["D1"] == 50
    assert evaluate(disp, gt).all["bad2.0"] == 100


def test_d1_counts_errors_of_exactly_5_percent_but_not_of_3_pixels():
    """KITTI's devkit compares a float32 ratio with a double limit, and 0.05 in float32 is above 0.05 in double."""
    gt = np.array([[20, 100, 100, 100]], np.float32)
    disp = np.array([[23, 104.99609375, 105, 95]], np.float32)
    assert evaluate(disp, gt, protocol="kitti2015").all["D1"] == 50


@pytest.mark.parametrize("sign", [1, -1])
def test_d1_of_every_png_value_with_an_error_of_exactly_5_percent(sign):
    codes = np.arange(15_380, 62_401, 20)[None]  # 5% is above 3 px
    gt, disp = (
        (values / 256).astype(np.float32)
        for values in (codes, codes + sign * codes // 20)
    )
    assert evaluate(disp, gt, protocol="kitti2015").all["D1"] == 100
    nearer = disp - np.float32(sign / 256)
    assert evaluate(nearer, gt, protocol="kitti2015").all["D1"] == 0


def test_d1_scores_a_gap_that_stays_as_minus_one():
    """The devkit's `interpolateBackground` leaves a row without estimates between two others, and invalid is -1."""
    gt = np.array([[9, 9, 9], [1, 2, 2.00390625], [9, 9, 9]], np.float32)
    disp = np.array([[9, 9, 9], [INF, INF, -5], [9, 9, 9]], np.float32)
    scores = evaluate(disp, gt, protocol="kitti2015").all
    assert scores["D1"] == pytest.approx(100 / 9)
    assert (scores["D1_est"], scores.estimated) == (0, 6)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_d1_takes_the_ratio_in_float32(seed):
    """Truths and errors of exactly 5%, where 0.05 in float64 and in float32 decide differently."""
    rng = np.random.default_rng(seed)
    gt = (rng.integers(61 * 256, 250 * 256, (5, 40)) / 256).astype(np.float32)
    disp = (gt * rng.choice([1.05, 0.95], gt.shape)).astype(np.float32)
    found = evaluate(disp, gt, protocol="kitti2015").all
    same(found, naive.kitti(disp.tolist(), gt.tolist(), np.ones(gt.shape, bool)))


def test_middlebury_counts_estimates_above_1000_ndisp_as_invalid():
    gt = np.full((1, 4), 10, np.float32)
    disp = np.array([[10, 60, 12000, 12001]], np.float32)
    scores = evaluate(disp, gt, ndisp=12).all
    assert (scores["invalid"], scores["bad1.0"], scores["avgerr"]) == (
        25,
        50,
        pytest.approx((0 + 2 + 2) / 3),
    )
    same(
        scores,
        naive.middlebury(disp.tolist(), gt.tolist(), np.ones(gt.shape, bool), 12),
    )


@given(seed=st.integers(0, 2**32 - 1), isint=st.booleans())
@settings(max_examples=30, deadline=None)
def test_isint_rounds_estimates_under_middlebury_only(seed, isint):
    disp, gt, mask = random_case(seed, 12, 12)
    calibration = CALIBRATION.replace(isint=isint)
    scores = evaluate(disp, gt, mask, 20, calibration=calibration)
    assert scores.rounded == isint
    same(
        scores.all,
        naive.middlebury(
            disp.tolist(), gt.tolist(), np.ones(gt.shape, bool), 20, isint
        ),
    )
    eth3d = evaluate(disp, gt, mask, 20, protocol="eth3d", calibration=calibration)
    assert not eth3d.rounded
    assert not evaluate(
        disp, gt, mask, 20, calibration=calibration, round_disparity=False
    ).rounded


def test_d1_fills_what_eth3d_leaves_out_and_middlebury_counts_bad():
    gt = np.array([[1, 1, 1, 4]], np.float32)
    disp = np.array([[1, INF, INF, 4]], np.float32)
    assert evaluate(disp, gt, protocol="kitti2015").all["D1"] == 0
    assert evaluate(disp, gt, protocol="eth3d").all["bad4.0"] == 0
    assert evaluate(disp, gt).all["totbad4.0"] == 50


def test_thresholds_are_strict():
    gt = np.full((1, 4), 8, np.float32)
    disp = gt + np.array([[0.5, 1, 2, 4]], np.float32)
    scores = evaluate(disp, gt).all
    assert [scores[f"bad{t}"] for t in (0.5, 1.0, 2.0, 4.0)] == [75, 50, 25, 0]


def test_a_bool_mask_and_its_uint8_form_are_one():
    disp, gt, mask = random_case(11, 9, 9, 0.2)
    assert evaluate(disp, gt, mask).nonocc == evaluate(disp, gt, mask == 255).nonocc


def test_regions_carry_their_counts():
    disp, gt, mask = random_case(12, 9, 9, 0.2)
    scores = evaluate(disp, gt, mask, regions={"left": np.indices(gt.shape)[1] < 4})
    left = scores.regions["left"]
    assert (left.image, left.evaluated) == (81, np.isfinite(gt[:, :4]).sum())
    assert left.estimated == (np.isfinite(gt) & np.isfinite(disp))[:, :4].sum()
    assert scores.all.evaluated == np.isfinite(gt).sum()


def test_an_empty_region_has_no_score():
    disp, gt, _ = random_case(1, 5, 5, 0.0)
    for name in PROTOCOLS:
        scores = evaluate(
            disp, gt, np.zeros(gt.shape, bool), protocol=name, calibration=CALIBRATION
        ).nonocc
        assert scores.evaluated == 0
        assert all(math.isnan(v) for v in scores.values())


def test_nonocc_without_a_mask_says_what_is_missing():
    disp, gt, _ = random_case(1, 5, 5)
    with pytest.raises(InputError, match="mask_nonocc"):
        _ = evaluate(disp, gt).nonocc


FLAT = np.ones((4, 6), np.float32)


def poked(value):
    array = FLAT.copy()
    array[2, 3] = value
    return array


@pytest.mark.parametrize(
    ("args", "options", "says"),
    [
        (
            (poked(np.nan), FLAT),
            {},
            r"disp holds NaN at 1 of 24 pixels, the first at x=3, y=2",
        ),
        ((FLAT, poked(np.nan)), {}, "gt holds NaN"),
        (("a.pfm", "b.pfm"), {}, "^gt is str: expected an array of real numbers"),
        (
            (FLAT.astype(complex), FLAT),
            {},
            "disp is complex128: expected an array of real numbers",
        ),
        ((poked(-np.inf), FLAT), {}, r"disp holds -inf"),
        ((FLAT, poked(-np.inf)), {"protocol": "eth3d"}, r"gt holds -inf"),
        ((FLAT[:, :5], FLAT), {}, r"disp has shape \(4, 5\)"),
        ((FLAT[:2, :3], FLAT), {"protocol": "kitti2015"}, r"disp has shape \(2, 3\)"),
        ((FLAT[0], FLAT), {}, r"\(6,\): expected \(height, width\)"),
        ((FLAT.astype(complex), FLAT), {}, "complex128"),
        ((FLAT, FLAT, FLAT), {}, "mask_nonocc holds float32"),
        ((FLAT, FLAT, FLAT[:3] > 0), {}, r"mask_nonocc has shape \(3, 6\)"),
        ((FLAT, FLAT, None, 0), {}, "ndisp is 0"),
        ((FLAT, FLAT), {"min_disparity": math.nan}, "min_disparity is nan"),
        ((FLAT, FLAT), {"protocol": "points"}, "needs the pair's calibration"),
        ((FLAT, FLAT), {"protocol": "midlebury"}, "did you mean 'middlebury-v3'"),
        ((FLAT, FLAT), {"regions": {"all": FLAT > 0}}, "region 'all'"),
        ((FLAT, FLAT), {"regions": {"edge": FLAT}}, "region 'edge' holds float32"),
    ],
)
def test_bad_input_is_refused_in_one_line(args, options, says):
    with pytest.raises(InputError, match=says) as error:
        evaluate(*args, **options)
    assert "\n" not in str(error.value)


def test_the_message_lists_the_accepted_sizes():
    """A truth of odd size has no half size."""
    with pytest.raises(InputError) as error:
        evaluate(np.ones((2, 2)), np.ones((5, 6)))
    assert str(error.value).endswith("expects (5, 6) for a truth of (5, 6)")
    with pytest.raises(InputError, match=r"expects \(6, 10\) or \(3, 5\) for a truth"):
        evaluate(np.ones((2, 2)), np.ones((6, 10)))


def test_a_confidence_adds_the_area_of_its_sparsification():
    rng = np.random.default_rng(2)
    gt, trust = rng.uniform(6, 12, (20, 30)).astype(np.float32), rng.random((20, 30))
    disp = (gt + rng.normal(0, 2, gt.shape)).astype(np.float32)
    disp[rng.random(gt.shape) < 0.2], gt[:2] = INF, INF
    known = np.isfinite(gt) & np.isfinite(disp)
    for protocol, limit in (("middlebury-v3", 2.0), ("eth3d", 1.0)):
        scores = evaluate(disp, gt, protocol=protocol, confidence=trust).all
        bad = np.abs(disp[known].astype(float) - gt[known]) > limit
        curve = sparsification(trust[known], bad)
        assert scores[f"auc{limit}"] == pytest.approx(100 * curve.auc)
        assert scores[f"auc{limit}_opt"] == pytest.approx(100 * curve.optimal_auc)
        assert scores.sparsification[-1] == pytest.approx(100 * bad.mean())
        assert not evaluate(disp, gt, protocol=protocol).all.sparsification
        assert f"auc{limit}" not in evaluate(disp, gt, protocol=protocol).all
    assert not evaluate(
        disp, gt, protocol="kitti2015", confidence=trust
    ).all.sparsification


def test_a_confidence_of_a_small_map_is_enlarged_but_not_scaled():
    disp, gt, _ = random_case(3, 6, 8, 0.0)
    trust = np.random.default_rng(2).random(gt.shape)
    large = [
        np.repeat(np.repeat(values, 2, axis=0), 2, axis=1)
        for values in (disp * 2, gt * 2, trust)
    ]
    small = evaluate(disp, large[1], confidence=trust).all
    assert (
        small.sparsification
        == evaluate(*large[:2], confidence=large[2]).all.sparsification
    )


def test_wrong_confidences_are_refused():
    with pytest.raises(InputError, match="expected numbers of disp's shape"):
        evaluate([[1.0, 2.0]], [[1.0, 2.0]], confidence=[[1.0]])
    with pytest.raises(InputError, match="NaN"):
        evaluate([[1.0, 2.0]], [[1.0, 2.0]], confidence=[[1.0, np.nan]])
