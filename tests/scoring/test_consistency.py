"""Measures without truth: closed forms of shifted pairs, OpenCV's warps, naive loops; and boards of such pairs."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.scoring.scoring_methods import Constant
from twinlens.cli.boards import without_truth
from twinlens.errors import InputError
from twinlens.matching import StereoMatcher
from twinlens.scoring import (
    PROTOCOLS,
    MapFolder,
    Pair,
    board_to_json,
    evaluate,
    load_pair,
    read_board,
    run_benchmark,
    with_disagreements,
    write_board,
)
from twinlens.scoring.board_file import board_from_json
from twinlens.scoring.consistency import (
    apart,
    check_views,
    mirrored,
    of_right_map,
    photometric_residual,
)

HEIGHT, WIDTH, SHIFT = 24, 60, 7


def shifted_pair(dtype=np.uint8, channels=(), name="shifted"):
    """A pair whose left image is the right one moved by SHIFT pixels; columns below SHIFT have no match."""
    top = np.iinfo(dtype).max
    rng = np.random.default_rng(4)
    shape = (HEIGHT, WIDTH + SHIFT, *channels)
    wide = rng.integers(0, top, shape, dtype, endpoint=True)
    left, right = wide[:, :WIDTH], wide[:, SHIFT:]
    return Pair(name, left.copy(), right.copy(), None, None, 16)


def flat(value):
    return np.full((HEIGHT, WIDTH), value, np.float32)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_constant_shift_has_no_residual_and_agrees_with_the_right_view(
    dtype, channels
):
    pair = shifted_pair(dtype, channels)
    scores = check_views(flat(SHIFT), pair.im0, pair.im1, flat(SHIFT)).all
    assert scores["photo_mean"] == pytest.approx(0, abs=1e-9)
    assert scores["photo_A90"] == pytest.approx(0, abs=1e-9)
    assert scores["lr_consistent"] == 100
    # The matches of the first SHIFT columns are outside the right image.
    assert scores["confirmed"] == pytest.approx(100 * (WIDTH - SHIFT) / WIDTH)
    assert scores["coverage"] == 100


@pytest.mark.parametrize("offset", [3, -11])
def test_a_difference_of_exposure_is_the_residual(offset):
    pair = shifted_pair()
    left = np.clip(pair.im0, 20, 200)
    right = np.clip(pair.im1, 20, 200)
    brighter = (left.astype(int) + offset).astype(np.uint8)
    scores = check_views(flat(SHIFT), brighter, right).all
    assert scores["photo_mean"] == pytest.approx(abs(offset), abs=1e-9)
    assert scores["photo_A50"] == pytest.approx(abs(offset), abs=1e-9)
    assert np.isnan(scores["lr_consistent"])
    assert np.isnan(scores["confirmed"])


def test_the_residual_of_a_slanted_surface_is_that_of_opencvs_warp():
    """Rows that are linear, of random levels: OpenCV's linear interpolation and cubic splines are both exact."""
    rng = np.random.default_rng(9)
    rows, columns = np.mgrid[0:80, 0:120].astype(np.float32)
    slopes, levels = rng.uniform(-0.5, 0.5, (80, 1)), rng.uniform(80, 150, (80, 1))
    right = np.rint(257 * (levels + slopes * columns)).astype(np.uint16)
    # OpenCV rounds coordinates to 1/32 px.
    disparity = np.rint(32 * (3 + 0.05 * columns + 0.02 * rows)) / np.float32(32)
    coordinates = (columns - disparity).astype(np.float32)
    warped = cv2.remap(right.astype(np.float32), coordinates, rows, cv2.INTER_LINEAR)
    left = np.rint(warped + 257 * 5).astype(np.uint16)  # 5 grey levels brighter
    residual = photometric_residual(left, right, disparity)
    assert np.isnan(residual[coordinates < 0]).all()
    inner = (coordinates > 12) & (coordinates < 107)  # a spline is bent at borders
    assert inner.sum() > 5000
    assert np.abs(residual[inner] - 5).max() < 2 / 257  # four rounded values


def naive_of_right(left, right):
    """The rule of `of_right_map`, pixel by pixel."""
    result = np.full(left.shape, np.nan)
    for y, x in np.ndindex(left.shape):
        if not np.isfinite(left[y, x]):
            continue
        match = round(x - float(left[y, x]))
        if 0 <= match < left.shape[1]:
            result[y, x] = right[y, match]
    return result


@pytest.mark.parametrize("seed", range(4))
def test_the_right_map_is_read_at_the_match(seed):
    rng = np.random.default_rng(seed)
    left = rng.uniform(-6, 14, (9, 17)).astype(np.float32)
    right = rng.uniform(-6, 14, (9, 17)).astype(np.float32)
    left[rng.random(left.shape) < 0.2] = np.inf
    right[rng.random(right.shape) < 0.2] = np.inf
    np.testing.assert_array_equal(
        of_right_map(left, right), naive_of_right(left, right)
    )


