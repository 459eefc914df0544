"""Verification of whole datasets: dataset.json, unlisted samples, metadata, and repair hints."""

import json
import shutil

import pytest

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    describe,
    place,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.verify import missing_parts, repair_hint
from twinlens.errors import FileError

NAMES = ("a", "train/0")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write(tmp_path_factory.mktemp("made") / "set")


def write(root):
    rows = [
        Row(name, write_sample(root / name, dataset_scene.sample())) for name in NAMES
    ]
    write_manifest(root, Manifest(tuple(rows)))
    describe(root)
    return root


@pytest.fixture
def root(made, tmp_path):
    return shutil.copytree(made, tmp_path / "set")


def wrong(where):
    return {name: findings for name, findings in verify_place(where) if findings}


def test_a_complete_dataset_has_no_findings(root):
    calls = []
    assert [name for name, _ in verify_place(root, lambda *now: calls.append(now))] == [
        "dataset.json",
        *NAMES,
    ]
    assert calls == [(0.0, "a"), (0.5, "train/0")]
    (root / ".cache").mkdir()
    (root / "notes").mkdir()
    (root / "notes" / "todo.txt").touch()
    assert wrong(root) == {}
    assert missing_parts(root) == ""


def test_verification_in_a_bucket(tmp_path):
    root = write(place(f"memory:/{tmp_path}/set"))
    assert wrong(root) == {}
    write_sample(root / "train" / "1", dataset_scene.sample())
    (root / "a" / "im0.png").write_bytes(b"short")
    assert wrong(root) == {
        "dataset.json": ["train/1: is a sample that dataset.json does not list"],
        "a": ["im0.png: differs from its SHA-256 in dataset.json"],
    }


def test_unlisted_samples_are_reported(root):
    write_sample(root / "b", dataset_scene.sample(num_lenses=2))
    shutil.copytree(root / "a", root / "train" / "deep" / "er")
    assert wrong(root)["dataset.json"] == [
        "b: is a sample that dataset.json does not list",
        "train/deep/er: is a sample that dataset.json does not list",
    ]


def test_a_removed_sample_is_reported(root):
    shutil.rmtree(root / "a")
    ((name, findings),) = wrong(root).items()
    assert name == "a"
    assert "no such folder" in findings[0]


def test_a_damaged_list_is_reported_and_samples_are_checked(root):
    path = root / "dataset.json"
    path.write_bytes(path.read_bytes()[:-40])
    (root / "a" / "disp0.pfm").write_bytes(b"")
    found = wrong(root)
    assert found["dataset.json"][0].startswith("not valid JSON")
    assert found["a"][0].startswith("disp0.pfm: not a PFM")
    assert str(root) not in str(found)


def test_a_removed_list_is_reported(root):
    (root / "dataset.json").unlink()
    ((name, (finding,)),) = wrong(root).items()
    assert name == "dataset.json"
    assert finding.startswith(
        "is missing, so no checksums can be verified; 1 found without it; "
    )
    assert finding.endswith(
        "if `twinlens generate` made them, rerun it to restore the file"
    )
    assert missing_parts(root).startswith("no dataset.json: ")
    # The folder of a single sample needs no dataset.json.
    assert wrong(root / "a") == {}


def test_outdated_metadata_is_reported(root):
    write_manifest(root, Manifest(Dataset(root).manifest.rows, seed=1))
    assert wrong(root) == {
        "dataset.json": [
            "croissant.json: describes another dataset.json; `twinlens describe` rewrites it"
        ]
    }
    describe(root)
    assert wrong(root) == {}


@pytest.mark.parametrize(
    ("count", "info", "expected"),
    [
        (2, {"complete": True}, ""),
        (
            5,
            {"complete": False},
            "lists 2 of 5 samples; rerun `twinlens generate` to make",
        ),
        (
            5,
            {},
            "lists 2 of 5 samples; rerun `twinlens generate` to make the missing samples",
        ),
        (
            5,
            {"failed": [{}]},
            '1 failed ("failed" in it says why); rerun `twinlens generate`',
        ),
        (
            3,
            {"complete": True, "failed": [{}]},
            'lists 2 of 3 samples; 1 failed ("failed"',
        ),
        ("many", {"failed": 7}, ""),
    ],
)
def test_missing_samples_are_counted_and_not_findings(root, count, info, expected):
    write_manifest(
        root, Manifest(Dataset(root).manifest.rows, {"count": count}, info=info)
    )
    describe(root)
    assert wrong(root) == {}
    assert expected in missing_parts(root)
    assert bool(expected) == bool(missing_parts(root))
    assert ("make the missing" in missing_parts(root)) == (count == 5)


def test_metadata_of_an_unfinished_dataset_is_not_checked(root):
    """It describes the last complete dataset, and is rewritten when the dataset is complete again."""
    rows = Dataset(root).manifest.rows
    write_manifest(root, Manifest(rows, {"count": 5}, info={"complete": False}))
    assert wrong(root) == {}
    write_manifest(root, Manifest(rows, {"count": 2}, info={"complete": True}))
    assert "describes another dataset.json" in wrong(root)["dataset.json"][0]


def test_an_unreadable_row_is_reported_and_its_sample_checked(root):
    for name in ("0000000", "0000001"):
        shutil.copytree(root / "a", root / name)
    (root / ".rows").mkdir()
    (root / ".rows" / "0000001.json").touch()
    unlisted, row = wrong(root)["dataset.json"][::-1]
    assert unlisted == "0000000: is a sample that dataset.json does not list"
    assert row.startswith(".rows/0000001.json: not valid JSON")
    assert row.endswith(
        "the next `twinlens generate` makes it again, from the sample's files"
    )
    (root / "0000001" / "disp0.pfm").write_bytes(b"")
    assert wrong(root)["0000001"][0].startswith("disp0.pfm: not a PFM")


def test_nothing_is_counted_without_a_readable_list(root):
    (root / "dataset.json").write_text("{")
    assert missing_parts(root) == ""


def test_repair_hint_for_samples_of_generate(root):
    rows = Dataset(root).manifest.rows
    write_manifest(root, Manifest(rows, info={"made_with": {"backend": "llvm_ad_rgb"}}))
    assert repair_hint(root, wrong(root)) == ""
    (root / "a" / "notes.txt").touch()
    assert repair_hint(root, wrong(root)) == ""
    (root / "a" / "disp0.pfm").write_bytes(b"")
    assert repair_hint(root, wrong(root)).startswith(
        "1 sample is damaged: delete its folder and rerun"
    )
    shutil.rmtree(root / "train" / "0")
    assert repair_hint(root, wrong(root)).startswith("2 samples are damaged: ")
    write_manifest(root, Manifest(rows))
    assert repair_hint(root, wrong(root)) == "", "not made by generate"
    (root / "dataset.json").write_text("{")
    assert repair_hint(root, wrong(root)) == ""


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"distribution": 7}', '{"distribution": [7]}', "[" * 5000]
)
def test_damaged_metadata_is_reported(root, text):
    (root / "croissant.json").write_text(text)
    assert wrong(root)["dataset.json"] == [
        "croissant.json: is damaged; `twinlens describe` rewrites it"
    ]


def test_folders_without_samples_are_rejected(tmp_path):
    with pytest.raises(FileError, match="has no sample"):
        list(verify_place(tmp_path))
    (tmp_path / "dataset.json").write_text(json.dumps({"format": "other"}))
    assert "not a twinlens-dataset file" in wrong(tmp_path)["dataset.json"][0]
