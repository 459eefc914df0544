"""Exports of dual pixels, light fields and focal stacks, read back by the rules of their public readers."""

import configparser
import functools
import json
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from scipy.spatial.transform import Rotation

import twinlens as tl
from twinlens.camera import layouts
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    Sample,
    Shot,
    read_pfm,
    write_manifest,
    write_sample,
)
from twinlens.dataset.export import export
from twinlens.errors import InputError
from twinlens.geometry import transform_points

CAMERA = tl.Camera(40, 30, 45.0, 45.0, 19.5, 14.5, pixel_pitch_um=8.0)
WIDE = tl.ThinLens(0.012, 1.25)
DISTANCES = (2.0, 0.8, 1.3)


SCENE = tl.load_scene("cards")


@functools.cache
def truths(rig):
    return tuple(tl.ground_truth(SCENE, rig, objects=False))


def image(seed, dtype=np.uint8, shape=(30, 40, 3)):
    return np.random.default_rng(seed).integers(
        0, np.iinfo(dtype).max + 1, shape, dtype=dtype
    )


def light_field(rig):
    shot = Shot(tl.Pinhole(), tuple(map(image, range(len(rig)))))
    return Sample(rig, (shot,))


def views(n):
    return tl.light_field_rig(CAMERA, WIDE, n, SCENE.world_from_left)


ALONE = tl.Rig([CAMERA], [SCENE.world_from_left])


def alone(*shots):
    return Sample(ALONE, shots, truths(ALONE))


def dual(dtype=np.uint16):
    halves = ((image(2, dtype), image(3, dtype)),)
    return alone(
        Shot(tl.Pinhole(), (image(0, dtype),)),
        Shot(WIDE, (image(1, dtype),), halves=halves),
    )


@pytest.fixture
def exported(tmp_path):
    def run(to, samples, splits=(), **options):
        rows = []
        for name, sample in samples.items():
            files = write_sample(tmp_path / "in" / name, sample)
            split = {"split": splits[len(rows)]} if splits else {}
            rows.append(Row(name, files, split))
        write_manifest(tmp_path / "in", Manifest(rows))
        export(Dataset(tmp_path / "in"), tmp_path / "out", to, **options)
        return tmp_path / "out"

    return run


def test_dpdd(exported):
    """The reader sorts each folder, and opens the files of each index with cv2."""
    out = exported(
        "dpdd",
        {"a1": dual(), "a": dual(np.uint8), "b": dual()},
        ["train", "val", "train"],
    )
    listed = [
        sorted((out / f"train_{name}").iterdir())
        for name in ("c/source", "l/source", "r/source", "c/target")
    ]
    assert all([path.stem for path in paths] == ["a1", "b"] for paths in listed)
    for files in zip(*listed, strict=True):
        for path, seed in zip(files, (1, 2, 3, 0), strict=True):
            pixels = cv2.imread(str(path), -1)
            assert pixels.dtype == np.uint16
            assert_array_equal(pixels[..., ::-1], image(seed, np.uint16))
    assert_array_equal(
        cv2.imread(str(out / "val_l/source/a.png"), -1)[..., ::-1],
        image(2) * np.uint16(257),
    )
    expected = tl.dual_pixel_disparity(truths(ALONE)[0], CAMERA, WIDE)
    assert_allclose(read_pfm(out / "val_disparity/a.pfm"), expected, rtol=1e-6)


def test_dpdd_needs_dual_pixels_and_an_image_in_focus(exported):
    with pytest.raises(InputError, match="s: dpdd needs a pinhole"):
        exported("dpdd", {"s": alone(dual().shots[1])})
    with pytest.raises(InputError, match="t: dpdd needs a lens with dual pixels"):
        exported("dpdd", {"t": alone(dual().shots[0])})


