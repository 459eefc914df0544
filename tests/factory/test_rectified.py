"""Rectified samples: their truth is that of the pair built rectified, their rows agree, their pictures show it."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from twinlens.camera import BrownConrady, Misalignment, Rig, layouts
from twinlens.camera.rectification import warp
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.verify import verify_sample
from twinlens.errors import InputError
from twinlens.factory import (
    Shoot,
    make,
    make_sample,
    recipe_from_table,
    rectified_sample,
)
from twinlens.geometry import rigid
from twinlens.sensor import Sensor

# `twinlens.factory.remake` is the function of that name.
families_of_records = importlib.import_module("twinlens.factory.remake")
BASELINE, CROSSING = 0.3, 1.6
FINE = Sensor.preset("ideal")


@pytest.fixture(scope="module")
def scene():
    return tl.load_scene("cards")


@pytest.fixture(scope="module")
def middle(scene):
    return scene.world_from_left @ rigid(np.eye(3), [0.5 * scene.baseline, 0, 0])


def toed_in(middle, distortion):
    camera = tl.Camera(96, 72, 105.0, 100.0, 47.0, 36.0, distortion)
    return layouts.toed_in(camera, BASELINE, CROSSING, middle)


@pytest.fixture(scope="module")
def stored(scene, middle, tmp_path_factory):
    """A toed-in pair with distortion, on the disk."""
    folder = tmp_path_factory.mktemp("toed") / "cards"
    rig = toed_in(middle, BrownConrady(-0.15, 0.03))
    write_sample(
        folder, make_sample(scene, rig, [tl.Pinhole()], Shoot(spp=32, sensor=FINE))
    )
    return Dataset(folder)[0]


def test_truth_equals_that_of_the_pair_built_rectified_and_rows_agree(scene, middle):
    distortion = BrownConrady(-0.15, 0.03, 1e-3, -5e-4)
    rig = tl.rectify(toed_in(middle, distortion)).rectified_rig
    left = middle @ rigid(np.eye(3), [-0.5 * BASELINE, 0, 0])
    built = Rig.stereo(rig.cameras[0], BASELINE, left)
    truths = zip(
        tl.ground_truth(scene, rig), tl.ground_truth(scene, built), strict=True
    )
    for side, (truth, expected) in enumerate(truths):
        same = truth.object_id == expected.object_id
        assert same.mean() > 0.9995
        ours, theirs = truth.disparity[same], expected.disparity[same]
        finite = np.isfinite(ours)
        assert np.array_equal(finite, np.isfinite(theirs))
        assert np.abs(ours[finite] - theirs[finite]).max() < 1e-4
        matches = tl.correspondence(scene, rig, side, 1 - side).pixels
        shift = matches[..., 1] - rig.cameras[side].pixel_grid()[..., 1]
        assert np.abs(shift[np.isfinite(shift)]).max() < 1e-6


@pytest.fixture(scope="module")
def rectified(stored):
    """The pair with warped pictures, and with pictures of the rectified cameras."""
    return {
        pictures: rectified_sample(stored, pictures=pictures, zero_doffs=False)
        for pictures in ("maps", "render")
    }


@pytest.mark.parametrize("pictures", ["maps", "render"])
def test_what_is_written_verifies_and_is_a_rectified_pair(
    rectified, tmp_path, pictures
):
    write_sample(tmp_path / "s", rectified[pictures])
    again = Dataset(tmp_path)[0]
    assert verify_sample(again) == []
    assert again.rig.is_rectified()
    assert again.record["record"]["rectified_from"]["views"] == [0, 1]


def test_warped_pictures_are_those_that_the_rectified_cameras_take(stored, rectified):
    warped, taken = rectified["maps"], rectified["render"]
    result = tl.rectify(stored.rig, zero_doffs=False)
    for side in (0, 1):
        valid = result.valid(side)
        image, other = warped.shots[0].images[side], taken.shots[0].images[side]
        correlation = np.corrcoef(image[valid].ravel(), other[valid].ravel())
        assert correlation[0, 1] > 0.97
        assert not image[~valid][:, 0].any() or (~valid).sum() < 400
        assert not warped.truths[side].visible[~valid].any()


def test_an_error_left_in_is_in_the_pictures_and_not_in_the_truth(stored):
    error = Misalignment(vertical_px=2.0)
    plain, off = (
        rectified_sample(stored, misalignment=m) for m in (Misalignment(), error)
    )
    assert np.array_equal(plain.truths[0].disparity, off.truths[0].disparity)
    assert off.rig.calibrated is not None
    a, b = (s.shots[0].images[1].astype(int) for s in (plain, off))
    assert np.abs(a[20:50] - b[22:52]).mean() < 0.1 * np.abs(a[20:50] - b[20:50]).mean()


def test_pixels_that_a_picture_lacks_are_not_called_visible(stored):
    made = rectified_sample(stored, fit="all", zero_doffs=False)
    result = tl.rectify(stored.rig, fit="all", zero_doffs=False)
    exact = tl.ground_truth(tl.load_scene("cards"), result.aligned_rig)
    for side in (0, 1):
        valid, visible = result.valid(side), made.truths[side].visible
        assert not visible[~valid].any()
        assert np.array_equal(made.truths[side].extra["valid"], 255 * valid)
        lost = exact[side].visible & valid & ~visible
        u, v = np.rint(
            tl.correspondence(
                tl.load_scene("cards"), result.aligned_rig, side, 1 - side
            ).pixels[lost]
        ).T
        assert not result.valid(1 - side)[v.astype(int), u.astype(int)].any()
        assert not (visible & ~exact[side].visible).any()


def test_a_family_that_has_changed_since_is_refused(tmp_path, monkeypatch):
    recipe = recipe_from_table(
        {"seed": 3, "count": 1, "families": ["cards"], "width": 48, "height": 36, "spp": 1,
         "denoise": False, "gates": {"texture": 0}, "rig": {"layout": "toed_in"}}
    )  # fmt: skip
    write_sample(tmp_path / "s", make(recipe, 0))
    stored = Dataset(tmp_path / "s")[0]
    rectified_sample(stored)
    before = families_of_records.family_scene

    def family_scene(*arguments):
        made = before(*arguments)
        return replace(made, objects=made.objects[1:])

    monkeypatch.setattr(families_of_records, "family_scene", family_scene)
    with pytest.raises(InputError, match="makes another scene from its record"):
        rectified_sample(stored)


def test_warping_is_bilinear_and_black_outside():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4) * 10
    x = np.array([[0.5, 3.0, -9.0]], np.float32)
    y = np.array([[1.0, 0.5, 0.0]], np.float32)
    assert warp(image, x, y).tolist() == [[45, 50, 0]]
