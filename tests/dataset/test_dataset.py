import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    read_manifest,
    write_manifest,
    write_pfm,
    write_png,
    write_sample,
)
from twinlens.dataset.codecs.calib import write_calib
from twinlens.dataset.dataset import row_of
from twinlens.dataset.files import hash_files
from twinlens.dataset.verify import verify_sample
from twinlens.errors import FileError, InputError
from twinlens.scoring import motorcycle


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    sample = dataset_scene.sample()
    names = ["b", "a", "train/0001"]
    for name in names:
        write_sample(folder / name, sample)
    rows = tuple(row_of(folder, name, {"split": "train"}) for name in names)
    write_manifest(
        folder, Manifest(rows, recipe={"count": 3}, seed=5, info={"rejected": {}})
    )
    return folder


def test_a_dataset_is_a_sequence_in_manifest_order(folder):
    data = Dataset(folder)
    assert len(data) == 3
    assert [sample.name for sample in data] == ["b", "a", "train/0001"]
    assert data[-1] == data[2] == data["train/0001"] == list(data)[2]
    assert data[0].row["info"] == {"split": "train"}
    with pytest.raises(IndexError):
        data[3]
    with pytest.raises(
        InputError, match="unknown sample 'train/001'; did you mean 'train/0001'"
    ):
        data["train/001"]


def test_a_slice_is_a_dataset_of_the_same_manifest(folder):
    names = [sample.name for sample in Dataset(folder)[:0:-1]]
    assert names == ["train/0001", "a"]
    assert len(Dataset(folder)[5:]) == 0
    assert Dataset(folder)[1:].manifest.seed == 5


def test_a_selection_needs_names(folder):
    with pytest.raises(InputError, match="select needs the names of quantities"):
        Dataset(folder).select()


def test_arrays_are_read_from_the_file_each_time(folder):
    sample = Dataset(folder)[0]
    sample.disp0[:] = 0
    assert sample.disp0.max() > 0


def test_folders_without_samples_are_refused(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        Dataset(tmp_path / "nothing")
    with pytest.raises(
        FileError,
        match=r"has no sample: .* im0.png .left; im1.png is the right image.$",
    ):
        Dataset(tmp_path)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("im0.jpg", "`magick im0.jpg im0.png`"),
        ("desk/im0.tif", "`magick im0.tif im0.png`"),
        ("desk/im0.JPEG", "`magick im0.JPEG im0.png`"),
        ("IM0.PNG", "rename it to im0.png"),
    ],
)
def test_images_of_another_format_are_named(tmp_path, name, remedy):
    (tmp_path / "desk").mkdir()
    (tmp_path / name).touch()
    with pytest.raises(FileError) as caught:
        Dataset(tmp_path)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / name}: the images of a pair must be im0.png and im1.png; ")  # fmt: skip
    assert remedy in message


def test_the_manifest_reads_back(folder):
    manifest = read_manifest(folder)
    assert (manifest.recipe, manifest.seed, manifest.info) == (
        {"count": 3},
        5,
        {"rejected": {}},
    )
    assert manifest.rows[0].files == hash_files(folder / "b")
    before = (folder / "dataset.json").read_bytes()
    write_manifest(folder, manifest)
    assert (folder / "dataset.json").read_bytes() == before


def test_hashes_equal_those_of_sha256sum(folder):
    path = folder / "a" / "im0.png"
    expected = subprocess.run(
        ["sha256sum", str(path)], capture_output=True, text=True, check=True
    ).stdout.split()[0]
    assert hash_files(folder / "a")["im0.png"] == expected


def test_a_plain_middlebury_folder(tmp_path):
    pair = motorcycle()
    for name in ("Motorcycle", "Adirondack"):
        write_png(tmp_path / name / "im0.png", pair.im0)
        write_png(tmp_path / name / "im1.png", pair.im1)
        write_calib(tmp_path / name / "calib.txt", pair.calibration)
        write_pfm(tmp_path / name / "disp0GT.pfm", pair.disp0)
    (tmp_path / "notes").mkdir()
    (tmp_path / ".cache").mkdir()
    data = Dataset(tmp_path)
    assert [sample.name for sample in data] == ["Adirondack", "Motorcycle"]
    sample = data["Motorcycle"]
    assert_array_equal(sample.disp0, pair.disp0)
    assert_array_equal(sample.mask0_nonocc, pair.mask0_nonocc)
    assert sample.ndisp == 70
    assert sample.num_lenses == 1
    assert_array_equal(sample.lens(0).im1, pair.im1)
    assert sample.rig.baseline() == pytest.approx(0.193001)
    assert verify_sample(sample) == []
    with pytest.raises(FileError, match="no such file"):
        _ = sample.truth0
    with pytest.raises(FileError, match=r"dataset\.json: no such file"):
        _ = data.manifest


def test_missing_masks_are_computed(tmp_path):
    sample = dataset_scene.sample(width=200, height=150)
    for i in (0, 1):
        write_png(tmp_path / f"im{i}.png", sample.shots[0].images[i])
        write_pfm(tmp_path / f"disp{i}.pfm", sample.truths[i].disparity)
    stored = Dataset(tmp_path)[0]
    for i in (0, 1):
        exact = sample.truths[i].mask_nonocc()
        assert (stored.mask_nonocc(i) == exact).mean() > 0.999
        assert (exact == 128).mean() > 0.01
    assert stored.ndisp == np.ceil(stored.disp0[np.isfinite(stored.disp0)].max()) + 1


def test_a_folder_above_datasets_names_them(tmp_path):
    for name in ("trainingQ/Adirondack", "trainingQ/Adirondack/lens-1", "a/b/scene"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "im0.png").touch()
    with pytest.raises(FileError) as caught:
        Dataset(tmp_path)
    assert str(caught.value).endswith(
        f"; these have: {tmp_path / 'a' / 'b'}, {tmp_path / 'trainingQ'}"
    )


def test_importing_the_dataset_package_loads_no_renderer():
    heavy = "('mitsuba', 'drjit', 'numba', 'torch')"
    code = f"import sys, twinlens.dataset; sys.exit(any(m in sys.modules for m in {heavy}))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_invalid_manifest_is_rejected(folder, tmp_path):
    good = json.loads((folder / "dataset.json").read_text())
    first, second, third = good["samples"]
    for change, message in (
        ({"version": 9}, "reads version 1"),
        ({"format": "other"}, "not a twinlens-dataset file"),
        ({"samples": []}, "lists no sample"),
        ({"samples": [{**first, "name": "../b"}]}, r"samples\[0\]\.name: '../b' is not a plain relative name"),
        ({"samples": [first, {**second, "name": "b"}]}, "'b' twice"),
        ({"samples": [{**first, "files": {"/etc/passwd": ""}}]}, "plain relative name"),
        ({"samples": [first, second, third, 7]}, r"samples\[3\]: must be a table"),
    ):  # fmt: skip
        (tmp_path / "dataset.json").write_text(json.dumps({**good, **change}))
        with pytest.raises(FileError, match=message):
            Dataset(tmp_path)
