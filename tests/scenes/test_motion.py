"""Motions of a scene: as scene files and Python declare them, still scenes at a time, and what cannot move."""

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.geometry.motion import Keyframe, Motion, Turn
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.placement import rotation, translation

PLACED = "objects.ball.translate = [1, 2, 3]"
LAMP = """
[lights.lamp]
type = "point"
position = [0, 1, 2]
intensity = 3.0
[lights.beam]
type = "spot"
translate = [1, 0, 0]
intensity = 3.0
"""
COPIES = """
[objects.nuts]
shape = "sphere"
material = "grey"
translate = [0, 0, 1]
instances = [{ translate = [0, 0, 0] }, { translate = [4, 0, 0] }]
"""
MERGED = """
[objects.nuts]
shape = "box"
extents = 1
material = "grey"
merge = true
instances = [{ translate = [0, 0, 0] }, { translate = [4, 0, 0] }]
"""


def pose_of(scene, name="ball"):
    return next(item for item in scene.objects if item.name == name).world_from_object


def test_velocities_of_a_file(read_scene):
    scene = read_scene(
        f"{PLACED}\n[[motion]]\nobject = 'ball'\nvelocity = [0.5, 0, 0]\nangular_velocity_deg = [0, 0, 90]\n"
    )
    expected = Motion(
        object="ball", velocity=(0.5, 0, 0), angular_velocity_deg=(0, 0, 90)
    )
    assert scene.motion == (expected,)
    still = scene.at(2.0)
    np.testing.assert_allclose(
        pose_of(still), translation([2, 2, 3]) @ rotation([0, 0, 1], 180), atol=1e-14
    )
    assert still.motion == ()
    assert still.at(7.0) is still
    assert np.array_equal(pose_of(scene), translation([1, 2, 3]))


def test_keyframes_of_a_file(read_scene):
    scene = read_scene(
        f"{PLACED}\n[[motion]]\nobject = 'ball'\n"
        "keyframes = [{ time = 0 }, { time = 1, translate = [0, 0, 2], rotate = { axis = [0, 1, 0], deg = 90 } }]\n"
    )
    end = Keyframe(1.0, (0, 0, 2), Turn((0, 1, 0), 90))
    assert scene.motion == (Motion(object="ball", keyframes=(Keyframe(0.0), end)),)
    expected = translation([1, 2, 4]) @ rotation([0, 1, 0], 45)
    np.testing.assert_allclose(pose_of(scene.at(0.5)), expected, atol=1e-14)


def test_a_trajectory_beside_the_file(read_scene, tmp_path):
    (tmp_path / "path.tum").write_text("0 0 0 0 0 0 0 1\n2 4 0 0 0 0 1 0\n")
    scene = read_scene(f"{PLACED}\n[[motion]]\nobject='ball'\ntrajectory='path.tum'\n")
    assert tmp_path / "path.tum" in scene.files
    quarter = translation([2, 0, 0]) @ rotation([0, 0, 1], 90)
    expected = quarter @ translation([1, 2, 3])
    np.testing.assert_allclose(pose_of(scene.at(1.0)), expected, atol=1e-14)


def test_lights_move(read_scene):
    scene = read_scene(LAMP).moving(
        Motion(light="lamp", velocity=(1, 0, 0)),
        Motion(light="beam", velocity=(0, 0, 1), angular_velocity_deg=(0, 90, 0)),
    )
    lights = scene.at(2.0).lights
    assert lights["lamp"]["position"] == [2, 1, 2]
    expected = translation([1, 0, 2]) @ rotation([0, 1, 0], 180)
    np.testing.assert_allclose(lights["beam"]["to_world"], expected, atol=1e-14)
    assert lights["sky"] is scene.lights["sky"]


def test_copies_turn_about_their_own_origins(read_scene):
    """All of them, or one."""
    scene = read_scene(COPIES)
    spin = {"angular_velocity_deg": (0, 0, 90)}
    for name, turned in (("nuts", (True, True)), ("nuts[1]", (False, True))):
        moved = scene.moving(Motion(object=name, **spin)).at(1.0).objects[-1]
        places = ([0, 0, 1], [4, 0, 1])
        for instance, place, turns in zip(moved.instances, places, turned, strict=True):
            expected = translation(place) @ rotation([0, 0, 1], 90.0 if turns else 0.0)
            got = instance @ moved.world_from_object
            np.testing.assert_allclose(got, expected, atol=1e-14)


def test_a_pose_is_a_view_and_a_number_a_time(read_scene):
    scene = read_scene().moving(Motion(object="ball", velocity=(1, 0, 0)))
    turned = scene.at(translation([0, 0, 5]))
    assert turned.world_from_left[2, 3] == 5
    assert turned.motion == scene.motion
    for time in (1, np.float64(1.0)):
        assert pose_of(scene.at(time))[0, 3] == 1
    for time in (np.nan, "1", None, True):
        with pytest.raises(InputError, match="a time must be a finite number of sec"):
            scene.at(time)


