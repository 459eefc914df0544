"""The light of projectors in images, against closed forms, and decoded codes against the truth of projection."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, minimum_filter
from scipy.spatial.transform import Rotation
from scipy.special import j1

import twinlens as tl
from twinlens import geometry
from twinlens.camera import (
    BrownConrady,
    Camera,
    GrayCode,
    PhaseShift,
    Rig,
    decode,
    patterns,
)
from twinlens.camera.projector import LUMENS_PER_WATT
from twinlens.errors import InputError
from twinlens.rendering import ProjectorWarning
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build
from twinlens.rendering.projectors import lit_by_projectors
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Bitmap, Color, Scene, SceneObject

Projector = partial(tl.Projector, band="rgb")
GREY = {
    "type": "twosided",
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
}
LENS = Camera(64, 48, 80.0, 70.0, 20.0, 30.0)
SLOW = pytest.mark.slow
CHECKER = patterns.checker(64, 48, 8)
CAMERA = Camera.from_fov(96, 72, 40)
TINY = Camera.from_fov(16, 12, 40)
SIDE = geometry.rigid(
    Rotation.from_euler("xyz", [3, -6, 10], degrees=True).as_matrix(),
    [0.15, 0.02, -0.01],
)


def scene_of(*objects, depth=2, **lights):
    integrator = {"type": "path", "max_depth": depth}
    return Scene(
        "test",
        objects,
        {"grey": GREY},
        np.eye(4),
        (0.1, 10.0),
        lights=lights,
        integrator=integrator,
    )


def wall(z, turn_deg=0.0):
    turn = Rotation.from_euler("y", 180 + turn_deg, degrees=True).as_matrix()
    return SceneObject(
        "wall",
        {"type": "rectangle"},
        "grey",
        geometry.rigid(turn, [0, 0, z]) @ np.diag([9, 9, 1, 1]),
    )


def ball(centre, radius):
    return SceneObject(
        "ball", {"type": "sphere", "center": list(centre), "radius": radius}, "grey"
    )


def irradiance(scene, rig, spp=16):
    return (
        tl.render(scene, rig, spp=spp, seed=1)[0][..., 1].astype(np.float64)
        * np.pi
        / 0.5
    )


@pytest.mark.parametrize("distortion", [None, BrownConrady(-0.2, 0.05, 1e-3, -1e-3)])
def test_irradiance_is_the_flux_of_a_pixel_over_its_area_on_the_wall(distortion):
    """The area is that between the rays through the pixel's corners, so this includes 1/z^2, cosine and distortion."""
    lens = LENS.replace(distortion=distortion)
    rig = Rig([CAMERA], [np.eye(4)], projectors=[Projector(SIDE, lens, power=3.0)])
    for z, turn in ((1.0, 0.0), (2.0, 0.0), (1.5, 40.0)):
        scene = scene_of(wall(z, turn))
        u, v = np.moveaxis(tl.projection(scene, rig).pixels, -1, 0)
        inner = (u > 2) & (u < 61) & (v > 2) & (v < 45)
        normal = geometry.rotate(scene.objects[0].world_from_object, [0.0, 0.0, 1.0])
        corners = []
        for du, dv in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
            rays = geometry.rotate(
                SIDE, lens.unproject(np.stack([u[inner] + du, v[inner] + dv], axis=-1))
            )
            t = ((np.array([0, 0, z]) - SIDE[:3, 3]) @ normal) / (rays @ normal)
            corners.append(t[:, None] * rays)
        a, b, c, d = corners
        area = 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=1)
        expected = 3.0 / 3 / (64 * 48) / area
        assert inner.sum() > 2000
        assert np.abs(irradiance(scene, rig)[inner] / expected - 1).max() < 0.01
        assert irradiance(scene, rig)[(u < -2) | (v < -2)].max() == 0


