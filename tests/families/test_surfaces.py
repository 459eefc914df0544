"""Baked surfaces are sharp near the camera and smooth far from it: no pixel contains finer detail."""

import numpy as np
from scipy.ndimage import map_coordinates

from twinlens.families.composition import Viewpoint
from twinlens.families.surfaces import Sheet, bake
from twinlens.geometry import look_at

FLOOR = Sheet(np.array([-20.0, 0.2, 0]), np.array([40.0, 0, 0]), np.array([0, 20.0, 0]))
VIEW = Viewpoint(look_at([0, 0, 0.6], [0, 3, 0]), 50.0, 4 / 3, 320)


def seen(texture, x, y):
    """Bilinear values of the floor's texture at picture positions x, y in [-1, 1]."""
    directions = (
        np.stack([x * VIEW.half[0], y * VIEW.half[1], np.ones_like(x)], axis=-1)
        @ VIEW.world_from_cam[:3, :3].T
    )
    t = -VIEW.eye[2] / directions[..., 2]
    point = VIEW.eye + t[..., None] * directions
    s, up = (point[..., 0] + 20) / 40, (point[..., 1] - 0.2) / 20
    rows, columns = texture.shape[:2]
    return map_coordinates(
        texture[..., 0],
        [(1 - up) * rows - 0.5, s * columns - 0.5],
        order=1,
        mode="nearest",
    )


def roughness(texture, row):
    """RMS difference of a pixel's centre from its mean, along a row of pixels."""
    columns = (2 * (np.arange(320) + 0.5) / 320 - 1)[:, None, None]
    offset = (np.arange(8) + 0.5) / 8 - 0.5
    x = columns + offset[None, :, None] * 2 / 320
    y = row + offset[None, None, :] * 2 / 240
    mean = seen(texture, *np.broadcast_arrays(x, y)).mean(axis=(1, 2))
    middle = seen(texture, columns[:, 0, 0], np.full(320, row))
    return np.sqrt(np.mean((middle - mean) ** 2))


def test_a_checkered_floor_does_not_alias_far_away_and_keeps_contrast_nearby():
    squares = np.indices((64, 64)).sum(axis=0) // 8 % 2
    checks = np.repeat(squares[..., None], 3, axis=2).astype(np.float32)
    baked = bake(checks, 0.8, FLOOR, VIEW)
    untreated = np.tile(checks[::4, ::4], (25, 50, 1))
    far, near = -0.42, 0.8
    assert roughness(baked, far) < 0.06
    assert roughness(untreated, far) > 3 * roughness(baked, far)
    assert np.ptp(seen(baked, np.linspace(-1, 1, 320), np.full(320, near))) > 0.7


def test_baking_keeps_the_mean():
    noise = (
        np.random.default_rng(0)
        .random((64, 64, 1))
        .astype(np.float32)
        .repeat(3, axis=2)
    )
    assert abs(bake(noise, 0.5, FLOOR, VIEW).mean() - 0.5) < 0.02
