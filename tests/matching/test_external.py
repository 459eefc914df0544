"""Other people's matchers: they give what they would give alone, and fail in one line that names them."""

import sys

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import InputError, MissingExtraError

cv2 = pytest.importorskip("cv2")


def scene(shift=5):
    texture = cv2.GaussianBlur(np.random.default_rng(0).normal(128, 160, (60, 160)), (0, 0), 1.2)
    texture = np.clip(texture, 0, 255).astype(np.uint8)
    return texture[:, 20:140], texture[:, 20 + shift : 140 + shift]


@pytest.mark.parametrize("method", ["opencv_bm", "opencv_sgbm", "opencv_sgbm:mode=hh", "opencv_bm:prefilter=false"])
@pytest.mark.parametrize(("shift", "low"), [(5, 0), (-6, -16)])
def test_opencv_finds_the_shift_with_our_sign_and_our_unknown(method, shift, low):
    left, right = scene(shift)
    disparity = tm.match(left, right, method, num_disparities=20, min_disparity=low)
    inside = disparity[10:-10, 40:-40]
    assert np.mean(np.abs(inside - shift) < 0.5) > 0.95
    assert not np.isnan(disparity).any()
    assert np.isinf(disparity).any()


def test_opencv_is_given_what_it_would_be_given_by_hand():
    left, right = scene()
    matcher = cv2.StereoSGBM.create(0, 32, 5, P1=200, P2=800)
    by_hand = matcher.compute(left, right).astype(np.float32) / 16
    ours = tm.match(left, right, "opencv_sgbm", num_disparities=32, block_size=5)
    np.testing.assert_array_equal(ours, np.where(by_hand < 0, np.inf, by_hand))


def test_without_opencv_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match=r"twinlens\[opencv\]"):
        tm.match(*scene(), "opencv_bm")


def constant(left, _right, num_disparities, min_disparity):
    return np.full(left.shape[:2], min_disparity + num_disparities)


def test_a_function_is_called_with_the_range():
    left, right = scene()
    got = tm.match(left, right, f"function:function={__name__}:constant", num_disparities=7, min_disparity=2)
    np.testing.assert_array_equal(got, np.full(left.shape, 9, np.float32))


RESULTS = {
    "wrong shape": (lambda left, *_a, **_k: left[1:], r"shape \(59, 120\); the left image has \(60, 120\)"),
    "not a number": (lambda left, *_a, **_k: np.where(left == left[3, 4], np.nan, 1.0), "returned nan at"),
    "minus infinity": (lambda left, *_a, **_k: np.full(left.shape, -np.inf), r"-inf at \[0, 0\]; unknown .* \+inf"),
    "words": (lambda *_a, **_k: "a disparity", "not an array"),
}


@pytest.mark.parametrize("case", RESULTS)
def test_what_a_function_returns_is_checked(case):
    function, message = RESULTS[case]
    with pytest.raises(InputError, match=message):
        tm.PythonFunction(function).match(*scene())


COPY = """
import sys, numpy as np
from PIL import Image
left, right, out, value = sys.argv[1:]
image = np.asarray(Image.open(left))
with open(out, "wb") as file:
    file.write(b"Pf\\n%d %d\\n-1.0\\n" % image.shape[::-1])
    file.write((image[::-1] + np.float32(value)).astype("<f4").tobytes())
"""


def program(tmp_path, code, tail="{num_disparities}"):
    path = tmp_path / "a matcher.py"
    path.write_text(code)
    return f"{sys.executable} '{path}' {{left}} {{right}} {{out}} {tail}"


def test_a_program_is_given_the_images_and_its_map_comes_back_the_right_way_up(tmp_path):
    left, right = scene()
    got = tm.Program(program(tmp_path, COPY), num_disparities=3).match(left, right)
    np.testing.assert_array_equal(got, left + np.float32(3))


FAULTS = {
    "fails": ("import sys; sys.exit('no model found')", "status 1: no model found"),
    "writes nothing": ("pass", "wrote no file"),
    "hangs": ("import time; time.sleep(60)", "longer than 0.5 s"),
    "writes rubbish": ("import sys; open(sys.argv[3], 'wb').write(b'hello')", "not a PFM"),
    "is cut short": ("import sys; open(sys.argv[3], 'wb').write(b'Pf\\n120 60\\n-1.0\\nabc')", "of the size it names"),
    "has another size": (
        "import sys; open(sys.argv[3], 'wb').write(b'Pf\\n1 1\\n-1.0\\nabcd')",
        r"shape \(1, 1\); the left image has \(60, 120\)",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_program_that_fails_says_so_in_one_line(case, tmp_path):
    code, message = FAULTS[case]
    timeout = 0.5 if case == "hangs" else 60
    with pytest.raises(InputError, match=message) as caught:
        tm.Program(program(tmp_path, code), timeout_s=timeout).match(*scene())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("command", "message"),
    [("prog {left} {right}", "{out}"), ("'prog {left} {right} {out}", "cannot be read"), ("", "{left}")],
)
def test_a_command_without_its_places_is_refused(command, message):
    with pytest.raises(InputError, match=message):
        tm.Program(command)


def test_a_program_that_is_not_there_is_named():
    with pytest.raises(InputError, match="'no-such-program' cannot be started"):
        tm.Program("no-such-program {left} {right} {out}").match(*scene())
