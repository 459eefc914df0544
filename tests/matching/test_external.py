"""OpenCV, functions and programs as methods: their results, and errors of one line that name them."""

import resource
import sys
import time

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import InputError, MissingExtraError
from twinlens.matching.contract import MatcherFailedError
from twinlens.matching.external import PythonFunction

cv2 = pytest.importorskip("cv2")


def scene(shift=5):
    noise = np.random.default_rng(0).normal(128, 160, (60, 160))
    texture = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.2), 0, 255).astype(np.uint8)
    return texture[:, 20:140], texture[:, 20 + shift : 140 + shift]


@pytest.mark.parametrize(
    "method",
    ["opencv_bm", "opencv_sgbm", "opencv_sgbm:mode=hh", "opencv_bm:prefilter=false"],
)
@pytest.mark.parametrize(("shift", "low"), [(5, 0), (-6, -16)])
def test_opencv_matchers_find_a_shift(method, shift, low):
    images = scene(shift)
    disparity = tm.match(*images, method, num_disparities=20, min_disparity=low)
    inside = disparity[10:-10, 40:-40]
    assert np.mean(np.abs(inside - shift) < 0.5) > 0.95
    assert not np.isnan(disparity).any()
    assert np.isinf(disparity).any()


def test_opencv_sgbm_equals_a_direct_call():
    left, right = scene()
    matcher = cv2.StereoSGBM.create(0, 32, 5, P1=200, P2=800)
    by_hand = matcher.compute(left, right).astype(np.float32) / 16
    ours = tm.match(left, right, "opencv_sgbm", num_disparities=32, block_size=5)
    np.testing.assert_array_equal(ours, np.where(by_hand < 0, np.inf, by_hand))


@pytest.mark.parametrize("mode", ["default", "hh", "3way"])
def test_opencv_sgbm_refuses_a_range_wider_than_the_image(mode):
    """At 34 columns it is refused, at 35 it is matched."""
    options = {"mode": mode, "num_disparities": 32, "block_size": 5}
    wide, narrow = (
        [np.ascontiguousarray(image[:, :width]) for image in scene()]
        for width in (35, 34)
    )
    assert tm.match(*wide, "opencv_sgbm", **options).shape == wide[0].shape
    with pytest.raises(InputError, match="wider than 34 pixels"):
        tm.match(*narrow, "opencv_sgbm", **options)


@pytest.mark.parametrize("option", ["opencv_bm:texture", "opencv_sgbm:uniqueness"])
def test_errors_of_opencv_are_one_line(option):
    with pytest.raises(InputError, match=r"^OpenCV's Stereo\w+ failed: [^\n]+$"):
        tm.match(*scene(), f"{option}=1000000000000")


def test_without_opencv_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtraError, match=r"twinlens\[opencv\]"):
        tm.match(*scene(), "opencv_bm")
    # Before a board runs anything.
    with pytest.raises(MissingExtraError, match="opencv"):
        tm.parse_method("opencv_sgbm").check_parts()


def constant(left, _right, num_disparities, min_disparity):
    return np.full(left.shape[:2], min_disparity + num_disparities)


def test_a_function_receives_the_range():
    left, right = scene()
    method = f"function:function={__name__}:constant"
    disparity = tm.match(left, right, method, num_disparities=7, min_disparity=2)
    np.testing.assert_array_equal(disparity, np.full(left.shape, 9, np.float32))


RESULTS = {
    "wrong shape": (
        lambda left: left[1:],
        r"shape \(59, 120\); the left image has \(60, 120\)",
    ),
    "not a number": (
        lambda left: np.where(left == left[3, 4], np.nan, 1.0),
        "returned nan at",
    ),
    "minus infinity": (
        lambda left: np.full(left.shape, -np.inf),
        r"-inf at \[0, 0\]; unknown .* \+inf",
    ),
    "complex numbers": (
        lambda left: left * 1j,
        "returned ndarray, not an array of real",
    ),
}


@pytest.mark.parametrize("case", RESULTS)
def test_the_result_of_a_function_is_checked(case):
    result, message = RESULTS[case]
    function = PythonFunction(lambda left, _right, **_range: result(left))
    with pytest.raises(InputError, match=message):
        function.match(*scene())


def test_an_exception_of_a_function_is_named_after_the_function():
    def boom(*_images, **_range):
        raise ValueError("no luck")

    message = r"^function 'boom' failed: ValueError: no luck$"
    with pytest.raises(MatcherFailedError, match=message) as caught:
        tm.match(*scene(), PythonFunction(boom))
    assert isinstance(caught.value.__cause__, ValueError)


COPY = """
import sys, numpy as np
from PIL import Image
left, right, *outs, value = sys.argv[1:]
image = np.asarray(Image.open(left))
for out in outs:
    with open(out, "wb") as file:
        file.write(b"Pf\\n%d %d\\n-1.0\\n" % image.shape[::-1])
        file.write((image[::-1] + np.float32(value)).astype("<f4").tobytes())
"""


def program(tmp_path, code, tail="{num_disparities}"):
    path = tmp_path / "a matcher.py"
    path.write_text(code)
    return f"{sys.executable} '{path}' {{left}} {{right}} {{out}} {tail}"


