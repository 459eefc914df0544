import warnings
from functools import partial

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_array_equal

from tests.dataset.dataset_damage import damaged
from twinlens import geometry
from twinlens.camera import Camera, Rig
from twinlens.dataset import Dataset, write_pfm, write_png
from twinlens.dataset.codecs.calib import (
    Calibration,
    decode_calib,
    encode_calib,
    read_calib,
    write_calib,
)
from twinlens.errors import FileError, InputError, NotUsedWarning, TwinlensError
from twinlens.scoring import Pair

MOTORCYCLE = """cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]
cam1=[3979.911 0 1369.115; 0 3979.911 1019.507; 0 0 1]
doffs=124.343
baseline=193.001
width=2964
height=2000
ndisp=270
isint=0
vmin=23
vmax=245
dyavg=0.2
dymax=0.5
"""

positive = st.floats(1e-3, 1e6)
point = st.floats(-1e5, 1e5)


@given(
    positive,
    positive,
    point,
    point,
    point,
    positive,
    st.integers(1, 9999),
    st.none() | st.integers(1, 999),
    st.booleans(),
)
def test_every_value_reads_back_the_same(
    fx, fy, cx0, cx1, cy, baseline, width, ndisp, isint
):
    calibration = Calibration(
        (fx, fy, cx0, cy), (fx, fy, cx1, cy), baseline, width, 7, cx1 - cx0, ndisp
    ).replace(isint=isint)
    assert decode_calib(encode_calib(calibration)) == calibration


def test_middleburys_own_file():
    calibration = decode_calib(MOTORCYCLE)
    assert calibration.cam1 == (3979.911, 3979.911, 1369.115, 1019.507)
    assert (calibration.baseline, calibration.doffs, calibration.ndisp) == (
        0.193001,
        124.343,
        270,
    )
    assert (calibration.vmin, calibration.vmax) == (23.0, 245.0)
    assert not calibration.isint
    assert decode_calib(MOTORCYCLE.replace("isint=0", "isint=1")).isint
    # A disparity of vmax is the nearest point: 3979.911 * 0.193001 / (245 + 124.343).
    assert float(calibration.depth(245.0)) == pytest.approx(2.0797, abs=1e-4)


MOBILE = """cam0=[1758.23 0 953.34; 0 1758.23 552.29; 0 0 1]
cam1=[1758.23 0 953.34; 0 1758.23 552.29; 0 0 1]
doffs=0
baseline=111.53
width=1920
height=1080
ndisp=290
vmin=75
vmax=262
"""
"""Of Middlebury's scenes of 2021."""


@pytest.mark.parametrize(
    "text",
    [
        MOTORCYCLE,
        MOBILE,
        MOTORCYCLE.replace("dyavg=0.2", "dyavg=0").replace("vmin=23", "vmin=0"),
        encode_calib(decode_calib(MOTORCYCLE)),
    ],
    ids=["2014", "2021", "eth3d", "twinlens"],
)
def test_published_files_have_no_unknown_keys(text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decode_calib(text)


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        ("nidsp=64", "'nidsp' (unknown key, did you mean ndisp?)"),
        ("Ndisp=64\nfps=30", "'Ndisp' (unknown key, did you mean ndisp?), 'fps' (unknown key)"),
        ("base_line=5", "'base_line' (unknown key, did you mean baseline?)"),
    ],
)  # fmt: skip
def test_unknown_keys_are_named_in_one_warning(tmp_path, lines, named):
    path = tmp_path / "calib.txt"
    path.write_text(MOBILE + lines + "\n")
    with pytest.warns(NotUsedWarning) as caught:
        calibration = read_calib(path)
    assert [str(item.message) for item in caught] == [f"{path}: not used: {named}"]
    assert calibration.ndisp == 290


def test_a_rig_goes_there_and_back(tmp_path):
    left = Camera(640, 480, 700.0, 690.0, 300.0, 239.5)
    pose = geometry.look_at([1, 2, 3], [4, 6, 1])
    rig = Rig.stereo(left, 0.1, world_from_left=pose, right=left.replace(cx=311.25))
    write_calib(tmp_path / "calib.txt", Calibration.from_rig(rig, ndisp=64))
    back = read_calib(tmp_path / "calib.txt")
    assert "baseline=100.0\n" in (tmp_path / "calib.txt").read_text()
    assert back.rig().cameras == rig.cameras
    assert back.rig().is_rectified()
    assert back.doffs == rig.doffs() == 11.25
    assert_array_equal(back.rig().cameras[1].K, rig.cameras[1].K)


