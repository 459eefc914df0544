"""Regions against naive loops."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from tests.scoring.scoring_methods import Constant, pair
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import InputError
from twinlens.scoring import REGIONS, Pair, region_masks, run_benchmark
from twinlens.scoring.regions import (
    discontinuity,
    distance_bands,
    occluded,
    out_of_focus,
    textureless,
)

shapes = hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9)
truths = hnp.arrays(
    np.float32,
    shapes,
    elements=st.sampled_from([3.0, 4.0, 4.5, 5.0, 6.5, 20.0, np.inf]),
)


def clamp(i, n):
    return min(max(i, 0), n - 1)


@given(
    image=hnp.arrays(
        np.uint8,
        st.tuples(st.integers(1, 7), st.integers(2, 8), st.just(3)),
        elements=st.integers(0, 12),
    ),
    window=st.sampled_from([1, 3, 5]),
)
def test_textureless_equals_the_loops(image, window):
    height, width, _ = image.shape
    pixels = image.astype(int).tolist()

    def step(y, x):
        return (
            sum(
                (a - b) ** 2
                for a, b in zip(pixels[y][x], pixels[y][x + 1], strict=True)
            )
            / 3
        )

    def largest(y, x):
        return max(step(y, k) for k in (x - 1, x) if 0 <= k < width - 1)

    r = window // 2
    found = textureless(image, window)
    for y in range(height):
        for x in range(width):
            near = [
                largest(clamp(y + j, height), clamp(x + i, width))
                for j in range(-r, r + 1)
                for i in range(-r, r + 1)
            ]
            assert found[y, x] == (math.fsum(near) / len(near) < 16 - 1e-9)


def test_the_limit_itself_has_texture():
    steps = np.array([[0, 4, 8, 12, 16, 20]], np.uint8)
    assert not textureless(steps).any()
    assert textureless(steps, limit=4.001).all()


@given(gt=truths, window=st.sampled_from([1, 3, 9]))
def test_discontinuity_equals_the_loops(gt, window):
    height, width = gt.shape
    edges = set()
    for y in range(height):
        for x in range(width):
            for j, i in ((y, x + 1), (y + 1, x)):
                if (
                    j < height
                    and i < width
                    and math.isfinite(gt[y, x])
                    and math.isfinite(gt[j, i])
                ):
                    edges |= (
                        {(y, x), (j, i)}
                        if abs(float(gt[y, x]) - float(gt[j, i])) >= 2
                        else set()
                    )
    r = window // 2
    wanted = [
        [
            any(abs(y - j) <= r and abs(x - i) <= r for j, i in edges)
            for x in range(width)
        ]
        for y in range(height)
    ]
    np.testing.assert_array_equal(discontinuity(gt, window=window), wanted)


@given(gt=truths)
def test_the_bands_partition_the_known_pixels(gt):
    near, mid, far = distance_bands(gt)
    np.testing.assert_array_equal(near.astype(int) + mid + far, np.isfinite(gt))
    if np.isfinite(gt).any():
        known = gt[np.isfinite(gt)]
        assert far[gt == known.min()].all()
        if known.min() < known.max():
            assert near[gt == known.max()].all()
            assert gt[near].min(initial=np.inf) > gt[far].max()


def test_a_third_of_the_range_includes_its_upper_end():
    near, mid, far = distance_bands([[1.0, 2.0, 3.0, 4.0]])
    assert [b.tolist()[0] for b in (near, mid, far)] == [
        [False, False, False, True],
        [False, False, True, False],
        [True, True, False, False],
    ]


def test_occluded_is_neither_visible_nor_unknown():
    mask = np.array([[255, 128, 0]], np.uint8)
    assert occluded(mask).tolist() == [[False, True, False]]
    assert occluded(mask == 255).tolist() == [[False, True, True]]


def test_blur_counts_on_both_sides_of_the_focus():
    assert out_of_focus([[-2.5, -2, 0, 2, 2.5, np.nan]]).tolist() == [
        [True, False, False, False, True, False]
    ]


def test_materials_partition_the_hit_pixels():
    plain, named = pair(), MATERIAL_KINDS[1:]
    kinds = np.random.default_rng(0).integers(
        0, len(MATERIAL_KINDS), plain.disp0.shape, np.uint8
    )
    masks = region_masks(replace(plain, material_kind0=kinds), named)
    assert [kinds[masks[name]].tolist() for name in named] == [
        [k] * (kinds == k).sum() for k in range(1, len(named) + 1)
    ]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: discontinuity(np.full((3, 3), np.nan)), "gt holds NaN"),
        (lambda: region_masks(pair(), ["miror"]), "did you mean 'mirror'"),
        (lambda: region_masks(pair(), ["texturless"]), "did you mean 'textureless'"),
    ],
)
def test_bad_arguments_are_refused(call, says):
    with pytest.raises(InputError, match=says):
        call()


def full():
    plain = pair()
    kinds = np.full(plain.disp0.shape, MATERIAL_KINDS.index("mirror"), np.uint8)
    return Pair(
        "full",
        plain.im0,
        plain.im1,
        plain.disp0,
        plain.mask0_nonocc,
        16,
        None,
        plain.disp0 - 2,
        kinds,
    )


def test_regions_without_data_are_left_out():
    assert list(region_masks(full(), REGIONS)) == list(REGIONS)
    assert set(REGIONS) - set(region_masks(pair(mask=False), REGIONS)) == {
        "nonocc",
        "occluded",
        "textureless",
        "discontinuity",
        "out-of-focus",
        *MATERIAL_KINDS[1:],
    }


def test_regions_of_2002_are_within_the_non_occluded_pixels():
    masks = region_masks(full(), REGIONS)
    for name in ("textureless", "discontinuity"):
        assert not (masks[name] & ~masks["nonocc"]).any()
    assert not (masks["occluded"] & masks["nonocc"]).any()


def test_sixteen_bit_images_have_the_same_texture():
    eight = full()
    sixteen = Pair(
        "x",
        eight.im0 * np.uint16(257),
        eight.im1 * np.uint16(257),
        eight.disp0,
        eight.mask0_nonocc,
        16,
    )
    np.testing.assert_array_equal(
        *(region_masks(p, ["textureless"])["textureless"] for p in (eight, sixteen))
    )


def test_a_board_counts_the_pixels_of_each_region():
    sample = full()
    entry = run_benchmark([sample], [Constant("c", 4)], regions=list(REGIONS)).entries[
        0
    ]
    known = np.isfinite(sample.disp0)
    for name, mask in region_masks(sample, REGIONS).items():
        assert entry.regions[name].evaluated == (mask & known).sum()
