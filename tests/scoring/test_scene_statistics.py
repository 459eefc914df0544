"""How hard a scene is: statistics of maps of known shape, and beside plain loops."""

import itertools

import numpy as np
import pytest

from twinlens.scoring.scene_statistics import geometry_statistics, image_statistics

WIDTH, HEIGHT = 100, 40


def plane(slope=0.0, at=20.0):
    row = at + slope * np.arange(WIDTH)
    return np.broadcast_to(row, (HEIGHT, WIDTH)).copy()


@pytest.mark.parametrize("slope", [0.0, 0.03, -0.4])
def test_a_plane_has_its_slope_and_no_edges(slope):
    measured = geometry_statistics(plane(slope))
    assert measured["slant"] == pytest.approx(abs(slope))
    assert measured["slant_high"] == pytest.approx(abs(slope))
    assert measured["edges"] == measured["thin"] == measured["unknown"] == 0
    # The quantiles of evenly spaced values.
    assert measured["range"] == pytest.approx(0.96 * abs(slope) * (WIDTH - 1) / WIDTH)


@pytest.mark.parametrize(
    ("columns", "nearer", "thin_columns", "edge_columns"),
    [
        (5, 10.0, 5, 15),  # 5 to the left of the pole, 5 in it, 5 to the right
        (10, 2.0, 10, 20),
        (11, 10.0, 0, 20),  # 10 around each of its sides; its middle is 5 px inside
        (30, 10.0, 0, 20),
        (5, 1.9, 0, 0),
        (5, -10.0, 0, 15),  # a gap between two boards wider than the window
    ],
)
def test_poles_before_a_wall(columns, nearer, thin_columns, edge_columns):
    disparity = plane()
    disparity[:, 40 : 40 + columns] += nearer
    measured = geometry_statistics(disparity)
    assert measured["thin"] == pytest.approx(thin_columns / WIDTH)
    assert measured["edges"] == pytest.approx(edge_columns / WIDTH)
    assert measured["slant"] == 0


def test_unknown_pixels_count_only_as_unknown():
    disparity = plane(0.02)
    disparity[:, 40:45] += 10.0
    disparity[:, 45:65] = np.inf  # what the pole hides from the other camera
    measured = geometry_statistics(disparity)
    assert measured["unknown"] == pytest.approx(0.2)
    assert measured["thin"] == pytest.approx(5 / 80)
    assert measured["slant"] == pytest.approx(0.02)
    nothing = geometry_statistics(np.full((HEIGHT, WIDTH), np.inf))
    assert np.isnan(list(nothing.values())).all()


def test_thin_things_are_those_of_a_plain_loop():
    """A pixel is thin unless some 11 pixels of the row that contain it are all nearer than it less 2 px."""
    rng = np.random.default_rng(3)
    disparity = rng.uniform(0, 6, (6, 60)).repeat(4, axis=1)
    beyond = np.pad(disparity, ((0, 0), (10, 10)), mode="edge")
    count = 0
    for row, u in itertools.product(beyond, range(disparity.shape[1])):
        lowest = max(row[start : start + 11].min() for start in range(u, u + 11))
        count += row[u + 10] - lowest >= 2
    measured = geometry_statistics(disparity)["thin"]
    assert 0.1 < count / disparity.size < 0.9
    assert measured == pytest.approx(count / disparity.size, abs=0.005)


def test_dark_bright_and_plain_parts():
    grey = np.full((HEIGHT, WIDTH), 100.0)
    grey[:, 60:] = np.random.default_rng(1).uniform(50, 200, (HEIGHT, 40))
    # 3x3 windows up to column 57 are even; of 21 columns, 17 or more of these are more than 80 %: up to column 51.
    assert image_statistics(grey)["plain_areas"] == pytest.approx(0.52)
    grey[:, 60:70] = 15.9
    grey[:, 70:75] = 250.5
    grey[:, 75:80] = 250.0
    grey[:, 80:85] = 16.0
    measured = image_statistics(grey)
    assert measured["dark"] == pytest.approx(0.10)
    assert measured["bright"] == pytest.approx(0.05)
