"""Calibrations as the programs of their makers write them: messages of ROS, EuRoC's files, lengths and sizes unsaid."""

import json
import math
import warnings

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq

import twinlens as tl
from tests.calibrations.calibration_files import opencv_file, same, write_ros
from tests.dataset.test_calib import MOTORCYCLE
from twinlens import geometry
from twinlens.calibrations import read_rig
from twinlens.calibrations.reading import LengthWarning
from twinlens.camera import BrownConrady, Camera, KannalaBrandt, Rig
from twinlens.errors import FileError, InputError
from twinlens.scenes import Scene, rig_from_table

LEFT = Camera(192, 144, 171.0, 170.5, 94.5, 73.0, BrownConrady(-0.11, 0.08, 1e-3, -7e-4))  # fmt: skip
RIGHT = Camera(192, 144, 172.0, 171.5, 97.0, 70.5, BrownConrady(-0.12, 0.09))
TURN = cv2.Rodrigues(np.radians([0.4, 4.0, -0.3]))[0]
SHIFT = np.array([[-0.12], [0.002], [0.005]])
APART = [np.eye(4), geometry.rigid(np.eye(3), [0.1, 0, 0])]
SCENE = Scene("stage", (), {}, np.eye(4), (1.0, 3.0))


def rectified():
    """(R, P) of both cameras, of OpenCV."""
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        LEFT.K, np.zeros(5), RIGHT.K, np.zeros(5), (192, 144), TURN, SHIFT
    )
    return (r1, p1), (r2, p2)


def message(camera, turn, projection, letters="DKRP"):
    """A message sensor_msgs/CameraInfo as plain values, with the fields in the order of its definition."""
    arrays = (
        [*camera.distortion.coefficients[:4], 0.0],
        *(array.ravel().tolist() for array in (camera.K, turn, projection)),
    )
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0}
    return {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"},
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        **dict(zip(letters, arrays, strict=True)),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {**region, "do_rectify": False},
    }


def as_flow(values):
    """As `rostopic echo` prints a message: lists in brackets, and a line of --- at the end."""
    return "".join(f"{key}: {json.dumps(value)}\n" for key, value in values.items()) + "---\n"  # fmt: skip


def as_blocks(values):
    """As `ros2 topic echo` prints a message: a number a line."""
    lines = []
    for key, value in values.items():
        if isinstance(value, list):
            lines += [f"{key}:", *(f"- {number!r}" for number in value)]
        else:
            lines.append(f"{key}: {json.dumps(value)}")
    return "\n".join([*lines, "---", ""])


MESSAGES = {
    "rostopic echo": (as_flow, "DKRP"),
    "without a last line": (lambda values: as_flow(values)[: -len("---\n")], "DKRP"),
    "without a last line end": (lambda values: as_flow(values)[:-1], "dkrp"),
    "ros2 topic echo": (as_blocks, "dkrp"),
    "json": (json.dumps, "dkrp"),
}


