"""The samples of the lens grid: one in each stratum of every pixel, uniform over seeds, shared where they must be."""

import numpy as np
import pytest

from twinlens.rendering.strata import shared_strata, strata

PIXELS = 50


def drawn(count, seed, draw) -> np.ndarray:
    """[pixel, sample, axis] of the third draw of a pass."""
    sampler = shared_strata(count)
    sampler.seed(seed, PIXELS * sampler.sample_count())
    sampler.next_2d(), sampler.next_1d()
    values = np.array(getattr(sampler, draw)())
    return np.atleast_2d(values).T.reshape(PIXELS, sampler.sample_count(), -1)


@pytest.mark.parametrize("count", [1, 2, 8, 11, 32, 64])
@pytest.mark.parametrize("draw", ["next_2d", "next_shared_2d"])
def test_every_stratum_of_every_pixel_gets_one_sample_and_so_does_every_row_and_column(count, draw):
    columns, rows = strata(count)
    n = columns * rows
    assert count <= n <= 1.2 * count + 1
    x, y = np.moveaxis(drawn(count, 3, draw), -1, 0)
    for cells in (np.floor(x * columns) + columns * np.floor(y * rows), np.floor(x * n), np.floor(y * n)):
        assert (np.sort(cells, axis=1) == np.arange(n)).all()


@pytest.mark.parametrize("count", [1, 11, 32])
def test_single_numbers_are_stratified(count):
    x = drawn(count, 4, "next_1d")[..., 0]
    n = x.shape[1]
    assert (np.sort(np.floor(x * n), axis=1) == np.arange(n)).all()


def test_what_is_shared_is_the_same_in_every_pixel_and_nothing_else_is():
    shared, own = drawn(12, 5, "next_shared_2d"), drawn(12, 5, "next_2d")
    assert (shared == shared[0]).all()
    assert len(np.unique(own[..., 0])) > 0.99 * own[..., 0].size
    cells = np.floor(own * strata(12))
    assert (cells == cells[0]).all()  # but sample m keeps to its stratum


def test_dimensions_and_seeds_do_not_repeat_each_other():
    """The order of strata is another one in the next dimension and with the next seed."""
    sampler = shared_strata(64)
    sampler.seed(1, 64)
    orders = [np.floor(np.array(sampler.next_1d()) * 64) for _ in range(20)]
    sampler.seed(2, 64)
    orders += [np.floor(np.array(sampler.next_1d()) * 64) for _ in range(20)]
    agreement = (np.array(orders)[:, None] == np.array(orders)[None]).mean(axis=-1)[~np.eye(40, dtype=bool)]
    assert agreement.max() < 0.15
    assert agreement.mean() == pytest.approx(1 / 64, rel=0.15)


@pytest.mark.parametrize("draw", ["next_2d", "next_shared_2d"])
def test_sample_m_of_a_pixel_is_uniform_over_seeds(draw):
    """Of 11 samples asked for, the fifth, in 600 passes: mean, spread and joint quarter within four standard errors."""
    points = np.array([drawn(11, seed, draw)[7, 4] for seed in range(600)])
    assert np.abs(points.mean(axis=0) - 0.5).max() < 4 * np.sqrt(1 / 12 / 600)
    assert np.abs(points.var(axis=0) - 1 / 12).max() < 4 * np.sqrt(1 / 180 / 600)
    quarter = (points < 0.5).all(axis=1).mean()
    assert abs(quarter - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 600)
