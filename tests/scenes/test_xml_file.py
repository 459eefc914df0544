"""The sensor of a Mitsuba file becomes the default view: compared with the camera Mitsuba itself builds from it."""

from pathlib import Path

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.rendering.backends import mitsuba
from twinlens.scenes import load_scene

SENSORS = {
    "lookat": '<lookat origin="1, -3, 1.5" target="0, 0.2, 0.5" up="0, 0, 1"/>',
    "lookat without up": '<lookat origin="1, -3, 1.5" target="0, 0.2, 0.5"/>',
    "lookat with zero up": '<lookat origin="-1, 2, -1.5" target="0, 0.2, 0.5" up="0, 0, 0"/>',
    "lookat down the y axis": '<lookat origin="0, 2, 0" target="0, 0, 0"/>',
    "chain": '<rotate x="1" angle="35"/><rotate y="1" angle="-50"/><translate x="1" y="2" z="3"/>',
    "matrix": '<matrix value="0 0 -1 4  1 0 0 2  0 -1 0 1  0 0 0 1"/>',
    "unit scale": '<rotate z="1" angle="20"/><scale value="1"/><translate value="1, 0, 2"/>',
    "none": "",
}
FIELDS = {
    "x": '<float name="fov" value="40"/>',
    "y": '<float name="fov" value="40"/><string name="fov_axis" value="y"/>',
    "diagonal": '<float name="fov" value="40"/><string name="fov_axis" value="diagonal"/>',
    "smaller": '<float name="fov" value="40"/><string name="fov_axis" value="smaller"/>',
    "larger": '<float name="fov" value="40"/><string name="fov_axis" value="larger"/>',
    "lens": '<string name="focal_length" value="35mm"/>',
    "default": "",
}


def write(folder: Path, sensor: str, transform: str = "") -> Path:
    path = folder / "s.xml"
    film = '<film type="hdrfilm"><integer name="width" value="90"/><integer name="height" value="60"/></film>'
    to_world = f'<transform name="to_world">{transform}</transform>'
    path.write_text(
        f'<scene version="3.0.0"><sensor type="perspective">{sensor}{to_world}{film}</sensor></scene>'
    )
    return path


@pytest.mark.parametrize("transform", SENSORS)
@pytest.mark.parametrize("field", FIELDS)
def test_pose_and_field_of_view_are_those_mitsuba_builds(
    tmp_path: Path, transform: str, field: str
) -> None:
    mi = mitsuba()
    path = write(tmp_path, FIELDS[field], SENSORS[transform])
    scene = load_scene(path)
    sensor = mi.load_file(str(path)).sensors()[0]
    theirs = (
        np.array(mi.traverse(sensor)["to_world"].matrix, dtype=float)
        .reshape(-1)[:16]
        .reshape(4, 4)
    )
    axes = theirs[:3, :3] / np.linalg.norm(theirs[:3, :3], axis=0)
    np.testing.assert_allclose(
        scene.world_from_left[:3, :3], axes @ np.diag([-1, -1, 1]), atol=1e-6
    )
    np.testing.assert_allclose(scene.world_from_left[:3, 3], theirs[:3, 3], atol=1e-5)
    their_fov = float(np.ravel(mi.traverse(sensor)["x_fov"])[0])
    assert scene.fov_x_deg == pytest.approx(their_fov, rel=1e-5)


def test_depth_range_is_the_clipping_range(tmp_path: Path) -> None:
    scene = load_scene(
        write(
            tmp_path,
            '<float name="near_clip" value="0.5"/><float name="farClip" value="7"/>',
        )
    )
    assert scene.depth_range == (0.5, 7.0)
    assert scene.depth_range_known
    assert scene.xml == (tmp_path / "s.xml").resolve()
    assert scene.name == "s"


@pytest.mark.parametrize(
    "clip",
    ["", '<float name="near_clip" value="1"/>', '<float name="farClip" value="7"/>'],
)
def test_a_missing_depth_range_is_unknown(tmp_path: Path, clip: str) -> None:
    scene = load_scene(write(tmp_path, clip))
    assert not scene.depth_range_known
    assert not scene.at(np.eye(4)).depth_range_known


def test_a_scene_toml_knows_its_depth_range() -> None:
    assert load_scene("cards").depth_range_known


BAD = [
    ('<float name="fov" value="200"/>', "", "fov must lie between"),
    ('<string name="focal_length" value="0mm"/>', "", "got 180 along diagonal"),
    ('<float name="fov" value="wide"/>', "", "'wide' must be a finite number"),
    ('<float name="fov" value="$fov"/>', "", "without $ parameters"),
    ("", '<matrix value="1 2 3"/>', "must be 16 finite numbers"),
    ("", '<scale x="-1"/>', "mirrored or singular"),
    ("", '<scale value="2"/>', "must hold a right-handed rotation"),
    ("", '<scale value="0"/>', "mirrored or singular"),
    ("", '<rotate angle="3"/>', "needs an axis"),
    ("", '<lookat origin="0 0 0" target="0 0 0"/>', "different origin and target"),
    (
        "",
        '<matrix value="1 1 0 0  0 1 0 0  0 0 1 0  0 0 0 1"/>',
        "right-handed rotation",
    ),
]


@pytest.mark.parametrize(
    ("sensor", "transform", "message"), BAD, ids=[b[2] for b in BAD]
)
def test_an_unsupported_sensor_is_an_error(
    tmp_path: Path, sensor: str, transform: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_scene(write(tmp_path, sensor, transform))
    assert message in str(caught.value)


def test_a_missing_sensor_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "s.xml").write_text('<scene version="3.0.0"/>')
    with pytest.raises(InputError, match="has no <sensor>; add one"):
        load_scene(tmp_path / "s.xml")