@pytest.mark.parametrize("kind", MESSAGES)
def test_a_printed_message_is_the_rig_of_the_files(kind, tmp_path):
    form, letters = MESSAGES[kind]
    for name, camera, (turn, projection) in zip(
        ("left", "right"), (LEFT, RIGHT), rectified(), strict=True
    ):
        write_ros(tmp_path / f"{name}.yaml", camera, turn, projection)
        values = message(camera, turn, projection, letters)
        (tmp_path / f"{name}.txt").write_text(form(values))
    files, messages = (
        [tmp_path / f"{name}.{ending}" for name in ("left", "right")]
        for ending in ("yaml", "txt")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = read_rig(*messages).rig
    same(read_rig(*files).rig, back)
    assert np.allclose(back.b_from_a(0, 1), geometry.rigid(TURN, SHIFT.ravel()))


def test_a_message_of_a_part_of_the_image_is_named(tmp_path):
    names = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    for path, camera, pair in zip(names, (LEFT, RIGHT), rectified(), strict=True):
        path.write_text(as_flow(message(camera, *pair)))
    left = names[0].read_text()
    names[0].write_text(left.replace("binning_x: 0", "binning_x: 2"))
    with pytest.warns(UserWarning, match=r"left\.yaml: not used: binning_x"):
        read_rig(*names)


def test_several_messages_are_one_line(tmp_path):
    path = tmp_path / "left.yaml"
    path.write_text(2 * as_flow(message(LEFT, *rectified()[0])))
    with pytest.raises(FileError, match=r"left\.yaml: holds 2 messages") as caught:
        read_rig(path, path)
    assert "\n" not in str(caught.value)


def test_exchanged_files_of_ros_are_named(tmp_path):
    names = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    for path, camera, pair in zip(names, (LEFT, RIGHT), rectified(), strict=True):
        write_ros(path, camera, *pair)
    with pytest.raises(FileError, match=r"left\.yaml: .* exchanged, \S*right\.yaml is the right camera's"):  # fmt: skip
        read_rig(*reversed(names))
    with pytest.raises(FileError, match="no baseline"):
        read_rig(names[0], names[0])


EUROC = """%YAML:1.0
sensor_type: camera
comment: VI-Sensor (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [{pose},
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [{intrinsics}] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [{coefficients}]
"""
EUROC_LEFT = {
    "pose": "0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,"
    "0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,"
    "-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949",
    "intrinsics": "458.654, 457.296, 367.215, 248.375",
    "coefficients": "-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05",
}
EUROC_RIGHT = {
    "pose": "0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556,"
    "0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024,"
    "-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038",
    "intrinsics": "457.587, 456.134, 379.999, 255.238",
    "coefficients": "-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05",
}


def write_euroc(folder, name, values):
    path = folder / name / "sensor.yaml"
    path.parent.mkdir()
    path.write_text(EUROC.format(**values))
    return path


def test_the_pair_of_euroc_has_its_published_baseline(tmp_path):
    """ORB-SLAM3's settings of EuRoC have the rectified fx 435.2046959714599 and bf = fx B = 47.90639384423901."""
    left = write_euroc(tmp_path, "cam0", EUROC_LEFT)
    right = write_euroc(tmp_path, "cam1", EUROC_RIGHT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = tl.read_rig(left, right)
    assert read.names == ("cam0", "cam1")
    assert read.rig.baseline() == pytest.approx(47.90639384423901 / 435.2046959714599, abs=2e-6)  # fmt: skip
    # The second camera is to the right, and T of cv2.stereoRectify, which the settings also have, is close to -x.
    assert read.rig.b_from_a(0, 1)[0, 3] == pytest.approx(-0.110, abs=2e-4)
    camera = read.rig.cameras[0]
    assert (camera.fx, camera.cy, camera.width) == (458.654, 248.375, 752)
    assert camera.distortion.k1 == -0.28340811


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("resolution: [752, 480]", "", "has no resolution"),
        ("pinhole", "omni", "unknown camera_model 'omni'"),
        ("radial-tangential", "fov", "unknown distortion_model 'fov'"),
        ("0.999557249008", "0.9", "rotation"),
        ("458.654, ", "", "intrinsics must be 1x4"),
    ],
)
def test_a_wrong_file_of_euroc_is_one_line(tmp_path, old, new, what):
    left = write_euroc(tmp_path, "cam0", EUROC_LEFT)
    right = write_euroc(tmp_path, "cam1", EUROC_RIGHT)
    left.write_text(left.read_text().replace(old, new, 1))
    with pytest.raises(FileError, match=what) as raised:
        tl.read_rig(left, right)
    assert str(raised.value).startswith(str(left))
    with pytest.raises(FileError, match=r"sensor\.yaml is of one camera"):
        tl.read_rig(right)


def write_opencv_sample(folder):
    """intrinsics.yml and extrinsics.yml as OpenCV's stereo_calib writes them: no size, and T in the board's unit."""
    inner, outer = folder / "intrinsics.yml", folder / "extrinsics.yml"
    none = np.zeros((1, 5))
    opencv_file(inner, M1=LEFT.K, D1=none, M2=RIGHT.K, D2=none)
    opencv_file(outer, R=TURN, T=1e3 * SHIFT)
    return [str(inner), str(outer)]


def test_a_rigs_table_states_size_and_unit_of_opencvs_sample(tmp_path):
    table = {"file": write_opencv_sample(tmp_path), "length_unit": "mm"}
    size = {"width": 192, "height": 144}
    rig = rig_from_table(table | size, SCENE, 640, 480)
    assert (rig.cameras[1].width, rig.cameras[1].height) == (192, 144)
    assert np.allclose(rig.b_from_a(0, 1), geometry.rigid(TURN, SHIFT.ravel()))
    with pytest.raises(InputError, match=r"has no image_width.*width and height"):
        rig_from_table(table, SCENE, 640, 480)
    with pytest.raises(InputError, match=r"'width' and 'height' .* go together"):
        rig_from_table(table | {"width": 192}, SCENE, 640, 480)


