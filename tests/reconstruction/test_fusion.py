"""Fusion and evaluation against spheres and planes."""

import numpy as np
import pytest
import trimesh

from twinlens.camera import BrownConrady, Camera
from twinlens.camera.layouts import arc
from twinlens.errors import InputError
from twinlens.geometry import rigid
from twinlens.reconstruction.evaluation import compare
from twinlens.reconstruction.fusion import fuse, integrate, surface_of, thinned
from twinlens.reconstruction.surface import Cloud, DepthView

RADIUS, DISTANCE = 0.4, 2.0
CAMERA = Camera(120, 120, 240.0, 240.0, 59.5, 59.5, BrownConrady(-0.1, 0.02))


def sphere_depth(camera, pose):
    """Depths of a sphere of RADIUS about the world's origin, +inf elsewhere."""
    rays = camera.unproject(camera.pixel_grid()) @ pose[:3, :3].T
    eye = pose[:3, 3]
    a, b, c = (rays**2).sum(-1), rays @ eye, eye @ eye - RADIUS**2
    inside = b * b - a * c
    return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)


@pytest.fixture(scope="module")
def ring():
    """Twelve views around the sphere; red increases with height."""
    rig = arc(CAMERA, 12, DISTANCE, 360.0, rigid(np.eye(3), [0, 0, -DISTANCE]))
    views = []
    for camera, pose in zip(rig.cameras, rig.world_from_cams, strict=True):
        view = DepthView(camera, pose, sphere_depth(camera, pose))
        height = np.where(view.known, view.positions()[..., 1], 0.0)
        image = np.stack(
            [np.uint8(127 + 250 * height), *[np.full(height.shape, 40, np.uint8)] * 2],
            axis=-1,
        )
        views.append(DepthView(camera, pose, view.depth, image))
    return views


@pytest.fixture(scope="module")
def surface(ring):
    return surface_of(integrate(ring, 0.02))


def test_the_surface_is_the_sphere_where_it_was_seen(surface):
    off = np.linalg.norm(surface.vertices, axis=1) - RADIUS
    steep = np.abs(surface.vertices[:, 1]) > 0.3  # seen at a slant, or not at all
    assert np.abs(off[~steep]).max() < 0.003
    assert np.sqrt(np.mean(off[~steep] ** 2)) < 0.001
    assert abs(off[~steep].mean()) < 5e-4


def test_triangles_face_outwards_and_have_the_colours_of_the_images(surface):
    solid = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    level = np.abs(solid.triangles_center[:, 1]) < 0.3
    outwards = np.einsum("nc,nc->n", solid.face_normals, solid.triangles_center)
    assert (outwards[level] > 0).mean() > 0.999
    belt = np.abs(surface.vertices[:, 1]) < 0.3
    assert (
        np.abs(surface.colors[belt, 0] - (127 + 250 * surface.vertices[belt, 1])).max()
        < 12
    )
    assert (surface.colors[belt, 1] == 40).all()


def test_unseen_parts_have_no_triangles(ring):
    volume = integrate(ring[:1], 0.02)
    half = surface_of(volume)
    towards = ring[0].world_from_cam[:3, 3] / DISTANCE
    assert (
        half.vertices @ towards > 0
    ).all()  # the far side is unknown: no wall closes it
    inside = (volume.weight > 0) & (volume.distance < -0.999)
    assert not inside.any() or volume.distance.min() >= -1


def belt_errors(surface):
    """Distances of vertices from the sphere, but for the poles, which are seen at a slant."""
    belt = surface.vertices[np.abs(surface.vertices[:, 1]) < 0.25]
    return np.linalg.norm(belt, axis=1) - RADIUS


def test_fusing_many_views_reduces_noise(ring):
    rng = np.random.default_rng(3)
    noisy = []
    for view in ring:
        depth = view.depth + rng.normal(0, 0.01, view.depth.shape)
        noisy.append(DepthView(view.camera, view.world_from_cam, depth))
    errors = belt_errors(surface_of(integrate(noisy, 0.02, reach=0.08)))
    assert errors.std() < 0.005
    assert abs(errors.mean()) < 0.002


def test_fusing_keeps_points_that_other_views_agree_on(ring):
    wrong = ring[3].depth.copy()
    wrong[50:70, 50:70] *= 0.9  # a bump that only one view believes in
    views = [
        *ring[:3],
        DepthView(ring[3].camera, ring[3].world_from_cam, wrong),
        *ring[4:],
    ]
    loose, strict = fuse(views), fuse(views, min_views=2)
    assert len(loose) == sum(view.known.sum() for view in views)
    assert np.abs(np.linalg.norm(strict.points, axis=1) - RADIUS).max() < 1e-9
    assert len(strict) > 0.9 * (len(loose) - 400)


def test_thinning_keeps_the_mean_of_each_cell():
    rng = np.random.default_rng(0)
    cloud = Cloud(
        rng.uniform(-1, 1, (500, 3)), rng.integers(0, 255, (500, 3), np.uint8)
    )
    thin = thinned(cloud, 0.5)
    cells = {}
    for point, color in zip(cloud.points, cloud.colors, strict=True):
        cells.setdefault(tuple(np.floor(point / 0.5)), []).append((point, color))
    assert len(thin) == len(cells)
    expected = {
        key: (np.mean([p for p, _ in v], axis=0), np.mean([c for _, c in v], axis=0))
        for key, v in cells.items()
    }
    for point, color in zip(thin.points, thin.colors, strict=True):
        mean, mean_color = expected[tuple(np.floor(point / 0.5))]
        assert np.allclose(point, mean)
        assert np.abs(color - mean_color).max() <= 0.5


def grid_plane(z, width=1.0, step=0.01):
    x, y = np.meshgrid(np.arange(0, width, step), np.arange(0, 1, step))
    return Cloud(np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1))


def test_comparison_of_a_shifted_half_plane():
    comparison = compare(
        grid_plane(0.003, 0.5),
        grid_plane(0.0),
        tolerances_mm=(2, 4),
        max_distance_mm=20,
    )
    assert comparison.accuracy_mean_mm == pytest.approx(3)
    assert comparison.accuracy_median_mm == pytest.approx(3)
    assert comparison.accuracy_outliers == 0
    assert comparison.completeness_outliers == pytest.approx(
        0.49
    )  # all but the columns that lie within 2 cm
    assert [s.accuracy for s in comparison.shares] == [0, 1]
    assert [s.completeness for s in comparison.shares] == [0, pytest.approx(0.5)]
    assert comparison.shares[0].f_score == 0
    assert comparison.shares[1].f_score == pytest.approx(2 / 3)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda ring: fuse([]), "at least one view"),
        (lambda ring: fuse(ring, min_views=13), "from 1 to 12"),
        (lambda ring: integrate(ring, 1e-4), "64 million"),
        (lambda ring: integrate(ring, 0.1, reach=0.05), "one cell or more"),
        (lambda ring: integrate(ring, 0.1, bounds=[[0, 0, 0], [1, 1, 0]]), "lowest"),
        (
            lambda ring: surface_of(
                integrate(ring, 0.1, bounds=[[5, 5, 5], [6, 6, 6]])
            ),
            "no surface crosses",
        ),
    ],
)
def test_invalid_input_raises(ring, make, says):
    with pytest.raises(InputError, match=says):
        make(ring)
