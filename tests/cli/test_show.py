"""`twinlens show epipolar`: the picture, its points, and refusals."""

import json

import pytest

from twinlens.dataset import Dataset, read_png


def test_points_are_true_matches_on_their_epipolar_lines(twinlens, dataset, tmp_path):
    code, out, _ = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "e.png", "--points", 4)
    assert (code, "4 true matches" in out) == (0, True)
    assert read_png(tmp_path / "e.png").shape == (48, 2 * 64 + 12, 3)
    code, out, _ = twinlens("show", "epipolar", dataset, "-o", tmp_path / "e.png", "--json")
    record = json.loads(out)
    assert max(record["off_px"]) < 1e-4
    stored = Dataset(dataset)[0]
    for (u, v), (u2, v2) in zip(record["points"]["a"], record["points"]["b"], strict=True):
        assert u - u2 == pytest.approx(stored.disp0[round(v), round(u)], abs=1e-3)
        assert v == pytest.approx(v2, abs=1e-3)


def test_a_folder_without_truth_is_drawn_from_its_disparity_map(twinlens, dataset, tmp_path):
    folder = tmp_path / "plain"
    folder.mkdir()
    for name in ("im0.png", "im1.png", "disp0.pfm", "calib.txt"):
        (folder / name).write_bytes((dataset / "cards" / name).read_bytes())
    assert twinlens("show", "epipolar", folder, "-o", tmp_path / "e.png")[0] == 0
    assert twinlens("show", "epipolar", folder, "-o", tmp_path / "e.png", "--cameras", "1,0")[0] == 2


@pytest.mark.parametrize("cameras", ["0", "0,0", "0,2", "a,b", "0,1,2"])
def test_bad_camera_pairs_are_refused(twinlens, dataset, tmp_path, cameras):
    code, _, err = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "e.png", "--cameras", cameras)
    assert code == 2
    assert "--cameras" in err


def test_missing_samples_and_unknown_subcommands_are_refused(twinlens, dataset, tmp_path):
    assert twinlens("show", "epipolar", tmp_path / "none", "-o", tmp_path / "e.png")[0] == 2
    assert twinlens("show", "epipolr", dataset / "cards", "-o", tmp_path / "e.png")[0] == 2


def test_the_picture_must_end_in_png(twinlens, dataset, tmp_path):
    for name in ("e.jpg", "e"):
        code, _, err = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / name)
        assert (code, err.count("\n")) == (2, 1)
        assert "must end in .png" in err
        assert not (tmp_path / name).exists()
    assert twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "E.PNG")[0] == 0