def test_corners_of_a_projected_checker_are_where_the_projection_says():
    """Divided by the image of white light, whose slope over the wall would move the saddle points."""
    scene = scene_of(wall(1.2, 20.0))
    rigs = [
        Rig([CAMERA], [np.eye(4)], projectors=[Projector(SIDE, LENS, each)])
        for each in (CHECKER, "white")
    ]
    checker, white = (irradiance(scene, rig, 256) for rig in rigs)
    image = checker / np.maximum(white, 1e-9)
    # Each corner of the checker on the wall, by a ray of the projector, and its pixel in the camera.
    v, u = np.mgrid[15.5:40:8, 15.5:56:8]
    rays = geometry.rotate(
        SIDE, LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=-1))
    )
    normal = geometry.rotate(scene.objects[0].world_from_object, [0.0, 0.0, 1.0])
    t = ((np.array([0, 0, 1.2]) - SIDE[:3, 3]) @ normal) / (rays @ normal)
    truth = CAMERA.project(SIDE[:3, 3] + t[:, None] * rays)
    inside = (np.abs(truth - [47.5, 35.5]) < [38, 26]).all(axis=1)
    assert inside.sum() >= 10
    found = np.array([_saddle(image, at) for at in truth[inside]])
    assert np.abs(found - truth[inside]).max() < 0.05


def _saddle(image, start):
    """The saddle point of a quadratic fitted to the image, blurred to twice a pixel, around `start`."""
    smooth, at = gaussian_filter(image, 1.5), np.array(start)
    for _ in range(5):
        u0, v0 = np.round(at).astype(int)
        v, u = np.mgrid[-1:2, -1:2]
        u, v = u.ravel() + u0 - at[0], v.ravel() + v0 - at[1]
        values = smooth[v0 - 1 : v0 + 2, u0 - 1 : u0 + 2].ravel()
        _, gu, gv, uu, uv, vv = np.linalg.lstsq(
            np.stack([np.ones(9), u, v, u * u, u * v, v * v], axis=1),
            values,
            rcond=None,
        )[0]
        at = at - np.linalg.solve([[2 * uu, uv], [uv, 2 * vv]], [gu, gv])
    return at


def test_speckle_on_a_wall_has_full_contrast_and_grains_of_wavelength_times_distance_over_aperture():
    """Its correlation at r metres is (2 J1(x) / x)^2, x = pi D r / (lambda z): 0 at 1.22 lambda z / D.

    Within 4 standard errors of the independent grains in the picture, and 2 % for its pixels, an eighth of a grain.
    """
    z, wavelength, aperture = 1.5, 850e-9, 3e-5
    lens = Camera.from_fov(384, 288, 50)
    grain = wavelength * lens.fx / aperture
    shown = patterns.speckle(384, 288, grain, seed=1)
    light = irradiance(
        scene_of(wall(z)),
        Rig([lens], [np.eye(4)], projectors=[Projector(None, lens, shown)]),
    )
    light = light[2:-2, 2:-2] / light[2:-2, 2:-2].mean() - 1
    error = 0.02 + 4 * grain / np.sqrt(light.size)
    assert light.std() == pytest.approx(1, abs=error)
    for step in (4, 8, 11, 14, 20):
        x = np.pi * aperture * (step * z / lens.fx) / (wavelength * z)
        expected = (2 * j1(x) / x) ** 2
        for a, b in (
            (light[:, step:], light[:, :-step]),
            (light[step:], light[:-step]),
        ):
            assert np.mean(a * b) == pytest.approx(expected, abs=error)


@pytest.mark.parametrize(
    ("z", "focus"), [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (1.5, np.inf)]
)
def test_a_point_of_the_pattern_is_a_disk_away_from_the_focus(z, focus):
    """Of diameter A |1 - z/f|, from the variance D^2/16 along an axis, on a wall at right angles; its flux stays."""
    lens, point = Camera.from_fov(32, 24, 40), np.zeros((24, 32))
    point[12, 16] = 1
    made = Projector(
        None, lens, point, 20.0, aperture_diameter=0.1, focus_distance=focus
    )
    light = irradiance(
        scene_of(wall(z)), Rig([CAMERA], [np.eye(4)], projectors=[made]), 256
    )
    x = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx * z
    share, area = light.sum(axis=0) / light.sum(), (z / CAMERA.fx) ** 2
    assert light.sum() * area == pytest.approx(20 / 3 / (32 * 24), rel=0.01)
    spread = (
        share @ x**2 - (share @ x) ** 2 - (z / lens.fx) ** 2 / 6 - area / 12
    )  # without the tent and the pixel
    assert 16 * spread == pytest.approx(
        (0.1 * (1 - z / focus)) ** 2, rel=0.02, abs=1e-6
    )


def shoot(scene, rig, shown, spp):
    projector = rig.projectors[0]
    lit = (rig.with_projectors([projector.with_pattern(each)]) for each in shown)
    return [tl.render(scene, each, spp=spp, seed=k)[0] for k, each in enumerate(lit)]


