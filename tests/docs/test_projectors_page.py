"""The Python blocks of docs/projectors.md run one after another, with fewer samples and pixels."""

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "projectors.md").read_text()
SMALLER = {
    "848, 480": "212, 120",
    "(320, 240": "(80, 60",
    "512, 384": "64, 48",
    "spp=64": "spp=16",
    "spp=32": "spp=4",
}


@pytest.mark.slow
def test_blocks_run_and_decoded_columns_are_those_of_the_truth():
    made: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.S):
        for old, new in SMALLER.items():
            block = block.replace(old, new)
        exec(block, made)
    truth = made["tl"].projection(made["scene"], made["rig"])
    error = np.abs(made["columns"] - truth.pixels[..., 0])[truth.lit]
    assert np.median(error) < 0.5
    assert ((made["depth"] > 0.3) & (made["depth"] < 10)).mean() > 0.2
