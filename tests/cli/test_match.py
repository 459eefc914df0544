"""`twinlens match`: search limits, protected files, and the colours of the picture."""

import json

import numpy as np
import pytest

import twinlens as tl
from twinlens.dataset import read_pfm, write_png
from twinlens.dataset.pictures import disparity_limits
from twinlens.matching import METHODS, StereoMatcher
from twinlens.matching.contract import LARGEST_DEFAULT_WINDOW, WINDOW_OPTIONS
from twinlens.matching.networks import OnnxNetwork


@pytest.fixture
def images(tmp_path):
    """A pair 40 x 30, shifted by 3 px."""
    right = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)
    for name, image in (("l.png", np.roll(right, 3, axis=1)), ("r.png", right)):
        write_png(tmp_path / name, image)
    return tmp_path / "l.png", tmp_path / "r.png"


def test_input_images_and_samples_are_not_overwritten(twinlens, images, tmp_path):
    before, map_ = images[0].read_bytes(), tmp_path / "d.pfm"
    sample, same = tmp_path / "sample", tmp_path / ".." / tmp_path.name / "l.png"
    sample.mkdir()
    (sample / "sample.json").write_text("{}")
    for options, words in (
        (("-o", map_, "--picture", same), "is one of the two images"),
        (("-o", sample / "disp0.pfm"), "is in a sample of a dataset"),
        (("-o", map_, "--picture", sample / "im1.png"), "is in a sample of a dataset"),
    ):
        code, out, err = twinlens("match", *images, *options)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    assert images[0].read_bytes() == before
    assert [path.name for path in sample.iterdir()] == ["sample.json"]
    assert not map_.exists()


def test_colours_span_the_search_range_or_else_the_map():
    disparity = np.array([[2.5, np.inf, 7.0]], np.float32)
    network = OnnxNetwork("n.onnx")
    assert disparity_limits(
        disparity, StereoMatcher(min_disparity=-4, num_disparities=10)
    ) == (-4, 5)
    assert disparity_limits(disparity, network) == (2.5, 7)
    assert disparity_limits(disparity[:, :1], network) == (2.5, 3.5)
    assert disparity_limits(disparity[:, 1:2], network) == (0, 1)


@pytest.mark.parametrize("size", [(1, 1), (5, 3)])
def test_default_options_match_images_smaller_than_their_windows(size):
    """The default windows are larger than these images."""
    image = np.zeros(size, np.uint8)
    for method in ("zncc", "cross", "sgm"):
        assert tl.match(image, image, method=method).shape == size


def test_the_largest_default_window():
    defaults = [
        method.options.get(name) or 0
        for method in METHODS.values()
        for name in WINDOW_OPTIONS
    ]
    assert max(defaults) == LARGEST_DEFAULT_WINDOW


def test_a_function_that_prints_or_raises(twinlens, images, tmp_path):
    """What it prints does not mix with JSON, and what it raises is one line."""
    file = tmp_path / "own.py"
    file.write_text(
        "import numpy as np\n\ndef flat(left, right, **_):\n    print('hello')\n    return np.ones(left.shape[:2])\n\n"
        "def boom(left, right, **_):\n    raise RuntimeError('no\\nluck')\n"
    )
    line = ("match", *images, "--json", "-o", tmp_path / "disp.pfm", "--method")
    code, out, err = twinlens(*line, f"function:{file}:flat")
    assert (code, err) == (0, "hello\n")
    assert json.loads(out)["known_fraction"] == 1
    error = f"twinlens: function '{file}:boom' failed: RuntimeError: no luck\n"
    assert twinlens(*line, f"function:{file}:boom") == (1, "", error)


def test_the_confidence_is_written(twinlens, images, tmp_path):
    file = tmp_path / "c.pfm"
    method = ("--ndisp", "8", "--method", "sad:confidence=peak_ratio")
    line = ("match", *images, *method, "-o", tmp_path / "d.pfm", "--confidence", file)
    assert twinlens(*line)[0] == 0
    confidence = read_pfm(file)
    assert confidence.shape == (30, 40)
    assert (confidence[5:-5, 15:-5] == 1).all(), "the shifted images differ nowhere"


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ("np.int16(16 * 3 * np.ones(left.shape[:2]))", "48 to 48, are outside the searched 0 to 7 px"),
        ("np.where(np.arange(left.shape[1]) < 15, 3.0, -16.0) * np.ones(left.shape[:2])", "-16 to 3, are outside"),
        ("100 * np.ones(left.shape[:2])", "100 to 100, are outside"),
        ("3 * np.ones(left.shape[:2])", ""),
        ("np.full(left.shape[:2], np.inf)", ""),
    ],
)  # fmt: skip
def test_values_outside_the_search_are_named(twinlens, images, tmp_path, values, says):
    """As those of a map in sixteenths of a pixel; nothing is said of a map within the search, or of an empty one."""
    file = tmp_path / "own.py"
    file.write_text(f"import numpy as np\n\ndef own(left, right, **_):\n    return {values}\n")  # fmt: skip
    method = ("--method", f"function:{file}:own", "--ndisp", "8")
    code, _, err = twinlens("match", *images, *method, "-o", tmp_path / "d.pfm")
    assert code == 0
    assert says in err
    assert bool(err) == bool(says)