def structured_light(**lights):
    """A scene and a rig with a projector, its true pixels (H, W, 2), and which of them are lit and away from edges."""
    rig = Rig([CAMERA], [np.eye(4)], projectors=[Projector(SIDE, LENS, power=20.0)])
    scene = scene_of(wall(1.6, 15.0), ball([-0.1, 0.05, 1.2], 0.15), depth=3, **lights)
    truth = tl.projection(scene, rig)
    ids = tl.ground_truth(scene, rig, objects=False)[0].object_id
    inside = LENS.contains(truth.pixels + 1) & LENS.contains(truth.pixels - 1)
    away = minimum_filter(truth.lit & inside, 5) & (
        minimum_filter(ids, 5) == -minimum_filter(-ids, 5)
    )
    assert away.mean() > 0.5
    return scene, rig, truth, away


def test_opencv_has_the_same_gray_code_and_decodes_it():
    """OpenCV's positions are whole pixels, so an error of 0.5 px is that of a right code at the edge of a pixel."""
    cv2 = pytest.importorskip("cv2")
    if not hasattr(cv2, "structured_light"):
        pytest.skip(
            "this OpenCV has no structured_light; opencv-contrib-python-headless has"
        )
    scene, rig, truth, away = structured_light()
    peer = cv2.structured_light.GrayCodePattern.create(64, 48)
    shown = [pattern for axis in "uv" for pattern in GrayCode(64, 48, axis).patterns]
    assert all(
        (a > 0).tolist() == (b > 0).tolist()
        for a, b in zip(peer.generate()[1], shown, strict=True)
    )
    images = [image.mean(axis=2) for image in shoot(scene, rig, shown, 64)]
    levels = [(255 * image / np.max(images)).astype(np.uint8) for image in images]
    peer.setWhiteThreshold(1)
    found = [peer.getProjPixel(levels, int(u), int(v)) for v, u in np.argwhere(away)]
    errors = [
        np.inf if failed else np.abs(at - true).max()
        for (failed, at), true in zip(found, truth.pixels[away], strict=True)
    ]
    assert (np.array(errors) <= 0.5).mean() >= 0.99


def test_decoded_gray_code_and_phase_shift_equal_the_truth():
    scene, rig, truth, away = structured_light(
        lamp={"type": "constant", "radiance": 0.5}
    )
    code, fine = GrayCode(64, 48), PhaseShift(64, 48, 16.0, 4)
    found = decode(shoot(scene, rig, code.patterns, 64), code)
    assert (np.abs(found.position - truth.pixels[..., 0])[away] <= 0.5).mean() >= 0.99
    assert np.median(np.abs(found.position - truth.pixels[..., 0])[away]) < 0.05
    scene = structured_light()[0]
    exact = decode(shoot(scene, rig, fine.patterns, 128), fine, coarse=found.position)
    assert np.quantile(np.abs(exact.position - truth.pixels[..., 0])[away], 0.99) < 0.05


def test_shadow_of_a_ball_and_the_far_side_of_a_sheet_are_not_lit():
    sheet = SceneObject(
        "sheet", {"type": "rectangle"}, "grey", geometry.rigid(np.eye(3), [0, 0, 1.0])
    )
    beyond = Rig(
        [CAMERA],
        [np.eye(4)],
        projectors=[Projector(geometry.look_at([0, 0, 2], [0, 0, 1], (0, 1, 0)), LENS)],
    )
    assert not tl.projection(scene_of(sheet), beyond).lit.any()
    rig = Rig([CAMERA], [np.eye(4)], projectors=[Projector(SIDE, LENS)])
    scene = scene_of(wall(1.6), ball([-0.05, 0.0, 1.0], 0.1))
    truth, image = tl.projection(scene, rig), irradiance(scene, rig)
    lit = truth.lit
    rim = (np.abs(truth.pixels + 0.5) < 1).any(axis=2) | (
        np.abs(truth.pixels - [63.5, 47.5]) < 1
    ).any(axis=2)
    sure = (
        minimum_filter(lit, 3) | minimum_filter(~lit, 3)
    ) & ~rim  # where the bilinear filter falls to 0
    assert 50 < (~lit & sure).sum() < lit.size / 2
    assert ((image > 0) == lit)[sure].mean() > 0.995