def test_lengths_that_are_probably_millimetres_are_warned_of(tmp_path):
    table = {"file": write_opencv_sample(tmp_path), "width": 192, "height": 144}
    with pytest.warns(LengthWarning, match=r'120.1 m apart.* length_unit = "mm"'):
        rig_from_table(table, SCENE, 640, 480)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rig_from_table(table | {"length_unit": "mm"}, SCENE, 640, 480)


def fields(twinlens, *files):
    """Degrees across and down of each camera, as the command prints them."""
    words = [word for file in files for word in ("--read", file)]
    code, printed, _ = twinlens("cameras", "--json", *words)
    assert code == 0
    return [camera["field_deg"] for camera in json.loads(printed)["cameras"]]


@pytest.mark.parametrize("coefficients", [(0.0, 0, 0, 0), (-0.02, 0.01, -0.006, 0.002)])
def test_the_field_of_a_fisheye_is_that_of_its_edges(tmp_path, twinlens, coefficients):
    """OpenCV undistorts the edges; without coefficients an angle is a distance from the centre over fx."""
    fisheye = LEFT.replace(distortion=KannalaBrandt(*coefficients), fx=120.0, fy=110.0)
    tl.write_rig(tmp_path / "rig.yml", Rig([fisheye] * 2, APART))  # fmt: skip
    edges = [(-0.5, 73.0), (191.5, 73.0), (94.5, -0.5), (94.5, 143.5)]
    points = cv2.fisheye.undistortPoints(np.array([edges]), fisheye.K, np.array(coefficients))[0]  # fmt: skip
    left, right = np.degrees(np.arctan(points[:2, 0]))
    top, bottom = np.degrees(np.arctan(points[2:, 1]))
    (across, down), _ = fields(twinlens, tmp_path / "rig.yml")
    assert across == pytest.approx(right - left, abs=1e-4)
    assert down == pytest.approx(bottom - top, abs=1e-4)
    if not any(coefficients):
        assert across == pytest.approx(math.degrees(192 / 120.0))
        assert down == pytest.approx(math.degrees(144 / 110.0))


def test_the_field_of_a_perspective_camera_counts_its_distortion(tmp_path, twinlens):
    """An edge at the distance e from the centre is x = tan(angle) with x + k1 x^3 + k2 x^5 = e / fx."""
    tl.write_rig(tmp_path / "rig.yml", Rig([RIGHT] * 2, APART))

    def angle(edge):
        return brentq(lambda a: np.polyval([0.09, 0, -0.12, 0, 1, -edge], math.tan(a)), 0, 0.8)  # fmt: skip

    across = math.degrees(angle(97.5 / 172.0) + angle(94.5 / 172.0))
    down = math.degrees(angle(71.0 / 171.5) + angle(73.0 / 171.5))
    assert fields(twinlens, tmp_path / "rig.yml")[0] == pytest.approx([across, down], abs=1e-4)  # fmt: skip


