"""`twinlens match`: the picture has colours whatever was searched, and a search that cannot be meant is refused."""

import numpy as np
import pytest

from twinlens.cli.match import DEFAULT_WINDOW, WINDOWS, picture_range
from twinlens.dataset import read_pfm, read_png, write_png
from twinlens.matching import METHODS, OnnxNetwork, StereoMatcher


@pytest.fixture
def images(tmp_path):
    """A pair 40 x 30, shifted by 3 px."""
    right = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)
    for name, image in (("l.png", np.roll(right, 3, axis=1)), ("r.png", right)):
        write_png(tmp_path / name, image)
    return tmp_path / "l.png", tmp_path / "r.png"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--ndisp", "80"), "num_disparities (--ndisp) is 80: an image 40 pixels wide has disparities from -39 to 39"),
        (("--ndisp", "1000000000"), "79 in all"),
        (("--min-disparity", "40"), "min_disparity is 40: an image 40 pixels wide"),
        (("--min-disparity", "-1000000000"), "from -39 to 39"),
        (("--method", "sad:num_disparities=100"), "num_disparities (--ndisp) is 100"),
        (("--method", "sad:block_size=999999"), "block_size is 999999: a window of 79 sees all of an image of 40 x 30"),
        (("--method", "sad:median=81"), "median is 81"),
        (("--method", "census:census_window=81"), "census_window is 81"),
        (("--method", "opencv_sgbm:block_size=99999"), "block_size is 99999"),
        (("--method", "onnx:model=n.onnx", "--ndisp", "8"), "searches the disparities that it was made for"),
    ],
)
def test_what_no_image_of_this_size_can_need_is_refused(twinlens, images, tmp_path, options, words):
    code, out, err = twinlens("match", *images, *options, "-o", tmp_path / "d.pfm")
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "d.pfm").exists()


def test_neither_its_images_nor_a_samples_truth_are_written_over(twinlens, images, tmp_path):
    before = images[0].read_bytes()
    sample = tmp_path / "sample"
    sample.mkdir()
    (sample / "sample.json").write_text("{}")
    for options, words in (
        (
            ("-o", tmp_path / "d.pfm", "--picture", tmp_path / ".." / tmp_path.name / "l.png"),
            "is one of the two images",
        ),
        (("-o", sample / "disp0.pfm"), "stands in a sample of a dataset"),
        (("-o", tmp_path / "d.pfm", "--picture", sample / "im1.png"), "stands in a sample of a dataset"),
    ):
        code, out, err = twinlens("match", *images, *options)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    assert images[0].read_bytes() == before
    assert [path.name for path in sample.iterdir()] == ["sample.json"]
    assert not (tmp_path / "d.pfm").exists()


@pytest.mark.parametrize(
    "options", [("--ndisp", "79", "--min-disparity", "-39"), (), ("--method", "sad:block_size=79")]
)
def test_the_most_that_an_image_can_need_is_done(twinlens, images, tmp_path, options):
    code, _, err = twinlens("match", *images, *options, "-o", tmp_path / "d.pfm")
    assert code == 0, err


@pytest.mark.parametrize("ndisp", ["1", "2", "16"])
def test_the_picture_has_a_range_however_few_are_searched(twinlens, images, tmp_path, ndisp):
    code, _, err = twinlens(
        "match", *images, "--ndisp", ndisp, "--min-disparity", "3", "--method", "sad", "-o", tmp_path / "d.pfm",
        "--picture", tmp_path / "d.png",
    )  # fmt: skip
    assert code == 0, err
    assert read_pfm(tmp_path / "d.pfm")[15, 20] == pytest.approx(3, abs=0.5)
    assert read_png(tmp_path / "d.png").shape == (30, 40, 3)


def test_the_picture_spans_what_was_searched_or_else_what_was_found():
    found = np.array([[2.5, np.inf, 7.0]], np.float32)
    network = OnnxNetwork("n.onnx")
    assert picture_range(found, StereoMatcher(min_disparity=-4, num_disparities=10)) == (-4, 5)
    assert picture_range(found, network) == (2.5, 7)
    assert picture_range(found[:, :1], network) == (2.5, 3.5)
    assert picture_range(found[:, 1:2], network) == (0, 1)


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (5, 3)])
def test_a_thumbnail_is_matched_by_what_nobody_asked_to_change(twinlens, tmp_path, size):
    """Every method's own window is larger than that."""
    write_png(tmp_path / "a.png", np.zeros(size, np.uint8))
    for method in ("zncc", "cross", "sgm"):
        arguments = ("match", tmp_path / "a.png", tmp_path / "a.png", "--method", method, "-o", tmp_path / "d.pfm")
        code, _, err = twinlens(*arguments)
        assert code == 0, err
        assert read_pfm(tmp_path / "d.pfm").shape == size


def test_no_method_has_a_larger_window_of_its_own():
    assert max(method.options.get(name) or 0 for method in METHODS.values() for name in WINDOWS) == DEFAULT_WINDOW
