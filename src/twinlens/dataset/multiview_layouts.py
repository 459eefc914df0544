"""Exports of all views of a sample with exact poses, points and depths: COLMAP, nerfstudio. `export` has the table.

Each sample is a scene with a folder. Sources: https://colmap.github.io/format.html, with "Dense Reconstruction";
https://docs.nerf.studio/quickstart/data_conventions.html, and the parser of its data,
nerfstudio/data/dataparsers/nerfstudio_dataparser.py.
"""

import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from twinlens.dataset.channels import IMAGE
from twinlens.dataset.codecs.colmap import (
    encode_colmap_binary,
    encode_colmap_map,
    encode_colmap_text,
)
from twinlens.dataset.codecs.ply import encode_points
from twinlens.dataset.layouts import Source
from twinlens.dataset.poses import transforms_table
from twinlens.dataset.tracks import Tracks, find_tracks
from twinlens.errors import InputError, located
from twinlens.geometry import inverse, rotate

Files = Iterator[tuple[str, bytes]]

_SOURCE_IMAGES = 20
"""Images that COLMAP chooses for the dense matching of another one, its own default."""

_MM = 1000.0
_HELD_OUT = 8
"""Of so many views one is for evaluation, as in benchmarks of radiance fields; with fewer views none is held out."""


def colmap(source: Source) -> Files:
    """<name>/: images, sparse (a model as text), sparse/0 (the same in binary), and stereo, a dense workspace's maps.

    The points of the model are `tracks.find_tracks`; poses and cameras are those of the calibration. A dense workspace
    is of cameras without distortion: with others, there is no stereo. Raises InputError for a camera that sees 90
    degrees or more from its axis, FileError without truth.
    """
    sample = source.sample
    rig = sample.rig
    _check_views(source, "COLMAP")
    names = [IMAGE.name(view) for view in range(len(rig))]
    for view, name in enumerate(names):
        yield f"{source.name}/images/{name}", source.image(view)
    tracks = _tracks(source)
    for file, content in encode_colmap_text(rig, names, tracks).items():
        yield f"{source.name}/sparse/{file}", content
    for file, content in encode_colmap_binary(rig, names, tracks).items():
        yield f"{source.name}/sparse/0/{file}", content
    if all(camera.distortion is None for camera in rig.cameras):
        for file, content in _dense_maps(source, names):
            yield f"{source.name}/stereo/{file}", content


def nerfstudio(source: Source) -> Files:
    """<name>/: transforms.json, images, depths (.npy, float32, millimetres, 0 unknown) and sparse_pc.ply.

    Lengths are metres, camera axes are OpenGL's, and the world is that of the sample, z up. The points are
    `tracks.find_tracks`. Raises InputError for a camera that sees 90 degrees or more from its axis, for rational
    distortion and for views of different camera models, FileError without truth.
    """
    sample = source.sample
    rig = sample.rig
    _check_views(source, "nerfstudio")
    names = [f"images/{IMAGE.name(view)}" for view in range(len(rig))]
    with located(sample.name):
        table = transforms_table(rig, names)
    frames = table["frames"]
    models = sorted({frame["camera_model"] for frame in frames})
    if len(models) > 1:
        raise InputError(
            f"{sample.name}: has views of {' and '.join(models)}, and transforms.json of nerfstudio has one model for "
            "all; the layout colmap holds them"
        )
    for view, name in enumerate(names):
        yield f"{source.name}/{name}", source.image(view)
        depth_name = f"depths/{IMAGE.name(view).removesuffix('.png')}.npy"
        frames[view]["depth_file_path"] = depth_name
        yield f"{source.name}/{depth_name}", _depth_array(source, view)
    tracks = _tracks(source)
    points = encode_points(tracks.points, tracks.colors)
    yield f"{source.name}/sparse_pc.ply", points
    transforms = {
        **_with_shared_intrinsics(table),
        "ply_file_path": "sparse_pc.ply",
        **_splits_of_views(names),
    }
    yield f"{source.name}/transforms.json", json.dumps(transforms, indent=1).encode()


def _depth_array(source: Source, view: int) -> bytes:
    """The depths of a view along its axis as .npy: float32 (H, W), millimetres, 0 where unknown."""
    truth = source.sample.truth(view)
    depth_mm = np.where(truth.hit, truth.depth, 0.0) * _MM
    stream = io.BytesIO()
    np.save(stream, depth_mm.astype(np.float32))
    return stream.getvalue()


def _with_shared_intrinsics(table: dict[str, Any]) -> dict[str, Any]:
    """The table with the intrinsics of its frames once, before them, if they are those of all.

    nerfstudio takes a group of values from the frames only if the file has none of them before.
    """
    frames = table["frames"]
    of_frame = {"file_path", "transform_matrix", "depth_file_path"}
    intrinsics = [
        {key: frame[key] for key in frame if key not in of_frame} for frame in frames
    ]
    if any(values != intrinsics[0] for values in intrinsics):
        return table
    places = [{key: frame[key] for key in frame if key in of_frame} for frame in frames]
    return {**intrinsics[0], "frames": places}


def _splits_of_views(names: Sequence[str]) -> dict[str, list[str]]:
    """Lists of the images to train with and to evaluate with; nerfstudio needs all three if a file has one."""
    held_out = list(names[::_HELD_OUT])
    trained = [name for name in names if name not in held_out]
    if len(names) < _HELD_OUT:
        held_out = trained = list(names)
    return {
        "train_filenames": trained,
        "val_filenames": held_out,
        "test_filenames": held_out,
    }


def _check_views(source: Source, program: str) -> None:
    """Raise InputError for a camera that has no plane of the image before it."""
    for view, camera in enumerate(source.sample.rig.cameras):
        if camera.is_wide:
            raise InputError(
                f"{source.sample.name}: view {view} sees 90 degrees or more from its axis, which no camera model of "
                f"{program} holds; use a fisheye of a smaller field of view"
            )


def _tracks(source: Source) -> Tracks:
    """The points of the sample, with colours of the images to export."""
    image = source.sample.lens(source.lens).image
    return find_tracks(source.sample.rig, source.sample.truth, image)


def _dense_maps(source: Source, names: list[str]) -> Files:
    """Depths (metres along the axis) and normals (camera axes) of each view, 0 where unknown; lists of the images."""
    rig = source.sample.rig
    for view, name in enumerate(names):
        truth = source.sample.truth(view)
        depth = np.where(truth.hit, truth.depth, 0.0)
        normal = rotate(inverse(rig.world_from_cams[view]), truth.normal)
        yield f"depth_maps/{name}.geometric.bin", encode_colmap_map(depth)
        yield f"normal_maps/{name}.geometric.bin", encode_colmap_map(normal)
    matched = [f"{name}\n__auto__, {_SOURCE_IMAGES}\n" for name in names]
    yield "patch-match.cfg", "".join(matched).encode()
    yield "fusion.cfg", "".join(f"{name}\n" for name in names).encode()
