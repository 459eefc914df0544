"""Semi-global costs of float images, which are scaled to integers, do not overflow."""

import numpy as np
import pytest

from twinlens.matching import match

SHIFT = 5


@pytest.mark.parametrize("glints_in", ["left", "right"])
@pytest.mark.parametrize(
    ("method", "glint"),
    [("sgm:cost=sad,block_size=3", 4.0), ("sgm4:cost=ssd,block_size=3", 2.0)],
)
def test_highlights_in_one_image_do_not_overflow_the_costs(method, glint, glints_in):
    rng = np.random.default_rng(3)
    right = rng.random((40, 80)).astype(np.float32)
    left = np.roll(right, SHIFT, axis=1)
    glinting = {"left": left, "right": right}[glints_in]
    glinting[rng.random(glinting.shape) < 0.03] *= glint
    found = match(left, right, method=method, num_disparities=16)
    inside = np.s_[4:-4, 24:-4]
    assert (np.abs(found[inside] - SHIFT) < 1).mean() > 0.97


def test_flat_float_images_do_not_divide_by_zero():
    flat = np.full((12, 30), 0.3, np.float32)
    assert (
        match(flat, flat, method="sgm:cost=sad", num_disparities=8)[:, 8:] == 0
    ).all()
