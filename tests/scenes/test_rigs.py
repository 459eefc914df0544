"""Rig tables: each layout equals its function, defaults come from the scene, and every mistake names its key."""

import re
import tomllib

import numpy as np
import pytest
from PIL import Image

from twinlens import geometry
from twinlens.camera import (
    ALIGNED,
    BrownConrady,
    Camera,
    KannalaBrandt,
    Misalignment,
    Projector,
    ThinLens,
    layouts,
    light_field_grid,
    light_field_rig,
    misaligned,
    patterns,
)
from twinlens.errors import InputError
from twinlens.scenes import Scene, rig_from_table
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene_file import scene_with_rig

POSE = geometry.look_at([1.0, -2.0, 1.5], [0.2, 3.0, 1.0])
SCENE = Scene("stage", (), {}, POSE, (1.0, 3.0), fov_x_deg=40.0, baseline=0.25)


def rig(text, width=64, height=48):
    return rig_from_table(tomllib.loads(text), SCENE, width, height)


def assert_same(rig, expected):
    assert rig.cameras == expected.cameras
    np.testing.assert_allclose(
        rig.world_from_cams, expected.world_from_cams, atol=1e-12
    )


def test_an_empty_table_is_the_pair_that_the_scene_was_composed_for():
    ours = rig("")
    assert ours.is_rectified()
    assert ours.baseline() == pytest.approx(0.25)
    assert np.array_equal(ours.world_from_cams[0], POSE)
    assert ours.cameras[1] == Camera.from_fov(64, 48, 40.0)


CAMERA = Camera.from_fov(64, 48, 40.0)
ASIDE = POSE @ geometry.rigid(np.eye(3), [0.15, 0, 0])
ELSEWHERE = geometry.look_at([0, 0, 1], [1, 1, 1])
PLACED = {
    'layout = "line"\ncount = 3\nspacing = 0.1': layouts.line(CAMERA, 3, 0.1, POSE),
    'layout = "line"\ncount = 2\nposition = [0, 0, 1]\nlook_at = [1, 1, 1]': layouts.line(CAMERA, 2, 0.25, ELSEWHERE),
    'layout = "vertical"': layouts.grid(CAMERA, 2, 1, 0.25, 0.25, POSE),
    'layout = "grid"\nrows = 2\ncolumns = 3\nspacing_y = 0.3': layouts.grid(CAMERA, 2, 3, 0.25, 0.3, POSE),
    'layout = "arc"\ncount = 5\nradius = 2\nangle_deg = 60': layouts.arc(CAMERA, 5, 2.0, 60.0, POSE),
    'layout = "arc"\ncount = 5\nangle_deg = 60': layouts.arc(CAMERA, 5, 1.5, 60.0, POSE),
    'layout = "toed_in"\ndistance = 2\nbaseline = 0.3': layouts.toed_in(CAMERA, 0.3, 2.0, ASIDE),
    'layout = "orbit"\ncount = 5': layouts.orbit(CAMERA, 5, 1.5, world_from_first=POSE),
    'layout = "orbit"\ncount = 5\nradius = 2\nangle_deg = 90\nelevation_deg = 30\naxis = [0, 0, 2]': layouts.orbit(
        CAMERA, 5, 2.0, 90.0, 30.0, POSE
    ),
    'layout = "hemisphere"\ncount = 9\nposition = [0, 0, 1]\nlook_at = [1, 1, 1]': layouts.hemisphere(
        CAMERA, 9, np.sqrt(2), 10.0, ELSEWHERE
    ),
    'layout = "hemisphere"\ncount = 9\nradius = 3\nelevation_deg = -20\naxis = [0, 1, 0]': layouts.hemisphere(
        CAMERA, 9, 3.0, -20.0, POSE, (0.0, 1.0, 0.0)
    ),
    'layout = "trajectory"\ncount = 4\nwaypoints = [[0, 0, 0], [1, 0, 0], [1, 0, 1]]': layouts.trajectory(
        CAMERA, 4, [[0, 0, 0], [1, 0, 0], [1, 0, 1]], None, POSE
    ),
    'layout = "trajectory"\ncount = 4\nwaypoints = [[0, 0, 0], [1, 0, 0]]\ndistance = 2': layouts.trajectory(
        CAMERA, 4, [[0, 0, 0], [1, 0, 0]], 2.0, POSE
    ),
}  # fmt: skip


