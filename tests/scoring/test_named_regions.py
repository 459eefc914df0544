"""Every named region against a naive loop over pixels, written from the text that tables print."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.scoring import scoring_loops as naive
from twinlens.dataset import Calibration
from twinlens.scoring import (
    PROTOCOLS,
    REGIONS,
    Pair,
    evaluate,
    region_masks,
    run_benchmark,
)

KINDS = {"diffuse": 1, "glossy": 2, "mirror": 3, "transmissive": 4}


def random_pair(seed):
    """Flat and noisy patches, disparity steps of 2 px and slightly less, every value of mask and material."""
    rng = np.random.default_rng(seed)
    height, width = (int(n) for n in rng.integers(6, 16, 2))
    image = rng.integers(0, 256, (height, width, 3), np.uint8)
    image[:, : width // 2] = rng.choice([100, 101, 103, 106], (height, width // 2, 1))
    if rng.random() < 0.3:
        image = image[..., 0].copy()
    gt = rng.choice(np.float32([3, 4.5, 4.99, 5, 5.01, 7, 30, np.inf]), (height, width))
    gt[: height // 2, : width // 2] = 4
    mask = rng.choice(np.array([0, 128, 255], np.uint8), gt.shape, p=[0.1, 0.3, 0.6])
    blur = rng.choice(np.float32([-9, -2.01, -2, 0, 1.99, 2, 2.01, np.inf]), gt.shape)
    kind = rng.integers(0, 5, gt.shape).astype(np.uint8)
    return Pair("p", image, image.copy(), gt, mask, 32, None, blur, kind)


def naive_regions(pair):
    """Region -> set of (y, x) with known truth."""
    height, width = pair.disp0.shape
    gt, mask = pair.disp0.tolist(), pair.mask0_nonocc.tolist()
    known = {(y, x) for y in range(height) for x in range(width) if gt[y][x] < math.inf}
    seen = {(y, x) for y, x in known if mask[y][x] == 255}
    values = sorted(gt[y][x] for y, x in known) or [0.0]
    third = (values[-1] - values[0]) / 3
    levels = pair.im0.reshape(height, width, -1).tolist()

    def rough(y, x):
        """The larger mean squared step to the left or right neighbour; y and x may be one pixel outside."""
        y, x = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
        neighbours = [k for k in (x - 1, x + 1) if 0 <= k < width]
        return max(
            sum((a - b) ** 2 for a, b in zip(levels[y][x], levels[y][k], strict=True))
            / len(levels[y][x])
            for k in neighbours
        )

    def flat(y, x):
        return (
            math.fsum(rough(y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1)) / 9
            < 16 - 1e-9
        )

    jumps = set()
    for y, x in known:
        for place in ((y + 1, x), (y, x + 1)):
            if place in known and abs(gt[y][x] - gt[place[0]][place[1]]) >= 2:
                jumps |= {(y, x), place}
    near_jump = {
        (y, x)
        for y, x in known
        if any(abs(y - j) <= 4 and abs(x - i) <= 4 for j, i in jumps)
    }
    found = {
        "all": known,
        "nonocc": seen,
        "occluded": {(y, x) for y, x in known if mask[y][x] == 128},
        "textureless": {(y, x) for y, x in seen if flat(y, x)},
        "discontinuity": near_jump & seen,
        "out-of-focus": {
            (y, x) for y, x in known if 2 < abs(pair.blur0[y, x]) < math.inf
        },
        "far": {(y, x) for y, x in known if gt[y][x] <= values[0] + third},
        "near": {(y, x) for y, x in known if gt[y][x] > values[0] + 2 * third},
    }
    found["mid"] = known - found["far"] - found["near"]
    return found | {
        name: {p for p in known if pair.material_kind0[p] == code}
        for name, code in KINDS.items()
    }


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_every_region_equals_the_loops(seed):
    pair = random_pair(seed)
    wanted = naive_regions(pair)
    assert set(wanted) == set(REGIONS)
    known = np.isfinite(pair.disp0)
    for name, mask in region_masks(pair, REGIONS).items():
        assert {(int(y), int(x)) for y, x in np.argwhere(mask & known)} == wanted[
            name
        ], name


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_every_protocol_in_every_region_equals_the_loops(seed):
    """Naive protocols within naive regions."""
    pair, rng = random_pair(seed), np.random.default_rng(seed + 1)
    truth = np.where(np.isfinite(pair.disp0), pair.disp0, 5)
    disp = (truth + rng.choice([0, 0.4, -1.5, 2, 2.2, 3.5, -40], truth.shape)).astype(
        np.float32
    )
    disp[rng.random(disp.shape) < 0.2] = np.inf
    masks = region_masks(pair, REGIONS)
    others = {
        name: mask for name, mask in masks.items() if name not in ("all", "nonocc")
    }
    scores = {
        p: evaluate(disp, pair.disp0, masks["nonocc"], 32, protocol=p, regions=others)
        for p in LOOPS
    }
    for name, pixels in naive_regions(pair).items():
        inside = [
            [(y, x) in pixels for x in range(disp.shape[1])]
            for y in range(disp.shape[0])
        ]
        for rules, loop in LOOPS.items():
            assert scores[rules].regions[name].evaluated == len(pixels)
            if pixels:
                wanted = loop(disp.tolist(), pair.disp0.tolist(), inside)
                assert dict(scores[rules].regions[name]) == pytest.approx(
                    wanted, rel=1e-9, abs=1e-9, nan_ok=True
                ), (
                    rules,
                    name,
                )


LOOPS = {
    "middlebury-v3": lambda disp, gt, mask: naive.middlebury(disp, gt, mask, 32),
    "eth3d": naive.eth3d,
    "kitti2015": naive.kitti,
}


def test_an_image_one_pixel_wide_has_no_textureless_region():
    one = Pair(
        "p",
        np.zeros((4, 1), np.uint8),
        np.zeros((4, 1), np.uint8),
        np.ones((4, 1), np.float32),
        None,
        2,
    )
    seen = replace(one, mask0_nonocc=np.full((4, 1), 255, np.uint8))
    assert list(region_masks(seen, ["textureless", "all", "discontinuity"])) == [
        "all",
        "discontinuity",
    ]


def test_mirror_and_glass_are_separate_regions():
    pair = random_pair(7)
    masks = region_masks(pair, ["mirror", "transmissive"])
    assert (masks["mirror"] & masks["transmissive"]).sum() == 0
    assert masks["mirror"].sum() == (pair.material_kind0 == 3).sum() > 0
    assert masks["transmissive"].sum() == (pair.material_kind0 == 4).sum() > 0


def test_one_board_holds_errors_in_metres_and_pixels():
    """One map scored by every protocol in every region."""
    calibration = Calibration(
        (90.0, 90.0, 5.0, 5.0), (90.0, 90.0, 5.0, 5.0), 0.1, 8, 8, 0.0
    )
    pair = replace(random_pair(3), calibration=calibration)

    class Off:
        name = "off"

        def match(self, left, right, *, num_disparities, min_disparity):
            return np.where(np.isfinite(pair.disp0), pair.disp0 + 1, np.inf).astype(
                np.float32
            )

    board = run_benchmark(
        [pair],
        [Off()],
        protocol=list(PROTOCOLS),
        regions=["all", "near", "far"],
        warm_up=False,
    )
    assert [e.protocol for e in board.entries] == list(PROTOCOLS)
    pixels, metres = (
        board.find("off", "p", name) for name in ("middlebury-v3", "points")
    )
    for region in ("all", "near", "far"):
        assert pixels.value(region, "avgerr") == pytest.approx(1, abs=1e-6)
    known = pair.disp0[np.isfinite(pair.disp0)].astype(float)
    depth_error = 90 * 0.1 / known - 90 * 0.1 / (known + 1)
    assert metres.value("far", "point_avgerr") > metres.value("near", "point_avgerr")
    assert (
        metres.value("all", "point_avgerr") >= depth_error.mean()
    )  # along the ray it is longer than along the axis
