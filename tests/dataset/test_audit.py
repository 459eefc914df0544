"""Verification of whole datasets: dataset.json, unlisted and pending samples, metadata, and repair hints.

Pending samples are made but not yet listed in dataset.json, as parallel shards and interrupted runs leave them.
"""

import shutil

import pytest

from tests.dataset.dataset_scene import sample
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    describe,
    place,
    verify,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.files import hash_files, write_file
from twinlens.dataset.record import encode_json
from twinlens.dataset.verify import missing_parts, repair_hint
from twinlens.factory.plan import sample_name

NAMES = ("a", "train/0")
SAMPLE = sample()
GROWING = {"complete": False, "made_with": {"backend": "llvm_ad_rgb"}}
NOT_LISTED = "is a sample that dataset.json does not list"


def write(root):
    rows = [Row(name, write_sample(root / name, SAMPLE)) for name in NAMES]
    write_manifest(root, Manifest(rows))
    describe(root)
    return root


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write(tmp_path_factory.mktemp("made") / "set")


@pytest.fixture
def root(made, tmp_path):
    return shutil.copytree(made, tmp_path / "set")


def bucket(tmp_path):
    return place(f"memory:/{tmp_path}/set")


def row_file(root, name):
    return root / ".rows" / f"{name}.json"


def encode_row(**content):
    return encode_json({"format": "twinlens-row", "version": 1, **content})


def shards(root, count, **info):
    """A dataset of `count` samples made by shards: two samples and one failure, none listed yet."""
    for name in ("0000000", "0000002"):
        row = {"name": name, "files": write_sample(root / name, SAMPLE)}
        write_file(row_file(root, name), encode_row(row=row))
    write_file(row_file(root, "0000004"), encode_row(failure={}))
    write_manifest(root, Manifest((), {"count": count}, info=GROWING | info))
    return root


@pytest.fixture(params=["disk", "bucket"])
def growing(request, tmp_path):
    return shards(tmp_path / "set" if request.param == "disk" else bucket(tmp_path), 6)


def wrong(where):
    return {name: findings for name, findings in verify_place(where) if findings}


def none_wrong(*names):
    return {"dataset.json": []} | {name: [] for name in names}


def test_a_complete_dataset_has_no_findings(root):
    assert dict(verify_place(root)) == none_wrong(*NAMES)
    (root / ".cache").mkdir()
    (root / "notes").mkdir()
    (root / "notes" / "todo.txt").touch()
    assert wrong(root) == {}
    assert missing_parts(root) == ""


def test_unlisted_and_removed_samples_are_reported(root):
    write_sample(root / "b", sample(num_lenses=2))
    shutil.copytree(root / "a", root / "train" / "deep" / "er")
    shutil.rmtree(root / "a")
    findings = wrong(root)
    assert findings["dataset.json"] == [
        f"b: {NOT_LISTED}",
        f"train/deep/er: {NOT_LISTED}",
    ]
    assert "no such folder" in findings["a"][0]


def test_a_damaged_list_is_reported_and_samples_are_checked(root):
    path = root / "dataset.json"
    path.write_bytes(path.read_bytes()[:-40])
    (root / "a" / "disp0.pfm").write_bytes(b"")
    findings = wrong(root)
    assert findings["dataset.json"][0].startswith("not valid JSON")
    assert findings["a"][0].startswith("disp0.pfm: not a PFM")
    assert str(root) not in str(findings)
    assert missing_parts(root) == repair_hint(root, findings) == ""


def test_a_removed_list_is_reported(root):
    (root / "dataset.json").unlink()
    (finding,) = wrong(root)["dataset.json"]
    assert finding.startswith("is missing, so no checksums can be verified; 1 found")
    assert missing_parts(root).startswith("no dataset.json: ")
    # The folder of a single sample needs no dataset.json.
    assert wrong(root / "a") == {}


def test_outdated_metadata_is_reported_of_complete_datasets(root):
    """Otherwise it describes the last complete one, and is rewritten when the dataset is complete again."""
    rows = Dataset(root).manifest.rows
    write_manifest(root, Manifest(rows, {"count": 5}, info={"complete": False}))
    assert wrong(root) == {}
    write_manifest(root, Manifest(rows, {"count": 2}, info={"complete": True}))
    finding = "croissant.json: describes another dataset.json; `twinlens describe` rewrites it"
    assert wrong(root) == {"dataset.json": [finding]}
    describe(root)
    assert wrong(root) == {}


@pytest.mark.parametrize("text", ["[]", "{}", '{"distribution": [7]}', "[" * 5000])
def test_damaged_metadata_is_reported(root, text):
    (root / "croissant.json").write_text(text)
    finding = "croissant.json: is damaged; `twinlens describe` rewrites it"
    assert wrong(root) == {"dataset.json": [finding]}


RERUN = "rerun `twinlens generate` to "


