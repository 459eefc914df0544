"""The sensor of a Mitsuba file becomes the default view: compared with the camera Mitsuba itself builds from it."""

import re

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.rendering.backends import mitsuba
from twinlens.scenes import load_scene

TRANSFORMS = {
    "lookat": '<lookat origin="1, -3, 1.5" target="0, 0.2, 0.5" up="0, 0, 1"/>',
    "lookat without up": '<lookat origin="1, -3, 1.5" target="0, 0.2, 0.5"/>',
    "lookat with zero up": '<lookat origin="-1, 2, -1.5" target="0, 0.2, 0.5" up="0, 0, 0"/>',
    "lookat down the y axis": '<lookat origin="0, 2, 0" target="0, 0, 0"/>',
    "chain": '<rotate x="1" angle="35"/><rotate y="1" angle="-50"/><translate x="1" y="2" z="3"/>',
    "matrix": '<matrix value="0 0 -1 4  1 0 0 2  0 -1 0 1  0 0 0 1"/>',
    "unit scale": '<rotate z="1" angle="20"/><scale value="1"/><translate value="1, 0, 2"/>',
    "none": "",
}
FOV = '<float name="fov" value="40"/>'
FIELDS = {
    "x": FOV,
    **{axis: f'{FOV}<string name="fov_axis" value="{axis}"/>' for axis in ("y", "diagonal", "smaller", "larger")},
    "lens": '<string name="focal_length" value="35mm"/>',
    "default": "",
}  # fmt: skip


@pytest.fixture
def write(tmp_path):
    """Writes a file with a sensor of 90x60 pixels."""

    def write(sensor, transform=""):
        path = tmp_path / "s.xml"
        size = '<integer name="width" value="90"/><integer name="height" value="60"/>'
        to_world = f'<transform name="to_world">{transform}</transform>'
        parts = f'{sensor}{to_world}<film type="hdrfilm">{size}</film>'
        sensor = f'<sensor type="perspective">{parts}</sensor>'
        path.write_text(f'<scene version="3.0.0">{sensor}</scene>')
        return path

    return write


@pytest.mark.parametrize("transform", TRANSFORMS)
@pytest.mark.parametrize("field", FIELDS)
def test_pose_and_field_of_view_are_those_mitsuba_builds(write, transform, field):
    mi = mitsuba()
    path = write(FIELDS[field], TRANSFORMS[transform])
    scene = load_scene(path)
    parameters = mi.traverse(mi.load_file(str(path)).sensors()[0])
    matrix = np.array(parameters["to_world"].matrix, dtype=float)
    pose = matrix.reshape(-1)[:16].reshape(4, 4)
    axes = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)
    ours = scene.world_from_left
    np.testing.assert_allclose(ours[:3, :3], axes @ np.diag([-1, -1, 1]), atol=1e-6)
    np.testing.assert_allclose(ours[:3, 3], pose[:3, 3], atol=1e-5)
    fov_x_deg = float(np.ravel(parameters["x_fov"])[0])
    assert scene.fov_x_deg == pytest.approx(fov_x_deg, rel=1e-5)


NEAR_CLIP = '<float name="near_clip" value="0.5"/>'
FAR_CLIP = '<float name="farClip" value="7"/>'


def test_depth_range_is_the_clipping_range(write):
    path = write(NEAR_CLIP + FAR_CLIP)
    scene = load_scene(path)
    assert scene.depth_range == (0.5, 7.0)
    assert scene.depth_range_known
    assert scene.xml == path.resolve()
    assert scene.name == "s"
    for clip in ("", NEAR_CLIP, FAR_CLIP):
        unknown = load_scene(write(clip))
        assert not unknown.depth_range_known
        assert not unknown.at(np.eye(4)).depth_range_known


def test_a_scene_toml_knows_its_depth_range(read_scene):
    assert read_scene().depth_range_known


WRONG_SENSORS = {
    '<float name="fov" value="200"/>': "fov must lie between",
    '<string name="focal_length" value="0mm"/>': "got 180 along diagonal",
    '<float name="fov" value="wide"/>': "'wide' must be a finite number",
    '<float name="fov" value="$fov"/>': "no parameter 'fov'; add <default name='fov'",
}
NO_ROTATION = "must hold a right-handed rotation"
WRONG_TRANSFORMS = {
    '<matrix value="1 2 3"/>': "must be 16 finite numbers",
    '<scale x="-1"/>': "mirrored or singular",
    '<scale value="2"/>': NO_ROTATION,
    '<scale value="0"/>': "mirrored or singular",
    '<rotate angle="3"/>': "needs an axis",
    '<lookat origin="0 0 0" target="0 0 0"/>': "different origin and target",
    '<matrix value="1 1 0 0  0 1 0 0  0 0 1 0  0 0 0 1"/>': NO_ROTATION,
}


def test_an_unsupported_sensor_is_an_error(write):
    for sensor, message in WRONG_SENSORS.items():
        with pytest.raises(InputError, match=re.escape(message)):
            load_scene(write(sensor))
    for transform, message in WRONG_TRANSFORMS.items():
        with pytest.raises(InputError, match=message):
            load_scene(write("", transform))


def test_a_missing_sensor_is_an_error(tmp_path):
    (tmp_path / "s.xml").write_text('<scene version="3.0.0"/>')
    with pytest.raises(InputError, match="has no <sensor>; add one"):
        load_scene(tmp_path / "s.xml")
