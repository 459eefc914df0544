"""Layers of things on the ground: which are clear of each other."""

import numpy as np

from twinlens.families.things.ground import Layer
from twinlens.scenes.stable_poses import gap, outline


def layer(rng):
    points = rng.uniform(-1, 1, 2) + rng.uniform(0.1, 0.6) * rng.normal(size=(9, 2))
    low, high = np.sort(rng.uniform(0, 1, 2))
    return Layer(float(low), float(high), outline(points))


def test_layers_are_clear_where_their_outlines_or_heights_are_apart():
    """With the rectangles around both compared first, as without."""
    rng = np.random.default_rng(0)
    counts = {True: 0, False: 0}
    for _ in range(400):
        one, other = layer(rng), layer(rng)
        spacing = float(rng.choice([0.0, 0.02, 0.3]))
        is_above = one.low >= other.high or other.low >= one.high
        expected = is_above or gap(one.outline, other.outline) > spacing
        assert one.is_clear_of(other, spacing) == expected
        counts[bool(expected)] += 1
    assert min(counts.values()) > 50
