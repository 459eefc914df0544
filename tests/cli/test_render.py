"""`twinlens render`: every option of lens, camera and sensor reaches the sample."""

from dataclasses import replace

import numpy as np
import pytest

from tests.factory_recipes import write_sky
from twinlens.camera import BareAperture, BrownConrady, MaskAperture, ThinLens
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    read_manifest,
    write_manifest,
    write_png,
)
from twinlens.dataset.sample_files import sample_files
from twinlens.factory import remake
from twinlens.scenes import load_scene

QUICK = ("--size", "64x48", "--spp", "1", "--no-denoise")


def test_what_the_dataset_said_before_stays(twinlens, ball, tmp_path):
    """Its recipe, seed, info and rows; without a recipe, samples of two seeds share none."""
    out, other = tmp_path / "out", tmp_path / "other"
    row = Row("old", {}, {"draw": 3})
    before = Manifest((row,), recipe={"count": 1}, seed=9, info={"owner": "me"})
    write_manifest(out, before)
    assert twinlens("render", ball, *QUICK, "-o", out)[0] == 0
    after = read_manifest(out)
    assert replace(after, rows=(row,)) == before
    assert [row.name for row in after.rows] == ["old", "ball"]
    for seed, shared in ((4, 4), (5, None)):
        line = ("render", ball, *QUICK, "--seed", seed, "--overwrite", "-o", other)
        assert twinlens(*line)[0] == 0
        assert read_manifest(other).seed == shared


def test_render_takes_the_whole_camera(twinlens, ball, tmp_path):
    """Every option of lens, camera and sensor reaches the sample, and the sample's record gives it back."""
    write_png(tmp_path / "code.png", np.eye(3, dtype=np.uint8) * 255)
    code, out, err = twinlens(
        "render", ball, *QUICK, "-o", tmp_path / "out", "--lens", "thin:3@1.5", "--lens", "hole:1@40",
        "--aperture", f"mask:{tmp_path / 'code.png'}", "--focal-length-px", "80,82", "--principal-point", "30,20.5",
        "--distortion", "-0.1,0.01", "--sensor-width-mm", "36", "--sensor", "phone:filters=rgb,prnu=0.02",
        "--bits", "16", "--exposure", "1/500,2", "--mismatch", "gain=1.1,time=1.05,black_level=2", "--sky-disparity",
    )  # fmt: skip
    assert code == 0
    warning, hint = err.splitlines()
    assert warning == (
        "twinlens: warning: ball: views 0 and 1 show nothing but clipped pixels: is the exposure too long?"
    )
    assert f"`twinlens rectify {tmp_path / 'out'}" in hint  # distorted cameras
    assert "thin:3@1.5: f/15, 1/500 s, gain 2" in out
    sample = Dataset(tmp_path / "out")["ball"]
    for camera in sample.rig.cameras:
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (80.0, 82.0, 30.0, 20.5)
        assert camera.distortion == BrownConrady(k1=-0.1, k2=0.01)
        assert camera.pixel_pitch_um == pytest.approx(36e3 / 64)
    shape = MaskAperture(np.eye(3))
    assert sample.lens(0).lens == ThinLens(3e-3, 1.5, shape)
    assert sample.lens(1).lens == BareAperture(1e-3, 40e-3, shape)
    assert sample.im0.dtype == np.uint16
    left, right = sample.lens(0).record["exposures"]
    assert (left["time_s"], left["gain"], left["sensor"]["prnu"]) == (
        1 / 500,
        2.0,
        0.02,
    )
    assert right["gain"] / left["gain"] == pytest.approx(1.1)
    assert right["time_s"] / left["time_s"] == pytest.approx(1.05)
    assert right["black_level_dn"] - left["black_level_dn"] == pytest.approx(2.0)
    assert (
        sample_files(remake(sample.record, load_scene(ball)))["sample.json"]
        == (sample.folder / "sample.json").read_bytes()
    )
    assert twinlens("verify", tmp_path / "out")[0] == 0