def test_a_program_may_write_a_confidence_and_its_maps_are_read_top_down(tmp_path):
    left, right = scene()
    command = program(tmp_path, COPY, "{confidence} {num_disparities}")
    answer = tm.Program(command, num_disparities=3).match_with_confidence(left, right)
    np.testing.assert_array_equal(answer.disparity, left + np.float32(3))
    np.testing.assert_array_equal(answer.confidence, answer.disparity)
    command = program(tmp_path, COPY.replace("*outs, value", "*outs, value, _"), "1")
    with pytest.raises(InputError, match=r"wrote no file at \{confidence\}"):
        tm.Program(f"{command} {{confidence}}").match(left, right)


WRITE = "import sys\nopen(sys.argv[3], 'wb').write"
FAULTS = {
    "is killed": (
        "import os; os.kill(os.getpid(), 9)",
        r"killed by SIGKILL \(out of memory\?\)",
    ),
    "fails at length": (
        "import os, sys\nfor _ in range(2000): os.write(1, b'x' * 65535 + b'\\n')\nsys.exit('so much for that')",
        "status 1: so much for that",
    ),
    "writes nothing": ("pass", "wrote no file"),
    "prints forever": (
        "import os\nwhile True: os.write(1, b'x' * 65536)",
        "longer than 0.5 s",
    ),
    "writes rubbish": (f"{WRITE}(b'hello')", "not a PFM"),
    "is larger than its header says": (
        f"{WRITE}(b'Pf\\n120 60\\n-1.0\\n')\nopen(sys.argv[3], 'ab').truncate(1 << 36)",
        "of the size in its header",
    ),
    "has another size": (
        f"{WRITE}(b'Pf\\n1 1\\n-1.0\\nabcd')",
        r"shape \(1, 1\); the left image has \(60, 120\)",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_the_failure_of_a_program_is_one_line(case, tmp_path):
    code, message = FAULTS[case]
    timeout = 0.5 if "longer" in message else 60
    with pytest.raises(InputError, match=message) as caught:
        tm.Program(program(tmp_path, code), timeout_s=timeout).match(*scene())
    assert "\n" not in str(caught.value)


TALK = "import os, sys\nfor _ in range(800): os.write(1, b'x' * 65536); os.write(2, b'y' * 65536)\n"
CHILD = "\nimport subprocess; subprocess.Popen(['sleep', '20'])"


def test_a_programs_output_is_not_kept_and_its_children_are_not_waited_for(tmp_path):
    """The program prints 100 MB, and leaves a child that holds its pipe open."""
    left, right = scene()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.monotonic()
    command = program(tmp_path, TALK + COPY + CHILD)
    disparity = tm.Program(command, num_disparities=3).match(left, right)
    assert time.monotonic() - started < 15
    np.testing.assert_array_equal(disparity, left + np.float32(3))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


WEIGHTED = """
import sys, cv2, numpy as np
image = cv2.imread(sys.argv[1], cv2.IMREAD_UNCHANGED)
values = image.astype(np.float32).reshape(*image.shape[:2], -1) @ np.float32([4, 2, 1][-image[0, 0].size :])
with open(sys.argv[3], "wb") as file:
    file.write(b"Pf\\n%d %d\\n-1.0\\n" % values.shape[::-1] + values[::-1].astype("<f4").tobytes())
"""


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(1,), (3,)])
def test_a_program_reads_8_and_16_bit_grey_and_colour_exactly(
    tmp_path, dtype, channels
):
    """OpenCV, which reads 16-bit colour, checks the PNG files."""
    rng = np.random.default_rng(3)
    image = rng.integers(0, np.iinfo(dtype).max, (7, 9, *channels), dtype)
    disparity = tm.Program(program(tmp_path, WEIGHTED)).match(image, image)
    weights = np.float32([1, 2, 4][: channels[0]])
    np.testing.assert_array_equal(disparity, image.astype(np.float32) @ weights)


def test_a_missing_program_is_named():
    with pytest.raises(InputError, match="'no-such-program' cannot be started"):
        tm.Program("no-such-program {left} {right} {out}").match(*scene())


def test_the_content_of_a_program_includes_the_files_of_its_command(tmp_path):
    weights, script = tmp_path / "w.bin", tmp_path / "a matcher.py"
    text = f"{program(tmp_path, 'pass')} --weights={weights}"
    contents = [tm.Program(text).content]
    for path, data in ((weights, "1"), (weights, "2"), (script, "print()")):
        path.write_text(data)
        contents.append(tm.Program(text).content)
    assert len(set(contents)) == 4
    assert all("a matcher.py=" in content for content in contents)
    assert tm.Program(text).content == contents[-1]
    assert tm.Program("no-such-program {left} {right} {out}").content == ""


def test_the_content_of_a_function_is_its_file(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    place, contents = tmp_path / "somebodys_matcher.py", set()
    for text in ("def f(): 1", "def f(): 22"):
        place.write_text(text)
        contents.add(PythonFunction("somebodys_matcher:f").content)
    assert len(contents) == 2
    assert PythonFunction("no_such_module.at_all:f").content == ""
    assert PythonFunction(constant).content == ""
