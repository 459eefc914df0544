"""Samples that wait to be listed: made by shards that run beside, or by a run that was stopped."""

import shutil

import pytest

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    audit,
    cure,
    place,
    unfinished,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.files import write_file
from twinlens.dataset.manifest import checksums
from twinlens.dataset.record import encode_json
from twinlens.errors import FileError
from twinlens.factory.plan import sample_name

MADE_WITH = {"made_with": {"backend": "scalar_rgb"}}


def wrong(where):
    return {name: findings for name, findings in verify_place(where) if findings}


def shards(root, count, **info):
    """What shards have made of `count` samples when none has listed them: two, and one that could not be made."""
    rows = [
        {"name": name, "files": write_sample(root / name, dataset_scene.sample())} for name in ("0000000", "0000002")
    ]
    for name, kept in (("0000000", {"row": rows[0]}), ("0000002", {"row": rows[1]}), ("0000004", {"failure": {}})):
        write_file(root / ".rows" / f"{name}.json", encode_json({"format": "twinlens-row", "version": 1, **kept}))
    write_manifest(root, Manifest((), {"count": count}, info={"complete": False, **info}))
    return root


@pytest.mark.parametrize("where", ["disk", "bucket"])
def test_what_shards_have_made_is_checked_before_it_is_listed(tmp_path, where):
    root = shards(tmp_path / "set" if where == "disk" else place(f"memory:/{tmp_path}/set"), 6)
    assert dict(verify_place(root)) == {"dataset.json": [], "0000000": [], "0000002": []}
    (root / "0000002" / "disp0.pfm").write_bytes(b"short")
    (root / "0000002" / "extra.txt").write_bytes(b"")
    assert wrong(root) == {
        "0000002": [
            "disp0.pfm: differs from its SHA-256 in .rows/0000002.json",
            "extra.txt: is not listed in .rows/0000002.json",
        ]
    }
    with pytest.raises(FileError, match="began it lists those that are there and makes the rest"):
        Dataset(root)


@pytest.mark.parametrize(
    ("count", "failed", "said"),
    [
        (
            6,
            [],
            "2 more are made and not listed yet; the `twinlens generate` that began it makes the rest and lists them",
        ),
        (2, [], "2 more are made and not listed yet; the `twinlens generate` that began it lists them"),
        (3, [{}], "that began it lists them"),
    ],
)
def test_what_shards_have_made_is_told(tmp_path, count, failed, said):
    told = unfinished(shards(tmp_path / "set", count, failed=failed))
    assert told.startswith(f"dataset.json lists 0 of the {count} samples of its recipe; ")
    assert told.endswith(said)


def row_of_a_sample(files):
    return encode_json({"format": "twinlens-row", "version": 1, "row": {"name": "0000000", "files": files}})


@pytest.mark.parametrize("where", ["disk", "bucket"])
def test_a_sample_without_a_row_waits_too_where_the_dataset_grows(tmp_path, where):
    """A sample appears before its row, and a process that is killed in between leaves it so."""
    root = tmp_path / "set" if where == "disk" else place(f"memory:/{tmp_path}/set")
    shards(root, 6, **MADE_WITH)
    write_sample(root / sample_name(5), dataset_scene.sample())
    assert dict(verify_place(root)) == {"dataset.json": [], "0000000": [], "0000002": [], "0000005": []}
    assert "3 more are made and not listed yet (1 without checksums so far); the `tw" in unfinished(root)
    (root / "0000005" / "disp0.pfm").write_bytes(b"")
    assert wrong(root)["0000005"][0].startswith("disp0.pfm: not a PFM")


@pytest.mark.parametrize("where", ["disk", "bucket"])
def test_what_no_sample_of_the_recipe_is_called_does_not_wait(tmp_path, where):
    root = tmp_path / "set" if where == "disk" else place(f"memory:/{tmp_path}/set")
    shards(root, 6, **MADE_WITH)
    names = ("0000006", "3", "deep/0000003")
    for name in names:
        write_sample(root / name, dataset_scene.sample())
    told = [f"{name}: is a sample that dataset.json does not list" for name in names]
    assert wrong(root) == {"dataset.json": told}
    for finished in ({"complete": True, **MADE_WITH}, {"complete": False}):
        write_manifest(root, Manifest((), {"count": 7}, info=finished))
        assert wrong(root)["dataset.json"] == told, "it is not `generate` that goes on there"