@pytest.mark.parametrize("text", PLACED)
def test_each_layout_equals_its_function(text):
    assert_same(rig(text), PLACED[text])


@pytest.mark.parametrize(
    ("text", "focus"), [("focus = 2", 2.0), ("focus = inf", np.inf), ("", 1.5)]
)
def test_the_light_field_of_a_lens(text, focus):
    intrinsics = "fx = 50\nfy = 60\ncx = 30"
    made = rig(f'layout = "light_field"\nn = 3\naperture_mm = 12\n{intrinsics}\n{text}')
    camera = Camera(64, 48, 50.0, 60.0, 30.0, 23.5)
    expected = light_field_rig(camera, ThinLens(0.012, focus), 3, POSE)
    for ours, theirs in zip(made.cameras, expected.cameras, strict=True):
        values = [
            getattr(ours, name) - getattr(theirs, name)
            for name in ("fx", "fy", "cx", "cy")
        ]
        np.testing.assert_allclose(values, 0, atol=1e-12)
    np.testing.assert_allclose(
        made.world_from_cams, expected.world_from_cams, atol=1e-15
    )
    assert light_field_grid(made) == (3, pytest.approx(0.004), pytest.approx(1 / focus))


def test_cameras_have_world_or_relative_poses():
    world = geometry.look_at([0, 1, 2], [3, 3, 1])
    rows = ", ".join(str(row) for row in world.tolist())
    ours = rig(f"""
        layout = "cameras"
        cameras = [
          {{}}, {{ translate = [0.1, 0.2, -0.3], euler_deg = [0, 90, 0] }},
          {{ position = [0, 1, 2], look_at = [3, 3, 1] }}, {{ world_from_cam = [{rows}] }},
        ]""")
    assert np.array_equal(ours.world_from_cams[0], POSE)
    step = geometry.inverse(POSE) @ ours.world_from_cams[1]
    assert np.allclose(step[:3, 3], [0.1, 0.2, -0.3])
    assert np.allclose(step[:3, 2], [1, 0, 0])  # turned from z to x
    assert np.allclose(ours.world_from_cams[2], world)
    assert np.allclose(ours.world_from_cams[3], world)


def test_shared_and_individual_intrinsics():
    ours = rig("""
        fx = 70
        cx = 30.5
        distortion = { k1 = -0.1, p1 = 0.001 }
        cameras = [
          {}, { fov_x_deg = 90, width = 80, height = 60, distortion = { model = "kannala-brandt", k1 = 0.02 } }
        ]""")
    first, second = ours.cameras
    assert (first.fx, first.fy, first.cx, first.cy) == (70, 70, 30.5, 23.5)
    assert first.distortion == BrownConrady(k1=-0.1, p1=0.001)
    assert (second.width, second.height, second.cx, second.cy) == (80, 60, 39.5, 29.5)
    assert second.fx == pytest.approx(40)
    assert second.distortion == KannalaBrandt(k1=0.02)


def test_a_misalignment_moves_the_second_camera_and_keeps_the_calibrated_rig():
    ours = rig("misalignment = { vertical_px = 1.5, roll_deg = 0.2 }")
    assert_same(ours.calibrated, rig(""))
    assert_same(ours, misaligned(rig(""), (ALIGNED, Misalignment(1.5, roll_deg=0.2))))
    assert not ours.is_rectified()
    all_of_them = rig(
        'layout = "line"\ncount = 3\nmisalignment = [{ yaw_deg = 1 }, {}, { vertical_px = -2 }]'
    )
    assert all_of_them.cameras[2].cy == pytest.approx(21.5)
    turned = (
        geometry.inverse(all_of_them.calibrated.world_from_cams[0])
        @ all_of_them.world_from_cams[0]
    )
    assert turned[0, 2] == pytest.approx(np.sin(np.radians(1)))


