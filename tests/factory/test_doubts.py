"""A sample of which nothing can be used is said to be so, with the likely cause; all others are not."""

import warnings

import pytest

import twinlens as tl
from twinlens.factory import Shoot, make_sample
from twinlens.factory.doubts import (
    ResultWarning,
    misplaced,
    warn_of_doubts,
    warn_of_wide_view,
)
from twinlens.sensor import Exposure, Sensor

SCENE = """
[camera]
position = [0, -3, 1]
look_at = [0, 0, 0.5]
depth_range = [1.0, 9.0]
[materials.m]
type = "diffuse"
[objects.ball]
shape = "sphere"
radius = 0.4
translate = [0, {y}, 1]
material = "m"
"""
SKY = "[lights.sky]\ntype = 'constant'\n"
INSIDE = "[lights.lamp]\ntype = 'point'\nposition = [0, 0, 1]\nintensity = 1\n"


@pytest.mark.parametrize("output", ["srgb", "raw"])
@pytest.mark.parametrize(
    ("y", "light", "seconds", "says"),
    [
        (0, SKY, None, None),
        (-8, SKY, None, "views 0 and 1 show no surface, .*turned away from the scene"),
        (0, INSIDE, None, "views 0 and 1 show no light at all: is there a light"),
        (0, SKY, 1e-20, "views 0 and 1 show nothing but black: is there a light"),
        (0, SKY, 1e3, "views 0 and 1 show nothing but clipped pixels: .* too long"),
    ],
)
def test_a_result_that_cannot_be_meant_is_said(
    tmp_path, y, light, seconds, says, output
):
    (tmp_path / "scene.toml").write_text(SCENE.format(y=y) + light)
    scene = tl.load_scene(tmp_path / "scene.toml")
    camera = tl.Camera.from_fov(16, 12, fov_x_deg=40)
    rig = tl.Rig.stereo(camera, 0.05, world_from_left=scene.world_from_left)
    exposure = None if seconds is None else Exposure(time=seconds)
    sensor = Sensor.preset("phone", output=output)
    shoot = Shoot(spp=1, denoise=False, exposure=exposure, sensor=sensor)
    sample = make_sample(scene, rig, [tl.Pinhole()], shoot)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if says is None:
            warn_of_doubts(sample, sensor, "ball")
            return
        with pytest.raises(ResultWarning, match=f"ball: {says}"):
            warn_of_doubts(sample, sensor, "ball")


@pytest.mark.parametrize(
    ("degrees", "warns"),
    [(40, False), (65, False), (65.1, True), (95, True), (140, True)],
)
def test_a_view_wider_than_scenes_of_families_are_made_for_is_said(degrees, warns):
    camera = tl.Camera.from_fov(640, 480, fov_x_deg=degrees)
    rig = tl.Rig.stereo(camera, 0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if not warns:
            warn_of_wide_view(rig, "room")
            return
        with pytest.raises(
            ResultWarning, match=rf"room: the view is {degrees:g} degrees.*rig\.fov_x"
        ):
            warn_of_wide_view(rig, "room")


POST = """
[objects.post]
shape = "cube"
scale = 0.1
translate = {place}
material = "m"
"""
LAMP = "emitter = { radiance = [3, 3, 3] }\n"


@pytest.mark.parametrize(
    ("post", "says"),
    [
        # Half of the view is 0.65 m wide and 0.49 m high at the place of the ball.
        (POST.format(place=[0.3, 0, 1]), None),
        (POST.format(place=[0, 2, 1]), None),  # hidden by the ball
        (POST.format(place=[0, -6, 1]), "'post' 3 m away, behind view 0"),
        (POST.format(place=[9, 0, 1]), "right of view 0"),
        (POST.format(place=[-9, 0, 1]), "left of view 0"),
        (POST.format(place=[0, 0, 5]), "above view 0"),
        # Millimetres taken for metres.
        (POST.format(place=[300, 0, 1000]), "1.04e\\+03 m away, above"),
        (POST.format(place=[0, 0, 5]) + LAMP, None),
        # The wall behind the camera.
        (POST.format(place=[0, -6, 1]).replace("0.1", "[4, 0.1, 4]"), None),
        (
            POST.format(place=[9, 0, 1]) + "[[objects.post.instances]]\n"
            "translate = [-9, 0, 0]\n[[objects.post.instances]]\n",
            None,
        ),
    ],
)
def test_an_object_outside_of_every_view_is_said(tmp_path, post, says):
    text = SCENE.format(y=0).replace("[0, 0, 0.5]", "[0, 0, 1]") + SKY + post
    (tmp_path / "scene.toml").write_text(text)
    scene = tl.load_scene(tmp_path / "scene.toml")
    camera = tl.Camera.from_fov(16, 12, fov_x_deg=25)
    rig = tl.Rig.stereo(camera, 0.05, world_from_left=scene.world_from_left)
    sample = make_sample(scene, rig, [tl.Pinhole()], Shoot(spp=1, denoise=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if says is None:
            warn_of_doubts(sample, Sensor(), "ball", scene)
            return
        with pytest.raises(ResultWarning, match=f"outside of every view: .*{says}"):
            warn_of_doubts(sample, Sensor(), "ball", scene)


@pytest.mark.slow
def test_bundled_scenes_have_no_object_outside_of_every_view():
    for name in tl.bundled_scenes():
        scene = tl.load_scene(name)
        rig = tl.Rig.stereo(
            tl.Camera.from_fov(32, 24, scene.fov_x_deg),
            scene.baseline,
            world_from_left=scene.world_from_left,
        )
        truths = tl.ground_truth(scene, rig)
        assert misplaced(scene, rig, truths) == [], name