@pytest.mark.parametrize("share", [0.0, 0.15, 0.6])
def test_known_shares_of_disagreement(share):
    """Of the right pixels a known number is off by 3 px: so many left pixels are not confirmed."""
    rng = np.random.default_rng(1)
    pair = shifted_pair()
    right = flat(SHIFT)
    # The last SHIFT columns of the right view have no left pixel.
    off = rng.random((HEIGHT, WIDTH - SHIFT)) < share
    right[:, : WIDTH - SHIFT][off] += 3
    scores = check_views(flat(SHIFT), pair.im0, pair.im1, right).all
    good = off.size - off.sum()
    assert scores["lr_consistent"] == pytest.approx(100 * good / off.size)
    assert scores["confirmed"] == pytest.approx(100 * good / (HEIGHT * WIDTH))
    assert apart(right, flat(SHIFT)) == (
        HEIGHT * WIDTH,
        pytest.approx(100 * off.sum() / (HEIGHT * WIDTH)),
    )


def test_one_pixel_is_agreement_and_unknown_pixels_confirm_nothing():
    pair = shifted_pair()
    right = flat(SHIFT + 1)
    assert (
        check_views(flat(SHIFT), pair.im0, pair.im1, right).all["lr_consistent"] == 100
    )
    right[:12] = np.inf
    scores = check_views(flat(SHIFT), pair.im0, pair.im1, right).all
    assert scores["lr_consistent"] == 50
    none = check_views(flat(np.inf), pair.im0, pair.im1, right).all
    assert none["coverage"] == none["confirmed"] == 0
    assert np.isnan(none["photo_mean"])
    assert np.isnan(none["lr_consistent"])
    assert apart(flat(np.inf), right)[0] == 0


def test_every_metric_of_the_protocol_is_measured():
    pair = shifted_pair()
    rules = PROTOCOLS["consistency"]
    scores = check_views(flat(SHIFT), pair.im0, pair.im1, flat(SHIFT))
    assert tuple(scores.all) == rules.metrics
    assert {rules.headline, *rules.columns} <= set(rules.metrics)
    assert not rules.needs_truth
    with pytest.raises(
        InputError, match=r"compares no truth: use scoring\.check_views"
    ):
        evaluate(flat(1), flat(1), protocol="consistency")


def two_planes():
    """A pair with a square at 12 px before a plane at 4 px, and the true maps of both views."""
    rng = np.random.default_rng(3)
    texture = rng.integers(0, 256, (40, 120), np.uint8)
    square = rng.integers(0, 256, (16, 24), np.uint8)
    left, right = texture[:, :90].copy(), texture[:, 4:94].copy()
    true_left, true_right = np.full((40, 90), 4.0), np.full((40, 90), 4.0)
    left[12:28, 40:64], true_left[12:28, 40:64] = square, 12
    right[12:28, 28:52], true_right[12:28, 28:52] = square, 12
    return Pair("planes", left, right, None, None, 20), true_left, true_right


def test_the_mirrored_pair_gives_the_map_of_the_right_view():
    pair, true_left, true_right = two_planes()
    matcher = StereoMatcher("sad", 5, num_disparities=20)
    maps = {}
    run_benchmark(
        [pair],
        [Named(matcher)],
        warm_up=False,
        on_map=lambda m, s, d: maps.update(left=d),
        on_right_map=lambda m, s, d: maps.update(right=d),
    )
    for name, truth in (("left", true_left), ("right", true_right)):
        inner = np.s_[4:36, 16:74]  # windows and matches inside both images
        right_share = np.mean(np.abs(maps[name] - truth)[inner] < 0.6)
        # The others are at most the rim of the square, two pixels wide, and the 8 columns that it hides.
        rim = (2 * (16 + 24) * 2 + 16 * 8) / (32 * 58)
        assert right_share > 1 - rim, name
    twice = mirrored(mirrored(pair))
    np.testing.assert_array_equal(twice.im0, pair.im0)
    np.testing.assert_array_equal(twice.im1, pair.im1)


class Named:
    """A matcher under a name of its own."""

    def __init__(self, matcher):
        self.name, self.matcher = "named", matcher

    def match(self, left, right, **search):
        return self.matcher.match(left, right)


def board_of(samples, methods, **options):
    maps = {}
    board = run_benchmark(
        samples,
        methods,
        warm_up=False,
        on_map=lambda m, s, d: maps.update({(m, s): d}),
        **options,
    )
    return with_disagreements(board, maps), maps


