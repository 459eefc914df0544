"""`twinlens reconstruct`: points and a surface of a sample, compared with its truth."""

import json

import pytest
import trimesh

from twinlens.dataset import read_png

QUICK = ("--size", "64x48", "--spp", "4", "--no-denoise")


@pytest.fixture(scope="module")
def arc(tmp_path_factory):
    """Three unrectified views of the table."""
    from twinlens.cli import run

    folder = tmp_path_factory.mktemp("arc")
    (folder / "rig.toml").write_text('layout = "arc"\ncount = 3\nangle_deg = 24\n')
    line = [
        "render",
        "tabletop",
        "--rig",
        folder / "rig.toml",
        *QUICK,
        "-o",
        folder / "out",
    ]
    assert run([str(part) for part in line]) == 0
    return folder / "out" / "tabletop"


def test_the_fused_truth_of_several_views_is_the_true_surface(twinlens, arc, tmp_path):
    made, options = tmp_path / "r", ("--far", 2, "--cell-mm", 20, "--json")
    code, out, _ = twinlens("reconstruct", arc, "-o", made, *options)
    assert code == 0
    record = json.loads(out)
    truth = record["against_truth"]
    assert record["views"] == 3
    assert truth["points"]["accuracy_mean_mm"] == 0
    assert truth["mesh"]["accuracy_median_mm"] < 15
    assert len(trimesh.load(made / "points.ply").vertices) == record["points"]
    mesh = trimesh.load(made / "mesh.ply", process=False)
    assert len(mesh.faces) == record["faces"]
    (mesh,) = trimesh.load(made / "mesh.glb").geometry.values()
    assert len(mesh.faces)
    assert read_png(made / "reconstruction.png").shape == (96, 128, 3)
    assert json.loads((made / "reconstruction.json").read_text()) == record


def test_unrectified_views_are_rectified_before_matching(twinlens, arc, tmp_path):
    line = ("reconstruct", arc, "-o", tmp_path / "r", "--far", 2, "--cell-mm", 40)
    code, out, _ = twinlens(*line, "--method", "zncc:block_size=7")
    assert code == 0
    assert "from 2 depth maps" in out
    assert "accuracy" in out


def test_a_folder_without_truth_is_reconstructed_without_comparison(
    twinlens, dataset, tmp_path
):
    folder = tmp_path / "plain"
    folder.mkdir()
    for name in ("im0.png", "im1.png", "calib.txt"):
        (folder / name).write_bytes((dataset / "cards" / name).read_bytes())
    line = ("reconstruct", folder, "--far", 4, "--json", "-o")
    code, out, _ = twinlens(*line, tmp_path / "r", "--method", "zncc")
    assert code == 0
    assert json.loads(out)["against_truth"] == {}
    assert twinlens(*line, tmp_path / "s")[0] == 2, "it has no truth to fuse"


@pytest.mark.parametrize(
    ("line", "instead"),
    [("height=48", "height=96"), ("width=64", "width=128"), ("height=48", "height=47")],
)
def test_a_calibration_of_another_size_is_refused_by_name(
    twinlens, dataset, tmp_path, line, instead
):
    for name in ("im0.png", "im1.png"):
        (tmp_path / name).write_bytes((dataset / "cards" / name).read_bytes())
    text = (dataset / "cards" / "calib.txt").read_text()
    assert line in text
    (tmp_path / "calib.txt").write_text(text.replace(line, instead))
    made = tmp_path / "made"
    code, _, err = twinlens("reconstruct", tmp_path, "--method", "sad", "-o", made)
    assert code == 2
    assert f"{tmp_path / 'calib.txt'} is of" in err
    assert "but the images have 64x48" in err
    assert err.count("\n") == 1
    assert not made.exists()


def test_only_earlier_reconstructions_are_overwritten(twinlens, arc, tmp_path):
    made, home = tmp_path / "r", tmp_path / "home"
    line = ("reconstruct", arc, "--far", 2, "--cell-mm", 40, "-o")
    assert twinlens(*line, made)[0] == 0
    assert twinlens(*line, made, "--overwrite")[0] == 0
    home.mkdir()
    (home / "thesis.tex").touch()
    for output, words in (
        ((made,), "exists already; choose another name, or add --overwrite"),
        ((home, "--overwrite"), "is not a reconstruction"),
    ):
        code, _, err = twinlens(*line, *output)
        assert (code, err.count("\n")) == (2, 1)
        assert words in err
    assert (home / "thesis.tex").exists()
