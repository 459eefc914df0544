from dataclasses import replace

import numpy as np
import pytest
import trimesh

import twinlens as tl
from twinlens.dataset import Sample, Shot
from twinlens.factory.gates import (
    WINDOW,
    Gates,
    Rejected,
    check_photographs,
    check_truth,
    grey,
    textured_windows,
)
from twinlens.factory.produce import NoiseWarning, warn_of_noise
from twinlens.rendering import ground_truth
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.sensor import Sensor

GATES = Gates()
SIZE = (96, 64)


def scene(*objects):
    grey = {"type": "diffuse", "reflectance": 0.5}
    lights = {"sky": {"type": "constant", "radiance": 1.0}}
    return Scene("made", objects, {"grey": grey}, np.eye(4), (0.5, 10.0), lights=lights)


def box(name, size, z):
    pose = np.diag([size / 2, size / 2, size / 2, 1.0])
    pose[2, 3] = z
    return SceneObject(name, {"type": "cube"}, "grey", pose)


def wall(z=4.0):
    pose = np.diag([9.0, 9.0, 1.0, 1.0])
    pose[2, 3] = z
    return SceneObject("wall", {"type": "rectangle"}, "grey", pose)


def truth_of(made, baseline=0.1):
    rig = tl.Rig.stereo(tl.Camera.from_fov(*SIZE, 60), baseline)
    return rig, ground_truth(made, rig)


WALL_RIG, WALL_TRUTHS = truth_of(scene(wall()))


def photographed(left, right, **record):
    """A sample of the wall with these images."""
    images = tuple(np.uint8(255 * np.clip(image, 0, 1)) for image in (left, right))
    shot = Shot(tl.Pinhole(), images, record=record)
    return Sample(WALL_RIG, (shot,), tuple(WALL_TRUTHS))


PAINT = np.random.default_rng(0).uniform(0.1, 0.9, (*SIZE[::-1], 3))


def test_a_camera_in_a_box_is_refused_and_one_before_it_is_not():
    # The left camera is in the crate, the right one alone in the lamp, a mesh.
    lamp = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    lamp.apply_translation([0.1, 0, 0])
    mesh = Mesh(lamp.vertices, lamp.faces.astype(np.uint32))
    for body, place in (
        (box("crate", 2.0, 0.0), "camera 0 in 'crate'"),
        (SceneObject("lamp", mesh, "grey"), "camera 1 in 'lamp'"),
    ):
        rig, truths = truth_of(made := scene(body, wall()))
        with pytest.raises(Rejected, match=f"camera inside an object: {place}"):
            check_truth(Gates(visible=0.0), made, rig, truths, None)
        check_truth(Gates(visible=0.0, inside=False), made, rig, truths, None)
    rig, truths = truth_of(made := scene(box("crate", 2.0, 4.0), wall(6.0)))
    check_truth(GATES, made, rig, truths, None)


def test_a_furnished_room_is_no_object_to_be_inside_of():
    rig, truths = truth_of(
        made := scene(box("walls", 12.0, 0.0), box("chair", 1.0, 3.0))
    )
    check_truth(GATES, made, rig, truths, None)


def test_disparity_is_held_to_ndisp_exactly():
    rig, truths = truth_of(made := scene(wall(4.0)))
    disparity = float(truths[0].disparity.max())  # fx B / z, the same at every pixel
    check_truth(GATES, made, rig, truths, ndisp=int(np.ceil(disparity)) + 1)
    with pytest.raises(Rejected, match="disparity beyond ndisp") as caught:
        check_truth(GATES, made, rig, truths, ndisp=int(np.floor(disparity)))
    assert "rig.baseline" in caught.value.remedy


def test_views_that_share_too_little_are_refused():
    rig, truths = truth_of(made := scene(wall(1.0)), baseline=1.1)
    assert truths[0].visible.mean() < 0.2
    with pytest.raises(Rejected, match="too little visible in both views"):
        check_truth(GATES, made, rig, truths, None)


@pytest.mark.parametrize(
    ("level", "reason"), [(0.0, "black image"), (1.0, "burnt image")]
)
def test_black_and_burnt_pictures_are_refused_in_either_eye(level, reason):
    bad = np.full_like(PAINT, level)
    gates = Gates(texture=0.0)
    check_photographs(gates, photographed(PAINT, PAINT), Sensor())
    for pair, where in (((bad, PAINT), "view 0"), ((PAINT, bad), "view 1")):
        with pytest.raises(Rejected, match=f"{reason}: 100.0% of {where}"):
            check_photographs(gates, photographed(*pair), Sensor())


