"""The samples of the lens grid: even in every pixel they land in, one in each stratum, and uniform over seeds."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.stats import chi2

import twinlens as tl
from twinlens.rendering.annuli import ApertureAnnulus, VergenceGroup
from twinlens.rendering.build import build
from twinlens.rendering.shared_paths import PaddedFilm, Tracer
from twinlens.rendering.stratified_samples import (
    StratifiedSampler,
    checkerboard,
    make_pattern,
    multijittered_points,
    place_evenly,
    stratum_grid,
    stratum_orders,
)

PIXELS = 50
SHEARS = [(-8.0, -9.0), (-2.0, -2.5), (6.0, 7.0)]  # pixels a metre, of a ring of a fifth of a metre
DIMENSIONS = {"first light": 2, "lobe": 3, "first bounce": 4, "later": 7}


def drawn(count, seed, draw, dimension=0, shears=SHEARS) -> tuple[np.ndarray, object]:
    """[pixel, sample, axis] of a draw of a pass, and the pattern."""
    shared = make_pattern(stratum_grid(count), 0.05, 0.2, shears, seed)
    sampler = StratifiedSampler(*shared.grid)
    sampler.start(shared, PIXELS, seed)
    for _ in range(dimension):
        sampler.next_1d()
    values = np.atleast_2d(np.array(draw(sampler)))
    return by_sample(sampler, values.T), shared


def by_sample(sampler, values) -> np.ndarray:
    """Rows of rays as [pixel, sample, ...]; each pixel's slots hold every sample once."""
    pixel, sample = np.array(sampler.pixel), np.array(sampler.sample)
    assert len(np.unique(pixel * sampler.sample_count() + sample)) == len(values)
    sorted_values = np.empty((pixel.max() + 1, sampler.sample_count(), *values.shape[1:]), values.dtype)
    sorted_values[pixel, sample] = values
    return sorted_values


def pair(sampler):
    return sampler.next_2d()


def cells_of(values, grid) -> np.ndarray:
    return (np.floor(values[..., 0] * grid[0]) + grid[0] * np.floor(values[..., 1] * grid[1])).astype(int)


@pytest.mark.parametrize("count", [1, 2, 8, 11, 25, 64])
@pytest.mark.parametrize("name", DIMENSIONS)
def test_every_stratum_of_every_pixel_gets_one_sample_and_so_does_every_row_and_column(count, name):
    (values, _), (columns, rows) = drawn(count, 3, pair, DIMENSIONS[name]), stratum_grid(count)
    n = columns * rows
    assert count <= n <= 1.2 * count + 1
    for cells in (cells_of(values, (columns, rows)), np.floor(values[..., 0] * n), np.floor(values[..., 1] * n)):
        assert (np.sort(cells, axis=1) == np.arange(n)).all()


@pytest.mark.parametrize("count", [1, 11, 32])
def test_single_numbers_are_stratified(count):
    x = drawn(count, 4, lambda sampler: sampler.next_1d())[0][..., 0]
    n = x.shape[1]
    assert (np.sort(np.floor(x * n), axis=1) == np.arange(n)).all()


@pytest.mark.parametrize("name", ["first light", "first bounce"])
def test_strata_hold_where_samples_land(name):
    """Samples of equal shifts come from one pixel, others from any other: together they have all strata once."""
    values, shared = drawn(64, 5, pair, DIMENSIONS[name])
    cells, random = cells_of(values, shared.grid), np.random.default_rng(0)
    assert len(np.unique(shared.group)) > 8
    for _ in range(20):
        from_pixel = random.integers(PIXELS, size=shared.group.max() + 1)[shared.group]
        assert (np.sort(cells[from_pixel, np.arange(64)]) == np.arange(64)).all()
    traders = 2 * shared.group + shared.white
    assert len(np.unique(cells[:, np.argmax(np.bincount(traders)[traders])])) > 1


