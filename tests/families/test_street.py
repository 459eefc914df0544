"""Streets: the far row is where it was asked for, nothing overlaps, all stands on its ground, the sky is open."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.families.families_checks import (
    bare_scene,
    in_world,
    inside,
    intersecting,
    plain_name,
    samples,
)
from twinlens.families import Assets, flying
from twinlens.families.composition import Composition, Viewpoint, rasterize
from twinlens.families.draws import one_of
from twinlens.families.things import THINGS, things_for

SURROUNDINGS = {
    "road", "markings", "pavement", "lawn", "garden-wall", "house", "far-house", "sun",
}  # fmt: skip
SLOW = pytest.mark.slow
SEEDS = [
    1,
    7,
    *(pytest.param(seed, marks=SLOW) for seed in (4, *range(10, 24), 32, 45)),
]


def scene_of(seed, ratio=None):
    depths = None if ratio is None else (1.0, ratio)
    return bare_scene("street", seed, depth_range=depths)


def named(scene, *names):
    return [item for item in scene.objects if plain_name(item.name) in names]


def movable(scene):
    """The scene without ground, walls and houses."""
    left = [item for item in scene.objects if plain_name(item.name) not in SURROUNDINGS]
    return replace(scene, objects=tuple(left))


# Seeds whose side walls and lawns, or blocks of the far row, once reached beyond the asked depth.
@pytest.mark.parametrize(
    ("seed", "ratio"),
    [
        (3, 2.6),
        (9, 4.0),
        *(
            pytest.param(s, r, marks=SLOW)
            for s in range(24)
            for r in (2.6, 4, 6, 10, 30)
        ),
    ],
)
def test_the_asked_ratio_is_met(seed, ratio):
    near, far = scene_of(seed, ratio).depth_range
    assert near == pytest.approx(1.0, rel=0.01)
    assert far == pytest.approx(ratio, rel=0.08)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_overlaps(seed):
    scene = movable(scene_of(seed))
    assert intersecting(scene, 150) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_reaches_into_houses_and_walls(seed):
    """Trees, cars, posts and bodies against the closed first surfaces of houses, and against garden walls."""
    scene = scene_of(seed)
    for item, wall in itertools.product(
        movable(scene).objects, named(scene, "house", "garden-wall", "far-house")
    ):
        vertices, faces = in_world(wall)
        if wall.shape.surface is not None:
            faces = faces[np.asarray(wall.shape.surface) == 0]
        points = samples(in_world(item), 300)
        share = inside(points, (vertices, faces)).mean()
        # The outermost twigs of a crown may touch a facade.
        limit = 0.05 if plain_name(item.name) == "tree" else 0.0
        assert share <= limit, (item.name, wall.name, share)


@pytest.mark.parametrize("seed", SEEDS)
def test_everything_stands_on_its_ground(seed):
    """Rays downwards from just above the lowest points of things and bodies meet what they stand on at once."""
    scene = scene_of(seed)
    surfaces = [in_world(item) for item in scene.objects]
    for item in movable(scene).objects:
        vertices, _ = in_world(item)
        foot = vertices[vertices[:, 2].argmin()]
        heights = [
            surface_below(foot, other) for other in surfaces if other[0] is not vertices
        ]
        nearest = min(abs(height - foot[2]) for height in heights if height is not None)
        # Trees are planted 3 cm deep at the trunk, on ground that may slope.
        limit = 0.15 if plain_name(item.name) == "tree" else 0.005
        assert nearest < limit, (item.name, nearest)


def surface_below(point, body):
    """The height nearest to a point where the vertical line through it meets a surface; None if it does not."""
    vertices, faces = body
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    p = point[:2]

    def side(start, end):
        along, to = end[:, :2] - start[:, :2], p - start[:, :2]
        return along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]

    weights = np.stack([side(b, c), side(c, a), side(a, b)], axis=-1)
    total = weights.sum(axis=1)
    hit = ((weights * np.sign(total)[:, None] >= 0).all(axis=1)) & (
        np.abs(total) > 1e-12
    )
    if not hit.any():
        return None
    corners = np.stack([a[hit, 2], b[hit, 2], c[hit, 2]], axis=-1)
    heights = (weights[hit] * corners).sum(axis=1) / total[hit]
    return heights[np.abs(heights - point[2]).argmin()]


def test_streets_have_sky_and_far_distances_in_most_seeds():
    open_above, farthest = [], []
    for seed in range(8):
        scene = scene_of(seed)
        view = Viewpoint(scene.world_from_left, scene.fov_x_deg, 4 / 3)
        depth = rasterize(view, [in_world(item) for item in scene.objects], 80)
        open_above.append(np.isinf(depth).mean())
        farthest.append(depth[np.isfinite(depth)].max())
    assert np.median(open_above) > 0.05
    assert max(open_above) < 0.6
    assert max(farthest) > 60
    assert min(farthest) < 25


def test_copies_have_one_mesh():
    """The posts of a row and the trees of a side are objects of one mesh each, not instances."""
    scene = scene_of(5)
    assert all(len(item.instances) == 0 for item in scene.objects)
    posts = named(scene, "bollard", "lamp-post", "tree")
    assert len({id(item.shape) for item in posts}) < len(posts)


def test_cars_and_trees_are_in_streets_alone():
    """No car flies, and no tree stands on a table."""
    assert {"car", "tree", "lamp-post"} <= {*things_for("street")}
    for place in ("table", "floor", "outdoors"):
        assert not {*things_for("street")} & {*things_for(place)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flying, "one_of", recorded := Recorded())
        for seed in range(6):
            root = np.random.SeedSequence(seed)
            air = Composition("air", root, Assets(), None, (6, 6), 4 / 3, 80)
            flying._draw_models(air)
    assert recorded.names
    assert not {*things_for("street")} & recorded.names


class Recorded:
    """`one_of` that keeps the names it chooses from."""

    def __init__(self):
        self.names = set()

    def __call__(self, rng, options):
        self.names.update(options)
        return one_of(rng, options)


def test_the_body_of_a_car_is_closed_and_its_wheels_are_on_the_ground():
    for seed in range(6):
        piece = THINGS["car"].make(np.random.default_rng(seed))
        meshes = {name: mesh for name, mesh, _ in piece.parts}
        tires = meshes["tires"].vertices
        assert tires[:, 2].min() == pytest.approx(0, abs=1e-9)
        # The body is above the ground, and no wheel sticks out of it at its front or rear.
        body = meshes["body"].vertices
        assert body[:, 2].min() > 0.1
        assert body[:, 0].min() < tires[:, 0].min()
        assert tires[:, 0].max() < body[:, 0].max()
        solid = trimesh.Trimesh(body, meshes["body"].faces, process=False)
        solid.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
        assert solid.is_watertight
