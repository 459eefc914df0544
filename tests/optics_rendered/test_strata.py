"""The samples of the lens grid: one in each stratum of every pixel they land in, and uniform over seeds."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import twinlens as tl
from twinlens.rendering.build import build
from twinlens.rendering.rings import Ring, Sheaf
from twinlens.rendering.sheaf import Tracer, _Film
from twinlens.rendering.strata import pattern, strata, strata_sampler

PIXELS = 50
SHEARS = [(-8.0, -9.0), (-2.0, -2.5), (6.0, 7.0)]  # pixels a metre, of a ring of a fifth of a metre


def drawn(count, seed, draw, shears=SHEARS) -> tuple[np.ndarray, object]:
    """[pixel, sample, axis] of a draw of a pass, and the pattern."""
    shared = pattern(strata(count), 0.05, 0.2, shears, seed)
    sampler = strata_sampler(shared.grid)
    sampler.start(shared, PIXELS, seed)
    values = np.array(draw(sampler, shared))
    return np.atleast_2d(values).T.reshape(len(shared), PIXELS, -1).swapaxes(0, 1), shared


def later(sampler, _):
    """A pair of the sixth dimension."""
    for _ in range(5):
        sampler.next_1d()
    return sampler.next_2d()


DRAWS = {
    "film": lambda sampler, shared: sampler.next_in(shared.film_cell),
    "first light": lambda sampler, _: sampler.next_2d(),
    "later": later,
}


@pytest.mark.parametrize("count", [1, 2, 8, 11, 25, 64])
@pytest.mark.parametrize("name", DRAWS)
def test_every_stratum_of_every_pixel_gets_one_sample_and_so_does_every_row_and_column(count, name):
    (values, _), (columns, rows) = drawn(count, 3, DRAWS[name]), strata(count)
    n = columns * rows
    assert count <= n <= 1.2 * count + 1
    x, y = np.moveaxis(values, -1, 0)
    for cells in (np.floor(x * columns) + columns * np.floor(y * rows), np.floor(x * n), np.floor(y * n)):
        assert (np.sort(cells, axis=1) == np.arange(n)).all()


@pytest.mark.parametrize("count", [1, 11, 32])
def test_single_numbers_are_stratified(count):
    x = drawn(count, 4, lambda sampler, _: sampler.next_1d())[0][..., 0]
    n = x.shape[1]
    assert (np.sort(np.floor(x * n), axis=1) == np.arange(n)).all()


def test_samples_of_equal_shifts_trade_their_strata_and_no_others_do():
    values, shared = drawn(64, 5, DRAWS["first light"])
    cell = (np.floor(values[..., 0] * 8) + 8 * np.floor(values[..., 1] * 8)).astype(int)
    for first in np.unique(shared.first):
        group = np.flatnonzero(shared.first == first)
        assert (shared.shifts[group] == shared.shifts[group[0]]).all()
        assert len(group) == shared.size[group[0]]
        assert (np.sort(cell[:, group], axis=1) == np.sort(cell[0, group])).all()
    assert len(np.unique(shared.first)) > 8
    largest = np.argmax(shared.size)
    assert len(np.unique(cell[:, largest])) > 1


def test_pixels_differ_where_nothing_shears():
    """With no shift to keep, two pixels agree on a stratum as often as chance has it."""
    for name in ("first light", "later"):
        values, shared = drawn(28, 6, DRAWS[name], shears=[(0.0, 0.0)])
        assert (shared.size == 28).all()
        cell = np.floor(values[..., 0] * 7) + 7 * np.floor(values[..., 1] * 4)
        assert (cell[:, None] == cell[None]).mean(axis=-1)[~np.eye(PIXELS, dtype=bool)].mean() < 0.06


def test_dimensions_and_seeds_do_not_repeat_each_other():
    """The order of strata is another one in the next dimension and with the next seed."""
    orders = []
    for seed in (1, 2):
        shared = pattern((8, 8), 0.0, 0.2, SHEARS, 0)
        sampler = strata_sampler(shared.grid)
        sampler.start(shared, 1, seed)
        orders += [np.floor(np.array(sampler.next_1d()) * 64) for _ in range(20)]
    agreement = (np.array(orders)[:, None] == np.array(orders)[None]).mean(axis=-1)[~np.eye(40, dtype=bool)]
    assert agreement.max() < 0.15
    assert agreement.mean() == pytest.approx(1 / 64, rel=0.15)


@pytest.fixture(scope="module")
def places():
    """[seed, sample, pixel, (x, y, ax, ay)] of 300 passes, their patterns and shears."""
    camera = tl.Camera(10, 5, 40.0, 45.0, 4.5, 2.0)
    scene = tl.load_scene("cards")
    tracer = Tracer(build(scene), camera, np.eye(4), "multijitter")
    ring, found, patterns = Ring(0.05, 0.2, (0.0, 0.3), 12), [], []
    shears = [(-6.0, -6.75), (6.0, 6.75)]
    for seed in range(300):
        shared = pattern((4, 3), ring.inner, ring.outer, shears, seed)
        sampler = strata_sampler(shared.grid)
        sampler.start(shared, PIXELS, seed)
        found.append([np.array(part).reshape(12, PIXELS) for part in tracer._places(sampler, shared, ring, shears)])
        patterns.append(shared)
    return np.moveaxis(np.array(found), 1, -1), patterns, shears


def test_every_sample_lands_as_far_away_as_the_pattern_says(places):
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
    any_of = np.random.default_rng(0).integers(12, size=300)  # samples stand in the order of their shifts
    one = found[np.arange(300), any_of, 0]
    radius2 = (one[..., 2] ** 2 + one[..., 3] ** 2 - 0.05**2) / (0.2**2 - 0.05**2)
    turn = np.arctan2(one[..., 3], one[..., 2]) / (2 * np.pi) % 1.0
    for values in (one[..., 0], one[..., 1], radius2, turn):
        assert abs(values.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 300)
        assert abs(values.var() - 1 / 12) < 4 * np.sqrt(1 / 180 / 300)


def test_most_pixels_have_places_of_their_own(places):
    found, _, _ = places
    assert np.mean([len(np.unique(sample[:, 0])) for sample in found[0]]) > 0.15 * PIXELS


def test_gathering_puts_every_ray_where_it_lands():
    """Beside a naive loop over rays."""
    camera, sheaf = tl.Camera(7, 5, 9.0, 9.0, 3.0, 2.0), Sheaf((0.0, 1.0), (2, 3))
    film, random = _Film(camera, sheaf), np.random.default_rng(0)
    shifts = random.integers(-2, 3, size=(6, 2, 2)).astype(np.int32)
    values = random.random((3, 6, film.height, film.width)).astype(np.float32)
    second = np.array([False, True, True, False, False, True])
    expected = np.zeros((2, 2, 3, 5, 7))
    for m, y, x, focus in np.ndindex(6, film.height, film.width, 2):
        column, row = x - 2 + shifts[m, focus, 0], y - 3 + shifts[m, focus, 1]
        if 0 <= column < 7 and 0 <= row < 5:
            expected[int(second[m]), focus, :, row, column] += values[:, m, y, x]
    by_sample = mi.Color3f(*(mi.Float(plane.ravel()) for plane in values))
    assert film.gather(by_sample, (1, film.pixels), shifts, second) == pytest.approx(expected)
    by_pixel = mi.Color3f(*(mi.Float(np.moveaxis(plane, 0, -1).ravel()) for plane in values))
    assert film.gather(by_pixel, (6, 1), shifts, second) == pytest.approx(expected)


def test_dimensions_go_on_within_compiled_loops():
    """A bounce draws other numbers than the bounce before it."""
    shared = pattern((4, 4), 0.0, 0.1, [(0.0, 0.0)], 0)
    sampler = strata_sampler(shared.grid)
    sampler.start(shared, 64, 1)

    def step(i, sampler, total):
        return i + 1, sampler, total + dr.select(i == 0, 1.0, -1.0) * sampler.next_1d()

    _, sampler, total = dr.while_loop(
        (mi.UInt32(0), sampler, mi.Float(0.0)), lambda i, *_: i < 2, step, mode="symbolic"
    )
    assert np.abs(np.array(total)).mean() > 0.1