def test_a_projector_lights_a_dark_scene_and_only_its_rig():
    scene = scene_of(wall(1.5))
    rig = Rig([CAMERA], [np.eye(4)])
    with pytest.raises(InputError, match="has no light"):
        tl.render(scene, rig, spp=1)
    lit = rig.with_projectors([Projector(SIDE, LENS)])
    assert tl.render(scene, lit, spp=1)[0].max() > 0
    lamp = scene_of(
        wall(1.5), lamp={"type": "point", "position": [0.0, 0.0, 0.0], "intensity": 1.0}
    )
    before = tl.render(lamp, rig, spp=2)[0]
    with_both = tl.render(lamp, lit, spp=256)[0].mean()
    only_projector, only_lamp = (
        tl.render(*each, spp=256)[0].mean() for each in ((scene, lit), (lamp, rig))
    )
    assert with_both == pytest.approx(only_projector + only_lamp, rel=0.02)
    assert (tl.render(lamp, rig, spp=2)[0] == before).all()


SURROUNDINGS = {
    "constant": {"radiance": Color((1.0, 0.5, 0.2))},
    "envmap": {
        "bitmap": Bitmap(np.linspace(0, 1, 96, dtype=np.float32).reshape(4, 8, 3))
    },
    "sunsky": {"sun_direction": [0.2, -0.5, -1.0]},
}


@pytest.mark.parametrize(
    "kind",
    ["constant", *(pytest.param(kind, marks=SLOW) for kind in ("envmap", "sunsky"))],
)
def test_ambient_scales_every_light_of_a_scene(kind):
    shining = Bitmap(np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3))
    emitters = (
        {"type": "area", "radiance": shining},
        {"type": "directionalarea", "radiance": Color((3.0, 2.0, 1.0))},
    )
    poses = [
        geometry.rigid(np.diag([1.0, -1.0, -1.0]), [x, 0, 0.8])
        @ np.diag([0.1, 0.1, 1, 1])
        for x in (0.5, 0.2)
    ]
    lamps = [
        SceneObject("lamp", {"type": "rectangle"}, "grey", *each)
        for each in zip(poses, emitters, strict=True)
    ]
    lights = {
        "point": {"type": "point", "position": [0.0, 0.5, 0.0], "intensity": 2.0},
        "spot": {
            "type": "spot",
            "to_world": np.eye(4),
            "intensity": Color((1.0, 2.0, 3.0)),
        },
        "sun": {"type": "directional", "direction": [0.0, 0.1, 1.0], "irradiance": 1.0},
    }
    scene = scene_of(
        wall(1.5), *lamps, around={"type": kind, **SURROUNDINGS[kind]}, **lights
    )
    rig = Rig([TINY], [np.eye(4)])
    whole, dimmed = (
        tl.render(each, rig, spp=4)[0] for each in (scene, scene.with_ambient(0.25))
    )
    assert whole.max() > 0
    assert np.allclose(dimmed, whole / 4, rtol=1e-5)
    dark = scene.with_ambient(0)
    with pytest.raises(InputError, match="has no light"):
        tl.render(dark, rig)
    lit = rig.with_projectors([Projector(SIDE, LENS)])
    unlit = scene_of(wall(1.5), *(replace(lamp, emitter=None) for lamp in lamps))
    found, expected = (
        tl.render(each, lit, spp=256)[0].mean() for each in (dark, unlit)
    )
    assert found == pytest.approx(expected, rel=0.05)


def test_another_pattern_power_or_pose_changes_the_loaded_scene():
    """It is not loaded again, and gives the bytes of a scene that is loaded for it."""
    first = Rig([CAMERA], [np.eye(4)], projectors=[Projector(SIDE, LENS)])
    other = first.with_projectors(
        [Projector(SIDE @ geometry.rigid(np.eye(3), [0.1, 0, 0]), LENS, CHECKER, 3.0)]
    )
    scene = scene_of(wall(1.5))
    tl.render(scene, first, spp=1)
    changed = tl.render(scene, other, spp=2)[0]
    loaded = [
        lit_by_projectors(build(scene), each, "rgb").integrator
        for each in (first, other)
    ]
    assert loaded[0] is loaded[1]
    assert (changed == tl.render(scene_of(wall(1.5)), other, spp=2)[0]).all()


@pytest.mark.parametrize("name", ["room", "spheres"])
def test_paths_are_those_of_mitsuba_where_there_is_no_projector(name):
    from twinlens.rendering.paths import Paths

    scene = tl.load_scene(name)
    built = build(scene)
    view = TINY, scene.world_from_left, tl.Pinhole(), 64, "multijitter"
    ours = Paths([], scene.integrator["max_depth"], rr_depth=3)
    theirs = mitsuba().load_dict({**scene.integrator, "rr_depth": 3})
    images = [
        np.asarray(each.render(built.mi_scene, make_sensor(*view), seed=3, spp=64))
        for each in (ours, theirs)
    ]
    assert images[0].mean() > 0.05
    assert np.abs(images[0] - images[1]).max() < 1e-5


