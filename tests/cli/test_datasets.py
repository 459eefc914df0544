"""Commands on datasets: verify, export, describe; buckets."""

import json
import shutil

import pytest

from tests.cli.conftest import QUICK
from twinlens.dataset import place, read_manifest


@pytest.fixture
def copied(dataset, tmp_path):
    return shutil.copytree(dataset, tmp_path / "own")


def test_verify_prints_each_finding_and_counts(twinlens, copied):
    (copied / "cards" / "disp0.pfm").unlink()
    code, out, _ = twinlens("verify", copied)
    assert code == 1
    assert out.splitlines() == [
        "cards: disp0.pfm: is missing",
        "1 sample, 1 with findings",
    ]
    code, out, _ = twinlens("verify", copied, "--json")
    assert code == 1
    assert json.loads(out) == {"cards": ["disp0.pfm: is missing"]}


def test_verify_reports_a_missing_dataset_json(twinlens, copied):
    (copied / "dataset.json").unlink()
    code, out, err = twinlens("verify", copied)
    assert code == 1
    assert out.startswith("dataset.json: is missing")
    assert out.endswith(
        "\n1 sample, 0 with findings; 1 finding of the dataset as a whole\n"
    )
    assert "no dataset.json: " in err
    code, out, err = twinlens("verify", copied / "cards", "--json")
    assert (code, json.loads(out)) == (0, {"cards": []})
    assert "not against checksums" in err


def test_exporting_again_needs_overwrite(twinlens, dataset, tmp_path):
    arguments = ("export", dataset, "--to", "eth3d", "-o", tmp_path / "out")
    assert twinlens(*arguments)[0] == 0
    code, _, err = twinlens(*arguments)
    assert code == 2
    assert "already exists" in err
    code, out, _ = twinlens(*arguments, "--overwrite", "--lens", "1")
    assert code == 0
    assert "1 sample, 9 files" in out


@pytest.mark.parametrize("name", ["out", "other"])
def test_an_export_removes_what_a_killed_one_left(twinlens, dataset, tmp_path, name):
    """Its own leftovers, and those of an export to another folder beside it."""
    left = tmp_path / f".{name}.unfinished-99999-0123abcd" / "training" / "image_2"
    left.mkdir(parents=True)
    (left / "000000_10.png").write_bytes(b"half")
    arguments = ("export", dataset, "--to", "eth3d", "-o", tmp_path / "out")
    assert twinlens(*arguments)[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_rendering_again_removes_what_a_killed_run_left(twinlens, copied):
    (copied / ".cards.unfinished-99999-0123abcd" / "models").mkdir(parents=True)
    line = ("render", "cards", *QUICK, "-o", copied)
    assert twinlens(*line, "--overwrite")[0] == 0
    assert not list(copied.glob(".*"))


def test_a_folder_that_a_killed_run_had_moved_aside_is_put_back_before_it_is_checked(
    twinlens, copied
):
    (copied / ".cards.replaced-99999-0123abcd").mkdir()
    (copied / "cards").rename(copied / ".cards.replaced-99999-0123abcd" / "cards")
    code, _, err = twinlens("render", "cards", *QUICK, "-o", copied)
    assert code == 2
    assert "cards: restored; a command that was killed had moved it aside" in err
    assert "exists" in err
    assert (copied / "cards" / "sample.json").is_file()
    assert not list(copied.glob(".*"))


def test_describe_keeps_what_it_is_told(twinlens, copied):
    assert twinlens("describe", copied, "--license", "CC-BY-4.0")[0] == 0
    assert twinlens("describe", copied)[0] == 0
    assert "CC-BY-4.0" in (copied / "README.md").read_text()
    assert read_manifest(copied).info["about"] == {"license": "CC-BY-4.0"}
    assert twinlens("verify", copied)[0] == 0


def test_a_bucket_is_rendered_into_and_looked_at(twinlens, tmp_path):
    """And file:// is a folder of this machine."""
    bucket, local = f"memory:/{tmp_path}/rendered", f"file://{tmp_path}"
    sample, line = f"{bucket}/cards", ("render", "cards", *QUICK, "-o", bucket)
    assert twinlens(*line)[0] == 0
    code, _, err = twinlens(*line)
    assert code == 2
    assert "exists already" in err
    for command in (
        (*line, "--overwrite"),
        ("verify", bucket),
        ("export", bucket, "--to", "kitti2015", "-o", f"{bucket}/export"),
        ("show", "epipolar", sample, "-o", f"{local}/e.png"),
        ("rectify", sample, "-o", tmp_path / "rectified"),
        ("benchmark", bucket, "--methods", "sad", "-o", f"{local}/board"),
        ("score", tmp_path / "rectified/disp0.pfm", "--truth", f"{sample}/disp0.pfm"),
    ):
        code, _, err = twinlens(*command)
        assert code == 0, err
    image = "export/Kitti2015/training/image_2/000000_10.png"
    assert (place(bucket) / image).is_file()
    assert (tmp_path / "e.png").is_file()
    assert (tmp_path / "board" / "board.json").is_file()
    assert not [path.name for path in tmp_path.iterdir() if ":" in path.name]
