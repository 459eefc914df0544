"""`twinlens subset` and `twinlens browse`: options, output, and one line for wrong input."""

import json

import pytest

from tests.dataset.dataset_scene import list_samples, sample
from twinlens.dataset import Dataset, write_sample


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """Two datasets of two samples whose scenes differ."""
    home = tmp_path_factory.mktemp("shards")
    for shard in "ab":
        for number in (0, 1):
            folder = home / shard / f"000000{number}"
            write_sample(folder, sample())
            record = json.loads((folder / "sample.json").read_text())
            record["record"]["scene"] = f"{shard}{number}"
            (folder / "sample.json").write_text(json.dumps(record))
        list_samples(home / shard, "0000000", "0000001")
    return home


def test_merge_filter_split_and_verify(twinlens, shards, tmp_path):
    both = (shards / "a", shards / "b")
    code, out, err = twinlens("subset", *both, "-o", tmp_path / "all", "--link")
    assert (code, err) == (0, "")
    assert (
        out
        == f"{tmp_path / 'all'}: 4 of 4 samples, 0 files written, 0 bytes, 40 hard links\n"
    )
    assert twinlens("verify", tmp_path / "all")[1] == "4 samples, 0 with findings\n"
    code, out, _ = twinlens(
        "subset", tmp_path / "all", "-o", tmp_path / "some", "--where", "scene != a1", "--drop", "position, normal",
        "--splits", "train=0.7,test=0.3", "--json",
    )  # fmt: skip
    result = json.loads(out)
    assert (code, result["samples"], result["of"]) == (0, 3, 4)
    assert result["splits"] == {"test": 1, "train": 2}
    assert twinlens("verify", tmp_path / "some")[1] == "3 samples, 0 with findings\n"
    kept = Dataset(tmp_path / "some")
    assert list(kept.names) == ["a/0000000", "b/0000000", "b/0000001"]
    assert kept[0].dropped == ("normal", "position")
    subset = kept.manifest.info["subset"]
    assert subset["where"] == ["scene != a1"]
    assert subset["splits"] == {
        "shares": {"train": 0.7, "test": 0.3},
        "by": "scene",
        "seed": 0,
    }
    again = twinlens("subset", *both, "-o", tmp_path / "all", "--link")
    assert again == (0, f"{tmp_path / 'all'}: 4 samples, complete already\n", "")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--where", "seen = a0"], "--where: unknown recorded value 'seen'; did you mean 'scene'?"),
        (["--where", "scene = c7"], "--where scene = c7: holds of no sample"),
        (["--where", "scene"], "--where: a condition is NAME"),
        (["--where", "scene > b"], "--where: scene > b: > needs a number, got 'b'"),
        (["--drop", "im"], "--drop: the images (im) cannot be dropped"),
        (["--drop", "dept"], "--drop: unknown channel to drop 'dept'; did you mean 'depth'?"),
        (["--splits", "a=0.2,b=0.9"], "--splits: the shares of splits must add up to 1, got 1.1"),
        (["--splits", "a=0.5,b=0.5", "--by", "lens.f_number"], "--splits: --by lens.f_number: is not recorded"),
        (["--splits", "a=0.2,b=0.3,c=0.5"], "--splits: 2 groups of samples cannot fill 3 splits"),
    ],
)  # fmt: skip
def test_wrong_options_are_one_line(twinlens, shards, tmp_path, options, line):
    code, out, err = twinlens("subset", shards / "a", "-o", tmp_path / "new", *options)
    assert (code, out) == (2, "")
    assert err.startswith(f"twinlens: {line}")
    assert err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_browse_writes_a_page_into_the_dataset_which_verify_accepts(twinlens, shards):
    folder = shards / "a"
    code, out, _ = twinlens("browse", folder)
    assert (code, out) == (0, f"{folder / 'browse/index.html'}: 2 samples\n")
    assert twinlens("verify", folder)[0] == 0
    assert twinlens("browse", folder)[0] == 0


def test_browse_refuses_a_folder_of_other_files(twinlens, shards, tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    code, _, err = twinlens("browse", shards / "b", "-o", tmp_path)
    assert code == 2
    assert "contains 'notes.txt' and no page of `twinlens browse`" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt"]