def test_a_projector_has_its_light_without_the_noise_of_a_choice_of_light():
    """Other integrators choose one of two lights p and l at each sample: equal mean, variance (p - l)^2 / spp."""
    scene = scene_of(
        wall(1.5),
        sun={"type": "directional", "direction": [0.0, 0.0, 1.0], "irradiance": 1.0},
    )
    chosen = replace(scene, integrator={**scene.integrator, "hide_emitters": True})
    rig = Rig(
        [TINY],
        [np.eye(4)],
        projectors=[Projector(SIDE, Camera.from_fov(16, 12, 100), power=40.0)],
    )
    render = partial(tl.render, spp=64, sampler="independent")
    ours, theirs = (
        np.array([render(each, rig, seed=k)[0] for k in range(8)], np.float64)
        for each in (scene, chosen)
    )
    sun = render(scene, rig.with_projectors([]))[0]
    choice = np.square(ours.mean(axis=0) - 2 * sun).mean() / 64
    assert ours.mean() == pytest.approx(
        theirs.mean(), rel=4 * np.sqrt(3 * choice / theirs.size) / ours.mean()
    )
    assert theirs.var(axis=0, ddof=1).mean() == pytest.approx(choice, rel=0.15)
    assert ours.var(axis=0, ddof=1).mean() < 0.02 * choice


def test_projection_refuses_what_the_rig_does_not_have():
    rig = Rig([CAMERA], [np.eye(4)])
    with pytest.raises(InputError, match="no projectors"):
        tl.projection(scene_of(wall(1.0)), rig)
    lit = rig.with_projectors([Projector(SIDE, LENS)])
    for pair, message in (
        ((0, 1), "projector must be 0, got 1"),
        ((0.0, 0), "camera must be 0"),
        ((0, "0"), "got '0'"),
    ):
        with pytest.raises(InputError, match=message):
            tl.projection(scene_of(wall(1.0)), lit, *pair)


GLASS = {"type": "thindielectric"}
CUT_OUT = {"type": "mask", "opacity": 0.5, "bsdf": GREY}
ROUGH = {"type": "roughdielectric", "alpha": 0.2}


@pytest.mark.parametrize(
    ("paint", "blocks"), [(GLASS, True), (CUT_OUT, True), (ROUGH, False), (GREY, False)]
)
def test_glass_in_front_of_a_projector_is_reported(paint, blocks):
    """Only where it is in the light: the second projector looks past the pane."""
    pane = geometry.rigid(np.diag([-1.0, 1.0, -1.0]), [0.15, 0.0, 0.8]) @ np.diag(
        [0.1, 0.1, 1.0, 1.0]
    )
    objects = (
        *scene_of(wall(1.5)).objects,
        SceneObject("pane", {"type": "rectangle"}, "paint", pane),
    )
    scene = replace(
        scene_of(), objects=objects, materials={"grey": GREY, "paint": paint}
    )
    poses = SIDE, geometry.rigid(np.eye(3), [2.0, 0.0, 0.0])
    rig = Rig([TINY], [np.eye(4)], projectors=[Projector(pose, LENS) for pose in poses])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tl.render(scene, rig, spp=1)
        tl.render(scene, rig, spp=1)
    texts = [str(each.message) for each in caught if each.category is ProjectorWarning]
    assert len(texts) == blocks
    assert all(
        text.startswith(
            "projectors[0]: the material 'paint', smooth glass or a cut-out,"
        )
        for text in texts
    )
    if blocks:
        position = tl.ground_truth(scene, rig, objects=False)[0].position
        rays = position - SIDE[:3, 3]
        crossing = SIDE[:3, 3] + rays * (
            (0.8 - SIDE[2, 3]) / rays[..., 2:]
        )  # with the plane of the pane
        behind = (position[..., 2] > 1) & (
            np.abs(crossing[..., :2] - [0.15, 0.0]) < 0.09
        ).all(axis=-1)
        assert behind.any()
        assert not tl.projection(scene, rig).lit[behind].any()


