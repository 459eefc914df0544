"""Time of the first match of a process: compiling into an empty kernel cache, and loading from it.

    python benchmarks/bench_compile.py [--size 640x480]

Each match runs in a fresh process. The first pass starts with an empty NUMBA_CACHE_DIR that all matches share: a kernel
compiled by one is loaded by the next. The second pass loads all kernels. Times are seconds of processor time of
`match`, without imports. Set NUMBA_CPU_NAME and NUMBA_CPU_FEATURES to compile for another processor.
"""

import argparse
import itertools
import os
import subprocess
import sys
import tempfile

METHODS = ("sad", "ssd", "zncc", "census", "sgm")
BLOCKS = (7, 21)
MATCH = """
import sys, time
import numba, numpy as np
import twinlens.matching.matcher
from twinlens.matching import match
height, width = int(sys.argv[2]), int(sys.argv[3])
pair = np.random.default_rng(0).integers(0, 256, (2, height, width), dtype=np.uint8)
start = time.process_time()
match(*pair, sys.argv[1])
print(time.process_time() - start)
"""


def seconds(method: str, size: tuple[int, int], folder: str) -> float:
    """Processor seconds of the first match of a process that uses this kernel cache."""
    command = [sys.executable, "-c", MATCH, method, str(size[1]), str(size[0])]
    environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
    return float(subprocess.check_output(command, env=environment, text=True))


def table(size: tuple[int, int]) -> list[str]:
    """Markdown rows: method, seconds with an empty cache, seconds in a second process; their sums."""
    methods = [
        f"{name}:block_size={block}"
        for name, block in itertools.product(METHODS, BLOCKS)
    ]
    with tempfile.TemporaryDirectory() as folder:
        passes = [
            [seconds(method, size, folder) for method in methods] for _ in range(2)
        ]
    rows = [
        f"| {name} | {first:.2f} | {then:.2f} |"
        for name, first, then in zip(methods, *passes, strict=True)
    ]
    total = f"| all | {sum(passes[0]):.2f} | {sum(passes[1]):.2f} |"
    head = [
        "| first match of | empty cache, s | second process, s |",
        "| --- | ---: | ---: |",
    ]
    return [*head, *rows, total]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="200x60", help="image size, WIDTHxHEIGHT")
    width, height = (int(part) for part in parser.parse_args().size.split("x"))
    print("\n".join(table((width, height))))


if __name__ == "__main__":
    main()