def test_the_table_of_a_rig_is_read_by_the_command(tmp_path, twinlens, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_opencv_sample(tmp_path)
    keys = 'file = ["intrinsics.yml", "extrinsics.yml"]\nlength_unit = "mm"\n'
    (tmp_path / "rig.toml").write_text(keys)
    _, printed, _ = twinlens("cameras", "--read", "rig.toml", "--size", "192x144")
    assert "0.120121 m from camera 0" in printed
    (tmp_path / "part.toml").write_text(f"width = 192\nheight = 144\n[rig]\n{keys}")
    _, printed, _ = twinlens("cameras", "--read", "part.toml")
    assert "0.120121 m from camera 0" in printed
    (tmp_path / "ours.toml").write_text("baseline = 0.1\n")
    code, _, error = twinlens("cameras", "--read", "ours.toml")
    assert code == 2
    assert "names a calibration" in error


def test_cameras_in_the_other_order_are_named_with_the_command(tmp_path, twinlens):
    pair = rig_from_table({"baseline": 0.1}, SCENE, 192, 144)
    poses = list(reversed(pair.world_from_cams))
    tl.write_rig(tmp_path / "rig.yml", Rig(pair.cameras, poses))
    _, printed, _ = twinlens("cameras", "--read", tmp_path / "rig.yml")
    assert "camera 1 is left of camera 0" in printed
    assert "--cameras 1,0" in printed


# A pair of ETH3D, whose baseline is below a millimetre's digits; spaces and commas.
ETH3D = """cam0=[541.764 0 553.869; 0 541.764 232.396; 0 0 1]
cam1=[541.764 0 553.869; 0 541.764 232.396; 0 0 1]
doffs=0
baseline=59.9504
width=941
height=490
ndisp=64
isint=0
vmin=0
vmax=14
"""
SPACED = """cam0 = [700, 0, 319.5; 0, 710, 239.5; 0, 0, 1]
cam1 = [700, 0, 330.25; 0, 710, 239.5; 0, 0, 1]
doffs = 10.75
baseline = 120
width = 640
height = 480
"""


@pytest.mark.parametrize(
    ("text", "fx", "cx", "doffs", "baseline", "size"),
    [
        (MOTORCYCLE, 3979.911, 1244.772, 124.343, 0.193001, (2964, 2000)),
        (ETH3D, 541.764, 553.869, 0.0, 0.0599504, (941, 490)),
        (SPACED, 700.0, 319.5, 10.75, 0.12, (640, 480)),
    ],
)
def test_a_calib_txt_is_a_rectified_rig_in_metres(
    tmp_path, twinlens, text, fx, cx, doffs, baseline, size
):
    file = tmp_path / "calib.txt"
    file.write_text(text)
    rig = tl.read_rig(file).rig
    left = rig.cameras[0]
    assert (left.fx, left.cx, left.width, left.height) == (fx, cx, *size)
    assert rig.is_rectified()
    # Middlebury: Z = baseline f / (d + doffs). The point at the left image's centre, as far as d = 10 px says.
    depth = baseline * fx / (10.0 + doffs)
    point = rig.unproject(0, [300.0, 200.0], depth)
    assert rig.project(1, point) == pytest.approx([290.0, 200.0], abs=1e-9)
    code, out, err = twinlens("cameras", "--read", file)
    assert (code, err) == (0, "")
    assert f"{round(baseline, 6):g} m from camera 0" in out
    assert f"A rectified pair: doffs = cx1 - cx0 = {doffs:.6g} px" in out
    assert ("ndisp = 270" in out) == ("ndisp=270" in text)


def test_a_recipe_and_a_rigs_file_name_a_calib_txt(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calib.txt").write_text(SPACED)
    (tmp_path / "rig.toml").write_text('file = "calib.txt"\n')
    expected = tl.read_rig(tmp_path / "calib.txt").rig
    in_recipe = rig_from_table({"file": "calib.txt"}, SCENE, 64, 48)
    for rig in (tl.read_rig(tmp_path / "rig.toml").rig, in_recipe):
        assert rig.cameras == expected.cameras
        assert rig.baseline() == pytest.approx(0.12)
    with pytest.raises(FileError, match="millimetres by its format; leave length_unit"):
        rig_from_table({"file": "calib.txt", "length_unit": "mm"}, SCENE, 64, 48)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("baseline = 120\n", "", "has no baseline= line"),
        ("doffs = 10.75", "doffs = 0", "doffs must be cx1 - cx0"),
        ("700, 0, 319.5", "700, 3, 319.5", "without skew"),
        ("width = 640", "width 640", "line 5 must read name=value"),
    ],
)
def test_a_wrong_calib_txt_is_one_line(tmp_path, twinlens, old, new, says):
    (tmp_path / "calib.txt").write_text(SPACED.replace(old, new))
    code, _, err = twinlens("cameras", "--read", tmp_path / "calib.txt")
    assert code == 2
    assert says in err
    assert err.count("\n") == 1


def test_the_unit_of_a_calib_txt_is_its_formats(tmp_path, twinlens, recwarn):
    file, table = tmp_path / "calib.txt", {"file": str(tmp_path / "calib.txt")}
    file.write_text(SPACED.replace("= 120", "= 12000"))
    rig_from_table(table, SCENE, 64, 48)
    assert not recwarn
    file.write_text(SPACED.replace("= 120", "= 0.12"))
    with pytest.warns(LengthWarning, match=r"0.12 mm apart.* baseline=120$"):
        rig_from_table(table, SCENE, 64, 48)
    assert (
        "write it in millimetres: baseline=120."
        in twinlens("cameras", "--read", file)[1]
    )
