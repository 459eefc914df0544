"""Options and images that are refused, in one line that says what is allowed, before anything runs."""

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import InputError
from twinlens.matching import StereoMatcher
from twinlens.matching.contract import check_image_size

OPTIONS = {
    "sadd": "did you mean 'sad'",
    "sad:blok_size=3": "did you mean 'block_size'",
    "sad:block_size": "write option=value",
    "sad:block_size=8": "use 7 or 9",
    "sad:block_size=-1": ">= 1",
    "sad:block_size=big": "whole number",
    "sad:num_disparities=0": ">= 1",
    "sad:min_disparity=0.5": "whole number",
    "sad:contrast=none": "a number >= 0",
    "sad:speckle_range=none": "a number >= 0",
    "sad:uniqueness=abc": "a number from 0 to below 100",
    "sad:uniqueness=100": "from 0 to below 100",
    "sad:lr_check=-1": ">= 0",
    "sad:subpixel=parabolla": "did you mean 'parabola'",
    "opencv_bm:texture=-1": ">= 0",
    "opencv_bm:uniqueness=abc": "whole number",
    "opencv_bm:block_size=4": "must be an odd whole number >= 5, got 4",
    "opencv_bm:block_size=6": "use 5 or 7",
    "opencv_sgbm:uniqueness=1.5": "whole number",
    "program:command=x,timeout_s=nan": "a number > 0",
    "program:prog {left} {right}": "{out}",
    "program:'prog \"{left} {right} {out}'": "cannot be read",
    "program:": "{left}",
    "onnx:": "name an .onnx file",
    "onnx:model=net.pt": "name an .onnx file",
    "onnx:model=n.onnx,scale=0": "a number > 0",
    "onnx:model=n.onnx,sign=2": "one of 1, -1",
    "onnx:model=n.onnx,multiple=0": ">= 1",
    "function:right.py": "write path/to/file.py:name",
}
GOOD = np.zeros((4, 6), np.uint8)
IMAGES = {
    "sizes differ": ((GOOD, GOOD[:3]), {}, "6x4 and 6x3"),
    "dtypes differ": ((GOOD, GOOD.astype(np.uint16)), {}, "one dtype"),
    "wide integers": ((GOOD.astype(np.int64),) * 2, {}, "use uint8, uint16 or float32"),
    "not a number": (
        (GOOD.astype(float), np.full((4, 6), np.nan)),
        {},
        r"right image holds nan at \[0, 0\]",
    ),
    "no image": ((GOOD[:0], GOOD[:0]), {}, r"shape \(0, 6\)"),
    "four channels": ((np.zeros((4, 6, 4), np.uint8),) * 2, {}, "H, W, 3"),
    "unknown method": ((GOOD, GOOD), {"method": "znc"}, "did you mean 'zncc'"),
    "unknown option": ((GOOD, GOOD), {"blocksize": 5}, "did you mean 'block_size'"),
    "misspelt method": ((GOOD, GOOD), {"methd": "sad"}, "did you mean 'method'"),
    "a path": (
        ("a.png", "b.png"),
        {},
        r"left image is 'a.png'; give an array: twinlens.dataset.read_image",
    ),
    "unknown fit": ((GOOD, GOOD), {"subpixel": "parabolla"}, "did you mean 'parabola'"),
    "negative check": ((GOOD, GOOD), {"lr_check": -1}, ">= 0"),
    "negative light": ((GOOD - 1.0, GOOD - 1.0), {"method": "jaccard"}, "values >= 0"),
}


def test_wrong_options_are_refused():
    for text, message in OPTIONS.items():
        with pytest.raises(InputError, match=message) as refusal:
            tm.parse_method(text)
        assert "\n" not in str(refusal.value), text


def test_wrong_images_and_arguments_are_refused():
    for images, options, message in IMAGES.values():
        with pytest.raises(InputError, match=message) as refusal:
            tm.match(*images, **options)
        assert "\n" not in str(refusal.value), message


LIMITS = {
    "num_disparities": (79, 80, "num_disparities is 80: an image 40 pixels wide"),
    "min_disparity": (-39, -40, "min_disparity is -40: .* from -39 to 39"),
    "block_size": (79, 81, "is 81: a window of 79 covers all of an image of 40 x 30"),
    "median": (79, 81, "median is 81"),
}


@pytest.mark.parametrize("name", LIMITS)
def test_searches_and_windows_up_to_the_size_of_the_images_are_accepted(name):
    largest, larger, message = LIMITS[name]
    check_image_size(StereoMatcher("sad", **{name: largest}), (30, 40))
    with pytest.raises(InputError, match=message):
        check_image_size(StereoMatcher("sad", **{name: larger}), (30, 40))


def test_none_switches_an_option_off():
    off = tm.parse_method("sad:uniqueness=none,texture=none").matcher()
    assert off == tm.parse_method("sad").matcher()
