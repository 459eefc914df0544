import json

import pytest

from twinlens.dataset import Dataset, read_png


def test_epipolar_geometry_is_drawn_over_both_views_and_told(twinlens, dataset, tmp_path):
    code, out, _ = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "e.png", "--points", 4)
    assert (code, "4 true matches" in out) == (0, True)
    assert read_png(tmp_path / "e.png").shape == (48, 2 * 64 + 12, 3)
    code, out, _ = twinlens("show", "epipolar", dataset, "-o", tmp_path / "e.png", "--json")
    told = json.loads(out)
    assert max(told["off_px"]) < 1e-4
    stored = Dataset(dataset)[0]
    for (u, v), (u2, v2) in zip(told["points"]["a"], told["points"]["b"], strict=True):
        assert u - u2 == pytest.approx(stored.disp0[round(v), round(u)], abs=1e-3)
        assert v == pytest.approx(v2, abs=1e-3)


def test_a_plain_folder_is_drawn_from_its_disparities(twinlens, dataset, tmp_path):
    folder = tmp_path / "plain"
    folder.mkdir()
    for name in ("im0.png", "im1.png", "disp0.pfm", "calib.txt"):
        (folder / name).write_bytes((dataset / "cards" / name).read_bytes())
    assert twinlens("show", "epipolar", folder, "-o", tmp_path / "e.png")[0] == 0
    assert twinlens("show", "epipolar", folder, "-o", tmp_path / "e.png", "--cameras", "1,0")[0] == 2


@pytest.mark.parametrize("cameras", ["0", "0,0", "0,2", "a,b", "0,1,2"])
def test_cameras_that_are_no_pair_are_refused(twinlens, dataset, tmp_path, cameras):
    code, _, err = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "e.png", "--cameras", cameras)
    assert code == 2
    assert "--cameras" in err


def test_what_is_no_sample_is_refused(twinlens, dataset, tmp_path):
    assert twinlens("show", "epipolar", tmp_path / "none", "-o", tmp_path / "e.png")[0] == 2
    assert twinlens("show", "epipolr", dataset / "cards", "-o", tmp_path / "e.png")[0] == 2


def test_the_picture_is_a_png_by_its_name(twinlens, dataset, tmp_path):
    for name in ("e.jpg", "e"):
        code, _, err = twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / name)
        assert (code, err.count("\n")) == (2, 1)
        assert "written as .png" in err
        assert not (tmp_path / name).exists()
    assert twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "E.PNG")[0] == 0