def test_depth_is_where_the_two_rays_meet():
    left = Camera(640, 480, 700.0, 690.0, 300.0, 239.5)
    rig = Rig.stereo(left, 0.1, right=left.replace(cx=311.25))
    point = np.array([[0.3, -0.2, 2.5]])
    left_px, right_px = (
        rig.cameras[i].project(geometry.transform_points(rig.b_from_a(0, i), point))
        for i in (0, 1)
    )
    disparity = left_px[0, 0] - right_px[0, 0]
    assert Calibration.from_rig(rig).depth(disparity) == pytest.approx(2.5, rel=1e-12)


def test_a_pair_that_is_not_rectified_has_no_calib():
    left = Camera(64, 48, 70.0, 70.0, 31.5, 23.5)
    rig = Rig([left, left], [np.eye(4), geometry.rigid(np.eye(3), [0.1, 0.05, 0])])
    for wrong in (rig, Rig([left], [np.eye(4)])):
        with pytest.raises(InputError, match="rectified"):
            Calibration.from_rig(wrong)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("doffs=124.343\n", "", "no doffs= line"),
        ("doffs=124.343", "doffs=12.343", "doffs must be cx1 - cx0"),
        ("doffs=124.343", "doffs", "line 3 must read name=value"),
        ("width=2964", "width=0", "positive"),
        ("width=2964", "width=29.64", "width must be a whole number, got '29.64'"),
        ("width=2964", "width=2964\nwidth=2964", "repeats the key"),
        ("baseline=193.001", "baseline=1e999999999", "number of millimetres"),
        ("baseline=193.001", "baseline=-1", "positive"),
        ("baseline=193.001", "baseline=nan", "finite"),
        ("0 0 1]\ncam1", "0 0 2]\ncam1", "without skew"),
        ("; 0 0 1]\ncam1", "]\ncam1", r"cam0 must be \[fx 0 cx"),
        ("ndisp=270", "ndisp=many", "ndisp must be a whole number, got 'many'"),
        ("ndisp=270", "ndisp=-3", "ndisp must be 1 or more"),
    ],
)
def test_errors_name_the_wrong_line(old, new, message):
    assert old in MOTORCYCLE
    with pytest.raises(FileError, match=rf"^calib\.txt: .*{message}"):
        decode_calib(MOTORCYCLE.replace(old, new, 1))


@pytest.mark.parametrize(
    "changed",
    [
        MOTORCYCLE.replace("\n", "\r\n"),
        "\ufeff" + MOTORCYCLE,
        MOTORCYCLE.rstrip("\n"),
        MOTORCYCLE.replace("ndisp=270", "ndisp=270.0").replace("2964", "2964."),
        MOTORCYCLE.replace("=", " = ").replace("; ", " ;  "),
        MOTORCYCLE.replace("3979.911 0 ", "3979.911, 0, "),
    ],
)
def test_forms_of_other_programs_are_read(changed):
    """A byte order mark, Windows's line ends, no last line end, whole numbers with a point, spaces, commas."""
    assert changed != MOTORCYCLE
    assert decode_calib(changed) == decode_calib(MOTORCYCLE)


def test_a_calibration_of_another_size_than_the_images_is_an_error(tmp_path):
    """As the pair is scored, and as its rig is read; the same with the right size is not."""
    image = np.zeros((120, 160, 3), dtype=np.uint8)
    truth = np.ones((120, 160), dtype=np.float32)
    folder = tmp_path / "scene"
    folder.mkdir()
    for size in ((320, 240), (160, 120)):
        camera = Camera.from_fov(*size, fov_x_deg=50)
        calibration = Calibration.from_rig(Rig.stereo(camera, 0.1), ndisp=16)
        write_calib(folder / "calib.txt", calibration)
        for view in (0, 1):
            write_png(folder / f"im{view}.png", image)
            write_pfm(folder / f"disp{view}.pfm", truth)
        sample = Dataset(tmp_path)[0]
        pair = partial(Pair, "a", image, image, truth, None, 16, calibration)
        if size == (160, 120):
            assert sample.rig.cameras[0].width == pair().im0.shape[1]
            continue
        for refused in (pair, lambda: sample.rig):  # noqa: B023
            with pytest.raises(
                InputError,
                match=r"calib\.txt is of 320x240 pixels, but the images have 160x120",
            ):
                refused()


@given(damaged(MOTORCYCLE.encode()))
def test_damage_is_read_or_rejected(data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotUsedWarning)
        try:
            calibration = decode_calib(data.decode("utf-8", "replace"))
        except TwinlensError:
            return
    assert decode_calib(encode_calib(calibration)) == calibration


def test_files_that_are_not_text_are_rejected(tmp_path):
    (tmp_path / "calib.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match=r"calib\.txt"):
        read_calib(tmp_path / "calib.txt")