def test_lumens_are_those_of_the_wavelengths_of_the_channels():
    """683 lm/W times Mitsuba's table of the CIE's luminous efficiency, the mean of the channels."""
    wavelengths = [1e9 * each for each in tl.Sensor().wavelengths]
    efficiency = np.mean(
        [np.ravel(mitsuba().cie1931_y(each))[0] for each in wavelengths]
    )
    assert pytest.approx(683.0 * efficiency, rel=1e-3) == LUMENS_PER_WATT


@pytest.mark.parametrize(
    ("aperture", "band"), [(0.0, "rgb"), (0.02, "rgb"), (0.02, "nir")]
)
def test_denoised_images_keep_the_dots_of_a_projector(aperture, band):
    """Noise around the dots is removed; the dots themselves are those of many raw samples."""
    lamp = {"type": "sphere", "center": [-2.0, -2.0, 1.0], "radius": 0.5}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}
    shining = SceneObject("lamp", lamp, "grey", emitter=emitter)
    scene = scene_of(wall(2.0, 10), ball([0.2, 0.1, 1.5], 0.2), shining, depth=4)
    projector = Projector(
        SIDE, Camera.from_fov(128, 96, 50), patterns.dots(128, 96, 0.1, seed=3), 20.0,
        aperture_diameter=aperture, focus_distance=2.0, band=band,
    )  # fmt: skip
    rig = Rig([CAMERA.replace(band=band)], [np.eye(4)], projectors=[projector])
    raw, denoised = (
        tl.render(scene, rig, spp=16, seed=3, denoise=denoise)[0]
        for denoise in (False, True)
    )
    many, dark = (
        tl.render(scene, each, spp=512, seed=4)[0]
        for each in (rig, rig.with_projectors([]))
    )
    pattern = many - dark
    contrast = (
        (denoised - denoised.mean()) * (pattern - pattern.mean())
    ).mean() / pattern.var()
    assert contrast == pytest.approx(1.0, abs=0.03)
    flat = minimum_filter(pattern[..., 1] < 0.1 * pattern.max(), 3)
    errors = [np.sqrt(np.mean((image - many)[flat] ** 2)) for image in (raw, denoised)]
    assert errors[1] < 0.5 * errors[0]
    assert np.sqrt(np.mean((denoised - many) ** 2)) < np.sqrt(
        np.mean((raw - many) ** 2)
    )


@pytest.mark.parametrize(("sampler", "spp"), [("sobol", 5), ("multijitter", 7)])
@pytest.mark.parametrize("parts", [None, tl.Dual()], ids=["whole", "halves"])
def test_guides_have_the_projected_light_of_the_image(sampler, spp, parts):
    """A wall under a projector alone, seen by the image's own samples. 7 samples take two passes."""
    from twinlens.rendering.images import image_passes, raw_image
    from twinlens.rendering.views import views_of

    projector = Projector(
        SIDE, Camera.from_fov(128, 96, 50), patterns.dots(128, 96, 0.1, seed=3), 20.0,
        aperture_diameter=0.02, focus_distance=2.0,
    )  # fmt: skip
    rig = Rig([TINY], [np.eye(4)], projectors=[projector])
    scenes = {"rgb": scene_of(wall(2.0), depth=2)}
    (view,) = views_of(scenes, rig, [tl.ThinLens(0.05, 1.0)], 0, denoise=True)
    passes = image_passes(view.camera, spp, 0, 0, sampler)
    raw, guides = raw_image(view, passes, parts, lambda _: None)
    assert raw.max() > 0.1
    np.testing.assert_allclose(guides.projected, raw, rtol=0, atol=1e-5 * raw.max())


def test_lens_grids_do_not_denoise_the_light_of_projectors():
    rig = Rig([TINY], [np.eye(4)], projectors=[Projector(SIDE, LENS, "white", 5.0)])
    lenses = [tl.Pinhole(), tl.ThinLens(0.05, 1.0)]
    raw, denoised = (
        tl.render_lens_grid(
            scene_of(wall(2.0), depth=2),
            rig,
            lenses,
            spp=4,
            sampler="multijitter",
            denoise=denoise,
        )
        for denoise in (False, True)
    )
    np.testing.assert_array_equal(denoised[1], raw[1])


def test_denoised_images_without_reflections_have_no_light_of_a_projector():
    scene = scene_of(wall(2.0), depth=1)
    rig = Rig([TINY], [np.eye(4)], projectors=[Projector(SIDE, LENS, "white", 5.0)])
    for denoise in (False, True):
        assert not tl.render(scene, rig, spp=4, denoise=denoise)[0].any()