def test_hci4d(exported):
    """The toolkit's formulas give the depth of the middle view, and the other views move by the disparity."""
    rig = views(3)
    sample = replace(light_field(rig), truths=truths(rig))
    out = exported("hci4d", {"s": sample}, ["test"]) / "test" / "s"
    for i in range(9):
        assert_array_equal(
            np.asarray(Image.open(out / f"input_Cam{i:03d}.png")), image(i)
        )
    text = configparser.ConfigParser()
    text.read(out / "parameters.cfg")
    meta = text["meta"]
    texts = {**text["intrinsics"], **text["extrinsics"]}
    number = {key: float(value) for key, value in texts.items()}
    assert (number["image_resolution_y_px"], number["num_cams_x"]) == (30, 3)
    disparity, truth = read_pfm(out / "gt_disp_lowres.pfm"), sample.truths[4]
    scale = number["baseline_mm"] * number["focal_length_mm"] * 40
    depth = 1 / (
        1000 * number["sensor_size_mm"] * disparity / scale
        + 1 / number["focus_distance_m"]
    )
    assert_allclose(depth, truth.depth, rtol=1e-4)
    assert_allclose(read_pfm(out / "gt_depth_lowres.pfm"), truth.depth, rtol=1e-6)
    assert float(meta["disp_min"]) <= disparity.min() < 0
    assert 0 < disparity.max() <= float(meta["disp_max"])
    v, u = np.indices(disparity.shape)
    for view, (du, dv) in {5: (-1, 0), 7: (0, -1)}.items():
        expected = np.stack([u + du * disparity, v + dv * disparity], axis=-1)
        assert_allclose(sample.rig.project(view, truth.position), expected, atol=1e-4)
    angles = [number[f"center_cam_r{axis}_rad"] for axis in "xyz"]
    place = [number[f"center_cam_{axis}_m"] for axis in "xyz"]
    pose = np.block(
        [[Rotation.from_euler("xyz", angles).as_matrix(), np.c_[place]], [np.eye(4)[3]]]
    )
    x, y, z = transform_points(
        np.linalg.inv(pose), truth.position
    ).T  # Blender: y up, z backward
    focal = number["focal_length_mm"] / number["sensor_size_mm"] * 40
    assert_allclose(19.5 - focal * x.T / z.T, u, atol=1e-4)
    assert_allclose(14.5 + focal * y.T / z.T, v, atol=1e-4)


def test_eslf(exported):
    """LFReadESLF with a lenslet of n pixels: view (row, column) is every n-th pixel from there."""
    sample = light_field(views(4))
    out = exported("eslf", {"s": sample})
    raw = np.asarray(Image.open(out / "s_eslf.png"))
    for i in range(16):
        assert_array_equal(raw[i // 4 :: 4, i % 4 :: 4], image(i))
    assert len(json.loads((out / "s.json").read_text())["rig"]["cameras"]) == 16


def test_light_fields_of_other_rigs_are_refused(exported):
    grid = layouts.grid(CAMERA, 2, 3, 0.01, 0.01, SCENE.world_from_left)
    with pytest.raises(
        InputError, match="s: the 6 cameras are not the n x n views of a light field"
    ):
        exported("eslf", {"s": light_field(grid)})
    uneven = layouts.grid(CAMERA, 3, 3, 0.01, 0.02, SCENE.world_from_left)
    with pytest.raises(InputError, match="t: the 9 cameras are not"):
        exported("eslf", {"t": light_field(uneven)})
    with pytest.raises(
        InputError,
        match="u: hci4d needs an odd number of views per side and fx = fy, got 2 x 2",
    ):
        exported("hci4d", {"u": light_field(views(2))})


def stack(distances=DISTANCES):
    thin = [
        Shot(tl.ThinLens(0.01, z), (image(10 + k),)) for k, z in enumerate(distances)
    ]
    return alone(Shot(tl.Pinhole(), (image(0),)), *thin)


def test_fod500(exported):
    """Readers sort the files that end with All.tif and Dpt.exr, and read the red channel as half floats."""
    out = exported("fod500", {"s": stack(), "t": stack()})
    images = sorted(path.name for path in out.iterdir() if path.name[-7:] == "All.tif")
    depths = sorted(path.name for path in out.iterdir() if path.name[-7:] == "Dpt.exr")
    assert [int(name[:6]) for name in images] == [0, 0, 0, 1, 1, 1]
    assert [int(name[:6]) for name in depths] == [0, 1]
    for name, seed in zip(images, (11, 12, 10, 11, 12, 10), strict=True):
        assert_array_equal(np.asarray(Image.open(out / name)), image(seed))
    with OpenEXR.File(str(out / depths[1]), separate_channels=True) as file:
        red = file.channels()["R"].pixels
    assert red.dtype == np.float16
    assert_allclose(red, truths(ALONE)[0].depth, rtol=5e-4)
    assert (out / "focus_distances.txt").read_text().split() == ["0.8", "1.3", "2.0"]


def test_focal_stacks_of_different_distances_are_refused(exported):
    with pytest.raises(
        InputError,
        match=r"t: has images of thin lenses at 2 focus distances \[0\.8, 1\.5\] m; other",
    ):
        exported("fod500", {"s": stack(), "t": stack((0.8, 1.5))})
    with pytest.raises(InputError, match="needs two or more"):
        exported("fod500", {"u": stack((0.8,))})
