"""Accuracy of matchers on Middlebury's Motorcycle: twinlens, OpenCV, CNES Pandora and the Machine Vision Toolbox.

    python benchmarks/bench_accuracy.py [--peers VENV/bin/python] [--write]

80 disparities, all pixels with known truth. Missing estimates count as bad (totbad2.0 of Middlebury v3, region `all`).
Every method runs with its defaults. OpenCV's StereoBM also runs without the two filters that mark pixels as unknown.
Times are medians of three calls after a warm-up call, on all processors: wall time, and processor time, which is more
robust on a busy machine.

CNES Pandora 1.9 and the Machine Vision Toolbox 2.4 run in a separate virtual environment:
`python -m venv V; V/bin/pip install pandora==1.9.0 machinevision-toolbox-python==2.4.1`, then `--peers
V/bin/python`. `--write` writes the table to benchmarks/accuracy.md.
"""

import argparse
import platform
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from twinlens.matching import grey, parse_method
from twinlens.scoring import evaluate, find_metric, motorcycle

COUNT = 80
METHODS = (
    "sad", "sad:prefilter=xsobel", "ssd", "ncc", "zncc", "census", "adaptive", "cross", "guided", "sgm4", "sgm",
    "opencv_bm", "opencv_bm:texture=0,uniqueness=0", "opencv_sgbm", "opencv_sgbm:mode=hh",
)  # fmt: skip
PEERS = ("Pandora", "Machine Vision Toolbox")
PAGE = Path(__file__).with_name("accuracy.md")
COLUMNS = ("totbad2.0", "bad2.0", "bad1.0", "invalid", "avgerr")
Found = tuple[str, np.ndarray, float, float]
"""Name of the method, disparity map, wall seconds and processor seconds of a call."""


def ours(left: np.ndarray, right: np.ndarray) -> Iterator[Found]:
    for text in METHODS:
        matcher = parse_method(text).matcher(num_disparities=COUNT)
        found, wall, processor = matcher.match(left, right), [], []
        for _ in range(3):
            start, used = time.perf_counter(), time.process_time()
            matcher.match(left, right)
            wall.append(time.perf_counter() - start)
            processor.append(time.process_time() - used)
        yield text, found, statistics.median(wall), statistics.median(processor)


def theirs(left: np.ndarray, right: np.ndarray, python: str) -> Iterator[Found]:
    with tempfile.TemporaryDirectory() as folder:
        pair, maps = Path(folder) / "pair.npz", Path(folder) / "maps.npz"
        np.savez(pair, left=left, right=right, count=COUNT)
        script = Path(__file__).with_name("peer_matchers.py")
        subprocess.run([python, str(script), str(pair), str(maps)], check=True)
        with np.load(maps) as answers:
            for name in (
                name for name in answers.files if not name.endswith("/seconds")
            ):
                unknown_as_infinite = np.where(
                    np.isfinite(answers[name]), answers[name], np.inf
                ).astype(np.float32)
                wall, processor = (
                    float(seconds) for seconds in answers[f"{name}/seconds"]
                )
                yield name, unknown_as_infinite, wall, processor


def row(found: Found, truth: np.ndarray) -> str:
    name, disparity, wall, processor = found
    scores = evaluate(disparity, truth, ndisp=COUNT, protocol="middlebury-v3").regions[
        "all"
    ]
    rate = truth.size * COUNT / processor / 1e6
    cells = [f"{scores[column]:.2f}" for column in COLUMNS]
    return f"| {name} | {' | '.join(cells)} | {1e3 * wall:.1f} | {1e3 * processor:.1f} | {rate:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--peers",
        metavar="PYTHON",
        help="the interpreter of a venv that has Pandora and the toolbox",
    )
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    options = parser.parse_args()
    real = motorcycle()
    left, right = grey(real.im0), grey(real.im1)
    lines = [
        f"| method | {' | '.join(f'{name} {find_metric(name).unit}' for name in COLUMNS)} | ms | processor ms | Mde |",
        "| --- |" + " ---: |" * (len(COLUMNS) + 3),
    ]
    print("\n".join(lines), flush=True)
    sources = [ours(left, right)] + (
        [theirs(left, right, options.peers)] if options.peers else []
    )
    for found in (found for source in sources for found in source):
        lines.append(row(found, real.disp0))
        print(lines[-1], flush=True)
    missing = [peer for peer in PEERS if not any(peer in line for line in lines)]
    notes = [f"{peer}: not installed, or it failed (see --peers)" for peer in missing]
    print("\n".join(notes))
    if options.write:
        PAGE.write_text(
            "\n".join([HEAD.format(processor=platform.machine()), *lines, *notes])
            + "\n"
        )


HEAD = """# Accuracy on Motorcycle

`python benchmarks/bench_accuracy.py --peers VENV/bin/python --write`. Middlebury 2014 Motorcycle, 741x500, grey, 80
disparities, all pixels with known truth; Middlebury v3's rules: totbad = bad + invalid, estimates clipped to [0, 80].
Times are medians of three calls on {processor}, with two processors that were also busy with other work. Mde: million
disparity evaluations per processor second, width x height x 80 / processor time. `bench_matching.py` measures speed.

`sad` compares brightness, while StereoBM computes SAD of clipped horizontal derivatives. With the same filter,
`prefilter=xsobel`, `sad` has fewer errors than StereoBM.
"""


if __name__ == "__main__":
    main()
