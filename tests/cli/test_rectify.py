import json

from twinlens.dataset import Dataset

QUICK = ("--size", "48x36", "--spp", "1")


def test_a_toed_in_pair_is_rectified_and_verifies(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('layout = "toed_in"\nbaseline = 0.2\n')
    assert twinlens("render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out")[0] == 0
    target = tmp_path / "new" / "cards"
    code, out, _ = twinlens("rectify", tmp_path / "out" / "cards", "-o", target, "--own-centres", "--json")
    assert code == 0
    assert {"disp0.pfm", "calib.txt"} <= set(json.loads(out)["files"])
    assert Dataset(target)[0].calibration.doffs == json.loads(out)["doffs"] != 0
    assert twinlens("verify", target)[0] == 0
    assert twinlens("rectify", tmp_path / "out" / "cards", "-o", target)[0] == 2  # it is there
    for wrong in (
        ("--fit", "vlid"),
        ("--misalignment", "roll=1"),
        ("--misalignment", "roll_deg=x"),
        ("--cameras", "1,0"),
    ):
        code, _, err = twinlens("rectify", tmp_path / "out" / "cards", "-o", tmp_path / "no", *wrong)
        assert code == 2
        assert err.count("\n") == 1