@pytest.mark.parametrize("name", DIMENSIONS)
def test_either_half_of_the_samples_has_the_strata_of_one_colour(name):
    values, shared = drawn(32, 8, pair, DIMENSIONS[name])
    colours = checkerboard(shared.grid)[cells_of(values, shared.grid)]
    assert (np.abs((colours == shared.white).mean(axis=1) - 0.5) == 0.5).all()
    assert shared.white.sum() == 16


def test_samples_of_equal_shifts_move_alike():
    shared = make_pattern((8, 8), 0.05, 0.2, SHEARS, 5)
    for group in range(shared.group.max() + 1):
        assert len(np.unique(shared.shifts[shared.group == group], axis=0)) == 1
    assert len(np.unique(shared.shifts, axis=0)) == shared.group.max() + 1


def test_pixels_differ_where_nothing_shears():
    """With no shift to keep, two pixels agree as often as chance has it: on one of the 14 strata of a colour where all
    take the same colour, else on one of 28."""
    for name, choices in (("first light", 14), ("first bounce", 14), ("later", 28)):
        values, shared = drawn(28, 6, pair, DIMENSIONS[name], shears=[(0.0, 0.0)])
        assert (shared.group == 0).all()
        cell = cells_of(values, shared.grid)
        agreement = (cell[:, None] == cell[None]).mean(axis=-1)[~np.eye(PIXELS, dtype=bool)].mean()
        assert agreement == pytest.approx(1 / choices, rel=0.1)


def test_dimensions_and_seeds_do_not_repeat_each_other():
    """The order of strata is another one in the next dimension and with the next seed."""
    orders = []
    for seed in range(4):
        shared = make_pattern((8, 8), 0.0, 0.2, SHEARS, 0)
        sampler = StratifiedSampler(*shared.grid)
        sampler.start(shared, 1, seed)
        sample = np.argsort(np.array(sampler.sample))
        orders += [np.floor(np.array(sampler.next_1d())[sample] * 64) for _ in range(20)]
    agreement = (np.array(orders)[:, None] == np.array(orders)[None]).mean(axis=-1)[~np.eye(80, dtype=bool)]
    assert agreement.max() < 0.2
    assert agreement.mean() == pytest.approx(1 / 64, rel=0.15)


def test_later_dimensions_are_independent():
    """A sample's strata of two of them, over pixels and seeds: every pair as often."""
    counts = np.zeros((6, 6))
    for seed in range(60):
        shared = make_pattern((3, 2), 0.05, 0.2, SHEARS, seed)
        sampler = StratifiedSampler(*shared.grid)
        sampler.start(shared, 1, seed)
        for _ in range(5):
            sampler.next_1d()
        several = [cells_of(np.array(sampler.next_2d()).T, (3, 2)) for _ in range(12)]
        one = int(np.flatnonzero(np.array(sampler.sample) == seed % 6)[0])
        np.add.at(counts, ([cells[one] for cells in several[::2]], [cells[one] for cells in several[1::2]]), 1)
    assert uniform(counts)


def test_dimensions_beyond_the_table_are_random():
    sampler = StratifiedSampler(8, 8)
    sampler.start(make_pattern((8, 8), 0.0, 0.1, SHEARS, 0), 64, 0)
    sampler.dimension = dr.opaque(mi.UInt32, sampler.orders)
    x = np.array(sampler.next_1d())
    assert uniform(np.histogram(x, bins=20, range=(0, 1))[0])
    assert (np.sort(np.floor(x.reshape(64, 64) * 64), axis=0) != np.arange(64)[:, None]).any(axis=0).all()


def uniform(counts) -> bool:
    """Whether counts of equally likely outcomes are: chi square within its central 99.9%."""
    expected = counts.sum() / counts.size
    return bool(((counts - expected) ** 2).sum() / expected < chi2.ppf(0.999, counts.size - 1))


