"""The speed of matching compared with OpenCV: one process, equal threads, medians of interleaved runs.

    python benchmarks/bench_matching.py [--rounds 9] [--threads 2] [--write]

For each size and range: milliseconds, million disparity evaluations a second (W H D / time), and ratios of wall time
and of processor time; the latter is meaningful on a machine that runs other programs too.
Then StereoBM, SAD and ZNCC on one thread each, the cost of 16-bit and float images, of each range from 16 to 256
disparities, and of the first match of a process (`bench_compile.py`).
`--write` writes the tables to benchmarks/matching.md.
"""

import argparse
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

import twinlens.matching as tm
from bench_compile import table
from twinlens.machine import processor_count

SIZES = ((640, 480), (1280, 720))
RANGES = (64, 128)
EVERY_RANGE = (16, 32, 48, 64, 72, 80, 96, 112, 128, 160, 192, 256)
DTYPES = ("uint8", "uint16", "float32")
BLOCK = 9
PAGE = Path(__file__).with_name("matching.md")
RATIOS = (("sad", "OpenCV StereoBM"), ("zncc", "sad"), ("zncc", "OpenCV StereoBM"), ("sgm4", "OpenCV SGBM"),
          ("sgm", "OpenCV SGBM HH"))  # fmt: skip
PUBLISHED = """
Other programs on similar machines (accuracy and times: `accuracy.md`, by `bench_accuracy.py --peers`): CNES Pandora 1.9
evaluates 20 to 40 million disparities per second (SAD, ZNCC and census at 640x480, 64 disparities), the Machine Vision
Toolbox 2.4 about 1 million.
"""
Run = Callable[[], object]
Times = dict[str, float]


