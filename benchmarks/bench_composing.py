"""Time and memory of composing random scenes: processor seconds a scene, and the memory of the process.

    python benchmarks/bench_composing.py                       # 1,000 scenes of all families by turns, 640 pixels wide
    python benchmarks/bench_composing.py 200 --width 160 --families room

Memory is flat if no part of a scene outlives it. No scene is rendered.
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np

from twinlens.families import FAMILIES, random_scene


def resident_mib():
    """The memory of this process now, and the most that it had, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    now = pages * resource.getpagesize() / 2**20
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    return now, most


def main():
    """Compose the scenes and print a line for each tenth of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=1000)
    parser.add_argument("--families", nargs="+", default=list(FAMILIES))
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    step = max(1, options.count // 10)
    seconds = {family: [] for family in options.families}
    for index in range(options.count):
        family = options.families[index % len(options.families)]
        start = time.process_time()
        random_scene(family, options.seed + index, width=options.width)
        seconds[family].append(time.process_time() - start)
        if (index + 1) % step == 0:
            now, most = resident_mib()
            print(f"{index + 1} scenes: {now:.0f} MiB, at most {most:.0f}", flush=True)
    for family, times in seconds.items():
        quantiles = np.quantile(times, (0.5, 0.9)) if times else (np.nan, np.nan)
        median, high = quantiles
        print(f"{family}: median {median:.2f} s, 90 % below {high:.2f} s")


if __name__ == "__main__":
    main()
