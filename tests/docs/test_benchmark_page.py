"""docs/benchmark.md lists exactly the existing protocols, regions, failures and keys."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from twinlens.scoring import PROTOCOLS, REGIONS, Pair, board_to_json, run_benchmark

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
    listed = re.findall(
        r"`([^`]+)`", "".join(re.findall(r"^\| (`.*?) \|", section("Regions"), re.M))
    )
    assert listed == list(REGIONS)
    assert re.findall(
        r"`([^`]+)`", re.search(r"^\| \| (.*) \|$", section("Protocols"), re.M)[1]
    ) == list(PROTOCOLS)


@pytest.mark.filterwarnings("ignore::twinlens.scoring.benchmark.MapWarning")
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
