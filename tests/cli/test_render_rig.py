import json

from twinlens.dataset import Dataset

QUICK = ("--size", "48x36", "--spp", "1", "--no-denoise")


def test_a_rig_of_a_file_photographs_the_scene_and_verifies(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('layout = "arc"\ncount = 3\nangle_deg = 30\ncameras = [{}, { distortion = { k1 = -0.1 } }, {}]\n')
    code, out, err = twinlens("render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out", "--json")
    assert (code, err) == (0, "")
    assert {"im2.png", "truth2.exr"} <= set(json.loads(out)["samples"][0]["files"])
    rig = Dataset(tmp_path / "out")[0].rig
    assert [camera.distortion is None for camera in rig.cameras] == [True, False, True]
    assert twinlens("verify", tmp_path / "out")[0] == 0


def test_a_mistake_in_the_file_is_named_by_file_and_key(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('layout = "arc"\ncount = "three"\n')
    code, _, err = twinlens("render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out")
    assert code == 2
    assert f"{file}: count: must be a whole number" in err
    assert twinlens("render", "cards", "--rig", tmp_path / "none.toml", *QUICK, "-o", tmp_path / "out")[0] == 2
