"""How much memory a match takes: winner-take-all must grow with W D, not with H W D.

    python benchmarks/bench_matching_memory.py

Prints what numpy allocates at its peak, less the result, for images that grow taller.
"""

import tracemalloc

import numpy as np

import twinlens.matching as tm

WIDTH, COUNT = 640, 128
HEIGHTS = (240, 480, 960)


def peak_mib(method: str, height: int) -> float:
    """MiB allocated at the peak of a match, beyond its float32 result."""
    left, right = np.random.default_rng(0).integers(0, 256, (2, height, WIDTH), dtype=np.uint8)
    matcher = tm.parse_method(method).matcher(num_disparities=COUNT, threads=1)
    matcher.match(left, right)
    tracemalloc.start()
    matcher.match(left, right)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return (peak - 4 * left.size) / 2**20


def main() -> None:
    volume = [f"{WIDTH * height * COUNT * 2 / 2**20:.0f}" for height in HEIGHTS]
    print(f"{WIDTH} wide, {COUNT} disparities; a 16-bit cost volume would take {', '.join(volume)} MiB")
    for method in ("sad", "ssd", "zncc", "census", "adaptive", "cross", "guided", "sgm"):
        sizes = ", ".join(f"{height} rows {peak_mib(method, height):7.1f} MiB" for height in HEIGHTS)
        print(f"  {method:10s} {sizes}")


if __name__ == "__main__":
    main()
