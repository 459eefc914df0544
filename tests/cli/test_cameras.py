"""`twinlens cameras` lists every preset with its source."""

import json

from twinlens.camera.presets import CAMERAS


def test_every_camera_is_listed_with_its_source(twinlens):
    code, out, _ = twinlens("cameras")
    assert code == 0
    for name, preset in CAMERAS.items():
        assert f"{name}: {preset.description}" in out
        assert f"Source: {preset.source}" in out
    assert "2/3 (8.8 mm)" in out


def test_the_json_has_the_figures(twinlens):
    code, out, _ = twinlens("cameras", "--json")
    assert code == 0
    found = {each["name"]: each for each in json.loads(out)["cameras"]}
    assert found.keys() == CAMERAS.keys()
    assert found["realsense-d435"]["baseline"] == 0.05
    assert found["gopro-hero9-wide"]["distortion"]["model"] == "kannala-brandt"