def test_what_no_lens_can_be_and_where_the_model_ends_is_said(twinlens, ball, tmp_path):
    """Warnings are one line each, and none is Python's."""
    line = ("render", ball, *QUICK, "--overwrite", "-o", tmp_path / "out", "--lens")
    _, out, _ = twinlens(*line, "thin:30")
    assert "--sensor-width-mm" in out
    code, _, err = twinlens(*line, "thin:30", "--exposure", "1/1000", "--diffraction")
    first, second = err.splitlines()
    assert code == 0
    assert first.startswith("twinlens: warning: working f-number")
    assert second.startswith("twinlens: warning: ball: views 0 and 1 show nothing but")


def test_what_was_finished_is_listed_when_the_next_scene_fails(
    twinlens, ball, tmp_path, monkeypatch
):
    from twinlens.cli import render

    make = render.make_sample

    def interrupted(scene, *rest, **options):
        if scene.name == "cards":
            raise KeyboardInterrupt
        return make(scene, *rest, **options)

    monkeypatch.setattr(render, "make_sample", interrupted)
    out = tmp_path / "out"
    code, _, err = twinlens("render", ball, "cards", *QUICK, "-o", out)
    words = "twinlens: interrupted; finished samples are kept"
    assert (code, err.strip()) == (130, words)
    assert [row.name for row in read_manifest(out).rows] == ["ball"]
    assert twinlens("verify", out)[0] == 0
    code, _, err = twinlens("render", "cards", "-o", tmp_path / "new")
    assert (code, err.strip()) == (130, "twinlens: interrupted")


def test_a_folder_of_other_things_is_left_alone(twinlens, ball, tmp_path):
    """Nothing is added to it and nothing in it is overwritten; what `render` made it replaces."""
    home = tmp_path / "home"
    sample, photo = home / "ball", home / "ball" / "photo.png"
    sample.mkdir(parents=True)
    photo.write_text("mine")
    line = ("render", ball, *QUICK, "-o", home)
    overwrite = (*line, "--overwrite")
    for command, words in (
        (line, f"{sample}: exists already; choose another name, or add --overwrite"),
        (overwrite, f"{sample}: exists and is not a sample, so it is not overwritten"),
    ):
        code, out, err = twinlens(*command)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    assert sorted(home.rglob("*")) == [sample, photo]
    photo.unlink()
    sample.rmdir()
    assert twinlens(*line)[0] == 0
    assert twinlens(*overwrite)[0] == 0
    assert [row.name for row in read_manifest(home).rows] == ["ball"]


def test_a_camera_that_exists_under_a_sky(twinlens, ball, tmp_path):
    """Its size unless another is given, its baseline, and the picture's light; the record makes the sample again."""
    write_sky(tmp_path / "day" / "white.exr", np.full((4, 8, 3), 2.0))
    options = (
        "--camera",
        "oak-d",
        "--size",
        "64x40",
        "--spp",
        "1",
        "--no-denoise",
        "--sensor-width-mm",
        "7.68",
    )
    code, _, err = twinlens(
        "render",
        ball,
        *options,
        "--sky",
        tmp_path / "day" / "white.exr",
        "--radiance",
        "-o",
        tmp_path / "out",
    )
    assert (code, err) == (0, "")
    stored = Dataset(tmp_path / "out")["ball"]
    camera = stored.rig.cameras[1]
    assert (camera.width, camera.height, camera.pixel_pitch_um) == (
        64,
        40,
        pytest.approx(120.0),
    )
    assert camera.fx == pytest.approx(64 * 2.35 / 7.68)
    assert stored.rig.baseline() == pytest.approx(0.075)
    assert stored.record["record"]["sky"]["file"] == "white.exr"
    credits = (tmp_path / "out" / "ASSETS.md").read_text()
    assert stored.record["record"]["sky"]["sha256"] in credits
    assert stored.lens(0).radiance(0).max() == pytest.approx(2.0, rel=1e-3)
    again = remake(stored.record, load_scene(ball), folder=tmp_path / "day")
    assert np.array_equal(again.shots[0].images[1], stored.lens(0).image(1))
