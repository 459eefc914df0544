"""How fast twinlens matches, beside OpenCV: one process, the same threads, medians of interleaved runs.

    python benchmarks/bench_matching.py [--rounds 15] [--threads 2]

Prints for each size and range the million disparity evaluations a second (W H D / time) and the ratios that matter,
once of wall time and once of processor time: the latter holds on a machine that does other things meanwhile.
Compile time (first call, less the second) is apart; it is paid once a machine, since compiled code is kept on disk.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np

import twinlens.matching as tm
from twinlens.matching.strips import cpu_count

SIZES = ((640, 480), (1280, 720))
RANGES = (64, 128)
BLOCK = 9
Run = Callable[[], object]


def textured_pair(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """A smooth 8-bit texture over a slanted ground, with some noise in each eye."""
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.random((height, width + 256)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(noise, None, 20, 235, cv2.NORM_MINMAX)
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    disparity = 8 + 40 * v / height
    left = cv2.remap(texture, u + 64, v, cv2.INTER_LINEAR)
    right = cv2.remap(texture, u + 64 + disparity, v, cv2.INTER_LINEAR)
    noisy = [np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for image in (left, right)]
    return noisy[0], noisy[1]


def first_calls(runs: dict[str, Run]) -> dict[str, float]:
    """Seconds by which the first call is longer than the second: compiling, or loading what was compiled before."""
    result = {}
    for name, run in runs.items():
        times = []
        for _ in range(2):
            start = time.perf_counter()
            run()
            times.append(time.perf_counter() - start)
        result[name] = max(times[0] - times[1], 0.0)
    return result


def interleaved(runs: dict[str, Run], rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Median seconds of each run, by the wall and by the processors.

    Every round runs each of them once, so that all meet the same machine.
    """
    wall: dict[str, list[float]] = {name: [] for name in runs}
    processor: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            start, used = time.perf_counter(), time.process_time()
            run()
            wall[name].append(time.perf_counter() - start)
            processor[name].append(time.process_time() - used)
    return tuple({name: statistics.median(values) for name, values in times.items()} for times in (wall, processor))


def contestants(left: np.ndarray, right: np.ndarray, count: int, threads: int) -> dict[str, Run]:
    def ours(method: str) -> Run:
        matcher = tm.parse_method(method).matcher(num_disparities=count, threads=threads)
        return lambda: matcher.match(left, right)

    block_matcher = cv2.StereoBM.create(count, BLOCK)
    semiglobal = cv2.StereoSGBM.create(0, count, 3, 72, 288)
    eight_paths = cv2.StereoSGBM.create(0, count, 3, 72, 288, mode=cv2.STEREO_SGBM_MODE_HH)
    return {
        "OpenCV StereoBM": lambda: block_matcher.compute(left, right),
        "sad": ours(f"sad:block_size={BLOCK}"),
        "ssd": ours(f"ssd:block_size={BLOCK}"),
        "zncc": ours(f"zncc:block_size={BLOCK}"),
        "OpenCV SGBM default": lambda: semiglobal.compute(left, right),
        "sgm4": ours("sgm4"),
        "OpenCV SGBM HH": lambda: eight_paths.compute(left, right),
        "sgm": ours("sgm"),
    }


RIVALS = (("sad", "OpenCV StereoBM"), ("zncc", "sad"), ("sgm4", "OpenCV SGBM default"), ("sgm", "OpenCV SGBM HH"))


def report(
    width: int,
    height: int,
    count: int,
    seconds: dict[str, float],
    used: dict[str, float],
    compiling: dict[str, float],
) -> None:
    print(f"\n{width}x{height}, {count} disparities, block {BLOCK}, 8-bit")
    for name, value in seconds.items():
        rate = width * height * count / value / 1e6
        print(f"  {name:24s} {1e3 * value:8.2f} ms {rate:8.0f} Mde/s   first call +{compiling[name]:.2f} s")
    for ours, theirs in RIVALS:
        by_wall, by_processor = seconds[theirs] / seconds[ours], used[theirs] / used[ours]
        print(f"  {ours} / {theirs}: {by_wall:.2f}x the throughput ({by_processor:.2f}x a processor second)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=cpu_count())
    options = parser.parse_args()
    cv2.setNumThreads(options.threads)
    print(f"{options.threads} threads, OpenCV {cv2.__version__}, medians of {options.rounds} interleaved rounds")
    for width, height in SIZES:
        left, right = textured_pair(width, height)
        for count in RANGES:
            runs = contestants(left, right, count, options.threads)
            compiling = first_calls(runs)
            report(width, height, count, *interleaved(runs, options.rounds), compiling)


if __name__ == "__main__":
    main()
