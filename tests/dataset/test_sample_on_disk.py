from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, Shot, write_sample
from twinlens.errors import FileError, InputError
from twinlens.optics import circle_of_confusion_px


@pytest.fixture(scope="module")
def sample():
    return dataset_scene.sample(num_lenses=3)


@pytest.fixture(scope="module")
def stored(sample, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    write_sample(folder / "one", sample)
    return Dataset(folder)[0]


def test_the_folder_has_the_documented_files(stored):
    names = {
        path.relative_to(stored.folder).as_posix()
        for path in stored.folder.rglob("*")
        if path.is_file()
    }
    expected = {"calib.txt", "sample.json"}
    for i in (0, 1):
        expected |= {f"im{i}.png", f"lens-1/im{i}.png", f"lens-2/im{i}.png"}
        expected |= {f"disp{i}.pfm", f"mask{i}nocc.png", f"truth{i}.exr"}
    assert names == expected


def test_the_truth_reads_back_in_float32_precision(stored, sample):
    """Its float64 fields; tests/dataset/test_channels.py compares all channels."""
    for truth, original in zip(
        (stored.truth0, stored.truth1), sample.truths, strict=True
    ):
        for back, written in (
            (truth.depth, original.depth),
            (truth.position, original.position),
        ):
            assert back.dtype == np.float64
            hit = np.isfinite(written)
            assert_array_equal(np.isfinite(back), hit)
            assert_allclose(back[hit], written[hit], rtol=2**-24)
        assert_array_equal(truth.disparity, original.disparity)
        assert truth.object_names == original.object_names
        assert truth.material_names == original.material_names


def test_each_lens_has_its_images_its_record_and_its_blur(stored, sample):
    assert stored.num_lenses == 3
    for k, shot in enumerate(sample.shots):
        view = stored.lens(k)
        assert view.lens == shot.lens
        assert view.record == {"spp": 16 + k}
        assert_array_equal(view.im1, shot.images[1])
        c = circle_of_confusion_px(
            sample.truths[0].depth, 0.02, 70.0, shot.lens.vergence
        )
        assert_allclose(view.blur_circle_px(0), c, rtol=1e-5, atol=1e-6)
    with pytest.raises(InputError, match="lenses 0 to 2, no lens 3"):
        stored.lens(3)


def test_the_record_reads_back(stored, sample):
    assert stored.record["record"] == {"seed": 7, "scene": "two planes"}
    assert stored.rig.cameras == sample.rig.cameras
    assert_array_equal(stored.rig.world_from_cams, sample.rig.world_from_cams)
    assert stored.calibration.baseline == 0.4
    assert stored.ndisp > stored.disp0[np.isfinite(stored.disp0)].max()


def test_sixteen_bits_grey_and_radiance(tmp_path, sample):
    deep = dataset_scene.images(sample.rig, 5, np.uint16)
    grey = tuple(image[..., 0] for image in deep)
    linear = tuple(image.astype(np.float32) / 1000 for image in deep)
    shots = (Shot(dataset_scene.LENS, deep, linear), Shot(dataset_scene.LENS, grey))
    write_sample(tmp_path / "s", replace(sample, shots=shots))
    stored = Dataset(tmp_path)[0]
    assert_array_equal(stored.im1, deep[1])
    assert_array_equal(stored.radiance(1), linear[1])
    assert_array_equal(stored.lens(1).im0, grey[0])
    with pytest.raises(FileError, match=r"lens-1.radiance0\.exr: no such file"):
        stored.lens(1).radiance(0)


def test_a_pair_that_is_not_rectified_has_no_calibration(tmp_path, sample):
    write_sample(tmp_path / "s", dataset_scene.unrectified(sample))
    stored = Dataset(tmp_path)[0]
    assert not stored.has("calib.txt")
    assert not stored.has("disp0.pfm")
    assert np.isposinf(stored.truth0.disparity).all()
    assert stored.record["rectified"] is False
    with pytest.raises(FileError, match=r"calib\.txt: no such file"):
        _ = stored.calibration


def test_arrays_that_do_not_fit_the_rig_are_rejected(sample):
    shot = sample.shots[0]
    for wrong in (
        {"shots": ()},
        {"shots": (replace(shot, images=shot.images[:1]),)},
        {"shots": (replace(shot, images=(shot.images[0][1:], shot.images[1])),)},
        {"shots": (replace(shot, radiances=(shot.images[0][:, 1:], shot.images[1])),)},
        {"truths": sample.truths[:1]},
    ):
        with pytest.raises(InputError):
            replace(sample, **wrong)


def test_rejected_arrays_leave_nothing_behind(tmp_path, sample):
    shot = replace(
        sample.shots[0], images=tuple(image / 255 for image in sample.shots[0].images)
    )
    with pytest.raises(InputError, match="uint8 or uint16"):
        write_sample(tmp_path / "s", replace(sample, shots=(shot,)))
    nan = replace(sample.truths[0], disparity=np.full((48, 64), np.nan, np.float32))
    with pytest.raises(InputError, match="NaN"):
        write_sample(tmp_path / "s", replace(sample, truths=(nan, sample.truths[1])))
    assert not list(tmp_path.iterdir())


def test_an_invalid_record_is_rejected(tmp_path, sample):
    write_sample(tmp_path / "s", sample)
    path = tmp_path / "s" / "sample.json"
    valid = path.read_text()
    for old, new, message in (
        ('"fx": 70.0', '"fx": -1', "camera fx must be"),
        ('"world_from_cams"', '"poses"', "rig: unknown key 'poses'"),
        ('"folder": "lens-1/"', '"folder": "../.."', "plain relative name"),
    ):
        assert old in valid
        path.write_text(valid.replace(old, new))
        stored = Dataset(tmp_path)[0]
        with pytest.raises(FileError, match=message) as caught:
            _ = stored.rig, stored.lens(1).lens
        assert str(caught.value).startswith(str(path))


def test_a_damaged_lens_leaves_the_rest_readable(tmp_path, sample):
    write_sample(tmp_path / "s", sample)
    with dataset_scene.edited(tmp_path / "s") as record:
        record["shots"][1]["lens"] = {"type": "Glass"}
    stored = Dataset(tmp_path)[0]
    assert stored.num_lenses == 3
    assert stored.rig.cameras == sample.rig.cameras
    assert_array_equal(stored["lens1.im0"], sample.shots[1].images[0])
    with pytest.raises(FileError, match=r"shots\[1\]\.lens\.type"):
        _ = stored.lens(1).lens