@pytest.mark.parametrize(
    ("count", "info", "expected"),
    [
        (2, {"complete": True}, ""),
        (5, {}, f"lists 2 of 5 samples; {RERUN}make the missing samples"),
        (5, {"failed": [{}]}, f'samples; 1 failed ("failed" in it says why); {RERUN}make the missing samples'),
        (3, {"failed": [{}]}, 'lists 2 of 3 samples; 1 failed ("failed" in it says why)'),
    ],
)  # fmt: skip
def test_missing_samples_are_counted_and_not_findings(root, count, info, expected):
    rows = Dataset(root).manifest.rows
    write_manifest(root, Manifest(rows, {"count": count}, info=info))
    describe(root)
    assert wrong(root) == {}
    assert missing_parts(root).endswith(expected)
    assert bool(missing_parts(root)) == bool(expected)


def test_repair_hint_for_samples_of_generate(root):
    rows = Dataset(root).manifest.rows
    write_manifest(root, Manifest(rows, info={"made_with": {"backend": "llvm_ad_rgb"}}))
    (root / "a" / "notes.txt").touch()
    assert repair_hint(root, wrong(root)) == "", "an additional file is no damage"
    (root / "a" / "disp0.pfm").write_bytes(b"")
    one = "1 sample is damaged: delete its folder and rerun"
    assert repair_hint(root, wrong(root)).startswith(one)
    shutil.rmtree(root / "train" / "0")
    assert repair_hint(root, wrong(root)).startswith("2 samples are damaged: ")
    write_manifest(root, Manifest(rows))
    assert repair_hint(root, wrong(root)) == "", "not made by generate"


def test_pending_samples_are_verified_by_their_rows(growing):
    assert dict(verify_place(growing)) == none_wrong("0000000", "0000002")
    (growing / "0000002" / "disp0.pfm").write_bytes(b"short")
    (growing / "0000002" / "extra.txt").write_bytes(b"")
    findings = wrong(growing)
    assert findings == {
        "0000002": [
            "disp0.pfm: differs from its SHA-256 in .rows/0000002.json",
            "extra.txt: is not listed in .rows/0000002.json",
        ]
    }
    assert repair_hint(growing, findings).startswith("1 sample is damaged: ")


def test_a_sample_without_a_row_is_pending_in_an_unfinished_dataset(growing):
    """A process that is killed between the sample and its row leaves it so."""
    write_sample(growing / sample_name(5), SAMPLE)
    assert dict(verify_place(growing)) == none_wrong("0000000", "0000002", "0000005")
    line = missing_parts(growing)
    assert "3 made but not listed yet (1 without checksums); rerun" in line
    (growing / "0000005" / "disp0.pfm").write_bytes(b"")
    assert wrong(growing)["0000005"][0].startswith("disp0.pfm: not a PFM")


@pytest.fixture(params=["_sample_folders", "pending_rows"])
def after_step(request, monkeypatch):
    """Let another process act after a step of the verification."""

    def install(act):
        step = getattr(verify, request.param)

        def step_and_act(*arguments):
            result = step(*arguments)
            seen = list(result) if request.param == "_sample_folders" else result
            act()
            return seen

        monkeypatch.setattr(verify, request.param, step_and_act)

    return install


def test_samples_listed_during_verification_are_not_findings(tmp_path, after_step):
    """Shards may add a sample, a row, or the whole list at any moment."""
    root = shards(tmp_path / "set", 4)
    write_sample(root / "0000001", SAMPLE)

    def finish():
        write_sample(root / "0000003", SAMPLE)
        names = [sample_name(i) for i in range(4)]
        rows = [Row(name, hash_files(root / name)) for name in names]
        write_manifest(root, Manifest(rows, {"count": 4}, info={"complete": True}))
        shutil.rmtree(root / ".rows")

    after_step(finish)
    assert dict(verify_place(root)) == none_wrong(*map(sample_name, range(4)))


def test_the_name_of_a_row_stays_below_the_folder(tmp_path):
    root, name = shards(tmp_path / "set", 4), ".."
    write_sample(tmp_path / "other", SAMPLE)
    mark = (root / "0000000" / "sample.json").read_bytes()
    for other in (root, tmp_path):
        (other / "sample.json").write_bytes(mark)
    row_file(root, name).write_bytes(encode_row(row={"name": name, "files": {}}))
    findings = dict(verify_place(root))
    assert list(findings) == ["dataset.json", "0000000", "0000002"]
    line = f".rows/{name}.json: {name!r} is not a plain relative name"
    assert findings["dataset.json"] == [line]


def files_row(files):
    return encode_row(row={"name": "0000000", "files": files})


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (b"{", "not valid JSON"),
        (files_row({"../im0.png": "0"}), "row.files.../im0.png: '../im0.png' is not a plain relative name"),
        (encode_row(failure={}), "missing key 'row'"),
    ],
)  # fmt: skip
def test_an_unreadable_row_is_reported_and_its_sample_checked(tmp_path, row, message):
    root = shards(tmp_path / "set", 4)
    row_file(root, "0000000").write_bytes(row)
    (root / "0000000" / "disp0.pfm").write_bytes(b"")
    findings = wrong(root)
    assert list(findings) == ["dataset.json", "0000000"]
    (line,) = findings["dataset.json"]
    assert line.startswith(f".rows/0000000.json: {message}")
    assert findings["0000000"][0].startswith("disp0.pfm: not a PFM")
    assert "(1 without checksums)" in missing_parts(root)
