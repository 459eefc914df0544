"""Memory of a match: for winner-take-all methods it must grow with W D, not with H W D.

    python benchmarks/bench_matching_memory.py

Prints the peak allocation of NumPy, without the result, for images of increasing height. Fails if doubling the height
increases it by more than a quarter of the memory that a cost volume of the additional rows would take.
"""

import tracemalloc

import numpy as np

import twinlens.matching as tm

WIDTH, COUNT = 640, 128
LOCAL = ("sad", "ssd", "zncc", "census", "adaptive", "cross", "guided")
HEIGHTS = (120, 240, 480)


def peak_mib(method: str, height: int) -> float:
    """MiB allocated at the peak of a match, beyond its float32 result."""
    left, right = np.random.default_rng(0).integers(
        0, 256, (2, height, WIDTH), dtype=np.uint8
    )
    matcher = tm.parse_method(method).matcher(num_disparities=COUNT, threads=1)
    matcher.match(left, right)
    tracemalloc.start()
    matcher.match(left, right)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return (peak - 4 * left.size) / 2**20


def main() -> None:
    volume = [f"{WIDTH * height * COUNT * 2 / 2**20:.0f}" for height in HEIGHTS]
    print(
        f"{WIDTH} wide, {COUNT} disparities; a 16-bit cost volume would take {', '.join(volume)} MiB"
    )
    for method in (*LOCAL, "sgm"):
        peaks = [peak_mib(method, height) for height in HEIGHTS]
        sizes = (
            f"{height} rows {peak:7.1f} MiB"
            for height, peak in zip(HEIGHTS, peaks, strict=True)
        )
        print(f"  {method:10s} {', '.join(sizes)}")
        added = WIDTH * (HEIGHTS[-1] - HEIGHTS[-2]) * COUNT * 2 / 2**20
        if method in LOCAL and peaks[-1] - peaks[-2] > 0.25 * added:
            raise SystemExit(
                f"{method}: {peaks[-1] - peaks[-2]:.1f} MiB more for twice the rows; it is not O(W D)"
            )


if __name__ == "__main__":
    main()
