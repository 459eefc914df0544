"""A scene with exact truth in closed form: a slanted wall, a card in front of it, and sky, seen by a rectified pair."""

import contextlib
import json
from dataclasses import fields, replace

import numpy as np

import twinlens
from twinlens import geometry
from twinlens.camera import Camera, Rig, ThinLens
from twinlens.camera.masks import encode_mask
from twinlens.camera.truth import ObjectTruth, Projection, Truth
from twinlens.dataset import (
    Manifest,
    Sample,
    Shot,
    open_sample,
    write_manifest,
    write_sample,
)
from twinlens.dataset.channels import CHANNELS, TRUTH
from twinlens.dataset.dataset import row_of

LENS = ThinLens(0.02, focus_distance=2.5)
CARD = ((-0.5, 0.3), (-0.2, 0.35), 2.0)  # x range, y range, z
SKY_ABOVE = -0.7  # the wall ends there
WALL = np.array([0.1, 0.05, 1.0]) / 4.0  # wall: WALL . p = 1


def rig(width=64, height=48, baseline=0.4, doffs=1.25):
    left = Camera(width, height, 70.0, 66.0, width / 2 - 1, height / 2 - 0.25)
    pose = geometry.look_at([0.5, -1.0, 1.5], [2.0, 3.0, 1.0])
    return Rig.stereo(
        left, baseline, world_from_left=pose, right=left.replace(cx=left.cx + doffs)
    )


def cast(origins, directions):
    """Depth along `directions` (z = 1) and object id, in the left camera's frame."""
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = (1 - origins @ WALL) / (directions @ WALL)
        wall = np.where(
            (wall > 0) & ((origins + wall[..., None] * directions)[..., 1] > SKY_ABOVE),
            wall,
            np.inf,
        )
        card = CARD[2] - origins[..., 2]
    x, y, _ = np.moveaxis(origins + card[..., None] * directions, -1, 0)
    on_card = (
        (x > CARD[0][0])
        & (x < CARD[0][1])
        & (y > CARD[1][0])
        & (y < CARD[1][1])
        & (card < wall)
    )
    depth = np.where(on_card, card, wall)
    return depth, np.where(on_card, 2, np.where(np.isfinite(wall), 1, 0)).astype(
        np.int32
    )


def truths(pair):
    return _truth(pair, 0), _truth(pair, 1)


def _truth(pair, i):
    camera, partner = pair.cameras[i], pair.cameras[1 - i]
    centres = np.array([[0.0, 0, 0], [pair.baseline(), 0, 0]])
    directions = camera.unproject(camera.pixel_grid())
    depth, ids = cast(centres[i] + np.zeros_like(directions), directions)
    hit = ids > 0
    points = centres[i] + np.where(hit, depth, 1.0)[..., None] * directions
    px = partner.project(points - centres[1 - i])
    visible = (
        hit & partner.contains(px) & (first_hit(points, centres[1 - i]) > 1 - 1e-9)
    )
    sign = 1 if i == 0 else -1
    disparity = np.where(hit, sign * (camera.pixel_grid()[..., 0] - px[..., 0]), np.inf)
    world = geometry.transform_points(pair.world_from_cams[0], points)
    normal = np.where(
        hit[..., None], geometry.rotate(pair.world_from_cams[0], [0.0, 0.0, -1.0]), 0.0
    )
    return Truth(
        depth=depth,
        position=np.where(hit[..., None], world, np.inf),
        disparity=disparity.astype(np.float32),
        visible=visible,
        normal=normal.astype(np.float32),
        shading_normal=normal.astype(np.float32),
        object_id=ids,
        material_id=ids,
        material_kind=hit.astype(np.uint8),
        object_names=("wall", "card"),
        material_names=("plaster", "paper"),
        objects=tuple(
            item
            for item in (_wall(pair, i, ids), _card(pair, i, ids))
            if item is not None
        ),
        extra=_extra(depth.shape),
    )


def _extra(shape):
    """Zeros for every channel of `Truth.extra`."""
    arrays = {}
    for name in extra_channels():
        channel = CHANNELS[name]
        components = (len(channel.planes),) if len(channel.planes) > 1 else ()
        arrays[name] = np.zeros((*shape, *components), channel.dtype)
    return arrays


def _wall(pair, i, ids):
    """The wall, without a bound of its own but SKY_ABOVE: it is counted in the image only, also behind the card."""
    camera, origin = pair.cameras[i], np.array([i * pair.baseline(), 0.0, 0.0])
    directions = camera.unproject(camera.pixel_grid())
    t = (1 - origin @ WALL) / (directions @ WALL)
    whole = (t > 0) & (t * directions[..., 1] > SKY_ABOVE)
    extent = np.array([[-8.0, SKY_ABOVE, 1.0], [8.0, 8.0, 6.0]])
    return _object(1, "0123456789abcdef", pair, i, np.zeros(3), extent, whole, ids == 1)


