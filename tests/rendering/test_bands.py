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

RED = {
    "type": "diffuse",
    "reflectance": Color((0.5, 0.1, 0.1)),
    "nir": Color((0.8, 0.8, 0.8)),
}
CAMERA = tl.Camera.from_fov(24, 18, 40)
NIR, BOTH = CAMERA.replace(band="nir"), CAMERA.replace(band="rgb+nir")
PROJECTOR = tl.Projector(
    geometry.rigid(np.eye(3), [0.1, 0.0, 0.0]),
    tl.Camera.from_fov(32, 24, 60),
    "dots",
    5.0,
)
POSES = [geometry.rigid(np.eye(3), [0.05 * i, 0.0, 0.0]) for i in range(4)]


def wall(**lights):
    facing = np.diag([9.0, 9.0, -1.0, 1.0]) @ np.diag([-1.0, 1.0, 1.0, 1.0])
    facing[2, 3] = 1.5
    objects = (SceneObject("wall", {"type": "rectangle"}, "red", facing),)
    return Scene("wall", objects, {"red": RED}, np.eye(4), (0.5, 3.0), lights=lights)


def sun(nir):
    return {
        "type": "directional",
        "direction": [0.0, 0.0, 1.0],
        "irradiance": Color((1.0, 2.0, 3.0)),
        "nir": nir,
    }


@pytest.fixture(scope="module")
def scene():
    return wall(sun=sun(0.5))


def test_near_infrared_radiance_is_that_of_its_own_light_and_reflectance(scene):
    rig = tl.Rig([NIR, CAMERA], POSES[:2])
    near, seen = tl.render(scene, rig, spp=1)
    assert near == pytest.approx(0.8 / np.pi * 0.5 * 2.0, rel=1e-4)
    assert (near[..., 0] == near[..., 2]).all()
    assert seen[9, 12] == pytest.approx(
        np.array([0.5, 0.1, 0.1]) * [1, 2, 3] / np.pi, rel=1e-4
    )
    near_guides = render_guides(
        build(in_band(scene, "nir")),
        NIR,
        POSES[0],
        tl.Pinhole(),
        [("independent", 1, 1)],
    )
    assert near_guides.albedo == pytest.approx(0.8, rel=1e-4)


def test_pictures_of_visible_light_are_the_same_to_the_byte_with_near_infrared_dots(
    scene,
):
    rig = tl.Rig([NIR, NIR, CAMERA, BOTH], POSES, projectors=[PROJECTOR])
    assert RIG.validate_python(plain(rig)).cameras == rig.cameras
    lit, dark = (
        tl.render(scene, each, spp=4, seed=3) for each in (rig, rig.with_projectors([]))
    )
    assert (lit[2] == dark[2]).all()
    assert all((lit[i] > dark[i] + 0.01).any() for i in (0, 1, 3))
    grids = [
        tl.render_lens_grid(scene, each, [tl.Pinhole()], spp=4)[0]
        for each in (rig, rig.with_projectors([]))
    ]
    assert (grids[0][2] == grids[1][2]).all()
    assert (grids[0][3] > grids[1][3] + 0.01).any()


def test_a_camera_without_filter_adds_both_bands(scene):
    both = tl.render(scene, tl.Rig([BOTH], POSES[:1]), spp=2, seed=1)[0]
    parts = tl.render(scene, tl.Rig([CAMERA, NIR], [POSES[0]] * 2), spp=2, seed=1)
    assert (both == parts[0] + parts[1]).all()


def test_a_scene_needs_light_in_the_band_and_a_projector_a_camera_that_sees_it():
    led = wall(lamp=sun("led"))
    with pytest.raises(InputError, match="'wall' has no near infrared light: add one"):
        tl.render(led, tl.Rig([NIR], POSES[:1]), spp=1)
    assert tl.render(led, tl.Rig([NIR], POSES[:1], projectors=[PROJECTOR]), spp=1)[
        0
    ].any()
    with pytest.raises(
        InputError, match=r"projectors\[0\] has the band 'nir', which no camera sees"
    ):
        tl.render(led, tl.Rig([CAMERA], POSES[:1], projectors=[PROJECTOR]), spp=1)
    with pytest.raises(InputError, match="unknown camera band 'ir'"):
        Sensor().for_band("ir")
    with pytest.raises(
        InputError, match="ambient of a scene must be a finite number >= 0, got '1'"
    ):
        led.with_ambient("1")
    mixed = tl.Rig([NIR, NIR, CAMERA, CAMERA], POSES, projectors=[PROJECTOR])
    assert [len(mixed.pair(a, a + 1).projectors) for a in (0, 2)] == [1, 0]


def test_partners_are_cameras_of_one_band():
    rig = tl.Rig([CAMERA, NIR, NIR, CAMERA, BOTH], [*POSES, POSES[0]])
    assert [rig.partner(i) for i in range(5)] == [3, 2, 1, 0, 3]
    assert tl.Rig([NIR], POSES[:1]).partner(0) is None
    table = plain(tl.Rig([NIR, CAMERA], POSES[:2]))
    assert [each.get("band") for each in table["cameras"]] == ["nir", None]


def test_photos_of_the_near_infrared_are_mono_and_have_their_own_exposure(scene):
    rig = tl.Rig([NIR, NIR, CAMERA], POSES[:3])
    images = [np.full((18, 24, 3), level, np.float32) for level in (0.1, 0.2, 1.0)]
    sensor = tl.Sensor(
        shot_noise=False,
        prnu=0.0,
        dsnu=0.0,
        read_noise=0.0,
        dark_current=0.0,
        vignetting=False,
    )
    photos = sensor.expose_rig(images, rig=rig, lens=tl.Pinhole())
    assert [photo.image.shape for photo in photos] == [(18, 24), (18, 24), (18, 24, 3)]
    times = [photo.record["time_s"] for photo in photos]
    assert times[0] == times[1] != times[2]
    assert 100 < photos[1].image.mean() < 160
    own = sensor.replace(
        nir=tl.Sensor.preset("phone", nir_efficiency=0.3), mismatch=Mismatch(gain=1.1)
    )
    assert Sensor.from_record(asdict(own)) == own
    assert own.for_band("rgb") is own
    seen = own.for_band("nir")
    assert (seen.full_well, seen.filters, seen.quantum_efficiency) == (
        6000.0,
        "mono",
        (0.3, 0.3, 0.3),
    )
    assert seen.mismatch == own.mismatch
    assert seen.for_band("nir") == seen
    with pytest.raises(InputError, match="sensor nir must be a Sensor"):
        sensor.replace(nir=own)
    rate = sensor.electrons_per_radiance(NIR, tl.Pinhole()).sum()
    visible = sensor.replace(quantum_efficiency=(1.0,) * 3, wavelengths=(500e-9,) * 3)
    per_photon = visible.electrons_per_radiance(CAMERA, tl.Pinhole()).sum() / 500e-9
    assert rate == pytest.approx(0.15 * 850e-9 * per_photon)
