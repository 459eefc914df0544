import numpy as np
import pytest

from twinlens.factory.generate import MOST, chosen, colored


@pytest.mark.parametrize("count", [1, 2, 47, 48, 49, 1000, 10_000_000])
def test_the_sheet_is_bounded_and_spread_over_the_whole(count):
    shown = chosen(count)
    assert len(shown) == min(count, MOST)
    assert shown == sorted(set(shown))
    assert shown[0] == 0
    assert shown[-1] >= count * (1 - 1 / len(shown)) - 1


def test_colours_rise_with_disparity_and_unknown_is_black():
    disparity = np.full((4, 6), np.inf, np.float32)
    disparity[0] = np.arange(6)
    image = colored(disparity)
    assert not image[1:].any()
    assert image[0, 0, 2] > image[0, 0, 0]  # turbo begins blue
    assert image[0, -1, 0] > image[0, -1, 2]  # and ends red
    assert not colored(np.full((2, 2), np.inf, np.float32)).any()
