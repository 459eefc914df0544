"""Parts of an aperture: fractions and centroids of their light beside closed forms, and refusals."""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.camera.parts import check_parts
from twinlens.errors import InputError

DISK = tl.Disk()


def test_halves_of_a_disk():
    """The centroid of a half-disk is 4/(3 pi) of the radius from its straight edge."""
    for axis, column in (("x", 0), ("y", 1)):
        fractions, centroids = tl.Dual(axis).light(DISK)
        np.testing.assert_allclose(fractions, 0.5, atol=1e-6)
        np.testing.assert_allclose(
            centroids[:, column], [-4 / (3 * math.pi), 4 / (3 * math.pi)], atol=1e-4
        )
        np.testing.assert_allclose(centroids[:, 1 - column], 0, atol=1e-6)


def test_quarters_of_a_disk_and_halves_of_a_ring():
    fractions, centroids = tl.Quad().light(DISK)
    off = 4 / (3 * math.pi)
    np.testing.assert_allclose(fractions, 0.25, atol=1e-6)
    np.testing.assert_allclose(
        centroids, [[-off, -off], [off, -off], [-off, off], [off, off]], atol=1e-4
    )
    inner = 0.6
    _, centroids = tl.Dual().light(tl.Annulus(inner))
    np.testing.assert_allclose(
        centroids[1, 0], off * (1 - inner**3) / (1 - inner**2), atol=1e-4
    )


def test_squares_of_a_grid_on_a_square():
    """A clear square aperture has equal light in every square of a grid, centred in it."""
    fractions, centroids = tl.Grid(4).light(tl.MaskAperture([[1.0]]))
    np.testing.assert_allclose(fractions, 1 / 16, atol=1e-9)
    x, y = np.meshgrid(np.arange(4) / 2 - 0.75, np.arange(4) / 2 - 0.75)
    np.testing.assert_allclose(
        centroids, np.stack([x.ravel(), y.ravel()], axis=-1), atol=1e-6
    )


def test_a_part_off_the_aperture_has_no_light():
    corner = np.zeros((7, 7))
    corner[0, 0] = 1
    fractions, centroids = tl.Masks([corner, 1 - corner]).light(DISK)
    assert fractions[1] == pytest.approx(1)
    assert fractions[0] == 0
    assert np.isnan(centroids[0]).all()


@pytest.mark.parametrize("side", [1, 2, 5])
def test_shares_are_those_of_the_cell(side):
    masks = (
        np.random.default_rng(side)
        .dirichlet([1, 1, 1], (side, side + 1))
        .transpose(2, 0, 1)
    )
    parts = tl.Masks(masks)
    row, column = np.indices((side, side + 1))
    x, y = (column + 0.5) / (side + 1) * 2 - 1, (row + 0.5) / side * 2 - 1
    np.testing.assert_array_equal(parts.shares(x, y), masks)
    np.testing.assert_array_equal(
        parts.shares(np.array([-1.0, 1.0]), np.array([-1.0, 1.0])),
        masks[:, [0, -1], [0, -1]],
    )


CAMERA = tl.Camera(48, 36, 50.0, 50.0, 23.5, 17.5)
RIGHT = tl.ThinLens(0.05, 2.0, tl.MaskAperture([[0.0, 1.0]]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tl.Dual("z"), "Dual: axis 'z'"),
        (lambda: tl.Grid(0), "Grid: n"),
        (lambda: tl.Grid(2.5), "Grid: n"),
        (lambda: tl.Masks([[[1]], [[1, 0]]]), "equal shapes"),
        (lambda: tl.Masks([[1, 0]]), r"masks \(P, H, W\)"),
        (lambda: tl.Masks([[[0.6]], [[0.6]]]), "add up to 1 at most"),
        (lambda: tl.Masks([[[math.nan]]]), "shares from 0 to 1"),
        (lambda: check_parts("dual", RIGHT), "Dual, Quad, Grid or Masks, got 'dual'"),
        (lambda: check_parts(tl.Dual(), tl.Pinhole()), "a pinhole has none"),
        (lambda: tl.dual_pixel_disparity([[1.0]], CAMERA, RIGHT), "light in both"),
    ],
)
def test_parts_that_make_no_sense_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