def _card(pair, i, ids):
    """The card, whose own axes are the left camera's, from its lower left corner."""
    (left, right), (top, bottom), z = CARD
    extent = np.array([[0.0, 0.0, 0.0], [right - left, bottom - top, 0.0]])
    return _object(
        2,
        "fedcba9876543210",
        pair,
        i,
        np.array([left, top, z]),
        extent,
        ids == 2,
        ids == 2,
    )


def _object(number, model, pair, i, at, extent, whole, visible):
    """The object in the image of a view; None if it has no pixel there."""
    if not whole.any():
        return None
    pose = geometry.rigid(np.eye(3), at - [i * pair.baseline(), 0.0, 0.0])
    grid = np.meshgrid(*extent.T, indexing="ij")
    pixels = pair.cameras[i].project(
        geometry.transform_points(pose, np.stack(grid, axis=-1).reshape(-1, 3))
    )
    return ObjectTruth(
        number, model, pose, extent, np.where(np.isnan(pixels), np.inf, pixels), encode_mask(whole),
        int(whole.sum()), box(whole), int(visible.sum()), box(visible),
    )  # fmt: skip


def box(mask):
    if not mask.any():
        return (0, 0, 0, 0)
    (v, u), (v1, u1) = (
        end(np.argwhere(mask), axis=0).tolist() for end in (np.min, np.max)
    )
    return (u, v, u1 - u + 1, v1 - v + 1)


def first_hit(points, origin):
    """The first hit between `origin` and `points`, as a fraction of the distance."""
    directions = points - origin
    z = directions[..., 2:]
    depth, _ = cast(origin + np.zeros_like(points), directions / z)
    return depth / z[..., 0]


def images(pair, seed, dtype=np.uint8):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    return tuple(
        rng.integers(0, top, (c.height, c.width, 3), dtype, endpoint=True)
        for c in pair.cameras
    )


def sample(num_lenses=1, **size):
    pair = rig(**size)
    lenses = [
        LENS,
        *(LENS.replace(focus_distance=2.0 + k) for k in range(1, num_lenses)),
    ]
    shots = tuple(
        Shot(lens, images(pair, k), record={"spp": 16 + k})
        for k, lens in enumerate(lenses)
    )
    return Sample(pair, shots, truths(pair), record={"seed": 7, "scene": "two planes"})


def stored(folder, made=None):
    """A sample, by default `sample()`, written as `folder` and opened."""
    write_sample(folder, made or sample())
    return open_sample(folder)


def next_version():
    """The version of twinlens in which a new channel appears."""
    major, minor, _ = twinlens.__version__.split(".")
    return f"{major}.{int(minor) + 1}.0"


def extra_channels():
    """The channels whose arrays are in `Truth.extra`."""
    of_truth = {field.name for field in fields(Truth)}
    return [
        channel.name
        for channel in TRUTH.channels
        if channel.value is None and channel.name not in of_truth
    ]


def full_sample():
    """A sample of two lenses that has every channel: radiance, dual pixels, a projector, and where it was warped."""
    made = sample(num_lenses=2)
    radiances = tuple(image.astype(np.float32) for image in made.shots[0].images)
    halves = tuple((image, 255 - image) for image in made.shots[0].images)
    shots = [replace(shot, radiances=radiances, halves=halves) for shot in made.shots]
    rng = np.random.default_rng(0)
    shape = made.truths[0].depth.shape
    light = Projection(rng.random((*shape, 2)), rng.random(shape) < 0.5)
    warped = {"valid": np.uint8(255) * (rng.random(shape) < 0.9)}
    lit = [replace(truth, projections=(light,), extra=warped) for truth in made.truths]
    return replace(made, shots=tuple(shots), truths=tuple(lit))


def unrectified(made):
    """The sample with a right camera that is turned by half a turn, so without disparities."""
    left, right = made.rig.world_from_cams
    turned = Rig(made.rig.cameras, [left, right @ np.diag([-1.0, -1, 1, 1])])
    return replace(made, rig=turned, truths=without_disparity(made.truths))


def without_disparity(truths):
    return tuple(
        replace(truth, disparity=np.full_like(truth.disparity, np.inf))
        for truth in truths
    )


def list_samples(folder, *names, **manifest):
    """Write the dataset.json of a folder with samples of these names."""
    rows = tuple(row_of(folder, name) for name in names)
    write_manifest(folder, Manifest(rows, **manifest))


@contextlib.contextmanager
def edited(sample_folder):
    """The record in a sample.json, written back when the block ends."""
    path = sample_folder / "sample.json"
    record = json.loads(path.read_text())
    yield record
    path.write_text(json.dumps(record))