def test_half_a_sample_is_told_but_for_a_bucket_where_it_is_being_written(tmp_path):
    disk, bucket = (shards(root, 6, **MADE_WITH) for root in (tmp_path / "set", place(f"memory:/{tmp_path}/set")))
    for root, name in ((disk, "im0.png"), (bucket, "im0.png"), (bucket, "lens-1/im0.png")):
        write_file(root / "0000003" / name, b"some")
    assert wrong(disk) == {"dataset.json": ["0000003: is a sample that dataset.json does not list"]}
    assert wrong(bucket) == {}
    write_sample(disk / "0000001" / "deep", dataset_scene.sample())
    assert "0000001/deep: is a sample that dataset.json does not list" in wrong(disk)["dataset.json"]


def test_a_dataset_of_which_nothing_is_made_yet_is_nothing_wrong(tmp_path):
    write_manifest(tmp_path, Manifest((), {"count": 3}, info={"complete": False, **MADE_WITH}))
    assert list(verify_place(tmp_path)) == [("dataset.json", [])]
    assert unfinished(tmp_path).startswith("dataset.json lists 0 of the 3 samples of its recipe; ")


@pytest.mark.parametrize("step", ["_folders_of_samples", "kept_rows"])
def test_what_moves_on_between_two_looks_is_nothing_wrong(tmp_path, monkeypatch, step):
    """Beside shards: a sample, its row, and the whole list with the rows gone, each at any moment."""
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    write_sample(root / "0000001", dataset_scene.sample())
    look = getattr(audit, step)

    def moved_on(*given):
        seen = list(look(*given))
        rows = [Row(name, checksums(root / name)) for name in ("0000000", "0000001", "0000002")]
        rows.append(Row("0000003", write_sample(root / "0000003", dataset_scene.sample())))
        write_manifest(root, Manifest(rows, {"count": 4}, info={"complete": True}))
        shutil.rmtree(root / ".rows")
        return seen

    monkeypatch.setattr(audit, step, moved_on)
    assert dict(verify_place(root)) == {"dataset.json": []} | {f"000000{i}": [] for i in range(4)}


@pytest.mark.parametrize("step", ["_folders_of_samples", "kept_rows"])
def test_a_sample_that_appears_between_two_looks_has_its_row_or_is_not_seen(tmp_path, monkeypatch, step):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    look = getattr(audit, step)

    def moved_on(*given):
        seen = list(look(*given))
        files = write_sample(root / "0000003", dataset_scene.sample())
        (root / ".rows" / "0000003.json").write_bytes(row_of_a_sample(files))
        return seen

    monkeypatch.setattr(audit, step, moved_on)
    told = unfinished(root)
    assert "more are made and not listed yet; " in told, "each with its checksums"
    assert told.startswith("dataset.json lists 0 of the 4")


def test_a_half_written_folder_that_goes_while_folders_are_listed(tmp_path, monkeypatch):
    """The dotted folder that a sample is filled under, and one that somebody deletes."""
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
def test_the_name_of_a_row_leads_nowhere_else(tmp_path, name):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    write_sample(tmp_path / "other", dataset_scene.sample())
    for stranger in (root, tmp_path):
        (stranger / "sample.json").write_bytes((root / "0000000" / "sample.json").read_bytes())
    (root / ".rows" / f"{name}.json").write_bytes(row_of_a_sample({}))
    found = dict(verify_place(root))
    assert list(found) == ["dataset.json", "0000000", "0000002"]
    assert found["dataset.json"] == [f".rows/{name}.json: {name!r} is not a plain relative name"]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (b"{", "not valid JSON"),
        (row_of_a_sample({"../0000002/im0.png": "0"}), "'../0000002/im0.png' is not a plain relative name"),
        (row_of_a_sample({"im0.png": 7}), 'needs a "row" with "files" that map names to SHA-256 texts'),
        (row_of_a_sample(None), 'needs a "row" with "files"'),
        (encode_json({"format": "twinlens-row", "version": 1, "failure": {}}), 'needs a "row" with "files"'),
    ],
)
def test_a_row_that_cannot_be_read_is_told(tmp_path, row, said):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    (root / ".rows" / "0000000.json").write_bytes(row)
    ((name, (finding,)),) = wrong(root).items()
    assert name == "dataset.json"
    assert finding.startswith(f".rows/0000000.json: {said}")
    assert "(1 without checksums so far)" in unfinished(root)


def test_damage_of_a_sample_that_waits_can_be_mended_too(tmp_path):
    root = shards(tmp_path / "set", 4, **MADE_WITH)
    (root / "0000000" / "disp0.pfm").write_bytes(b"")
    assert cure(root, wrong(root)).startswith("1 sample is damaged: delete the folder")
