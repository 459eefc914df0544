import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from tests.dataset import dataset_scene
from twinlens.camera import Camera, Rig
from twinlens.dataset.visibility import mask_from_both, mask_from_one
from twinlens.errors import InputError

maps = hnp.arrays(
    np.float32,
    st.tuples(st.integers(1, 4), st.integers(1, 12)),
    elements=st.floats(0, 8, width=16) | st.just(np.inf),
)


def loop_from_one(disparity, sign):
    """`mask_from_one`, pixel by pixel."""
    height, width = disparity.shape
    mask = np.zeros(disparity.shape, np.uint8)
    for y, u in np.ndindex(height, width):
        d = disparity[y, u]
        if not np.isfinite(d):
            continue
        match = int(np.floor(u - sign * float(d) + 0.5))
        nearest = 0.0
        for x in np.flatnonzero(np.isfinite(disparity[y])):
            place = x - sign * float(disparity[y, x])
            if match in (np.floor(place), np.ceil(place)):
                nearest = max(nearest, disparity[y, x])
        seen = 0 <= match < width and nearest <= d + 1
        mask[y, u] = 255 if seen else 128
    return mask


@given(maps, st.booleans())
def test_mask_from_one_equals_loops(disparity, left):
    expected = loop_from_one(disparity, 1 if left else -1)
    assert_array_equal(mask_from_one(disparity, left), expected)


@given(maps)
def test_the_right_view_is_the_mirrored_left_one(disparity):
    # Halves round the other way in a mirror: keep away from them.
    disparity = disparity + np.float32(0.125) * (
        disparity * 2 == np.round(disparity * 2)
    )
    mirrored = mask_from_one(np.ascontiguousarray(disparity[:, ::-1]), left=False)[
        :, ::-1
    ]
    assert_array_equal(mask_from_one(disparity), mirrored)
    both = mask_from_both(disparity[:, ::-1], disparity[:, ::-1], left=False)[:, ::-1]
    assert_array_equal(mask_from_both(disparity, disparity), both)


@pytest.mark.parametrize("i", [0, 1])
def test_masks_equal_exact_occlusions_except_at_edges(i):
    pair = Rig.stereo(Camera(320, 240, 350.0, 350.0, 160.0, 120.0), 0.4)
    truths = dataset_scene.truths(pair)
    exact = truths[i].mask_nonocc()
    assert (exact == 128).mean() > 0.1
    disparities = [truth.disparity for truth in truths]
    for mask in (
        mask_from_one(disparities[i], left=i == 0),
        mask_from_both(disparities[i], disparities[1 - i], left=i == 0),
    ):
        assert_array_equal(mask == 0, exact == 0)
        wrong = mask != exact
        # At most two pixels of each row's four edges (the card's, the frame's) may fall to the other side.
        assert wrong.sum(axis=1).max() <= 8
        assert wrong.mean() < 0.01


def test_invalid_maps_are_rejected():
    good = np.zeros((2, 3), np.float32)
    with pytest.raises(InputError):
        mask_from_one(good - np.inf)
    with pytest.raises(InputError, match="equal shape"):
        mask_from_both(good, good[:1])
