"""My matcher fails, or only seems to: what a board says of it, by commands alone."""

import json

import numpy as np
import pytest

import twinlens as tl
from twinlens.cli import run
from twinlens.dataset import write_pfm

METHODS = """
import cv2
import numpy as np

def raw(left, right, num_disparities, min_disparity):
    count = -(-num_disparities // 16) * 16
    return cv2.StereoSGBM.create(min_disparity, count, 5).compute(left, right)

def sixteen(left, right, **search):
    return raw(left, right, **search).astype(np.float32)

def transposed(left, right, **search):
    return np.zeros(left.shape[1::-1], np.float32)

def half(left, right, **search):
    return np.zeros((left.shape[0] // 2, left.shape[1] // 2), np.float32)

def inner(scale):
    raise ValueError(f"bad scale {scale}")

def crash(left, right, **search):
    inner(3)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dataset of a textured slanted plane, and methods that are wrong in several ways."""
    folder = tmp_path_factory.mktemp("failing")
    (folder / "my.py").write_text(METHODS)
    shots = ("--size", "160x120", "--spp", "1", "--no-denoise")
    assert run(["render", "cards", *shots, "-o", str(folder / "data")]) == 0
    return folder


def methods(folder, *names):
    texts = [f"{name}=function:{folder / 'my.py'}:{name}" for name in names]
    return "--methods", ",".join(texts)


def test_a_scaled_map_is_said_in_one_warning(twinlens, folder):
    board = folder / "scaled"
    command = (
        "benchmark",
        folder / "data",
        *methods(folder, "raw", "sixteen"),
        "-o",
        board,
    )
    for _ in range(2):  # the second run only reads the board
        code, _, err = twinlens(*command)
        assert code == 0
        assert err.count("raw, its map: values look scaled by 16") == 1
        assert err.count("sixteen, its map: values look scaled by 16") == 1
    document = json.loads((board / "board.json").read_text())
    assert "scaled by 16" in document["entries"][0]["doubt"]
    assert "scaled by 16" in (board / "index.html").read_text()
    code, out, err = twinlens(
        "benchmark", folder / "data", "--methods", "opencv_sgbm", "-o", folder / "right"
    )
    assert code == 0
    assert "look" not in out + err


def test_failures_say_what_to_do(twinlens, folder):
    names = ("transposed", "half", "crash")
    board = folder / "failed"
    command = ("benchmark", folder / "data", *methods(folder, *names), "-o", board)
    code, out, _ = twinlens(*command)
    assert code == 1  # no method has scores
    assert "transpose the map" in out
    assert "multiply its values by 2" in out
    assert "ValueError: bad scale 3" in out
    assert "in inner: raise ValueError" in out


def test_maps_made_elsewhere_are_doubted_too(twinlens, folder):
    maps = folder / "maps"
    maps.mkdir()
    sample = tl.Dataset(folder / "data")[0]
    disparity = sample.disp0
    negative = np.where(np.isfinite(disparity), -disparity, np.inf)
    write_pfm(maps / "cards.pfm", negative)
    truth = ("--truth", folder / "data")
    code, _, err = twinlens("score", maps, *truth, "-o", folder / "scored")
    assert code == 0
    assert "wrong sign" in err
    write_pfm(folder / "none.pfm", np.full_like(disparity, np.inf))
    truth = ("--truth", folder / "data" / "cards" / "disp0.pfm")
    code, out, _ = twinlens("score", folder / "none.pfm", *truth)
    assert code == 0
    assert "doubtful: the map has no estimate" in out
