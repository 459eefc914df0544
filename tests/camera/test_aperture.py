"""Aperture shapes: samples are uniform in the open area; areas equal closed forms."""

import math

import numpy as np
import pytest

from twinlens.camera.aperture import (
    FULL_DISK,
    Annulus,
    Disk,
    MaskAperture,
    Polygon,
)

LETTER = np.array([[1, 0, 0], [1, 0.5, 0], [1, 1, 0.25], [0, 0, 0]])
SHAPES = [
    FULL_DISK,
    Polygon(3),
    Polygon(5, rotation_deg=17.0),
    Polygon(6, roundness=0.4),
    Polygon(7, rotation_deg=-80.0, roundness=1.0),
    Annulus(0.4),
    MaskAperture(LETTER),
    MaskAperture(np.eye(9)[:, :5]),
]
IDS = [f"{i}-{shape.name}" for i, shape in enumerate(SHAPES)]


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
def test_samples_are_distributed_as_the_transmission(shape):
    """Counts on a grid equal the transmission integrated over the grid's cells, within five standard errors."""
    u1, u2 = np.random.default_rng(1).random((2, 400_000))
    x, y = shape.sample(u1, u2)
    edges = np.linspace(-1, 1, 13)
    counts, _, _ = np.histogram2d(y, x, bins=[edges, edges])
    assert counts.sum() == len(u1)

    fine = (np.arange(12 * 60) + 0.5) / (6 * 60) - 1
    open_area = (
        shape.transmission(*np.meshgrid(fine, fine))
        .reshape(12, 60, 12, 60)
        .mean(axis=(1, 3))
    )
    expected = open_area / open_area.sum() * len(u1)
    error = 5 * np.sqrt(expected + 1) + 0.01 * expected.max()
    assert (np.abs(counts - expected) < error).all()


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
def test_no_sample_is_opaque(shape):
    x, y = shape.sample(*np.random.default_rng(0).random((2, 90_000)))
    assert (shape.transmission(x * (1 - 1e-12), y * (1 - 1e-12)) > 0).all()


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
def test_area_fraction_is_the_integral_of_the_transmission(shape):
    grid = (np.arange(1680) + 0.5) / 840 - 1
    area = shape.transmission(*np.meshgrid(grid, grid)).mean() * 4
    assert shape.area_fraction * math.pi == pytest.approx(area, rel=1e-3)


@pytest.mark.parametrize("shape", SHAPES[:6], ids=IDS[:6])
def test_sampling_is_continuous(shape):
    """The map is continuous, strata stay connected; a ring is discontinuous only at the centre."""
    line = (np.arange(500) + 0.5) / 500
    u1, u2 = np.meshgrid(line, line)
    x, y = shape.sample(u1, u2)
    step = np.maximum(
        np.hypot(np.diff(x), np.diff(y))[:-1],
        np.hypot(np.diff(x, axis=0), np.diff(y, axis=0))[:, :-1],
    )
    opens = shape.name == "annulus"
    away = ~(opens & (np.hypot(u1 - 0.5, u2 - 0.5) < 0.1))[:-1, :-1]
    assert step[away].max() < 6 / 500


def test_polygon_rotation_is_from_right_to_down():
    """The first corner is along +x; 90 degrees rotate it to +y, down."""
    assert Polygon(3).transmission(0.99, 0) == 1
    assert Polygon(3).transmission(-0.99, 0) == 0
    assert Polygon(3, rotation_deg=90).transmission(0, 0.99) == 1
    assert Polygon(3, rotation_deg=90).transmission(0, -0.99) == 0


def test_mask_row_zero_is_at_the_top():
    """Row 0 is at the top (y < 0), column 0 is left (x < 0); the longer side spans the diameter."""
    mask = MaskAperture(LETTER)
    assert mask.transmission(-0.7, -0.9) == 1
    assert mask.transmission(0.7, -0.9) == 0
    assert mask.transmission(0.7, 0.1) == 0.25
    assert mask.transmission([-0.8, -0.7], 0.1).tolist() == [0, 1]


def test_masks_are_equal_by_content():
    grey = (LETTER * 255).astype(np.uint8)
    assert MaskAperture(grey) == MaskAperture(grey.copy())
    assert hash(MaskAperture(grey)) == hash(MaskAperture(grey.copy()))
    assert MaskAperture(grey) != MaskAperture(grey[:, ::-1])
    assert MaskAperture(grey) != Disk()
    with pytest.raises(ValueError, match="read-only"):
        MaskAperture(grey).mask[0, 0] = 0


def test_a_mask_copies_its_array():
    cells = np.ones((2, 2))
    mask = MaskAperture(cells)
    cells[:] = 0
    assert mask.area_fraction == pytest.approx(4 / math.pi)


def test_mask_sampling_reaches_the_last_cell_with_float32_numbers():
    mask = MaskAperture(np.eye(3))
    x, y = mask.sample(np.float32([0.0, 1 - 2**-24]), np.float32([0.0, 1 - 2**-24]))
    assert np.allclose([x, y], [[-1, 1], [-1, 1]], atol=1e-6)
