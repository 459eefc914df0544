import json

import numpy as np
import pytest

from twinlens.camera import Annulus, Disk, Pinhole, ThinLens
from twinlens.dataset import Dataset

QUICK = ("--size", "48x36", "--spp", "1", "--no-denoise")


def test_a_rig_of_a_file_photographs_the_scene_and_verifies(twinlens, tmp_path):
    file, out = tmp_path / "rig.toml", tmp_path / "out"
    cameras = "cameras = [{}, { distortion = { k1 = -0.1 } }, {}]\n"
    file.write_text('layout = "arc"\ncount = 3\nangle_deg = 30\n' + cameras)
    line = ("render", "cards", "--rig", file, *QUICK, "-o", out)
    code, printed, err = twinlens(*line, "--json")
    assert (code, err) == (0, "")
    files = json.loads(printed)["samples"][0]["files"]
    assert {"im2.png", "truth2.exr"} <= set(files)
    rig = Dataset(out)[0].rig
    assert [camera.distortion is None for camera in rig.cameras] == [True, False, True]
    assert twinlens("verify", out)[0] == 0


PLANNED = """
width = 48
height = 36
[rig]
baseline = 0.08
fx = 60
pixel_pitch_um = 30
[[lenses]]
kind = "thin"
aperture_mm = 60
focus = 1.5
"""


@pytest.fixture
def planned(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLANNED)
    return path


def test_lenses_of_a_file_are_replaced_by_options(twinlens, ball, planned, tmp_path):
    out, quick = tmp_path / "out", ("--spp", "1", "--no-denoise", "--overwrite")
    line = ("render", ball, "--rig", planned, *quick, "-o", out)
    code, printed, _ = twinlens(*line, "--lens", "pinhole")
    assert code == 0
    assert "sharp at every depth" in printed
    assert Dataset(out)[0].lens(0).lens == Pinhole()
    second = '[[lenses]]\nkind = "thin"\naperture_mm = 60\nfocus = 1.5\nshape = { kind = "annulus", inner = 0.5 }\n'
    planned.write_text(PLANNED + second)
    assert twinlens(*line)[0] == 0
    apertures = [Dataset(out)[0].lens(k).lens.aperture for k in range(2)]
    assert apertures == [Disk(), Annulus(0.5)]


def test_render_takes_the_lenses_of_a_file_and_reports_their_optics(
    twinlens, ball, planned, tmp_path
):
    """The same from rays through the lens: the image of z is at 1/v' = 1/f - 1/z, in front of or behind the film."""
    quick = ("--spp", "1", "--no-denoise", "--overwrite")
    line = ("render", ball, "--rig", planned, *quick, "-o", tmp_path / "out")
    shown = json.loads(twinlens(*line, "--json")[1])["samples"][0]["lenses"][0]
    sample = Dataset(tmp_path / "out")[0]
    assert sample.lens(0).lens == ThinLens(0.06, 1.5)
    hit = sample.truth0.depth[np.isfinite(sample.truth0.depth)]
    depth = np.array(shown["depths"])
    assert depth.tolist() == pytest.approx([hit.min(), hit.max()], rel=1e-6)

    film, aperture, pixel = 60 * 30e-6, 0.06, 30e-6
    image = 1 / (1 / film + 1 / 1.5 - 1 / depth)
    blur = aperture * np.abs(image - film) / np.abs(image) / pixel
    assert shown["blur_px"] == pytest.approx(blur)
    near, far = shown["depth_of_field"]
    out = twinlens(*line)[1]
    assert f"sharp to 1 px from {near:.3g} m to {far:.3g} m, hyperfocal distance" in out
    error_mm = 1e3 * shown["depth_error"][0]
    assert f"depth error {error_mm:.3g} mm at {depth[0]:.3g} m" in out
