import json

import numpy as np
import pytest

from twinlens.camera import Annulus, Disk, Pinhole, ThinLens
from twinlens.dataset import Dataset

QUICK = ("--size", "48x36", "--spp", "1", "--no-denoise")


def test_a_rig_of_a_file_photographs_the_scene_and_verifies(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(
        'layout = "arc"\ncount = 3\nangle_deg = 30\ncameras = [{}, { distortion = { k1 = -0.1 } }, {}]\n'
    )
    code, out, err = twinlens(
        "render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out", "--json"
    )
    assert (code, err) == (0, "")
    assert {"im2.png", "truth2.exr"} <= set(json.loads(out)["samples"][0]["files"])
    rig = Dataset(tmp_path / "out")[0].rig
    assert [camera.distortion is None for camera in rig.cameras] == [True, False, True]
    assert twinlens("verify", tmp_path / "out")[0] == 0


def test_a_mistake_in_the_file_is_named_by_file_and_key(twinlens, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('layout = "arc"\ncount = "three"\n')
    code, _, err = twinlens(
        "render", "cards", "--rig", file, *QUICK, "-o", tmp_path / "out"
    )
    assert code == 2
    assert f"{file}: count: must be a whole number" in err
    assert (
        twinlens(
            "render",
            "cards",
            "--rig",
            tmp_path / "none.toml",
            *QUICK,
            "-o",
            tmp_path / "out",
        )[0]
        == 2
    )


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
    command = (
        "render",
        ball,
        "--rig",
        planned,
        "--spp",
        "1",
        "--no-denoise",
        "-o",
        tmp_path / "out",
    )
    code, out, _ = twinlens(*command, "--lens", "pinhole")
    assert code == 0
    assert "sharp at every depth" in out
    assert Dataset(tmp_path / "out")[0].lens(0).lens == Pinhole()
    second = '[[lenses]]\nkind = "thin"\naperture_mm = 60\nfocus = 1.5\nshape = { kind = "annulus", inner = 0.5 }\n'
    planned.write_text(PLANNED + second)
    assert twinlens(*command, "--overwrite")[0] == 0
    lenses = [Dataset(tmp_path / "out")[0].lens(k).lens for k in range(2)]
    assert [lens.aperture for lens in lenses] == [Disk(), Annulus(0.5)]
    code, _, err = twinlens(*command, "--overwrite", "--aperture", "polygon:6")
    assert (code, "'shape'" in err) == (2, True)
    planned.write_text(PLANNED.replace("aperture_mm = 60", "aperture = 60"))
    code, _, err = twinlens(*command, "--overwrite")
    assert code == 2
    assert f"{planned}: lenses[0]: unknown key 'aperture'" in err


def test_render_takes_the_lenses_of_a_file_and_reports_their_optics(
    twinlens, ball, planned, tmp_path
):
    """The same from rays through the lens: the image of z is at 1/v' = 1/f - 1/z, in front of or behind the film."""
    command = (
        "render",
        ball,
        "--rig",
        planned,
        "--spp",
        "1",
        "--no-denoise",
        "--overwrite",
        "-o",
        tmp_path / "out",
    )
    found = json.loads(twinlens(*command, "--json")[1])["samples"][0]["lenses"][0]
    sample = Dataset(tmp_path / "out")[0]
    camera = sample.rig.cameras[0]
    assert (camera.width, camera.height, camera.fx, sample.rig.baseline()) == (
        48,
        36,
        60.0,
        0.08,
    )
    assert sample.lens(0).lens == ThinLens(0.06, 1.5)

    film, aperture, pixel = 60 * 30e-6, 0.06, 30e-6
    depth, hit = (
        np.array(found["depths"]),
        sample.truth0.depth[np.isfinite(sample.truth0.depth)],
    )
    assert depth.tolist() == pytest.approx([hit.min(), hit.max()], rel=1e-6)

    def circle(depth, focus=1.5):
        image = 1 / (1 / film + 1 / focus - 1 / depth)
        return aperture * abs(image - film) / abs(image) / pixel

    assert found["blur_px"] == pytest.approx(circle(depth))
    near, far = found["depth_of_field"]
    assert [circle(near), circle(far)] == pytest.approx([1, 1])
    assert circle(1e9, found["hyperfocal_distance"]) == pytest.approx(1)
    disparity, step = 60 * 0.08 / depth, 1e-4
    slope = (60 * 0.08 / (disparity - step) - 60 * 0.08 / (disparity + step)) / (
        2 * step
    )
    assert found["depth_error"] == pytest.approx(0.1 * slope, rel=1e-5)
    out = twinlens(*command)[1]
    assert f"sharp to 1 px from {near:.3g} m to {far:.3g} m, hyperfocal distance" in out
    assert (
        f"depth error {1e3 * found['depth_error'][0]:.3g} mm at {depth[0]:.3g} m" in out
    )
