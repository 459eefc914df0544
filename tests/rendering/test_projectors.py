"""The light of projectors in images, against closed forms, and decoded codes against the truth of projection."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.ndimage import minimum_filter
from scipy.spatial.transform import Rotation

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
from twinlens.rendering import ProjectorWarning, samplers
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build
from twinlens.rendering.paths import Paths
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import Bitmap, Color, Scene, SceneObject

Projector = partial(tl.Projector, band="rgb")
ALBEDO = 0.5
DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}}
GREY = {"type": "twosided", "bsdf": DIFFUSE}
LENS = Camera(64, 48, 80.0, 70.0, 20.0, 30.0)
CHECKER = patterns.checker(64, 48, 8)
CAMERA = Camera.from_fov(96, 72, 40)
TINY = Camera.from_fov(16, 12, 40)
TURN = Rotation.from_euler("xyz", [3, -6, 10], degrees=True).as_matrix()
SIDE = geometry.rigid(TURN, [0.15, 0.02, -0.01])


def scene_of(*objects, depth=2, **lights):
    path = {"type": "path", "max_depth": depth}
    return Scene("test", objects, {"grey": GREY}, np.eye(4), (0.1, 10.0), lights, path)


def wall(z, turn_deg=0.0):
    turn = Rotation.from_euler("y", 180 + turn_deg, degrees=True).as_matrix()
    pose = geometry.rigid(turn, [0, 0, z]) @ np.diag([9, 9, 1, 1])
    return SceneObject("wall", {"type": "rectangle"}, "grey", pose)


def ball(centre, radius):
    shape = {"type": "sphere", "center": list(centre), "radius": radius}
    return SceneObject("ball", shape, "grey")


def rig_of(*projectors, camera=CAMERA):
    return Rig([camera], [np.eye(4)], projectors=projectors)


def dots(**options):
    """A projector of sparse dots."""
    shown = patterns.dots(128, 96, 0.1, seed=3)
    lens = Camera.from_fov(128, 96, 50)
    focus = {"focus_distance": 2.0}
    return Projector(SIDE, lens, shown, 20.0, **focus, **options)


def irradiance(scene, rig, spp=16):
    """Of a surface of `GREY`."""
    green = tl.render(scene, rig, spp=spp, seed=1)[0][..., 1]
    return green.astype(np.float64) * np.pi / ALBEDO


def on_wall(z, turn_deg, lens, pixels):
    """Where the rays of a projector at `SIDE` meet `wall(z, turn_deg)`, relative to the projector."""
    normal = geometry.rotate(wall(z, turn_deg).world_from_object, [0.0, 0.0, 1.0])
    rays = geometry.rotate(SIDE, lens.unproject(pixels))
    t = ((np.array([0, 0, z]) - SIDE[:3, 3]) @ normal) / (rays @ normal)
    return t[:, None] * rays


@pytest.mark.parametrize("distortion", [None, BrownConrady(-0.2, 0.05, 1e-3, -1e-3)])
def test_irradiance_is_the_flux_of_a_pixel_over_its_area_on_the_wall(distortion):
    """The area is that between the rays through the pixel's corners, so this includes 1/z^2, cosine and distortion."""
    lens = LENS.replace(distortion=distortion)
    rig = rig_of(Projector(SIDE, lens, power=3.0))
    for z, turn in ((1.0, 0.0), (2.0, 0.0), (1.5, 40.0)):
        scene = scene_of(wall(z, turn))
        pixels = tl.projection(scene, rig).pixels
        u, v = np.moveaxis(pixels, -1, 0)
        inner = (u > 2) & (u < 61) & (v > 2) & (v < 45)
        offsets = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
        corners = [on_wall(z, turn, lens, pixels[inner] + by) for by in offsets]
        diagonals = np.cross(corners[2] - corners[0], corners[3] - corners[1])
        area = 0.5 * np.linalg.norm(diagonals, axis=1)
        expected = 3.0 / 3 / (64 * 48) / area
        measured = irradiance(scene, rig)
        assert inner.sum() > 2000
        assert np.abs(measured[inner] / expected - 1).max() < 0.01
        assert measured[(u < -2) | (v < -2)].max() == 0


