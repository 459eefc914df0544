"""Every named region against a naive loop over pixels, written from the text that tables print."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.scoring.scoring_methods import pair
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import InputError
from twinlens.scoring import REGIONS, Pair, region_masks
from twinlens.scoring.regions import discontinuity, distance_bands, textureless


def random_pair(seed):
    """Flat and noisy patches, disparity steps of 2 px and slightly less, every value of mask and material."""
    rng = np.random.default_rng(seed)
    height, width = shape = tuple(rng.integers(6, 16, 2))
    image = rng.integers(0, 256, (*shape, 3), np.uint8)
    image[:, : width // 2] = rng.choice([100, 101, 103, 106], (height, width // 2, 1))
    if rng.random() < 0.3:
        image = image[..., 0].copy()
    gt = rng.choice(np.float32([3, 4.5, 4.99, 5, 5.01, 7, 30, np.inf]), shape)
    gt[: height // 2, : width // 2] = 4
    mask = rng.choice(np.uint8([0, 128, 255]), shape, p=[0.1, 0.3, 0.6])
    blur = rng.choice(np.float32([-9, -2.01, -2, 0, 1.99, 2, 2.01, np.inf]), shape)
    kind = rng.integers(0, len(MATERIAL_KINDS), shape).astype(np.uint8)
    return Pair("p", image, image.copy(), gt, mask, 32, None, blur, kind)


def naive_textureless(image):
    """Of (H, W, C) levels: the mean over 3x3 of the larger mean squared step to a neighbour is below 16."""
    height, width, _ = image.shape
    levels = image.astype(float)

    def rough(y, x):
        y, x = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
        neighbours = [k for k in (x - 1, x + 1) if 0 <= k < width]
        return max(np.mean((levels[y, x] - levels[y, k]) ** 2) for k in neighbours)

    flat = set()
    for y, x in np.ndindex(height, width):
        near = [rough(y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1)]
        if math.fsum(near) / 9 < 16 - 1e-9:
            flat.add((y, x))
    return flat


def naive_discontinuity(gt):
    """Pixels within 9x9 of two neighbours whose known disparities differ by 2 px or more."""
    jumps = set()
    gt = np.where(np.isfinite(gt), gt, np.nan)
    for y, x in np.ndindex(gt.shape):
        for j, i in ((y + 1, x), (y, x + 1)):
            inside = j < gt.shape[0] and i < gt.shape[1]
            if inside and abs(gt[y, x] - gt[j, i]) >= 2:
                jumps |= {(y, x), (j, i)}
    return {
        (y, x)
        for y, x in np.ndindex(gt.shape)
        if any(abs(y - j) <= 4 and abs(x - i) <= 4 for j, i in jumps)
    }


def places(mask):
    return {(int(y), int(x)) for y, x in np.argwhere(mask)}


def naive_regions(pair):
    """Region -> set of (y, x) with known truth."""
    gt, mask = pair.disp0, pair.mask0_nonocc
    known = [place for place in np.ndindex(gt.shape) if gt[place] < math.inf]
    values = [float(gt[place]) for place in known] or [0.0]
    low, third = min(values), (max(values) - min(values)) / 3
    nonocc = {place for place in known if mask[place] == 255}
    image = pair.im0.reshape(*gt.shape, -1)
    regions = {
        "all": set(known),
        "nonocc": nonocc,
        "occluded": {place for place in known if mask[place] == 128},
        "textureless": naive_textureless(image) & nonocc,
        "discontinuity": naive_discontinuity(gt) & nonocc,
        "out-of-focus": {p for p in known if 2 < abs(pair.blur0[p]) < math.inf},
        "far": {place for place in known if gt[place] <= low + third},
        "near": {place for place in known if gt[place] > low + 2 * third},
    }
    regions["mid"] = regions["all"] - regions["far"] - regions["near"]
    for code, name in enumerate(MATERIAL_KINDS[1:], start=1):
        regions[name] = {p for p in known if pair.material_kind0[p] == code}
    return regions


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_every_region_equals_the_loops(seed):
    pair = random_pair(seed)
    expected = naive_regions(pair)
    known = np.isfinite(pair.disp0)
    masks = region_masks(pair, REGIONS)
    assert {name: places(mask & known) for name, mask in masks.items()} == expected


def test_the_limit_itself_has_texture():
    steps = np.array([[0, 4, 8, 12, 16, 20]], np.uint8)
    assert not textureless(steps).any()
    assert textureless(steps, limit=4.001).all()


def test_a_third_of_the_range_includes_its_upper_end():
    near, mid, far = distance_bands([[1.0, 2.0, 3.0, 4.0]])
    assert near.tolist() == [[False, False, False, True]]
    assert mid.tolist() == [[False, False, True, False]]
    assert far.tolist() == [[True, True, False, False]]


def test_a_bool_mask_of_visibility_calls_the_rest_occluded():
    full = random_pair(1)
    seen = full.mask0_nonocc == 255
    masks = region_masks(replace(full, mask0_nonocc=seen), ["nonocc", "occluded"])
    np.testing.assert_array_equal(masks["nonocc"], seen)
    np.testing.assert_array_equal(masks["occluded"], ~seen)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: discontinuity(np.full((3, 3), np.nan)), "gt holds NaN"),
        (lambda: region_masks(pair(), ["miror"]), "did you mean 'mirror'"),
    ],
)
def test_bad_arguments_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_regions_without_data_are_left_out():
    assert list(region_masks(random_pair(0), REGIONS)) == list(REGIONS)
    assert list(region_masks(pair(mask=False), REGIONS)) == [
        "all",
        "near",
        "mid",
        "far",
    ]
    column = np.zeros((4, 1), np.uint8)
    one = Pair("p", column, column, column + np.float32(1), column + np.uint8(255), 2)
    assert list(region_masks(one, ["textureless", "all"])) == ["all"]


def test_sixteen_bit_images_have_the_same_texture():
    eight = random_pair(2)
    sixteen = replace(
        eight, im0=eight.im0 * np.uint16(257), im1=eight.im1 * np.uint16(257)
    )
    masks = [region_masks(p, ["textureless"])["textureless"] for p in (eight, sixteen)]
    np.testing.assert_array_equal(*masks)
