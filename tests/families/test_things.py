"""Things have closed parts, real sizes, stand on z = 0 or hang from it, and are the same for the same seed."""

import hashlib
import itertools
import re

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from tests.families.families_checks import inside
from twinlens.families.materials import FURNITURE
from twinlens.families.things import THINGS
from twinlens.scenes.shapes import merged

PLACES = {"table", "floor", "wall", "outdoors", "street", "hangs"}
SHEETS = {"leaf"}  # both sides of a blade, without its edge
ROOTED = {"tree"}  # in the ground
SEEDS = range(12)


def pieces(name, seeds=SEEDS):
    return [THINGS[name].make(np.random.default_rng(seed)) for seed in seeds]


def closed(mesh):
    """As a trimesh, with vertices at equal positions merged; no triangle is left out."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    solid.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=7)
    return solid


def digest(piece):
    sums = hashlib.sha256(repr((piece.kind, piece.floor, piece.height)).encode())
    for name, mesh, word in piece.parts:
        sums.update(f"{name} {word}".encode())
        for values in (mesh.vertices, mesh.faces, mesh.normals, mesh.uv):
            sums.update(np.ascontiguousarray(values).tobytes())
    return sums.hexdigest()


@pytest.mark.parametrize("name", THINGS)
def test_a_thing_has_clean_parts_a_real_size_and_stands(name):
    thing = THINGS[name]
    assert thing.places
    assert set(thing.places) <= PLACES
    for piece in pieces(name):
        assert piece.kind == name
        vertices = np.concatenate([mesh.vertices for _, mesh, _ in piece.parts])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        assert thing.size[0] <= (high - low).max() <= thing.size[1]
        on_ground = high[2] if "hangs" in thing.places else low[2]
        assert on_ground == pytest.approx(0, abs=1e-12)
        assert (low + high)[:2] == pytest.approx(0, abs=1e-9)
        assert (high - low)[:2] == pytest.approx(piece.floor, abs=1e-9)
        assert (high - low)[2] == pytest.approx(piece.height, abs=1e-9)
        labels = [label for label, _, _ in piece.parts]
        assert len(set(labels)) == len(labels)
        assert {re.sub(r"(-\d+)+$", "", label) for label in labels} <= {*thing.parts}
        for _, mesh, word in piece.parts:
            check_part(mesh, word)


def check_part(mesh, word):
    assert word in FURNITURE or word in ("lit", "spines")
    assert np.isfinite(mesh.uv).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    longest = np.max(
        [np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], 0
    )
    assert (np.linalg.norm(cross, axis=1) > 1e-6 * longest**2).all()
    facing = np.einsum("nc,nc->n", cross, mesh.normals[mesh.faces].mean(axis=1))
    assert (facing > 0).all()
    solid = closed(mesh)
    assert solid.is_winding_consistent
    if word not in SHEETS:
        assert solid.is_watertight
        assert min(body.volume for body in solid.split()) > 0


@pytest.mark.parametrize("name", THINGS)
def test_a_seed_decides_every_byte_and_seeds_differ(name):
    sums = [digest(piece) for piece in pieces(name, range(4))]
    assert sums == [digest(piece) for piece in pieces(name, range(4))]
    assert len(set(sums)) == len(sums)


@pytest.mark.parametrize("name", sorted(THINGS.keys() - ROOTED))
def test_a_thing_stands_by_itself(name):
    """The centre of its surfaces is above its feet: the points within 1% of its size above the ground."""
    for piece in pieces(name):
        if "hangs" in THINGS[name].places:
            continue
        whole = merged([mesh for _, mesh, _ in piece.parts])
        solid = trimesh.Trimesh(whole.vertices, whole.faces, process=False)
        feet = whole.vertices[whole.vertices[:, 2] < 0.01 * max(solid.extents), :2]
        outline = ConvexHull(feet).equations  # (a, b, c): a x + b y + c <= 0 inside
        assert (outline @ [*solid.centroid[:2], 1.0] <= 0).all()


def test_books_that_lean_on_each_other_do_not_overlap():
    for piece in pieces("leaning-books"):
        books = [(mesh.vertices, mesh.faces) for _, mesh, _ in piece.parts]
        for one, other in itertools.permutations(books, 2):
            assert not inside(one[0], other).any()
