"""The samples of the lens grid: one in each stratum where they start and where they land, and uniform over seeds."""

import numpy as np
import pytest
from scipy.stats import chi2

import twinlens as tl
from twinlens.rendering import backend
from twinlens.rendering.annuli import ApertureAnnulus
from twinlens.rendering.shared_paths import (
    SharedPaths,
    StratifiedSampler,
    multijitter,
    random_cells,
    shuffle_within,
    stratum_grid,
)

backend()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported
import mitsuba as mi  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

PIXELS = 50
CAMERA = tl.Camera(10, 5, 40.0, 45.0, 4.5, 2.0)
RING = ApertureAnnulus(0.05, 0.2, (0.0, 0.1, 0.3), 12)  # shifts of up to 1.4 pixels
DIMENSIONS = {"first light": 0, "lobe": 1, "first bounce": 2, "later": 5}


def shared_points(grid, seed, ring=RING):
    paths = SharedPaths(None, CAMERA, np.eye(4), ring, "multijitter")
    return paths._film_and_aperture(grid, np.random.default_rng(seed))


def sampler_for(grid, shifts, seed, pixels=PIXELS):
    ray = dr.arange(mi.UInt32, pixels * len(shifts))
    n = len(shifts)
    return StratifiedSampler(grid, shifts, ray // n, ray % n, seed)


def drawn(count, seed, draw, dimension=0, ring=RING) -> tuple[np.ndarray, np.ndarray]:
    """[pixel, sample, axis] of a draw of a pass, and the shifts of the samples."""
    grid = stratum_grid(count)
    _, shifts = shared_points(grid, seed, ring)
    sampler = sampler_for(grid, shifts, seed)
    for _ in range(dimension):
        sampler.next_1d()
    values = np.atleast_2d(np.array(draw(sampler))).T
    return values.reshape(PIXELS, len(shifts), -1), shifts


def pair(sampler):
    return sampler.next_2d()


def cells_of(values, grid) -> np.ndarray:
    return (
        np.floor(values[..., 0] * grid[0])
        + grid[0] * np.floor(values[..., 1] * grid[1])
    ).astype(int)


def uniform(counts) -> bool:
    """Whether counts of equally likely outcomes are: chi square within its central 99.9%."""
    expected = counts.sum() / counts.size
    return bool(
        ((counts - expected) ** 2).sum() / expected < chi2.ppf(0.999, counts.size - 1)
    )


@pytest.mark.parametrize("count", [1, 2, 8, 11, 25, 64])
@pytest.mark.parametrize("name", DIMENSIONS)
def test_every_stratum_of_every_pixel_gets_one_sample_and_so_does_every_row_and_column(
    count, name
):
    (values, _), (columns, rows) = (
        drawn(count, 3, pair, DIMENSIONS[name]),
        stratum_grid(count),
    )
    n = columns * rows
    assert count <= n <= 1.2 * count + 1
    for cells in (
        cells_of(values, (columns, rows)),
        np.floor(values[..., 0] * n),
        np.floor(values[..., 1] * n),
    ):
        assert (np.sort(cells, axis=1) == np.arange(n)).all()


@pytest.mark.parametrize("count", [1, 11, 32])
def test_film_and_aperture_points_are_stratified(count):
    grid = stratum_grid(count)
    places = multijitter(
        random_cells(grid, np.random.default_rng(0)), grid, np.random.default_rng(1)
    )
    points, _ = shared_points(grid, 2)
    n = len(points)
    radius2 = ((points[:, 2:] ** 2).sum(axis=1) - 0.05**2) / (0.2**2 - 0.05**2)
    assert (np.sort(cells_of((places + 0.5) / n, grid)) == np.arange(n)).all()
    assert (np.sort(cells_of(points, grid)) == np.arange(n)).all()
    assert (radius2 > -1e-5).all()
    assert (radius2 < 1 + 1e-5).all()


@pytest.mark.parametrize("name", ["first light", "first bounce"])
def test_strata_hold_where_samples_land(name):
    """Samples of equal shifts come from one pixel, others from any other: together they have all strata once."""
    values, shifts = drawn(64, 5, pair, DIMENSIONS[name])
    cells = cells_of(values, (8, 8))
    random = np.random.default_rng(0)
    group = np.unique(shifts.reshape(64, -1), axis=0, return_inverse=True)[1].ravel()
    assert len(np.unique(group)) > 8
    for _ in range(20):
        from_pixel = random.integers(PIXELS, size=group.max() + 1)[group]
        assert (np.sort(cells[from_pixel, np.arange(64)]) == np.arange(64)).all()
    traders = 2 * group + (np.arange(64) >= 32)
    assert len(np.unique(cells[:, np.argmax(np.bincount(traders)[traders])])) > 1


def test_dimensions_and_seeds_do_not_repeat_each_other():
    """The order of strata is another one in the next dimension and with the next seed."""
    orders = []
    for seed in range(6):
        sampler = sampler_for((8, 8), shared_points((8, 8), 0)[1], seed, pixels=1)
        orders += [np.floor(np.array(sampler.next_1d()) * 64) for _ in range(12)]
    agreement = (np.array(orders)[:, None] == np.array(orders)[None]).mean(axis=-1)[
        ~np.eye(72, dtype=bool)
    ]
    assert agreement.max() < 0.2
    assert agreement.mean() == pytest.approx(1 / 64, rel=0.15)


def test_every_stratum_is_equally_likely_for_every_sample():
    classes = 2 * np.array([0, 1, 0, 1, 0, 1, 1, 0]) + (np.arange(8) >= 4)
    dealt = []
    for seed in range(2000):
        random = np.random.default_rng(seed)
        dealt.append(
            random_cells((4, 2), random)[shuffle_within(classes, 3, random)][seed % 3]
        )
    dealt = np.array(dealt)
    assert uniform(np.array([(dealt[:, 3] == stratum).sum() for stratum in range(8)]))
    assert uniform(
        np.array(
            [
                ((dealt[:, 3] == 5) & (dealt[:, 2] == second)).sum()
                for second in (0, 2, 7)
            ]
        )
    )


def test_places_are_uniform_at_every_aperture_point_over_seeds():
    """Jointly in 4x4 parts of the pixel and the quadrants of the aperture; where they start, and where they land."""
    random = np.random.default_rng(0)
    starts = np.zeros((4, 4, 2, 2))
    lands = np.zeros((4, 4, 2, 2))
    for seed in range(2500):
        points, _ = shared_points((4, 3), seed)
        point = points[random.integers(12)].astype(float)
        quadrant = tuple((point[2:] > 0).astype(int))
        landing = (point[:2] + 0.15 * point[2:] * (40.0, 45.0)) % 1.0
        starts[(*np.minimum(4 * point[:2], 3).astype(int), *quadrant)] += 1
        lands[(*np.minimum(4 * landing, 3).astype(int), *quadrant)] += 1
    assert uniform(starts)
    assert uniform(lands)
    assert not uniform(
        starts * np.where(np.arange(2) == 0, 1.3, 0.7)
    )  # it would notice


def test_gathering_puts_every_ray_where_it_lands():
    """Beside a naive loop over rays."""
    camera = tl.Camera(7, 5, 4.0, 6.0, 3.0, 2.0)
    paths = SharedPaths(
        None, camera, np.eye(4), ApertureAnnulus(0.0, 1.0, (0.0, 1.0), 6), "multijitter"
    )
    assert paths.annulus.film_size(camera) == (11, 11)  # margins of 2 and 3
    random = np.random.default_rng(0)
    shifts = random.integers(-2, 3, size=(6, 2, 2)).astype(np.int32)
    values = random.random((3, 11, 11, 6)).astype(np.float32)
    weights = random.random((6, 2))
    expected, weighted = np.zeros((2, 2, 2, 3, 5, 7))
    for m, y, x, focus in np.ndindex(6, 11, 11, 2):
        column = x - 2 + shifts[m, focus, 0]
        row = y - 3 + shifts[m, focus, 1]
        if 0 <= column < 7 and 0 <= row < 5:
            expected[int(m >= 3), focus, :, row, column] += values[:, y, x, m]
            weighted[int(m >= 3), focus, :, row, column] += (
                weights[m, focus] * values[:, y, x, m]
            )
    radiance = mi.Color3f(*(mi.Float(plane.ravel()) for plane in values))
    assert np.array(paths._gather(radiance, shifts, None)) == pytest.approx(expected)
    assert np.array(paths._gather(radiance, shifts, weights)) == pytest.approx(weighted)


def test_dimensions_advance_within_compiled_loops():
    """A bounce draws other numbers than the bounce before it."""
    sampler = sampler_for((4, 4), shared_points((4, 4), 0)[1], 1)

    def step(i, sampler, total):
        return i + 1, sampler, total + dr.select(i == 0, 1.0, -1.0) * sampler.next_1d()

    _, sampler, total = dr.while_loop(
        (mi.UInt32(0), sampler, mi.Float(0.0)),
        lambda i, *_: i < 2,
        step,
        mode="symbolic",
    )
    assert np.abs(np.array(total)).mean() > 0.1