@pytest.mark.parametrize(
    ("z", "focus"), [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0), (1.5, np.inf)]
)
def test_a_point_of_the_pattern_is_a_disk_away_from_the_focus(z, focus):
    """Of diameter A |1 - z/f|, from the variance D^2/16 along an axis, on a wall at right angles; its flux stays."""
    lens = Camera.from_fov(32, 24, 40)
    point = np.zeros((24, 32))
    point[12, 16] = 1
    aperture = {"aperture_diameter": 0.1, "focus_distance": focus}
    rig = rig_of(Projector(None, lens, point, 20.0, **aperture))
    light = irradiance(scene_of(wall(z)), rig, 256)
    area = (z / CAMERA.fx) ** 2  # of a camera's pixel on the wall
    assert light.sum() * area == pytest.approx(20 / 3 / (32 * 24), rel=0.01)
    x = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx * z
    share = light.sum(axis=0) / light.sum()
    tent = (z / lens.fx) ** 2 / 6
    pixel = area / 12
    variance = share @ x**2 - (share @ x) ** 2 - tent - pixel
    expected = (0.1 * (1 - z / focus)) ** 2
    assert 16 * variance == pytest.approx(expected, rel=0.02, abs=1e-6)


def shoot(scene, rig, shown, spp):
    """An image under each pattern."""
    projector = rig.projectors[0]
    images = []
    for seed, pattern in enumerate(shown):
        lit = rig.with_projectors([projector.with_pattern(pattern)])
        images.append(tl.render(scene, lit, spp=spp, seed=seed)[0])
    return images


def structured_light(**lights):
    """A scene and a rig with a projector, its true pixels (H, W, 2), and which of them are lit and away from edges."""
    rig = rig_of(Projector(SIDE, LENS, power=20.0))
    scene = scene_of(wall(1.6, 15.0), ball([-0.1, 0.05, 1.2], 0.15), depth=3, **lights)
    truth = tl.projection(scene, rig)
    ids = tl.ground_truth(scene, rig, objects=False)[0].object_id
    inside = LENS.contains(truth.pixels + 1) & LENS.contains(truth.pixels - 1)
    is_one_object = minimum_filter(ids, 5) == -minimum_filter(-ids, 5)
    away = minimum_filter(truth.lit & inside, 5) & is_one_object
    assert away.mean() > 0.5
    return scene, rig, truth, away


def test_opencv_has_the_same_gray_code():
    cv2 = pytest.importorskip("cv2")
    if not hasattr(cv2, "structured_light"):
        pytest.skip("structured_light is in opencv-contrib-python-headless")
    peer = cv2.structured_light.GrayCodePattern.create(64, 48)
    shown = [pattern for axis in "uv" for pattern in GrayCode(64, 48, axis).patterns]
    for theirs, ours in zip(peer.generate()[1], shown, strict=True):
        np.testing.assert_array_equal(theirs > 0, ours > 0)


def test_decoded_gray_code_and_phase_shift_equal_the_truth():
    """To a twentieth of a pixel of the projector: its pattern is where the projection says."""
    lamp = {"type": "constant", "radiance": 0.5}
    scene, rig, truth, away = structured_light(lamp=lamp)
    column = truth.pixels[..., 0]
    code = GrayCode(64, 48)
    fine = PhaseShift(64, 48, 16.0, 4)
    coarse = decode(shoot(scene, rig, code.patterns, 64), code)
    errors = np.abs(coarse.position - column)[away]
    assert (errors <= 0.5).mean() >= 0.99
    assert np.median(errors) < 0.05
    scene = structured_light()[0]
    images = shoot(scene, rig, fine.patterns, 128)
    exact = decode(images, fine, coarse=coarse.position)
    assert np.quantile(np.abs(exact.position - column)[away], 0.99) < 0.05


def test_shadow_of_a_ball_and_the_far_side_of_a_sheet_are_not_lit():
    sheet_pose = geometry.rigid(np.eye(3), [0, 0, 1.0])
    sheet = SceneObject("sheet", {"type": "rectangle"}, "grey", sheet_pose)
    behind = geometry.look_at([0, 0, 2], [0, 0, 1], (0, 1, 0))
    assert not tl.projection(scene_of(sheet), rig_of(Projector(behind, LENS))).lit.any()
    rig = rig_of(Projector(SIDE, LENS))
    scene = scene_of(wall(1.6), ball([-0.05, 0.0, 1.0], 0.1))
    truth = tl.projection(scene, rig)
    image = irradiance(scene, rig)
    lit = truth.lit
    # The bilinear filter falls to 0 at the rim of the pattern.
    ends = np.array([[-0.5, -0.5], [63.5, 47.5]])
    rim = (np.abs(truth.pixels[:, :, None] - ends) < 1).any(axis=(2, 3))
    sure = (minimum_filter(lit, 3) | minimum_filter(~lit, 3)) & ~rim
    assert 50 < (~lit & sure).sum() < lit.size / 2
    assert ((image > 0) == lit)[sure].mean() > 0.995