MISTAKES = {
    'layot = "line"': "did you mean 'layout'",
    'layout = "arcs"': "did you mean 'arc'",
    'layout = "arc"\ncount = 3': "angle_deg",
    "cameras = [{}]": "2 cameras, got 1",
    "cameras = [{}, { focal = 3 }]": "rig.cameras[1]: unknown key 'focal'",
    "cameras = [{}, { translate = [1, 0, 0] }]": "unknown key 'translate'",
    "fx = 3\nfov_x_deg = 40": "keep one",
    "fy = 3": "needs 'fx'",
    "baseline = 0": "rig.baseline: must be > 0",
    "baseline = nan": "must be a finite number",
    "look_at = [0, 0, 0]": "look_at",
    'layout = "grid"\nrows = 100\ncolumns = 100': "at most 1000",
    'layout = "orbit"': "missing key 'count'",
    'layout = "orbit"\ncount = 3\nelevation_deg = 95': "rig.elevation_deg: must be",
    'layout = "orbit"\ncount = 3\naxis = [0, 0, 0]': "up must be a direction",
    'layout = "hemisphere"\ncount = 3\nangle_deg = 30': "unknown key 'angle_deg'",
    'layout = "hemisphere"\ncount = 1001': "rig.count: must be <= 1000",
    'layout = "trajectory"\ncount = 3\nwaypoints = [[0, 0, 0]]': "waypoints",
    'layout = "trajectory"\ncount = 3\nwaypoints = [[0, 0, 0], [0, 0]]': "waypoints[1]",
    'layout = "trajectory"\ncount = 3\nwaypoints = [[0, 0, 0], [0, 0, 0]]': "must differ",
    'layout = "light_field"\nn = 3': "missing key 'aperture_mm'",
    'layout = "light_field"\nn = 40\naperture_mm = 5': "n: must be <= 31",
    'layout = "light_field"\nn = 2\naperture_mm = 5\ndistortion = { k1 = -0.1 }': "without lens distortion",
    "misalignment = { vertical = 1 }": "did you mean 'vertical_px'",
    "misalignment = [{}]": "misalignment: a rig of 2 cameras needs 2 misalignments, got 1",
    'layout = "line"\ncount = 1\nmisalignment = {}': "give a list",
    'distortion = { model = "fisheye" }': "kannala-brandt",
    'distortion = { model = "kannala-brandt", p1 = 1 }': "unknown key 'p1'",
    "distortion = { k1 = -5.0 }": "folds",
    'layout = "cameras"': "missing key 'cameras'",
    'layout = "cameras"\ncameras = [{ translate = [1, 0, 0], position = [0, 0, 0] }]': "keep one",
    'layout = "cameras"\ncameras = [{ world_from_cam = [[1,0,0,0],[0,1,0,0],[0,0,2,0],[0,0,0,1]] }]': "rotation",
    # The layout has the name of a key.
    'layout = "cameras"\ncameras = [{ fx = -1 }]': "rig.toml: rig.cameras[0].fx: ",
    'layout = "cameras"\ncameras = [{}]\n[[projectors]]\npower = nan': "rig.toml: rig.projectors[0].power: must be a",
    'layout = "cameras"\ncameras = [{}, {}]\nmisalignment = { focal = 0.0 }': "rig.toml: rig.misalignment.focal: ",
    "[[projectors]]\npower = 1\nlux = 2": "projectors[0]: 'power' and 'lux' both set the light; keep one",
    "[[projectors]]\naperture_mm = -1": "projectors[0].aperture_mm: must be >= 0",
    "[[projectors]]\nlux = 2": "projectors[0]: lux is a unit of visible light",
    "[[projectors]]\npower = 2":
        "projectors[0] has the band 'nir', which no camera sees: give a camera band = 'nir'",
    "[[projectors]]\npattern = { type = 'dot' }": "did you mean 'dots'?",
    "[[projectors]]\npattern = { type = 'dots', densty = 1 }": "unknown key 'densty'; did you mean 'density'?",
    "[[projectors]]\npattern = { type = 'gray_code', frame = 12 }": "projectors[0]: the frame of a Gray code",
    "[[projectors]]\npattern = { type = 'dot_grid', period = 1 }": "projectors[0]: the period of a dot grid",
}  # fmt: skip


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_reported_with_key_and_remedy(text):
    table = tomllib.loads(text)
    with pytest.raises(InputError, match=re.escape(MISTAKES[text])) as caught:
        rig_from_table(table, SCENE, 64, 48, "rig.toml", "rig")
    assert str(caught.value).startswith("rig.toml: rig")
    assert "\n" not in str(caught.value)


