from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from tests.dataset.dataset_scene import next_version
from twinlens.camera import ALIGNED, Misalignment, misaligned
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.channels import CHANNELS, TRUTH, Channel
from twinlens.dataset.verify import verify_sample
from twinlens.factory import Shoot, default_rig, make_sample
from twinlens.factory.sample import _noise_ratios
from twinlens.rendering import NoisyImage
from twinlens.rendering.ground_truth import EXTRA_CHANNELS
from twinlens.sensor import Exposure, Sensor, light

LENSES = (tl.Pinhole(), tl.Pinhole(), tl.ThinLens(0.04, 1.2))


@pytest.fixture(scope="module")
def scene():
    return tl.load_scene("cards")


@pytest.fixture(scope="module")
def sample(scene):
    return make_sample(
        scene,
        default_rig(scene, 48, 36),
        LENSES,
        Shoot(spp=4, seed=0, keep_radiance=True),
    )


def test_the_rig_is_the_one_the_scene_was_composed_for(scene):
    rig = default_rig(scene, 48, 36)
    assert rig.is_rectified()
    assert rig.baseline() == pytest.approx(scene.baseline)
    assert rig.cameras[0].fov_x_deg == pytest.approx(scene.fov_x_deg)
    assert default_rig(
        scene, 48, 36, fov_x_deg=30, baseline=0.2
    ).baseline() == pytest.approx(0.2)


def test_every_lens_and_eye_has_noise_of_its_own(sample):
    first, again = sample.shots[0].radiances, sample.shots[1].radiances
    assert not np.array_equal(first[0], again[0])
    noise = [
        (a - b).ravel() - (a - b).mean() for a, b in zip(first, again, strict=True)
    ]
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 5 / np.sqrt(noise[0].size)


def test_eyes_share_an_exposure_and_lenses_do_not(sample):
    times = [[e["time_s"] for e in shot.record["exposures"]] for shot in sample.shots]
    assert all(left == right for left, right in times)
    assert times[0][0] != times[2][0]


def test_a_further_channel_is_computed_stored_and_read(scene, tmp_path, monkeypatch):
    """A function of the renderer's hits and a row of the table of channels are all that it needs."""
    name, meaning = "ray_distance", "distance along the chief ray; +inf unknown"
    monkeypatch.setitem(EXTRA_CHANNELS, name, lambda view: view.first.distance)
    row = Channel(name, TRUTH, "float32", meaning, "m", since=next_version())
    monkeypatch.setitem(CHANNELS, name, row)
    rig = default_rig(scene, 24, 18)
    sample = make_sample(scene, rig, LENSES[:1], Shoot(spp=1, seed=0))
    write_sample(tmp_path / "s", sample)
    stored = Dataset(tmp_path)[0]
    assert verify_sample(stored) == []
    for view, camera in enumerate(rig.cameras):
        slopes = camera.unproject(camera.pixel_grid())
        expected = stored[f"depth{view}"] * np.linalg.norm(slopes, axis=-1)
        np.testing.assert_allclose(stored[f"ray_distance{view}"], expected, rtol=1e-6)


def darkening(sample) -> float:
    """The mean level through the second lens over that through the first."""
    first, second = (np.mean(shot.images[0]) for shot in sample.shots)
    return float(second / first)


def test_under_one_exposure_a_smaller_aperture_is_darker(scene):
    """A quarter of the light at half the width; automatic exposures make it up."""
    lenses = (tl.ThinLens(0.004, 1.2), tl.ThinLens(0.002, 1.2))
    sensor = Sensor.preset("ideal", output="linear", bits=16)
    camera = default_rig(scene, 24, 18).cameras[0].replace(pixel_pitch_um=200.0)
    rig = tl.Rig.stereo(camera, scene.baseline, scene.world_from_left)
    shoot = Shoot(spp=64, sensor=sensor)
    auto = make_sample(scene, rig, lenses, shoot)
    exposure = Exposure(auto.shots[0].record["exposures"][0]["time_s"])
    fixed = make_sample(scene, rig, lenses, replace(shoot, exposure=exposure))
    assert darkening(fixed) == pytest.approx(0.25, rel=0.02)
    assert darkening(auto) == pytest.approx(1.0, rel=0.02)


