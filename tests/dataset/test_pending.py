"""Pending samples, made but not yet listed in dataset.json, as parallel shards and interrupted runs leave them."""

import shutil

import pytest

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    place,
    verify,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.files import hash_files, write_file
from twinlens.dataset.record import encode_json
from twinlens.dataset.verify import missing_parts, repair_hint
from twinlens.errors import FileError
from twinlens.factory.plan import sample_name

MADE_WITH = {"made_with": {"backend": "llvm_ad_rgb"}}


def wrong(where):
    return {name: findings for name, findings in verify_place(where) if findings}


def shards(root, count, **info):
    """A dataset of `count` samples made by shards: two samples and one failure, none listed yet."""
    rows = [
        {"name": name, "files": write_sample(root / name, dataset_scene.sample())}
        for name in ("0000000", "0000002")
    ]
    for name, kept in (
        ("0000000", {"row": rows[0]}),
        ("0000002", {"row": rows[1]}),
        ("0000004", {"failure": {}}),
    ):
        write_file(
            root / ".rows" / f"{name}.json",
            encode_json({"format": "twinlens-row", "version": 1, **kept}),
        )
    write_manifest(
        root, Manifest((), {"count": count}, info={"complete": False, **info})
    )
    return root


@pytest.fixture(params=["disk", "bucket"])
def place_of_set(request, tmp_path):
    return tmp_path / "set" if request.param == "disk" else bucket(tmp_path)


def bucket(tmp_path):
    return place(f"memory:/{tmp_path}/set")


def test_pending_samples_are_verified(place_of_set):
    root = shards(place_of_set, 6)
    assert dict(verify_place(root)) == {
        "dataset.json": [],
        "0000000": [],
        "0000002": [],
    }
    (root / "0000002" / "disp0.pfm").write_bytes(b"short")
    (root / "0000002" / "extra.txt").write_bytes(b"")
    assert wrong(root) == {
        "0000002": [
            "disp0.pfm: differs from its SHA-256 in .rows/0000002.json",
            "extra.txt: is not listed in .rows/0000002.json",
        ]
    }
    with pytest.raises(
        FileError,
        match="rerun `twinlens generate` to list the finished samples and make the others",
    ):
        Dataset(root)


@pytest.mark.parametrize(
    ("count", "failed", "expected"),
    [
        (
            6,
            [],
            "2 made but not listed yet; rerun `twinlens generate` to make the missing samples and list the finished",
        ),
        (
            2,
            [],
            "2 made but not listed yet; rerun `twinlens generate` to list the finished ones",
        ),
        (3, [{}], "rerun `twinlens generate` to list the finished ones"),
    ],
)
def test_pending_samples_are_counted(tmp_path, count, failed, expected):
    line = missing_parts(shards(tmp_path / "set", count, failed=failed))
    assert line.startswith(f"dataset.json lists 0 of {count} samples; ")
    assert expected in line


def row_of_a_sample(files):
    return encode_json(
        {
            "format": "twinlens-row",
            "version": 1,
            "row": {"name": "0000000", "files": files},
        }
    )


def test_a_sample_without_a_row_is_pending_in_an_unfinished_dataset(place_of_set):
    """A process that is killed between the sample and its row leaves it so."""
    root = shards(place_of_set, 6, **MADE_WITH)
    write_sample(root / sample_name(5), dataset_scene.sample())
    assert dict(verify_place(root)) == {
        "dataset.json": [],
        "0000000": [],
        "0000002": [],
        "0000005": [],
    }
    assert "3 made but not listed yet (1 without checksums); rerun" in missing_parts(
        root
    )
    (root / "0000005" / "disp0.pfm").write_bytes(b"")
    assert wrong(root)["0000005"][0].startswith("disp0.pfm: not a PFM")


def test_samples_with_other_names_are_not_pending(place_of_set):
    root = shards(place_of_set, 6, **MADE_WITH)
    names = ("0000006", "3", "deep/0000003")
    for name in names:
        write_sample(root / name, dataset_scene.sample())
    lines = [f"{name}: is a sample that dataset.json does not list" for name in names]
    assert wrong(root) == {"dataset.json": lines}
    for finished in ({"complete": True, **MADE_WITH}, {"complete": False}):
        write_manifest(root, Manifest((), {"count": 7}, info=finished))
        assert wrong(root)["dataset.json"] == lines, (
            "generate does not continue this dataset"
        )