def test_toed_in_needs_a_distance_without_a_depth_range():
    vague = Scene("vague", (), {}, POSE, (0.1, 1e4), depth_range_known=False)
    with pytest.raises(InputError, match="distance"):
        rig_from_table({"layout": "toed_in"}, vague, 64, 48)


def test_a_scene_file_may_describe_its_rig(read_scene):
    arc = "rig.layout = 'arc'\nrig.count = 4\nrig.angle_deg = "
    scene = read_scene(arc + "40")
    assert len(rig_from_table(scene.rig, scene, 64, 48)) == 4
    message = r"scene.toml: rig.angle_deg: must be <= 360, got 400"
    with pytest.raises(InputError, match=message):
        read_scene(arc + "400")


def test_projectors_have_intrinsics_pose_pattern_and_light():
    made = rig("""
        [[projectors]]
        translate = [0.05, 0, 0]
        euler_deg = [0, -5, 0]
        width = 64
        height = 48
        fov_x_deg = 60
        distortion = { k1 = -0.1 }
        pattern = { type = "dots", density = 0.25, seed = 3 }
        power = 2.5
        band = "rgb"
        filter = "nearest"
        aperture_mm = 20
        focus = 1.5
        [[projectors]]
        lux = 100
        band = "rgb"
    """)
    first, second = made.projectors
    turn = rotation([0, 1, 0], -5)[:3, :3]
    assert np.allclose(first.pose, geometry.rigid(turn, [0.05, 0, 0]))
    assert first.intrinsics == Camera.from_fov(64, 48, 60).replace(
        distortion=BrownConrady(-0.1)
    )
    assert (first.pattern == patterns.dots(64, 48, density=0.25, seed=3)).all()
    assert (first.power, first.filter) == (2.5, "nearest")
    assert (
        first.aperture_diameter,
        first.focus_distance,
        second.aperture_diameter,
    ) == (0.02, 1.5, 0)
    assert second.intrinsics == CAMERA
    assert second.power == Projector(None, CAMERA, band="rgb").with_lux(100).power
    assert np.allclose(made.world_from_projectors[1], made.world_from_cams[0])


def test_a_grey_picture_is_the_pattern_of_a_projector(tmp_path):
    dots = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)
    Image.fromarray(dots).save(tmp_path / "dots.png")
    Image.fromarray(np.stack([dots, 0 * dots, dots], axis=-1)).save(
        tmp_path / "red.png"
    )

    def projector(file, more=""):
        pattern = f'pattern = {{ type = "picture", file = {file} }}\n{more}'
        (tmp_path / "rig.toml").write_text(f'[[projectors]]\nband = "rgb"\n{pattern}')
        scene = scene_with_rig(SCENE, tmp_path / "rig.toml")
        return rig_from_table(scene.rig, scene, 64, 48).projectors[0]

    made = projector("'dots.png'")
    assert (made.intrinsics.width, made.intrinsics.height) == (40, 30)
    assert np.allclose(made.pattern, dots / 255)
    mistakes = {
        ("'red.png'",): "a projector's pattern is a grey picture",
        ("'none.png'",): "rig.toml: projectors[0].pattern.file: no file 'none.png'",
        ("'../dots.png'",): "leads outside the folder",
        ("3",): "projectors[0].pattern.file",
        ("'dots.png'", "width = 20"): "must have the shape (30, 20)",
    }
    for arguments, message in mistakes.items():
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            projector(*arguments)
        assert "\n" not in str(caught.value)