def test_methods_that_share_no_pixel_do_not_enter_the_mean_disagreement():
    methods = [Constant("right", SHIFT), Constant("wrong", SHIFT + 4)]
    pairs = [replace(shifted_pair(), name=name) for name in ("a", "b")]
    board, _ = board_of(pairs, methods)
    first, second = board.disagreements
    nothing = replace(first, compared=0, apart=math.nan)
    half = replace(second, apart=50.0)
    (line,) = without_truth(replace(board, disagreements=(nothing, half)))[1:]
    assert line.startswith("right and wrong: on average 50.0 % of their estimates")
    assert len(without_truth(replace(board, disagreements=(nothing,)))) == 1


def with_truth(pair, name):
    return replace(pair, disp0=flat(SHIFT), name=name)


def test_pairs_without_truth_have_the_measures_that_need_none():
    blind, seeing = shifted_pair(), with_truth(shifted_pair(), "seeing")
    methods = [Constant("right", SHIFT), Constant("wrong", SHIFT + 4, holes=6)]
    board, _ = board_of([seeing, blind], methods, regions=["nonocc", "all", "near"])
    assert board.samples_of("middlebury-v3") == ("seeing",)
    assert board.samples_of("consistency") == ("shifted",)
    assert board.regions_of("consistency") == ("all",)
    scored = board.mean("right", "middlebury-v3", "all")
    assert (scored.counted, scored.missing) == (1, ())
    assert scored.metrics["totbad2.0"] == 0
    (pair,) = board.disagreements
    assert (pair.sample, pair.first, pair.second) == ("shifted", "right", "wrong")
    estimated = board.find("wrong", "shifted", "consistency").regions["all"].estimated
    assert (pair.compared, pair.apart) == (estimated, 100)
    assert board_from_json(board_to_json(board)) == board
    assert board.without(lambda entry: entry.method == "wrong").disagreements == ()


def test_a_board_without_truth_resumes(tmp_path):
    blind = shifted_pair()
    maps = MapFolder(tmp_path / "maps")
    options = {"save": tmp_path / "board.json", "on_map": maps.keep, "warm_up": False}
    first = run_benchmark([blind], [Constant("a", SHIFT)], **options)
    write_board(with_disagreements(first, maps), tmp_path / "board.json")
    steps = []
    board = run_benchmark(
        [blind],
        [Constant("a", SHIFT), Constant("b", SHIFT + 3)],
        progress=steps.append,
        **options,
    )
    assert [step.skipped for step in steps] == [True, False]
    board = with_disagreements(board, maps)
    assert [pair.apart for pair in board.disagreements] == [100]
    write_board(board, tmp_path / "board.json")
    assert read_board(tmp_path) == board
    document = json.loads((tmp_path / "board.json").read_text())
    assert document["disagreements"][0]["apart"] == 100


class FailsMirrored:
    """Fails on the pair that begins with a column of zeros."""

    name = "half"

    def match(self, left, right, **search):
        if not left[:, 0].any():
            raise RuntimeError("no column")
        return flat(SHIFT)


def test_a_failure_on_the_mirrored_images_keeps_the_map_of_the_left_view():
    protocols = ["middlebury-v3", "consistency"]
    pair = with_truth(shifted_pair(), "seeing")
    pair.im1[:, -1] = 0  # the first column of the mirrored left image
    with pytest.warns(UserWarning, match=r"half on 'seeing': no left-right.*no column"):
        board, maps = board_of([pair], [FailsMirrored()], protocol=protocols)
    assert maps.keys() == {("half", "seeing")}
    assert list(board.protocols) == protocols
    scored, measured = (board.find("half", "seeing", name) for name in protocols)
    assert scored.ok
    assert scored.value("all", "totbad2.0") == 0
    assert measured.ok
    assert measured.value("all", "photo_mean") == pytest.approx(0, abs=1e-9)
    assert np.isnan(measured.value("all", "confirmed"))
    again = board_from_json(board_to_json(board))
    assert again.find("half", "seeing", "consistency").ok
    # The mended method is run again only where failures are asked for.
    fixed = FailsMirrored()
    fixed.match = lambda left, right, **search: flat(SHIFT)
    for retry, share in ((False, math.nan), (True, 100.0)):
        options = {"protocol": protocols, "board": again, "retry_failed": retry}
        later, _ = board_of([pair], [fixed], **options)
        entry = later.find("half", "seeing", "consistency")
        consistent = entry.value("all", "lr_consistent")
        assert consistent == pytest.approx(share, nan_ok=True)


def test_objects_without_truth_are_samples():
    class Sample:
        name, disp0, mask0_nonocc, ndisp = "mine", None, None, 16
        im0, im1 = shifted_pair().im0, shifted_pair().im1

    pair = load_pair(Sample())
    assert pair.disp0 is None
    assert not np.isfinite(pair.truth).any()
    assert pair.shape == (HEIGHT, WIDTH)
    board, _ = board_of([Sample()], [Constant("right", SHIFT)])
    assert board.protocols == ("consistency",)