def test_every_stratum_is_equally_likely_for_every_sample():
    white, classes = checkerboard((4, 2)), np.array([0, 1, 2, 1, 3, 2, 1, 0])
    classes = 2 * classes + white
    dealt = []
    for seed in range(2000):
        random = np.random.default_rng(seed)
        dealt.append(stratum_orders(random.random(3) < 0.5, classes, white, (4, 2), random)[seed % 3])
    dealt = np.array(dealt)
    assert uniform(np.array([(dealt[:, 3] == stratum).sum() for stratum in range(8)]))
    assert uniform(np.array([((dealt[:, 3] == 5) & (dealt[:, 4] == other)).sum() for other in (0, 2, 7)]))


def test_places_are_uniform_at_every_aperture_point_over_seeds():
    """Jointly in 4x4 parts of the pixel and 2x2 of the aperture; in the pixel they start in, and where they land."""
    shears = np.array([(-6.0, -6.75), (6.0, 6.75)])
    random, starts, lands = np.random.default_rng(0), np.zeros((4, 4, 2, 2)), np.zeros((4, 4, 2, 2))
    for seed in range(2500):
        shared = make_pattern((3, 2), 0.05, 0.2, shears, seed)
        m = random.integers(6)
        half = tuple(np.floor(2 * shared.square[m]).astype(int))
        landing = (shared.film[m].astype(float) + shared.aperture[m] * shears[1]) % 1.0
        starts[(*np.floor(4 * shared.film[m]).astype(int), *half)] += 1
        lands[(*np.minimum(4 * landing, 3).astype(int), *half)] += 1
    assert uniform(starts)
    assert uniform(lands)
    assert not uniform(starts * np.where(np.arange(2) == 0, 1.3, 0.7))  # it would notice


def misses(points, random) -> float:
    """Mean squared error of the shares of points on one side of random lines, points and lines in the unit square."""
    fine = np.stack(np.meshgrid(*[(np.arange(64) + 0.5) / 64] * 2), axis=-1).reshape(-1, 2)
    angles, through = random.uniform(0, 2 * np.pi, 300), random.random((300, 2))
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    shares = [((of @ normals.T) < (through * normals).sum(axis=1)).mean(axis=0) for of in (points, fine)]
    return float(((shares[0] - shares[1]) ** 2).mean())


def test_landings_are_even_at_every_focus():
    """Compared with positions that are stratified only where they start, for edges through the pixel."""
    random, grid = np.random.default_rng(1), (8, 4)
    shears, woven, left = np.array([-4.0, -1.3, 1.3, 4.0]), np.zeros((20, 4)), np.zeros((20, 4))
    for trial in range(20):
        aperture = 0.2 * (random.random((32, 2)) - 0.5)
        moves = aperture[:, None] * shears[:, None]
        places = place_evenly(moves, checkerboard(grid), random)
        cells = multijittered_points(random.permutation(32), grid, random)
        for focus in range(4):
            woven[trial, focus] = misses((places + moves[:, focus]) % 1.0, random)
            left[trial, focus] = misses((cells + moves[:, focus]) % 1.0, random)
    assert (woven.mean(axis=0) < 0.75 * left.mean(axis=0))[[0, 3]].all()
    assert woven.mean() < 0.8 * left.mean()


def test_kernel_sums_do_not_depend_on_order():
    """Else the bytes of an image could depend on how many threads multiply matrices."""
    random = np.random.default_rng(0)
    moves, white = random.normal(size=(24, 5, 2)), checkerboard((6, 4))
    places = [place_evenly(of, white, np.random.default_rng(1)) for of in (moves, moves[:, [3, 0, 4, 2, 1]])]
    assert (places[0] == places[1]).all()