def test_incomplete_samples_are_reported_on_disk_only(tmp_path):
    disk = shards(tmp_path / "set", 6, **MADE_WITH)
    remote = shards(bucket(tmp_path), 6, **MADE_WITH)
    write_file(disk / "0000003" / "im0.png", b"some")
    for name in ("im0.png", "lens-1/im0.png"):
        write_file(remote / "0000003" / name, b"some")
    assert wrong(disk) == {
        "dataset.json": ["0000003: is a sample that dataset.json does not list"]
    }
    assert wrong(remote) == {}
    write_sample(disk / "0000001" / "deep", dataset_scene.sample())
    assert (
        "0000001/deep: is a sample that dataset.json does not list"
        in wrong(disk)["dataset.json"]
    )


def test_a_dataset_without_samples_yet_has_no_findings(tmp_path):
    write_manifest(
        tmp_path, Manifest((), {"count": 3}, info={"complete": False, **MADE_WITH})
    )
    assert list(verify_place(tmp_path)) == [("dataset.json", [])]
    assert missing_parts(tmp_path).startswith("dataset.json lists 0 of 3 samples; ")


@pytest.mark.parametrize("step", ["_sample_folders", "pending_rows"])
def test_samples_listed_during_verification_are_not_findings(
    tmp_path, monkeypatch, step
):
    """Shards may add a sample, a row, or the whole list at any moment."""
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    write_sample(root / "0000001", dataset_scene.sample())
    look = getattr(verify, step)

    def look_and_change(*given):
        seen = list(look(*given))
        rows = [
            Row(name, hash_files(root / name))
            for name in ("0000000", "0000001", "0000002")
        ]
        rows.append(
            Row("0000003", write_sample(root / "0000003", dataset_scene.sample()))
        )
        write_manifest(root, Manifest(rows, {"count": 4}, info={"complete": True}))
        shutil.rmtree(root / ".rows")
        return seen

    monkeypatch.setattr(verify, step, look_and_change)
    assert dict(verify_place(root)) == {"dataset.json": []} | {
        f"000000{i}": [] for i in range(4)
    }


@pytest.mark.parametrize("step", ["_sample_folders", "pending_rows"])
def test_a_sample_that_appears_during_verification_has_its_row_or_is_not_seen(
    tmp_path, monkeypatch, step
):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    look = getattr(verify, step)

    def look_and_change(*given):
        seen = list(look(*given))
        files = write_sample(root / "0000003", dataset_scene.sample())
        (root / ".rows" / "0000003.json").write_bytes(row_of_a_sample(files))
        return seen

    monkeypatch.setattr(verify, step, look_and_change)
    line = missing_parts(root)
    assert " made but not listed yet; " in line, "each with its checksums"
    assert line.startswith("dataset.json lists 0 of 4")


def test_folders_may_disappear_during_verification(tmp_path, monkeypatch):
    """The temporary folder of a sample, and one that a user deletes."""
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    for name in (".0000001.unfinished-1-2", "notes"):
        (root / name).mkdir()
    listed = type(root).iterdir

    def iterdir(folder):
        if folder.name in (".0000001.unfinished-1-2", "notes"):
            raise FileNotFoundError(folder)
        return listed(folder)

    monkeypatch.setattr(type(root), "iterdir", iterdir)
    assert next(iter(verify_place(root))) == ("dataset.json", [])


@pytest.mark.parametrize("name", ["..", ".", ""])
def test_the_name_of_a_row_stays_below_the_folder(tmp_path, name):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    write_sample(tmp_path / "other", dataset_scene.sample())
    for other in (root, tmp_path):
        (other / "sample.json").write_bytes(
            (root / "0000000" / "sample.json").read_bytes()
        )
    (root / ".rows" / f"{name}.json").write_bytes(row_of_a_sample({}))
    found = dict(verify_place(root))
    assert list(found) == ["dataset.json", "0000000", "0000002"]
    assert found["dataset.json"] == [
        f".rows/{name}.json: {name!r} is not a plain relative name"
    ]


def test_an_unreadable_row_is_reported(tmp_path):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    failed = encode_json({"format": "twinlens-row", "version": 1, "failure": {}})
    outside = "../0000002/im0.png"
    for row, expected in (
        (b"{", "not valid JSON"),
        (row_of_a_sample({outside: "0"}), f"row.files.{outside}: '{outside}' is not a plain relative name"),
        (row_of_a_sample({"im0.png": 7}), "row.files.im0.png: must be a string, got 7"),
        (row_of_a_sample(None), "row.files: must be a table"),
        (failed, "missing key 'row'"),
    ):  # fmt: skip
        (root / ".rows" / "0000000.json").write_bytes(row)
        ((name, (finding,)),) = wrong(root).items()
        assert name == "dataset.json"
        assert finding.startswith(f".rows/0000000.json: {expected}")
        assert "(1 without checksums)" in missing_parts(root)


def test_repair_hint_for_pending_samples(tmp_path):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    (root / "0000000" / "disp0.pfm").write_bytes(b"")
    assert repair_hint(root, wrong(root)).startswith(
        "1 sample is damaged: delete its folder"
    )
