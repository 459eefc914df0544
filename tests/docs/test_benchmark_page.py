"""docs/benchmark.md lists exactly the existing protocols, regions, failures and keys."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl
from twinlens.scoring import PROTOCOLS, REGIONS, Pair, board_to_json, run_benchmark
from twinlens.scoring.board import FAILURES

PAGE = (Path(__file__).parents[2] / "docs" / "benchmark.md").read_text()


class Nothing:
    """Returns an empty map, or raises."""

    def __init__(self, name, fails=False):
        self.name, self.fails = name, fails

    def match(self, left, right, *, num_disparities, min_disparity):
        if self.fails:
            raise ValueError
        return np.full(left.shape[:2], np.inf, np.float32)


def section(title):
    return PAGE.partition(f"## {title}\n")[2].partition("\n## ")[0]


def test_every_region_and_protocol_is_listed():
    found = re.findall(
        r"`([^`]+)`", "".join(re.findall(r"^\| (`.*?) \|", section("Regions"), re.M))
    )
    assert found == list(REGIONS)
    assert re.findall(
        r"`([^`]+)`", re.search(r"^\| \| (.*) \|$", section("Protocols"), re.M)[1]
    ) == list(PROTOCOLS)


def test_every_failure_is_listed_with_its_text():
    rows = dict(re.findall(r"^\| `([a-z-]+)` \| (.*) \|$", section("Methods"), re.M))
    assert rows == dict(FAILURES)


def test_every_key_of_a_board_is_listed():
    image = np.zeros((4, 5), np.uint8)
    pair = Pair("s", image, image, np.ones((4, 5), np.float32), None, 8)
    board = json.loads(
        board_to_json(
            run_benchmark([pair], [Nothing("a"), Nothing("b", True)], warm_up=False)
        )
    )
    text = section("board.json")
    failed = board["entries"][1]["failure"]
    region = board["entries"][0]["regions"]["all"]
    for keys in (
        board,
        *board["entries"],
        failed,
        region,
        *board["protocols"].values(),
        board["meta"],
    ):
        for key in keys:
            assert re.search(rf"\b{key}\b", text), key


def test_the_foreground_and_background_example():
    """D1 of all pixels is the mean of D1-fg and D1-bg weighted by their pixels."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(10, 30, (20, 30)).astype(np.float32)
    disp = truth + rng.choice([0, 5], truth.shape).astype(np.float32)
    ids = np.where(np.indices(truth.shape)[1] < 9, 7, 2)
    scores = tl.evaluate(
        disp, truth, protocol="kitti2015", regions={"fg": ids == 7, "bg": ids != 7}
    )
    fg, bg = scores.regions["fg"], scores.regions["bg"]
    both = (fg["D1"] * fg.evaluated + bg["D1"] * bg.evaluated) / scores.all.evaluated
    assert scores.all["D1"] == pytest.approx(both, rel=1e-12)
    assert fg.evaluated == 9 * 20