VELOCITY = "velocity = [1, 0, 0]"
REFUSED = {
    f"[[motion]]\nobject='bal'\n{VELOCITY}": "motion[0]: unknown object 'bal'; did you mean 'ball'?",
    f"[[motion]]\nlight='sku'\n{VELOCITY}": "motion[0]: unknown light 'sku'; did you mean 'sky'?",
    f"[[motion]]\nlight='sky'\n{VELOCITY}": "motion[0]: light 'sky' is 'constant', at infinity: only point and spot",
    f"[[motion]]\n{VELOCITY}": "motion[0]: names nothing that moves",
    f"{MERGED}[[motion]]\nobject='nuts'\n{VELOCITY}": "motion[0]: object 'nuts' is a merged mesh",
    f"{COPIES}[[motion]]\nobject='nuts[2]'\n{VELOCITY}": "unknown copy 'nuts[2]': object 'nuts' has 2 copies, counted",
    f"[[motion]]\nobject='ball[0]'\n{VELOCITY}": "unknown copy 'ball[0]': object 'ball' has 0 copies",
    f"[[motion]]\nobject='ball'\n{VELOCITY}\n" * 2: "motion[1]: object 'ball' has a motion already",
    f"{COPIES}[[motion]]\nobject='nuts[0]'\n{VELOCITY}\n[[motion]]\nobject='nuts'\n{VELOCITY}":
        "motion[1]: object 'nuts' has a motion already",
    f"{COPIES}[[motion]]\nobject='nuts'\n{VELOCITY}\n[[motion]]\nobject='nuts[1]'\n{VELOCITY}":
        "motion[1]: object 'nuts[1]' has a motion already",
    "[[motion]]\nobject='ball'": "motion[0]: a motion needs velocity",
    "[[motion]]\nobject='ball'\nvelocity=[nan, 0, 0]": "motion[0].velocity: must be three numbers of metres per second",
    "[[motion]]\nobject='ball'\nvelocty=[1, 0, 0]": "motion[0]: unknown key 'velocty'; did you mean 'velocity'?",
    "[[motion]]\nobject='ball'\nkeyframes=[{time=1}, {time=1}]":
        "motion[0]: keyframes: times must rise: the time 1 (from 0), 1 s, repeats the one before, 1 s",
    "[[motion]]\nobject='ball'\nkeyframes=[{time=1}, {time=0.5}]": "0.5 s, is before the one before, 1 s",
    "[[motion]]\nobject='ball'\nkeyframes=[{time=1}, {tim=2}]": "motion[0].keyframes[1]: unknown key 'tim'",
    "[[motion]]\nobject='ball'\nkeyframes=[{time=1}, {time=2, rotate={axis=[0,0,0], deg=3}}]":
        "motion[0].keyframes[1].rotate: rotation axis must not be zero",
    "[[motion]]\nobject='ball'\ntrajectory='none.tum'": "motion[0].trajectory: ",
    "[[motion]]\nobject='ball'\ntrajectory='../path.tum'": "motion[0].trajectory: '../path.tum' leads outside",
    "[[motion]]\nobject='ball'\ntrajectory='long.tum'": "must have the length 1, its length deviates by +1",
    "[motion]\nobject='ball'\nvelocity=[1, 0, 0]": "motion: must be a list",
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_a_mistake_is_named_in_one_line(read_scene, tmp_path, text):
    (tmp_path / "long.tum").write_text("0 0 0 0 0 0 0 1\n2 4 0 0 0 0 0 2\n")
    with pytest.raises(InputError) as caught:
        read_scene(text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'scene.toml'}: ")
    assert REFUSED[text] in message
    assert "\n" not in message


def test_motions_in_python_are_motions_of_what_is_there(read_scene, tmp_path):
    scene = read_scene()
    with pytest.raises(InputError, match=r"motion\[0\]: must be a Motion, got 'ball'"):
        scene.moving("ball")
    with pytest.raises(InputError, match=r"motion\[0\]: unknown object 'box'"):
        scene.moving(Motion(object="box", velocity=(1, 0, 0)))
    ball = SceneObject("ball", {"type": "sphere"}, "grey")
    moving = Scene(
        "made",
        (ball,),
        {"grey": {"type": "diffuse"}},
        np.eye(4),
        (1.0, 9.0),
        motion=[Motion(object="ball", velocity=(1, 0, 0))],
    )
    assert pose_of(moving.at(3.0))[0, 3] == 3
    with pytest.raises(InputError, match="objects of a Mitsuba file cannot move"):
        Scene(
            "file",
            (),
            {},
            np.eye(4),
            (1.0, 9.0),
            xml=tmp_path / "scene.xml",
            motion=moving.motion,
        )
