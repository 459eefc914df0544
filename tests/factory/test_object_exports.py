"""Truth of a random scene with the models of its objects, exported to BOP: the poses put models onto masks."""

import json

import cv2
import numpy as np
import pytest
import trimesh

import twinlens as tl
from twinlens.dataset import Sample, Shot, open_sample, write_sample
from twinlens.dataset.export import export
from twinlens.dataset.verify import verify_sample
from twinlens.factory import default_rig
from twinlens.families import random_scene
from twinlens.rendering import object_models

FINER = 16


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    scene = random_scene("tabletop", 3, object_count=4)
    rig = default_rig(scene, 320, 240)
    shot = Shot(tl.Pinhole(), (np.zeros((240, 320, 3), np.uint8),) * 2)
    sample = Sample(
        rig, (shot,), tuple(tl.ground_truth(scene, rig)), models=object_models(scene)
    )
    write_sample(folder / "in" / "s", sample)
    export(tl.Dataset(folder / "in"), folder / "bop", "bop")
    return folder


def painted(vertices, faces, K, shape):
    """Where OpenCV paints triangles (camera frame) in an image sixteen times finer, sampled at pixel centres."""
    u, v, w = K @ vertices.T
    points = np.rint(np.stack([u / w, v / w], axis=-1) * FINER * 16).astype(np.int32)
    canvas = np.zeros((shape[0] * FINER, shape[1] * FINER), np.uint8)
    for triangle in points[faces]:
        cv2.fillConvexPoly(canvas, triangle, 255, shift=4)
    return canvas[::FINER, ::FINER] > 0


def test_bop_poses_reproject_the_models_onto_the_masks(made):
    scene = made / "bop/train/000000"
    cameras, poses, infos = (
        json.loads((scene / f"scene_{n}.json").read_text())
        for n in ("camera", "gt", "gt_info")
    )
    tested = 0
    for i, camera in cameras.items():
        K = np.reshape(camera["cam_K"], (3, 3))
        for k, (pose, info) in enumerate(zip(poses[i], infos[i], strict=True)):
            mask = (
                cv2.imread(
                    scene / f"mask/{int(i):06d}_{k:06d}.png", cv2.IMREAD_UNCHANGED
                )
                > 0
            )
            mesh = trimesh.load_mesh(
                made / f"bop/models/obj_{pose['obj_id']:06d}.ply", process=False
            )
            points = (
                mesh.vertices @ np.reshape(pose["cam_R_m2c"], (3, 3)).T
                + pose["cam_t_m2c"]
            )
            if (
                points[:, 2].min() <= 0 or mask.sum() < 400
            ):  # behind the camera; or its border has most of its pixels
                continue
            ours = painted(points, mesh.faces, K, mask.shape)
            assert (ours & mask).sum() / (ours | mask).sum() >= 0.99
            assert info["px_count_all"] >= mask.sum()
            tested += 1
    assert tested >= 8


def test_the_dataset_is_consistent_and_damage_is_found(made):
    sample = open_sample(made / "in" / "s")
    assert verify_sample(sample) == []
    names = {thing.model for i in (0, 1) for thing in sample.objects(i)}
    assert {path.stem for path in (sample.folder / "models").iterdir()} >= names
    path = sample.folder / "sample.json"
    text = path.read_text()
    record = json.loads(text)
    first = next(each for each in record["objects"][0] if each["visible_pixel_count"])
    first["visible_pixel_count"] += 1
    path.write_text(json.dumps(record))
    (finding,) = verify_sample(sample)
    path.write_text(text)
    assert (
        finding
        == f"sample.json: objects[0]: object {first['object_id']} differs from the object ids of the truth"
    )
