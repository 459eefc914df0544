"""Colours of optical flow: those of the published wheel, in which directions lead, and what has no flow."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.report.flow_picture import colour_wheel, flow_picture, largest_flow


def test_the_wheel_is_the_published_one():
    """Rows of the table that color code of vision.middlebury.edu/flow makes."""
    wheel = colour_wheel()
    assert wheel.shape == (55, 3)
    rows = {
        0: (1, 0, 0),
        15: (1, 1, 0),
        18: (0.5, 1, 0),
        21: (0, 1, 0),
        25: (0, 1, 1),
        36: (0, 0, 1),
        49: (1, 0, 1),
        52: (1, 0, 0.5),
    }
    for row, colour in rows.items():
        np.testing.assert_allclose(wheel[row], colour, atol=1e-15)


def test_directions_have_their_colours_and_lengths_their_saturation():
    flow = np.array([[[4.0, 0], [-4, 0], [0, 4], [0, -4], [0, 0], [2, 0]]])
    red, cyan, below, above, none, half = flow_picture(flow)[0].tolist()
    assert red == [255, 0, 0]
    assert cyan == [
        0,
        209,
        255,
    ]  # place 27 of the wheel: 2 of 11 steps from cyan to blue
    assert below[0] == 255
    assert below[1] == 230  # 13.5 of 15 steps from red to yellow
    assert above == [88, 0, 255]  # place 40.5: 4.5 of 13 steps from blue to magenta
    assert none == [255, 255, 255]
    assert half == [255, 128, 128]


def test_unknown_flow_is_black_and_long_flow_is_dark():
    flow = np.array([[[np.inf, np.inf], [np.nan, 0], [3, 0], [1, 0]]])
    picture = flow_picture(flow, largest=2.0)[0].tolist()
    assert picture == [[0, 0, 0], [0, 0, 0], [191, 0, 0], [255, 128, 128]]
    assert largest_flow(flow) == 3.0
    assert largest_flow(np.full((2, 2, 2), np.inf)) == 0.0
    assert not flow_picture(np.full((2, 2, 2), np.inf)).any()
    assert (flow_picture(np.zeros((2, 2, 2))) == 255).all()


@pytest.mark.parametrize("shape", [(2, 2), (2, 2, 3), (0,)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match=r"must have the shape \(H, W, 2\), got"):
        flow_picture(np.zeros(shape))