@pytest.fixture(scope="module")
def places():
    """[seed, sample, pixel, (x, y, ax, ay)] of 300 passes, their patterns and shears."""
    camera = tl.Camera(10, 5, 40.0, 45.0, 4.5, 2.0)
    scene = tl.load_scene("cards")
    tracer = Tracer(build(scene), camera, np.eye(4), "multijitter")
    ring, found, patterns = ApertureAnnulus(0.05, 0.2, (0.0, 0.3), 12), [], []
    shears = [(-6.0, -6.75), (6.0, 6.75)]
    for seed in range(300):
        shared = make_pattern((4, 3), ring.inner, ring.outer, shears, seed)
        sampler = StratifiedSampler(*shared.grid)
        sampler.start(shared, PIXELS, seed)
        rays = np.stack([np.array(part) for part in tracer._film_and_aperture(sampler, shared, ring, shears)], axis=-1)
        found.append(by_sample(sampler, rays).swapaxes(0, 1))
        patterns.append(shared)
    return np.array(found), patterns, shears


def test_samples_land_at_the_shifts_of_the_pattern(places):
    found, patterns, shears = places
    for values, shared in zip(found, patterns, strict=True):
        for focus, shear in enumerate(shears):
            landing = values[..., :2].astype(np.float64) + values[..., 2:] * np.asarray(shear)
            inside = landing - shared.shifts[:, None, focus]
            assert (inside > -1e-5).all()
            assert (inside < 1 + 1e-5).all()


def test_places_and_points_are_uniform_over_seeds(places):
    """Place in the pixel, area of the ring and turn around it: mean and spread within four standard errors."""
    found, _, _ = places
    any_of = np.random.default_rng(0).integers(12, size=300)
    one = found[np.arange(300), any_of, 0]
    radius2 = (one[..., 2] ** 2 + one[..., 3] ** 2 - 0.05**2) / (0.2**2 - 0.05**2)
    turn = np.arctan2(one[..., 3], one[..., 2]) / (2 * np.pi) % 1.0
    for values in (one[..., 0] % 1.0, one[..., 1] % 1.0, radius2, turn):
        assert abs(values.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 300)
        assert abs(values.var() - 1 / 12) < 4 * np.sqrt(1 / 180 / 300)


def test_most_pixels_have_places_of_their_own(places):
    found, _, _ = places
    assert np.mean([len(np.unique(sample[:, 0])) for sample in found[0]]) > 0.15 * PIXELS


def test_gathering_puts_every_ray_where_it_lands():
    """Beside a naive loop over rays."""
    camera, group = tl.Camera(7, 5, 9.0, 9.0, 3.0, 2.0), VergenceGroup((0.0, 1.0), (2, 3))
    film, random = PaddedFilm(camera, group), np.random.default_rng(0)
    shifts = random.integers(-2, 3, size=(6, 2, 2)).astype(np.int32)
    values = random.random((3, 6, film.height, film.width)).astype(np.float32)
    second = np.array([False, True, True, False, False, True])
    expected = np.zeros((2, 2, 3, 5, 7))
    for m, y, x, focus in np.ndindex(6, film.height, film.width, 2):
        column, row = x - 2 + shifts[m, focus, 0], y - 3 + shifts[m, focus, 1]
        if 0 <= column < 7 and 0 <= row < 5:
            expected[int(second[m]), focus, :, row, column] += values[:, m, y, x]
    radiance = mi.Color3f(*(mi.Float(plane.ravel()) for plane in values))
    assert film.gather(radiance, shifts, second) == pytest.approx(expected)


def test_dimensions_advance_within_compiled_loops():
    """A bounce draws other numbers than the bounce before it."""
    shared = make_pattern((4, 4), 0.0, 0.1, [(0.0, 0.0)], 0)
    sampler = StratifiedSampler(*shared.grid)
    sampler.start(shared, 64, 1)

    def step(i, sampler, total):
        return i + 1, sampler, total + dr.select(i == 0, 1.0, -1.0) * sampler.next_1d()

    _, sampler, total = dr.while_loop(
        (mi.UInt32(0), sampler, mi.Float(0.0)), lambda i, *_: i < 2, step, mode="symbolic"
    )
    assert np.abs(np.array(total)).mean() > 0.1
