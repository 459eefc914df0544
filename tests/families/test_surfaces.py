"""Baked surfaces are sharp near the camera and smooth far from it: no pixel contains finer detail."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from twinlens.families.composition import Viewpoint
from twinlens.families.surfaces import Sheet, bake
from twinlens.geometry import look_at

FLOOR = Sheet(np.array([-20.0, 0.2, 0]), np.array([40.0, 0, 0]), np.array([0, 20.0, 0]))
VIEW = Viewpoint(look_at([0, 0, 0.6], [0, 3, 0]), 50.0, 4 / 3, 320)


def seen(texture, x, y, sheet=None, copies=(1, 1)):
    """Bilinear values of the floor's texture at picture positions x, y in [-1, 1].

    It covers the floor, with a number of copies (down, across), or `sheet`.
    """
    directions = (
        np.stack([x * VIEW.half[0], y * VIEW.half[1], np.ones_like(x)], axis=-1)
        @ VIEW.world_from_cam[:3, :3].T
    )
    t = -VIEW.eye[2] / directions[..., 2]
    point = VIEW.eye + t[..., None] * directions
    s, up = (point[..., 0] + 20) / 40, (point[..., 1] - 0.2) / 20
    if sheet is not None:  # the coordinates of its mesh, linear in each triangle
        mesh = sheet.mesh()
        s = np.interp((s * 40 - 20), *unique(mesh.vertices[:, 0], mesh.uv[:, 0]))
        up = np.interp(up * 20 + 0.2, *unique(mesh.vertices[:, 1], mesh.uv[:, 1]))
    rows, columns = np.multiply(texture.shape[:2], copies)
    mode = "nearest" if sheet is not None else "grid-wrap"
    place = [(1 - up) * rows - 0.5, s * columns - 0.5]
    return map_coordinates(texture[..., 0], place, order=1, mode=mode)


def unique(position, coordinate):
    positions, first = np.unique(position, return_index=True)
    return positions, coordinate[first]


def roughness(texture, row, sheet=None, copies=(1, 1)):
    """RMS difference of a pixel's centre from its mean, along a row of pixels."""
    columns = (2 * (np.arange(320) + 0.5) / 320 - 1)[:, None, None]
    offset = (np.arange(8) + 0.5) / 8 - 0.5
    x = columns + offset[None, :, None] * 2 / 320
    y = row + offset[None, None, :] * 2 / 240
    surface = sheet, copies
    mean = seen(texture, *np.broadcast_arrays(x, y), *surface).mean(axis=(1, 2))
    middle = seen(texture, columns[:, 0, 0], np.full(320, row), *surface)
    return np.sqrt(np.mean((middle - mean) ** 2))


def test_a_checkered_floor_does_not_alias_far_away_and_keeps_contrast_nearby():
    squares = np.indices((64, 64)).sum(axis=0) // 8 % 2
    checks = np.repeat(squares[..., None], 3, axis=2).astype(np.float32)
    sheet = FLOOR.seen_from(VIEW, 0.8 / 64)
    baked = bake(checks, 0.8, sheet, VIEW)
    far, near = -0.42, 0.8
    assert roughness(baked, far, sheet) < 0.06
    untreated = roughness(checks[::4, ::4], far, copies=(25, 50))
    assert untreated > 3 * roughness(baked, far, sheet)
    assert np.ptp(seen(baked, np.linspace(-1, 1, 320), np.full(320, near), sheet)) > 0.7


def test_baking_keeps_the_mean():
    noise = (
        np.random.default_rng(0)
        .random((64, 64, 1))
        .astype(np.float32)
        .repeat(3, axis=2)
    )
    sheet = FLOOR.seen_from(VIEW, 0.5 / 64)
    assert abs(bake(noise, 0.5, sheet, VIEW).mean() - 0.5) < 0.02


@pytest.mark.parametrize(
    ("row", "kept", "alike"), [(0.95, 0.85, 0.95), (0.6, 0.8, 0.9)]
)
def test_a_pixel_shows_the_mean_of_the_pattern_in_it(row, kept, alike):
    """Noise of 3 mm cells: the contrast that is kept, and the correlation with means over 16 x 16 places a pixel."""
    noise = np.random.default_rng(1).random((256, 256, 1)).astype(np.float32)
    noise = noise.repeat(3, axis=2)
    sheet = FLOOR.seen_from(VIEW, 0.8 / 256)
    baked = bake(noise, 0.8, sheet, VIEW)
    columns = 2 * (np.arange(320) + 0.5) / 320 - 1
    offset = (np.arange(16) + 0.5) / 16 - 0.5
    x = columns[:, None, None] + offset[:, None] * 2 / 320
    y = row + offset * 2 / 240
    places = np.broadcast_arrays(x, y)
    expected = seen(noise, *places, copies=(25, 50)).mean(axis=(1, 2))
    shown = seen(baked, columns, np.full(320, row), sheet)
    assert kept < shown.std() / expected.std() < 1.05
    assert np.corrcoef(shown, expected)[0, 1] > alike


TABLE = Sheet(np.array([-0.75, -0.4, 0]), np.array([1.5, 0, 0]), np.array([0, 36.0, 0]))


@pytest.mark.parametrize("sheet", [FLOOR, TABLE, Sheet(FLOOR.corner, FLOOR.v, FLOOR.u)])
@pytest.mark.parametrize("width", [320, 640, 1280])
def test_no_texel_is_larger_than_a_pixel_where_the_sheet_is_visible(sheet, width):
    """Vertices of the mesh, projected by the pinhole; between them texels and pixels are nearly even."""
    view = Viewpoint(VIEW.world_from_cam, VIEW.fov_x_deg, 16 / 9, width)
    fitted = sheet.seen_from(view, 1e-6)
    mesh = fitted.mesh()
    area = np.linalg.norm(np.cross(sheet.u, sheet.v))
    corners = mesh.vertices[mesh.faces]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(area)

    in_cam = (mesh.vertices - view.eye) @ view.world_from_cam[:3, :3]
    size = np.array([width / 2, width / 2 * 9 / 16])
    pixels = (in_cam[:, :2] / in_cam[:, 2:] / view.half) * size
    texels = mesh.uv * (fitted.across.texels, fitted.along.texels)
    visible = (in_cam[:, 2] > 0) & (np.abs(pixels) < size).all(axis=1)
    triangles = mesh.faces[visible[mesh.faces].all(axis=1)]
    assert len(triangles) > 50
    for one, other in ((0, 1), (1, 2), (2, 0)):
        ends = triangles[:, one], triangles[:, other]
        moved = np.linalg.norm(pixels[ends[0]] - pixels[ends[1]], axis=1)
        passed = np.linalg.norm(texels[ends[0]] - texels[ends[1]], axis=1)
        # Along the sides of the sheet, which need not be perpendicular in the picture.
        is_side = (mesh.uv[ends[0]] == mesh.uv[ends[1]]).any(axis=1)
        assert (passed >= moved - 0.1)[is_side].all()