def test_raw_pictures_are_black_at_their_black_level():
    sensor = Sensor(output="raw", adc_bits=12, black_level=400.0)
    raw = np.full((*SIZE[::-1], 3), 405, np.uint16)
    shot = Shot(tl.Pinhole(), (raw, raw))
    sample = replace(photographed(PAINT, PAINT), shots=(shot,))
    with pytest.raises(Rejected, match="black image"):
        check_photographs(GATES, sample, sensor)


def test_renderer_noise_has_a_limit_in_every_view():
    sample = photographed(PAINT, PAINT, light_paths_over_sensor=[0.2, 0.6])
    check_photographs(Gates(texture=0.0, noise=0.6), sample, Sensor())
    check_photographs(Gates(texture=0.0), sample, Sensor())
    with pytest.raises(
        Rejected,
        match=r"too much renderer noise: 0\.6 x sensor noise in the images of lens 0",
    ):
        check_photographs(Gates(texture=0.0, noise=0.5), sample, Sensor())


def test_a_limit_of_the_noise_that_is_not_met_is_said():
    sample = photographed(PAINT, PAINT, light_paths_over_sensor=[0.2, 0.6], spp=768)
    warn_of_noise(replace(sample, record={"noise": None}), 7)
    warn_of_noise(replace(sample, record={"noise": 0.6}), 7)
    text = r"sample 7: renderer noise 0\.6 x .* 768 samples per pixel, limit 0\.5"
    with pytest.warns(NoiseWarning, match=text):
        warn_of_noise(replace(sample, record={"noise": 0.5}), 7)


@pytest.mark.parametrize("noise", [0.03, 0.1, 0.2])
def test_noise_is_no_texture_and_paint_is(noise):
    """The wall is at one depth, so the right image is the left one shifted by the disparity."""
    rng = np.random.default_rng(3)
    shape = SIZE[::-1]

    def noisy(picture):
        return np.repeat((picture + rng.normal(0, noise, shape))[..., None], 3, axis=2)

    flat = np.full(shape, 0.5)
    with pytest.raises(Rejected, match="too little texture"):
        check_photographs(GATES, photographed(noisy(flat), noisy(flat)), Sensor())
    disparity = round(float(WALL_TRUTHS[0].disparity.max()))
    paint = 0.5 + 0.1 * rng.standard_normal((shape[0], shape[1] + disparity))
    left, right = paint[:, :-disparity], paint[:, disparity:]
    check_photographs(GATES, photographed(noisy(left), noisy(right)), Sensor())


@pytest.mark.parametrize("noise", [0.03, 0.1, 0.2])
def test_texture_is_told_from_noise_where_it_is_about_half_of_it(noise):
    """The correlation of texture t in noise s is t^2 / (t^2 + s^2); that of mere noise strays by 1/16 in a window."""
    rng = np.random.default_rng(7)
    shape = (40 * WINDOW, 40 * WINDOW)
    texture = rng.normal(0, 1, shape)

    def share(part):
        left, right = (
            0.5 + part * noise * texture + rng.normal(0, noise, shape) for _ in range(2)
        )
        return textured_windows(left, right, np.ones(shape, bool))

    assert share(0.0) < 0.01
    assert share(0.25) < 0.05
    assert 0.4 < share(0.5) < 0.8  # correlation 1/5, slightly above the threshold
    assert share(0.7) > 0.95  # correlation 1/3, threshold 3/16, standard deviation 0.05
    assert textured_windows(texture, texture, np.ones(shape, bool)) == 1.0


@pytest.mark.parametrize("shift", [4, 5])
def test_the_colours_of_a_raw_mosaic_are_no_texture(shift):
    """A flat red wall is a 2x2 pattern in both mosaics, and the patterns coincide at even disparities."""
    sensor = Sensor(filters="RGGB", output="raw")
    red = np.zeros((4 * WINDOW, 4 * WINDOW + shift))
    red[::2, ::2] = 3000
    left, right = (
        grey(picture.astype(np.uint16), sensor)
        for picture in (red[:, shift:], red[:, :-shift])
    )
    assert textured_windows(left, right, np.ones(left.shape, bool)) == 0.0


def test_windows_count_by_their_covariance():
    rng = np.random.default_rng(1)
    a = rng.normal(0.5, 0.1, (4 * WINDOW, 6 * WINDOW)).astype(np.float32)
    mask = np.ones(a.shape, bool)
    half = a.copy()
    half[:, : 3 * WINDOW] = 0.5
    assert textured_windows(a, a, mask) == 1.0
    assert textured_windows(a, half, mask) == 0.5
    assert textured_windows(a, 1 - a, mask) == 0.0
    mask[:, : 3 * WINDOW] = False
    assert textured_windows(a, half, mask) == 1.0
    assert textured_windows(a, half, np.zeros_like(mask)) == 1.0
    assert textured_windows(a[:5, :5], a[:5, :5], mask[:5, :5]) == 1.0
