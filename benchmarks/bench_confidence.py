"""Confidence measures on Middlebury's Motorcycle: their sparsification, and ambiguity compared with CNES Pandora.

    python benchmarks/bench_confidence.py [--pandora VENV/bin/python] [--write]

Columns: the error rate (above 2 px) of pixels visible in both views, the smallest possible area below the
sparsification curve, and the area of each measure, in percent. A random confidence has the error rate as its area.

CNES Pandora runs in a separate virtual environment: `python -m venv V; V/bin/pip install pandora==1.9.0`, then
`--pandora V/bin/python`. It gets the same cost volumes. The first 8 pixels of the first row are not compared: Pandora
1.9.0 reads memory there that it has freed (`min_max_cost` returns views of local arrays). `--write` writes the table to
benchmarks/confidence.md.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from twinlens.matching import CONFIDENCES, parse_method
from twinlens.scoring import motorcycle, score_confidences

METHODS = (
    "sad",
    "zncc",
    "census",
    "census:block_size=1,census_window=5",
    "adaptive",
    "sgm",
)
FREED = 8  # pixels
PAGE = Path(__file__).with_name("confidence.md")
HEAD = """# Confidence measures on Motorcycle

`python benchmarks/bench_confidence.py --pandora VENV/bin/python --write`. Errors above 2 px of pixels visible in both
views. The columns of the measures are the area below the sparsification curve in percent: `auc2.0`. A random confidence
has the error rate as its area. The last column compares all pixels but the first 8, where Pandora 1.9.0 reads memory
that it has freed.
"""
PANDORA = """
import sys
import numpy as np
import xarray as xr
from pandora.cost_volume_confidence import AbstractCostVolumeConfidence

costs = np.load(sys.argv[1])
costs[np.isinf(costs)] = np.nan
height, width, count = costs.shape
axes = {"row": np.arange(height), "col": np.arange(width)}
volume = xr.Dataset({"cost_volume": (["row", "col", "disp"], costs)}, coords=axes | {"disp": np.arange(count)})
volume.attrs = {"type_measure": "min", "subpixel": 1}
ends = np.stack([np.full((height, width), end, np.int64) for end in (0, count - 1)])
image = xr.Dataset({"disparity": (["band_disp", "row", "col"], ends)}, coords=axes | {"band_disp": ["min", "max"]})
method = AbstractCostVolumeConfidence(confidence_method="ambiguity", eta_max=0.7, eta_step=0.01)
np.save(sys.argv[2], method.confidence_prediction(None, image, image, volume)[1]["confidence_measure"].data[..., -1])
"""


def pandoras(volume: np.ndarray, python: str) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        costs, answer = Path(folder) / "costs.npy", Path(folder) / "answer.npy"
        np.save(costs, volume)
        subprocess.run([python, "-c", PANDORA, str(costs), str(answer)], check=True)
        return np.load(answer)


def row(text: str, python: str | None) -> str:
    pair = motorcycle()
    matcher = parse_method(text).matcher(**pair.search)
    found, difference = score_confidences(pair, matcher), "-"
    first = found.scores["ambiguity"]
    if python is not None:
        theirs = pandoras(matcher.cost_volume(pair.im0, pair.im1), python)
        difference = (
            f"{np.abs(theirs - found.maps['ambiguity']).ravel()[FREED:].max():.1g}"
        )
    areas = [scores["auc2.0"] for scores in found.scores.values()]
    numbers = [
        f"{value:.2f}" for value in (first["bad2.0"], first["auc2.0_opt"], *areas)
    ]
    return f"| `{text}` | {' | '.join([*numbers, difference])} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pandora", help="Python of an environment with Pandora.")
    parser.add_argument(
        "--write",
        action="store_true",
        help="Write the table to benchmarks/confidence.md.",
    )
    arguments = parser.parse_args()
    head = (
        "method",
        "bad2.0 %",
        "smallest auc2.0 %",
        *CONFIDENCES,
        "ambiguity: largest difference to Pandora",
    )
    lines = [f"| {' | '.join(head)} |", f"| --- |{' ---: |' * (len(head) - 1)}"]
    lines += [row(text, arguments.pandora) for text in METHODS]
    table = "\n".join(lines)
    print(table)
    if arguments.write:
        PAGE.write_text(f"{HEAD}\n{table}\n")


if __name__ == "__main__":
    main()
