"""Numbers of the sampler `sobol`: those of every pixel, and of blocks of 2^k x 2^k pixels, fill the square evenly."""

import numpy as np
import pytest
from scipy.stats import chisquare, qmc

WIDTH, HEIGHT, SPP = 16, 8, 8


def numbers(seed, calls, spp=SPP):
    """The numbers that each of WIDTH x HEIGHT x spp rays gets: arrays (HEIGHT, WIDTH, spp) or with two at the end."""
    from twinlens.rendering.samplers import load_sampler

    sampler = load_sampler("sobol", spp, WIDTH)
    sampler.seed(seed, WIDTH * HEIGHT * spp)
    drawn = []
    for size in calls:
        values = np.array(sampler.next_2d() if size == 2 else sampler.next_1d()).T
        drawn.append(values.reshape(HEIGHT, WIDTH, spp, *values.shape[1:]))
    return drawn


def is_net(points):
    """Whether each of the boxes 2^-i x 2^-j, as many as there are points, has one of the points (N, 2)."""
    count = len(points)
    for across in (1 << i for i in range(count.bit_length())):
        boxes = np.floor(points * (across, count // across)).astype(int)
        if len(np.unique(boxes, axis=0)) < count:
            return False
    return True


def blocks(values, side):
    """The numbers (HEIGHT, WIDTH, spp[, 2]) of each block of side x side pixels, (blocks, side^2 spp[, 2])."""
    rows = HEIGHT // side
    columns = WIDTH // side
    split = values.reshape(rows, side, columns, side, *values.shape[2:])
    return np.moveaxis(split, 2, 1).reshape(
        rows * columns, side * side * values.shape[2], *values.shape[3:]
    )


def test_the_pairs_of_blocks_are_nets():
    for seed in (0, 1, 2**32 - 1):
        first, _, second = numbers(seed, (2, 1, 2))
        for pairs in (first, second):
            for side in (1, 2, 4, 8):
                assert all(is_net(block) for block in blocks(pairs, side))


def test_single_numbers_of_blocks_are_stratified():
    (values,) = numbers(3, (1,))
    for side in (1, 2, 4, 8):
        strata = side * side * SPP
        for block in blocks(values, side):
            used = np.sort(np.floor(block * strata))
            assert np.array_equal(used, np.arange(strata))


@pytest.mark.parametrize(("spp", "part"), [(6, 2), (12, 4)])
def test_numbers_of_samples_that_are_no_powers_of_two_consist_of_nets(spp, part):
    pairs, values = numbers(3, (2, 1), spp)
    assert all(is_net(net) for net in pairs.reshape(-1, part, 2))
    intervals = WIDTH * HEIGHT * part
    for coordinate in (values, *np.moveaxis(pairs, -1, 0)):
        used = np.floor(coordinate.ravel() * intervals).astype(int)
        assert (np.bincount(used, minlength=intervals) == spp // part).all()


def test_the_second_dimension_is_that_of_another_implementation():
    from twinlens.rendering.backends import mitsuba

    mi = mitsuba()
    import drjit as dr

    from twinlens.rendering.sobol import _second_dimension

    points = (
        np.array(dr.brev(_second_dimension(dr.arange(mi.UInt32, 1 << 10)))) / 2.0**32
    )
    theirs = qmc.Sobol(2, scramble=False).random_base2(10)
    ours = np.stack(
        [[int(f"{i:010b}"[::-1], 2) / 2**10 for i in range(1 << 10)], points], axis=-1
    )
    assert np.array_equal(ours[np.lexsort(ours.T)], theirs[np.lexsort(theirs.T)])


def test_the_largest_number_is_below_1():
    from twinlens.rendering.backends import mitsuba

    mi = mitsuba()
    from twinlens.rendering.sobol import _unit

    assert np.array(_unit(mi.UInt32(2**32 - 1)))[0] < 1


def test_numbers_of_one_ray_are_uniform_and_independent():
    """Two numbers are equally often in each of 4x4 boxes: of a pair, of two calls, of two seeds, of two pixels."""
    rays = np.array(
        [[pair[2, 5, 3] for pair in numbers(seed, (2, 2))] for seed in range(1600)]
    )
    other = np.array([numbers(seed, (2,))[0][2, 6, 3] for seed in range(1600)])
    (x, y), (z, _), (far, _) = rays[:, 0].T, rays[:, 1].T, other.T
    for a, b in ((x, y), (x, z), (y, z), (x[1:], x[:-1]), (y, far)):
        counts = np.histogram2d(a, b, bins=4, range=[[0, 1], [0, 1]])[0]
        assert chisquare(counts.ravel()).pvalue > 1e-3