def test_a_projector_lights_a_dark_scene_and_only_its_rig():
    dark = scene_of(wall(1.5))
    point = {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": 1.0}
    lamp = scene_of(wall(1.5), lamp=point)
    rig = rig_of()
    with pytest.raises(InputError, match="has no light"):
        tl.render(dark, rig, spp=1)
    before = tl.render(lamp, rig, spp=2)[0]
    lit = rig.with_projectors([Projector(SIDE, LENS)])
    with_both, only_projector, only_lamp = (
        tl.render(scene, seen, spp=256)[0].mean()
        for scene, seen in ((lamp, lit), (dark, lit), (lamp, rig))
    )
    assert with_both == pytest.approx(only_projector + only_lamp, rel=0.02)
    assert (tl.render(lamp, rig, spp=2)[0] == before).all()


PANORAMA = Bitmap(np.linspace(0, 1, 96, dtype=np.float32).reshape(4, 8, 3))
SURROUNDINGS = {
    "constant": {"radiance": Color((1.0, 0.5, 0.2))},
    "envmap": {"bitmap": PANORAMA},
    "sunsky": {"sun_direction": [0.2, -0.5, -1.0]},
}
SLOW_SURROUNDINGS = [
    pytest.param(kind, marks=pytest.mark.slow) for kind in ("envmap", "sunsky")
]


@pytest.mark.parametrize("kind", ["constant", *SLOW_SURROUNDINGS])
def test_ambient_scales_every_light_of_a_scene(kind):
    pose = geometry.rigid(np.diag([1.0, -1.0, -1.0]), [0.5, 0, 0.8])
    pose[:3, :2] *= 0.1
    shining = Bitmap(np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3))
    emitter = {"type": "area", "radiance": shining}
    lamp = SceneObject("lamp", {"type": "rectangle"}, "grey", pose, emitter)
    up = {"to_world": np.eye(4)}
    blue = Color((1.0, 2.0, 3.0))
    lights = {
        "point": {"type": "point", "position": [0.0, 0.5, 0.0], "intensity": 2.0},
        "spot": {"type": "spot", **up, "intensity": blue},
        "sun": {"type": "directional", "direction": [0.0, 0.1, 1.0], "irradiance": 1.0},
        "around": {"type": kind, **SURROUNDINGS[kind]},
    }
    scene = scene_of(wall(1.5), lamp, **lights)
    rig = rig_of(camera=TINY)
    whole, dimmed = (
        tl.render(scene.with_ambient(ambient), rig, spp=4)[0] for ambient in (1, 0.25)
    )
    assert whole.max() > 0
    assert np.allclose(dimmed, whole / 4, rtol=1e-5)
    dark = scene.with_ambient(0)
    with pytest.raises(InputError, match="has no light"):
        tl.render(dark, rig)
    lit = rig.with_projectors([Projector(SIDE, LENS)])
    unlit = scene_of(wall(1.5), replace(lamp, emitter=None))
    of_dark, of_unlit = (
        tl.render(without_light, lit, spp=256)[0].mean()
        for without_light in (dark, unlit)
    )
    assert of_dark == pytest.approx(of_unlit, rel=0.05)


def test_threads_do_not_change_each_others_projectors(monkeypatch):
    """Between two passes of one render, another thread renders the same scene with another pattern and pose."""
    monkeypatch.setattr(samplers, "RAYS_PER_PASS", TINY.width * TINY.height)
    moved = SIDE @ geometry.rigid(np.eye(3), [0.1, 0, 0])
    ours = rig_of(Projector(SIDE, LENS), camera=TINY)
    theirs = rig_of(Projector(moved, LENS, CHECKER, 3.0), camera=TINY)
    scene = scene_of(wall(1.5))
    undisturbed, of_theirs = (tl.render(scene, rig, spp=2)[0] for rig in (ours, theirs))
    in_between = []
    with ThreadPoolExecutor(1) as thread:

        def render_theirs(fraction):
            image = thread.submit(tl.render, scene, theirs, spp=2).result()[0]
            in_between.append(image)

        image = tl.render(scene, ours, spp=2, progress=render_theirs)[0]
    assert len(in_between) == 2
    assert (in_between[0] == of_theirs).all()
    assert (image == undisturbed).all()
    assert (image != of_theirs).any()


