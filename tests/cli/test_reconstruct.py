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
    code, out, _ = twinlens(
        "reconstruct", arc, "-o", tmp_path / "r", "--far", 2, "--cell-mm", 20, "--json"
    )
    assert code == 0
    record = json.loads(out)
    assert record["views"] == 3
    assert record["against_truth"]["points"]["accuracy_mean_mm"] == 0
    assert record["against_truth"]["mesh"]["accuracy_median_mm"] < 15
    assert len(trimesh.load(tmp_path / "r" / "points.ply").vertices) == record["points"]
    assert (
        len(trimesh.load(tmp_path / "r" / "mesh.ply", process=False).faces)
        == record["faces"]
    )
    (mesh,) = trimesh.load(tmp_path / "r" / "mesh.glb").geometry.values()
    assert len(mesh.faces)
    assert read_png(tmp_path / "r" / "reconstruction.png").shape == (96, 128, 3)
    assert json.loads((tmp_path / "r" / "reconstruction.json").read_text()) == record


def test_unrectified_views_are_rectified_before_matching(twinlens, arc, tmp_path):
    code, out, _ = twinlens(
        "reconstruct",
        arc,
        "-o",
        tmp_path / "r",
        "--method",
        "zncc:block_size=7",
        "--far",
        2,
    )
    assert code == 0
    assert "from 2 depth maps" in out
    assert "accuracy" in out


def test_bad_options_give_one_line_errors(twinlens, arc, tmp_path):
    for wrong in (
        ("--method", "truht"),
        ("--far", "0.1"),
        ("--cell-mm", "-1"),
        ("--min-views", "9"),
    ):
        code, _, err = twinlens("reconstruct", arc, "-o", tmp_path / "r", *wrong)
        assert code == 2
        assert err.count("\n") == 1
        assert not (tmp_path / "r").exists()


def test_a_function_that_raises_is_a_one_line_error(twinlens, arc, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "def boom(left, right, **_):\n    print('hello')\n    raise SystemExit('no luck')\n"
    )
    code, out, err = twinlens(
        "reconstruct", arc, "-o", tmp_path / "r", "--method", f"function:{own}:boom"
    )
    assert (code, out) == (1, "")
    assert (
        err == f"hello\ntwinlens: function '{own}:boom' failed: SystemExit: no luck\n"
    )
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("far", ["-1", "0", "nan"])
def test_a_limit_that_no_depth_can_meet_is_refused(twinlens, arc, tmp_path, far):
    code, _, err = twinlens("reconstruct", arc, "-o", tmp_path / "r", "--far", far)
    assert code == 2
    assert f"--far must be a finite number > 0, got {float(far)}" in err


def test_an_unknown_method_is_named_beside_truth(twinlens, arc, tmp_path):
    _, _, err = twinlens("reconstruct", arc, "-o", tmp_path / "r", "--method", "foo")
    assert "--method is 'truth' or a matcher: unknown method 'foo'" in err


def test_a_pair_that_is_not_rectified_is_not_matched(twinlens, arc, tmp_path):
    code, _, err = twinlens("benchmark", arc.parent, "-o", tmp_path / "board")
    assert (code, err.count("\n")) == (2, 1)
    assert (
        "the pair is not rectified and has no disparity; run `twinlens rectify`" in err
    )


def test_a_folder_without_truth_is_reconstructed_without_comparison(
    twinlens, dataset, tmp_path
):
    folder = tmp_path / "plain"
    folder.mkdir()
    for name in ("im0.png", "im1.png", "calib.txt"):
        (folder / name).write_bytes((dataset / "cards" / name).read_bytes())
    code, out, _ = twinlens(
        "reconstruct",
        folder,
        "--method",
        "zncc",
        "-o",
        tmp_path / "r",
        "--far",
        4,
        "--json",
    )
    assert code == 0
    assert json.loads(out)["against_truth"] == {}
    assert (
        twinlens("reconstruct", folder, "-o", tmp_path / "s")[0] == 2
    )  # it has no truth to fuse


def test_a_view_without_surfaces_gives_a_one_line_error(twinlens, tmp_path):
    (tmp_path / "sky.toml").write_text(
        "position = [0, -3, 1]\nlook_at = [0, -3, 9]\nup = [0, 1, 0]\n"
    )
    assert (
        twinlens(
            "render",
            "cards",
            "--rig",
            tmp_path / "sky.toml",
            *QUICK,
            "-o",
            tmp_path / "o",
        )[0]
        == 0
    )
    code, _, err = twinlens(
        "reconstruct", tmp_path / "o" / "cards", "--method", "sad", "-o", tmp_path / "r"
    )
    assert (code, err.count("\n")) == (2, 1)
    assert "has no surface that both cameras can see" in err


def test_only_earlier_reconstructions_are_overwritten(
    twinlens, arc, tmp_path, monkeypatch
):
    line = ("reconstruct", arc, "-o", tmp_path / "r", "--far", 2, "--cell-mm", 40)
    assert twinlens(*line)[0] == 0
    (tmp_path / "r" / "points.ply").unlink()
    assert twinlens(*line, "--overwrite")[0] == 0
    assert (tmp_path / "r" / "points.ply").exists()
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").touch()
    monkeypatch.setattr(
        "twinlens.reconstruction.of_sample.depth_views", None
    )  # refused before any work
    code, _, err = twinlens(*line)
    assert code == 2
    assert (
        err
        == f"twinlens: {tmp_path / 'r'}: exists already; choose another name, or add --overwrite\n"
    )
    code, _, err = twinlens("reconstruct", arc, "-o", tmp_path / "home", "--overwrite")
    assert (code, err.count("\n")) == (2, 1)
    assert "is not a reconstruction" in err
    assert (tmp_path / "home" / "thesis.tex").exists()
