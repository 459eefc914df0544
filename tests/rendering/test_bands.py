"""Images of the near infrared: against closed forms, and apart from those of visible light."""

from dataclasses import asdict

import numpy as np
import pytest

import twinlens as tl
from twinlens import geometry
from twinlens.dataset.record import RIG, plain
from twinlens.errors import InputError
from twinlens.rendering.build import build
from twinlens.rendering.guides import render_guides
from twinlens.scenes import Color, Scene, SceneObject
from twinlens.scenes.bands import in_band
from twinlens.sensor import Mismatch, Sensor

RED = {"type": "diffuse", "reflectance": Color((0.5, 0.1, 0.1)), "nir": Color((0.8,) * 3)}  # fmt: skip
CAMERA = tl.Camera.from_fov(24, 18, 40)
NIR = CAMERA.replace(band="nir")
BOTH = CAMERA.replace(band="rgb+nir")
POSES = [geometry.rigid(np.eye(3), [0.05 * i, 0.0, 0.0]) for i in range(5)]
PROJECTOR = tl.Projector(POSES[2], tl.Camera.from_fov(32, 24, 60), "dots", 5.0)


def rig_of(*cameras, **options):
    return tl.Rig(cameras, POSES[: len(cameras)], **options)


def wall(nir):
    """A red wall under a sun."""
    pose = np.diag([-9.0, 9.0, -1.0, 1.0])
    pose[2, 3] = 1.5
    objects = (SceneObject("wall", {"type": "rectangle"}, "red", pose),)
    irradiance = {"irradiance": Color((1.0, 2.0, 3.0)), "nir": nir}
    sun = {"type": "directional", "direction": [0.0, 0.0, 1.0], **irradiance}
    lights = {"sun": sun}
    return Scene("wall", objects, {"red": RED}, np.eye(4), (0.5, 3.0), lights=lights)


@pytest.fixture(scope="module")
def scene():
    return wall(nir=0.5)


def test_near_infrared_radiance_is_that_of_its_own_light_and_reflectance(scene):
    near, visible = tl.render(scene, rig_of(NIR, CAMERA), spp=1)
    assert near == pytest.approx(0.8 / np.pi * 0.5 * 2.0, rel=1e-4)
    assert (near[..., 0] == near[..., 2]).all()
    expected = np.array([0.5, 0.1, 0.1]) * [1, 2, 3] / np.pi
    assert visible[9, 12] == pytest.approx(expected, rel=1e-4)
    view = NIR, POSES[0], tl.Pinhole()
    guides = render_guides(build(in_band(scene, "nir")), *view, [("independent", 1, 1)])
    assert guides.albedo == pytest.approx(0.8, rel=1e-4)


def test_images_of_visible_light_do_not_change_with_near_infrared_dots(scene):
    rig = rig_of(NIR, NIR, CAMERA, BOTH, projectors=[PROJECTOR])
    unlit = rig.with_projectors([])
    assert RIG.validate_python(plain(rig)).cameras == rig.cameras

    def grid(lit):
        return tl.render_lens_grid(scene, lit, [tl.Pinhole()], spp=4)[0]

    def images(lit):
        return tl.render(scene, lit, spp=4, seed=3)

    for render in (grid, images):
        bright = render(rig)
        dark = render(unlit)
        assert (bright[2] == dark[2]).all()
        for camera in (0, 1, 3):
            assert (bright[camera] > dark[camera] + 0.01).any()


def test_a_camera_without_filter_adds_both_bands(scene):
    both = tl.render(scene, rig_of(BOTH), spp=2, seed=1)[0]
    same_place = tl.Rig([CAMERA, NIR], [POSES[0]] * 2)
    visible, near = tl.render(scene, same_place, spp=2, seed=1)
    assert (both == visible + near).all()


def test_a_scene_needs_light_in_the_band_and_a_projector_a_camera_that_sees_it():
    led = wall(nir="led")
    with pytest.raises(InputError, match="'wall' has no near infrared light: add one"):
        tl.render(led, rig_of(NIR), spp=1)
    assert tl.render(led, rig_of(NIR, projectors=[PROJECTOR]), spp=1)[0].any()
    unseen = r"projectors\[0\] has the band 'nir', which no camera sees"
    with pytest.raises(InputError, match=unseen):
        tl.render(led, rig_of(CAMERA, projectors=[PROJECTOR]), spp=1)
    mixed = rig_of(NIR, NIR, CAMERA, CAMERA, projectors=[PROJECTOR])
    assert [len(mixed.pair(a, a + 1).projectors) for a in (0, 2)] == [1, 0]


def test_photos_of_the_near_infrared_are_mono_and_have_their_own_exposure():
    quiet = {"prnu": 0.0, "dsnu": 0.0, "read_noise": 0.0, "dark_current": 0.0}
    sensor = tl.Sensor(shot_noise=False, vignetting=False, **quiet)
    images = [np.full((18, 24, 3), level, np.float32) for level in (0.1, 0.2, 1.0)]
    rig = rig_of(NIR, NIR, CAMERA)
    photos = sensor.expose_rig(images, rig=rig, lens=tl.Pinhole())
    assert [photo.image.shape for photo in photos] == [(18, 24), (18, 24), (18, 24, 3)]
    times = [photo.record["time_s"] for photo in photos]
    assert times[0] == times[1] != times[2]
    assert 100 < photos[1].image.mean() < 160
    rate = sensor.electrons_per_radiance(NIR, tl.Pinhole()).sum()
    perfect = {"quantum_efficiency": (1.0,) * 3, "wavelengths": (500e-9,) * 3}
    visible = sensor.replace(**perfect).electrons_per_radiance(CAMERA, tl.Pinhole())
    per_photon = visible.sum() / 500e-9
    assert rate == pytest.approx(0.15 * 850e-9 * per_photon)


def test_a_sensor_may_have_another_one_for_the_near_infrared():
    phone = tl.Sensor.preset("phone", nir_efficiency=0.3)
    sensor = tl.Sensor(nir=phone, mismatch=Mismatch(gain=1.1))
    assert Sensor.from_record(asdict(sensor)) == sensor
    assert sensor.for_band("rgb") is sensor
    near = sensor.for_band("nir")
    assert near.full_well == 6000.0
    assert near.filters == "mono"
    assert near.quantum_efficiency == (0.3, 0.3, 0.3)
    assert near.mismatch == sensor.mismatch
    assert near.for_band("nir") == near
    with pytest.raises(InputError, match="sensor nir must be a Sensor"):
        tl.Sensor(nir=sensor)
    with pytest.raises(InputError, match="unknown camera band 'ir'"):
        Sensor().for_band("ir")