def textured_pair(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth 8-bit texture over a slanted ground, with some noise in each image."""
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(
        rng.random((height, width + 256)).astype(np.float32), (0, 0), 1.5
    )
    texture = cv2.normalize(noise, None, 20, 235, cv2.NORM_MINMAX)
    u, v = np.meshgrid(
        np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    )
    disparity = 8 + 40 * v / height
    left = cv2.remap(texture, u + 64, v, cv2.INTER_LINEAR)
    right = cv2.remap(texture, u + 64 + disparity, v, cv2.INTER_LINEAR)
    noisy = [
        np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        for image in (left, right)
    ]
    return noisy[0], noisy[1]


def interleaved(runs: dict[str, Run], rounds: int) -> tuple[Times, Times]:
    """Median wall seconds and processor seconds of each run.

    Every round runs each of them once; a warm-up round is not counted.
    """
    wall: dict[str, list[float]] = {name: [] for name in runs}
    processor: dict[str, list[float]] = {name: [] for name in runs}
    for index in range(rounds + 1):
        for name, run in runs.items():
            start, used = time.perf_counter(), time.process_time()
            run()
            if index:
                wall[name].append(time.perf_counter() - start)
                processor[name].append(time.process_time() - used)
    medians = [
        {name: statistics.median(values) for name, values in times.items()}
        for times in (wall, processor)
    ]
    return medians[0], medians[1]


def ours(
    method: str, pair: tuple[np.ndarray, np.ndarray], count: int, threads: int
) -> Run:
    matcher = tm.parse_method(method).matcher(num_disparities=count, threads=threads)
    return lambda: matcher.match(*pair)


def candidates(
    pair: tuple[np.ndarray, np.ndarray], count: int, threads: int
) -> dict[str, Run]:
    block_matcher = cv2.StereoBM.create(count, BLOCK)
    semiglobal = cv2.StereoSGBM.create(0, count, 3, 72, 288)
    eight_paths = cv2.StereoSGBM.create(
        0, count, 3, 72, 288, mode=cv2.STEREO_SGBM_MODE_HH
    )
    return {
        "OpenCV StereoBM": lambda: block_matcher.compute(*pair),
        "sad": ours(f"sad:block_size={BLOCK}", pair, count, threads),
        "ssd": ours(f"ssd:block_size={BLOCK}", pair, count, threads),
        "zncc": ours(f"zncc:block_size={BLOCK}", pair, count, threads),
        "OpenCV SGBM": lambda: semiglobal.compute(*pair),
        "sgm4": ours("sgm4", pair, count, threads),
        "OpenCV SGBM HH": lambda: eight_paths.compute(*pair),
        "sgm": ours("sgm", pair, count, threads),
    }


def against_opencv(rounds: int, threads: int) -> Iterator[str]:
    for width, height in SIZES:
        pair = textured_pair(width, height)
        for count in RANGES:
            wall, processor = interleaved(candidates(pair, count, threads), rounds)
            yield f"\n## {width}x{height}, {count} disparities, block {BLOCK}, 8-bit\n"
            yield "| matcher | ms | processor ms | Mde/s |\n| --- | ---: | ---: | ---: |"
            for name, seconds in wall.items():
                rate = width * height * count / seconds / 1e6
                yield f"| {name} | {1e3 * seconds:.2f} | {1e3 * processor[name]:.2f} | {rate:.0f} |"
            yield "\n| throughput ratio | wall time | processor time |\n| --- | ---: | ---: |"
            for one, other in RATIOS:
                ratios = (times[other] / times[one] for times in (wall, processor))
                yield f"| {one} / {other} | {' | '.join(f'{ratio:.2f}' for ratio in ratios)} |"


def on_one_thread(rounds: int, threads: int) -> Iterator[str]:
    names = ("OpenCV StereoBM", "sad", "zncc")
    yield f"\n## One thread each, block {BLOCK}, 8-bit: ms\n"
    yield f"| pair | {' | '.join(names)} | sad / StereoBM | zncc / sad |\n| --- |{' ---: |' * 5}"
    cv2.setNumThreads(1)
    for width, height in SIZES:
        pair = textured_pair(width, height)
        for count in RANGES:
            runs = candidates(pair, count, 1)
            wall, _ = interleaved({name: runs[name] for name in names}, 2 * rounds)
            ratios = wall["OpenCV StereoBM"] / wall["sad"], wall["sad"] / wall["zncc"]
            cells = [
                *(f"{1e3 * wall[name]:.2f}" for name in names),
                *(f"{ratio:.2f}" for ratio in ratios),
            ]
            yield f"| {width}x{height}, {count} disparities | {' | '.join(cells)} |"
    cv2.setNumThreads(threads)


def by_dtype(rounds: int, threads: int) -> Iterator[str]:
    images = textured_pair(640, 480)
    factor = {"uint8": 1, "uint16": 257, "float32": 1 / 255}
    yield "\n## 16-bit and float images, 640x480, 64 disparities: processor ms\n"
    yield f"| method | {' | '.join(DTYPES)} |\n| --- |{' ---: |' * len(DTYPES)}"
    methods = [
        f"{name}:block_size={BLOCK}" for name in ("sad", "ssd", "zncc", "census")
    ] + ["sgm"]
    for method in methods:
        pairs = {
            dtype: tuple(
                (image.astype(np.float64) * factor[dtype]).astype(dtype)
                for image in images
            )
            for dtype in DTYPES
        }
        _, processor = interleaved(
            {dtype: ours(method, pairs[dtype], 64, threads) for dtype in DTYPES}, rounds
        )
        yield f"| {method} | {' | '.join(f'{1e3 * processor[dtype]:.1f}' for dtype in DTYPES)} |"


def by_range(rounds: int, threads: int) -> Iterator[str]:
    pair = textured_pair(640, 480)
    yield "\n## Number of disparities, 640x480: processor ms\n"
    yield f"| method | {' | '.join(str(count) for count in EVERY_RANGE)} |\n| --- |{' ---: |' * len(EVERY_RANGE)}"
    for name in ("sad", "ssd", "zncc", "sgm"):
        method = name if name == "sgm" else f"{name}:block_size={BLOCK}"
        _, processor = interleaved(
            {str(n): ours(method, pair, n, threads) for n in EVERY_RANGE}, rounds
        )
        yield f"| {name} | {' | '.join(f'{1e3 * seconds:.1f}' for seconds in processor.values())} |"


def first_calls() -> Iterator[str]:
    yield "\n## The first match of a process, 200x60: processor seconds\n"
    yield "\n".join(table((200, 60)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=processor_count())
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    options = parser.parse_args()
    cv2.setNumThreads(options.threads)
    how = (
        f"{options.threads} threads, OpenCV {cv2.__version__}, "
        f"{platform.machine()}, medians of {options.rounds} rounds"
    )
    lines = [
        "# Matching speed\n",
        f"`python benchmarks/bench_matching.py --write`: one process, {how}, interleaved.",
    ]
    lines.append(
        "Mde/s: million disparity evaluations (width x height x disparities) per second."
    )
    parts = [against_opencv, on_one_thread, by_dtype, by_range]
    for text in (
        text for part in parts for text in part(options.rounds, options.threads)
    ):
        print(text, flush=True)
        lines.append(text)
    for text in (*first_calls(), PUBLISHED):
        print(text, flush=True)
        lines.append(text)
    if options.write:
        PAGE.write_text("\n".join(lines).rstrip() + "\n")


if __name__ == "__main__":
    main()
