"""Commands on datasets: verify, export, describe; buckets."""

import json
import shutil
from dataclasses import replace

import pytest

from twinlens.dataset import Dataset, place, read_manifest, write_manifest


@pytest.fixture
def own(dataset, tmp_path):
    return shutil.copytree(dataset, tmp_path / "own")


def test_verify_prints_each_finding_and_counts(twinlens, own):
    (own / "cards" / "disp0.pfm").unlink()
    code, out, _ = twinlens("verify", own)
    assert code == 1
    assert out.splitlines() == [
        "cards: disp0.pfm: is missing",
        "1 sample, 1 with findings",
    ]
    code, out, _ = twinlens("verify", own, "--json")
    assert code == 1
    assert json.loads(out) == {"cards": ["disp0.pfm: is missing"]}


def test_verify_reports_a_missing_dataset_json(twinlens, own):
    (own / "dataset.json").unlink()
    code, out, err = twinlens("verify", own)
    assert code == 1
    assert out.startswith("dataset.json: is missing")
    assert out.endswith(
        "\n1 sample, 0 with findings; 1 finding of the dataset as a whole\n"
    )
    assert "no dataset.json: " in err
    code, out, err = twinlens("verify", own / "cards", "--json")
    assert (code, json.loads(out)) == (0, {"cards": []})
    assert "not against checksums" in err


def test_verify_needs_a_dataset(twinlens, tmp_path):
    for where in (tmp_path, "memory://nothing/there", "nowhere://x"):
        code, _, err = twinlens("verify", where)
        assert code == 2
        assert err.count("\n") == 1


def test_export_reports_what_it_wrote(twinlens, dataset, tmp_path):
    code, out, _ = twinlens(
        "export", dataset, "--to", "carla", "-o", tmp_path / "out", "--json"
    )
    assert code == 0
    answer = json.loads(out)
    assert answer["layout"] == "carla"
    assert all(
        (tmp_path / "out" / name).stat().st_size == size
        for name, size in answer["files"].items()
    )


def test_exporting_again_needs_overwrite(twinlens, dataset, tmp_path):
    arguments = ("export", dataset, "--to", "eth3d", "-o", tmp_path / "out")
    assert twinlens(*arguments)[0] == 0
    code, _, err = twinlens(*arguments)
    assert code == 2
    assert "already exists" in err
    code, out, _ = twinlens(*arguments, "--overwrite", "--lens", "1")
    assert code == 0
    assert "1 sample, 9 files" in out


def test_export_to_and_from_a_bucket(twinlens, dataset, tmp_path):
    bucket = place(f"memory:/{tmp_path}/bucket")
    for path in dataset.rglob("*"):
        if path.is_file():
            (bucket / path.relative_to(dataset)).write_bytes(path.read_bytes())
    assert twinlens("verify", bucket)[0] == 0
    assert (
        twinlens("export", bucket, "--to", "kitti2015", "-o", bucket / "kitti")[0] == 0
    )
    assert (
        bucket / "kitti" / "Kitti2015" / "training" / "image_2" / "000000_10.png"
    ).is_file()


def test_export_names_the_nearest_layout(twinlens, dataset, tmp_path):
    code, _, err = twinlens("export", dataset, "--to", "kitti", "-o", tmp_path / "out")
    assert code == 2
    assert "unknown layout 'kitti'; did you mean 'kitti2015'?" in err


def test_export_of_an_unknown_split(twinlens, dataset, tmp_path):
    code, _, err = twinlens(
        "export", dataset, "--to", "carla", "-o", tmp_path / "out", "--split", "train"
    )
    assert code == 2
    assert "has no splits, so no split 'train'" in err


def test_describe_keeps_what_it_is_told(twinlens, own):
    code, out, _ = twinlens(
        "describe", own, "--license", "CC-BY-4.0", "--creator", "Ada"
    )
    assert code == 0
    assert [line.rpartition("/")[2] for line in out.splitlines()] == [
        *("README.md", "samples.jpg", "statistics.png", "croissant.json")
    ]
    assert twinlens("describe", own)[0] == 0
    assert "CC-BY-4.0" in (own / "README.md").read_text()
    assert read_manifest(own).info["about"] == {
        "license": "CC-BY-4.0",
        "creator": "Ada",
    }
    assert len(Dataset(own)) == 1
    assert twinlens("verify", own)[0] == 0


def test_export_of_a_split_that_is_misspelt_lists_them(twinlens, own, tmp_path):
    manifest = read_manifest(own)
    write_manifest(
        own,
        replace(manifest, rows=(replace(manifest.rows[0], info={"split": "train"}),)),
    )
    code, _, err = twinlens(
        "export", own, "--to", "carla", "-o", tmp_path / "out", "--split", "trian"
    )
    assert code == 2
    assert "unknown split 'trian'; did you mean 'train'? (known: train)" in err
    assert (
        twinlens(
            "export", own, "--to", "carla", "-o", tmp_path / "out", "--split", "train"
        )[0]
        == 0
    )


def test_a_bucket_is_rendered_into_and_looked_at(twinlens, tmp_path):
    """And file:// is a folder of this machine."""
    bucket, local = f"memory:/{tmp_path}/rendered", f"file://{tmp_path}/local"
    line = ("render", "cards", "--size", "64x48", "--spp", "1", "--no-denoise", "-o")
    assert twinlens(*line, bucket)[0] == 0
    assert twinlens("verify", bucket)[0] == 0
    code, _, err = twinlens(*line, bucket)
    assert code == 2
    assert "exists already" in err
    assert twinlens(*line, bucket, "--overwrite")[0] == 0
    assert (
        twinlens(
            "show", "epipolar", f"{bucket}/cards", "-o", f"file://{tmp_path}/e.png"
        )[0]
        == 0
    )
    assert (tmp_path / "e.png").is_file()
    assert twinlens("rectify", f"{bucket}/cards", "-o", tmp_path / "rectified")[0] == 0
    assert twinlens("benchmark", bucket, "--methods", "sad", "-o", local)[0] == 0
    assert (tmp_path / "local" / "board.json").is_file()
    assert (
        twinlens(
            "score",
            tmp_path / "rectified" / "disp0.pfm",
            "--truth",
            f"{bucket}/cards/disp0.pfm",
        )[0]
        == 0
    )
    assert not [path.name for path in tmp_path.iterdir() if ":" in path.name]


@pytest.mark.parametrize(
    ("scene", "size"),
    [
        ("fence", "8x6"),
        *(
            pytest.param(scene, size, marks=pytest.mark.slow)
            for scene in ("fence", "staircase", "room")
            for size in ("8x6", "16x12")
            if (scene, size) != ("fence", "8x6")
        ),
    ],
)
def test_a_picture_of_a_few_pixels_verifies(twinlens, tmp_path, scene, size):
    """Thin bars, steps and steep walls: hardly a pixel shows what its neighbours show."""
    assert (
        twinlens(
            "render",
            scene,
            "--size",
            size,
            "--spp",
            "1",
            "--no-denoise",
            "-o",
            tmp_path / "out",
        )[0]
        == 0
    )
    assert twinlens("verify", tmp_path / "out")[:2] == (
        0,
        "1 sample, 0 with findings\n",
    )