@pytest.mark.parametrize(
    "name", ["spheres", pytest.param("room", marks=pytest.mark.slow)]
)
def test_paths_are_those_of_mitsuba_where_there_is_no_projector(name):
    scene = tl.load_scene(name)
    built = build(scene)
    view = TINY, scene.world_from_left, tl.Pinhole(), 64, "multijitter"
    # Without Russian roulette, which ends other paths.
    ours = Paths([], max_depth=6, rr_depth=6)
    theirs = mitsuba().load_dict({"type": "path", "max_depth": 6, "rr_depth": 6})
    images = [
        np.asarray(paths.render(built.mi_scene, make_sensor(*view), seed=3, spp=64))
        for paths in (ours, theirs)
    ]
    assert images[0].mean() > 0.05
    assert np.abs(images[0] - images[1]).max() < 1e-5


GLASS = {"type": "thindielectric"}
CUT_OUT = {"type": "mask", "opacity": 0.5, "bsdf": GREY}
ROUGH = {"type": "roughdielectric", "alpha": 0.2}


@pytest.mark.parametrize(
    ("paint", "blocks"),
    [(GLASS, True), (CUT_OUT, False), (ROUGH, False), (GREY, False)],
)
def test_glass_in_front_of_a_projector_is_reported(paint, blocks):
    """Only where it is in the light: the second projector looks past the pane."""
    pane_pose = geometry.rigid(np.diag([-1.0, 1.0, -1.0]), [0.15, 0.0, 0.8])
    pane_pose[:3, :2] *= 0.1
    pane = SceneObject("pane", {"type": "rectangle"}, "paint", pane_pose)
    materials = {"grey": GREY, "paint": paint}
    objects = wall(1.5), pane
    scene = replace(scene_of(), objects=objects, materials=materials)
    past = geometry.rigid(np.eye(3), [2.0, 0.0, 0.0])
    rig = rig_of(Projector(SIDE, LENS), Projector(past, LENS), camera=TINY)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tl.render(scene, rig, spp=1)
        tl.render(scene, rig, spp=1)
    texts = [str(w.message) for w in caught if w.category is ProjectorWarning]
    assert len(texts) == blocks
    for text in texts:
        assert text.startswith("projectors[0]: the material 'paint', smooth glass")


def test_lumens_are_those_of_the_wavelengths_of_the_channels():
    """683 lm/W times Mitsuba's table of the CIE's luminous efficiency, the mean of the channels."""
    nanometres = [1e9 * wavelength for wavelength in tl.Sensor().wavelengths]
    efficiency = [np.ravel(mitsuba().cie1931_y(length))[0] for length in nanometres]
    assert pytest.approx(683.0 * np.mean(efficiency), rel=1e-3) == LUMENS_PER_WATT


@pytest.mark.parametrize(
    ("aperture", "band"),
    [pytest.param(0.0, "rgb", marks=pytest.mark.slow), (0.02, "nir")],
)
def test_denoised_images_keep_the_dots_of_a_projector(aperture, band):
    """Noise around the dots is removed; the dots themselves are those of many raw samples."""
    lamp = {"type": "sphere", "center": [-2.0, -2.0, 1.0], "radius": 0.5}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}
    shining = SceneObject("lamp", lamp, "grey", emitter=emitter)
    scene = scene_of(wall(2.0, 10), ball([0.2, 0.1, 1.5], 0.2), shining, depth=4)
    projector = dots(aperture_diameter=aperture, band=band)
    rig = rig_of(projector, camera=CAMERA.replace(band=band))
    raw, denoised = (
        tl.render(scene, rig, spp=16, seed=3, denoise=denoise)[0]
        for denoise in (False, True)
    )
    many = tl.render(scene, rig, spp=512, seed=4)[0]
    dark = tl.render(scene, rig.with_projectors([]), spp=512, seed=4)[0]
    pattern = many - dark
    deviation = pattern - pattern.mean()
    contrast = np.mean((denoised - denoised.mean()) * deviation) / pattern.var()
    assert contrast == pytest.approx(1.0, abs=0.03)

    def error(image, where):
        return np.sqrt(np.mean((image - many)[where] ** 2))

    flat = minimum_filter(pattern[..., 1] < 0.1 * pattern.max(), 3)
    everywhere = np.ones_like(flat)
    assert error(denoised, flat) < 0.5 * error(raw, flat)
    assert error(denoised, everywhere) < error(raw, everywhere)


def test_lens_grids_do_not_denoise_the_light_of_projectors():
    rig = rig_of(Projector(SIDE, LENS, "white", 5.0), camera=TINY)
    scene = scene_of(wall(2.0))
    lenses = [tl.Pinhole(), tl.ThinLens(0.05, 1.0)]
    options = {"spp": 4, "sampler": "multijitter"}
    raw, denoised = (
        tl.render_lens_grid(scene, rig, lenses, **options, denoise=denoise)
        for denoise in (False, True)
    )
    np.testing.assert_array_equal(denoised[1], raw[1])