def test_diffraction_blurs_what_the_lens_and_not_what_the_pinhole_sees(scene, sample):
    lenses = (tl.Pinhole(), tl.ThinLens(1e-5, 1.2))
    sensor = Sensor(wavelengths=(700e-9, 550e-9, 400e-9))
    shoot = Shoot(spp=4, sensor=sensor, keep_radiance=True)
    plain = make_sample(scene, sample.rig, lenses, shoot)
    blurred = make_sample(scene, sample.rig, lenses, replace(shoot, diffraction=True))
    assert np.array_equal(plain.shots[0].radiances[1], blurred.shots[0].radiances[1])

    def detail(image, channel):
        return np.abs(np.diff(image[..., channel], axis=1)).mean()

    for eye in (0, 1):
        sharp, soft = plain.shots[1].radiances[eye], blurred.shots[1].radiances[eye]
        assert soft.mean() == pytest.approx(sharp.mean(), rel=0.02)
        red, blue = (detail(soft, c) / detail(sharp, c) for c in (0, 2))
        assert red < blue < 0.9, "longer waves spread further"


def test_what_is_asked_of_every_camera_goes_before_what_a_table_says_of_one(scene):
    cameras = [
        {"fx": 20, "fy": 22},
        {"fov_x_deg": 40, "distortion": {"k1": 0.2}, "cx": 3.0},
    ]
    rigged = replace(scene, rig={"cameras": cameras})
    first, second = default_rig(
        rigged, 48, 36, intrinsics={"fx": 60.0, "fy": 61.0}
    ).cameras
    assert (first.fx, first.fy, second.fx, second.fy) == (60.0, 61.0, 60.0, 61.0)
    assert (second.cx, second.distortion.k1) == (3.0, 0.2)
    plain = {"cx": 20.0, "cy": 21.0, "distortion": {"k1": -0.01}}
    for camera in default_rig(rigged, 48, 36, intrinsics=plain).cameras:
        assert (camera.cx, camera.cy, camera.distortion.k1) == (20.0, 21.0, -0.01)
    assert default_rig(rigged, 48, 36, fov_x_deg=90).cameras[0].fx == pytest.approx(24)


def test_an_error_left_in_moves_the_picture_and_leaves_the_truth(scene):
    straight = default_rig(scene, 48, 36)
    off = misaligned(straight, (ALIGNED, Misalignment(vertical_px=3.0)))
    a, b = (
        make_sample(scene, rig, LENSES[:1], Shoot(spp=64, keep_radiance=True))
        for rig in (straight, off)
    )
    assert np.array_equal(a.truths[1].depth, b.truths[1].depth)
    left, right = ([sample.shots[0].radiances[i] for sample in (a, b)] for i in (0, 1))
    assert np.array_equal(*left)
    assert (
        np.abs(right[1][3:] - right[0][:-3]).mean()
        < 0.5 * np.abs(right[1] - right[0]).mean()
    )


@pytest.mark.parametrize("filters", ["rgb", "mono"])
@pytest.mark.parametrize("vignetting", [False, True])
def test_the_noise_ratio_is_that_of_the_electrons_in_a_pixel(
    scene, filters, vignetting
):
    """A uniform image without readout noise: the error in electrons over the root of the electrons."""
    sensor = Sensor(filters=filters, vignetting=vignetting, read_noise=0.0, adc_bits=16)
    rig, lens = default_rig(scene, 24, 24, fov_x_deg=90), tl.Pinhole()
    camera, exposure, radiance, error = rig.cameras[0], Exposure(0.01), 0.5, 0.1
    images = [np.full((24, 24, 3), value, np.float32) for value in (radiance, error)]
    views = [NoisyImage(*images)] * 2
    rate = exposure.time * sensor.electrons_per_radiance(camera, lens)
    if filters == "mono":
        rate = rate.sum(keepdims=True)
    if vignetting:
        rate = rate * np.median(light.vignetting(camera, lens))
    expected = np.sqrt(np.mean(error**2 * rate / radiance))
    photos = sensor.expose_rig(images[:1] * 2, rig=rig, lens=lens, exposure=exposure)
    ratios = _noise_ratios(views, photos, sensor, rig, lens)
    np.testing.assert_allclose(ratios, expected, rtol=0.05)
