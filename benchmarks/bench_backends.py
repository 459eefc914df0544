"""The backends beside each other: time, images and ground truth of the bundled scenes.

    python benchmarks/bench_backends.py [--backends llvm,cuda] [--scenes tabletop,room] [--write]

Each backend runs in a process of its own (TWINLENS_BACKEND), at 320x240, through a pinhole and through the f/1.4 lens
of bench_noise.py. Times are wall-clock seconds of a pair without files: of the first raw one of 64 samples, which
compiles, and the medians of three more raw ones and of three denoised ones of 16 samples. Everything is compared with
the first backend: the root mean square difference of raw images of one seed, and for scale that of two seeds of the
first backend, in percent of the light; the ratio of the means of raw and of denoised images; the largest difference
of disparities, and the share of the pixels that have one with only one of the backends. `--write` replaces the table
in benchmarks/backends.md.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import twinlens as tl
from bench_noise import BUNDLED, view

RAW, DENOISED, IMAGES = 64, 16, 4
LENSES = ("pinhole", "f/1.4")
PAGE = Path(__file__).with_name("backends.md")
HEAD = (
    "| scene, lens | backend | first, s | raw 64, s | denoised 16, s | same seed, % | other seed, % | brightness |"
    " denoised brightness | disparity, px |"
)


def measure(file: Path, scenes: list[str]) -> None:
    """Images and times of this process's backend, in an npz file."""
    found: dict[str, Any] = {}
    for name in scenes:
        for lens in LENSES:
            scene, rig, glass = view(name, lens.replace("/", ""))
            kinds = {
                "raw": {"spp": RAW},
                "denoised": {"spp": DENOISED, "denoise": True},
            }
            for kind, options in kinds.items():
                images, seconds = [], []
                for seed in range(IMAGES):
                    start = time.perf_counter()
                    images.append(
                        np.array(tl.render(scene, rig, glass, seed=seed, **options))
                    )
                    seconds.append(time.perf_counter() - start)
                found[f"{name} {lens} {kind}"] = np.array(images)
                found[f"{name} {lens} {kind} s"] = np.array(seconds)
            found[f"{name} {lens} truth"] = np.array(
                [truth.disparity for truth in tl.ground_truth(scene, rig)]
            )
    np.savez(file, **found)


def compared(of: Any, to: Any, key: str, backend: str, first: str) -> str:
    """One row of the table."""
    raw, reference = (
        of[f"{key} raw"].astype(np.float64),
        to[f"{key} raw"].astype(np.float64),
    )
    light = reference.mean()

    def apart(a: np.ndarray, b: np.ndarray) -> float:
        return 100 * float(np.sqrt(np.mean((a - b) ** 2)) / light)

    cells = [
        f"{of[f'{key} raw s'][0]:.1f}",
        f"{np.median(of[f'{key} raw s'][1:]):.2f}",
        f"{np.median(of[f'{key} denoised s'][1:]):.2f}",
    ]
    if backend == first:
        cells += ["", f"{apart(raw[0], raw[1]):.2f}", "", "", ""]
    else:
        truth, known = of[f"{key} truth"], to[f"{key} truth"]
        both = np.isfinite(truth) & np.isfinite(known)
        other = np.mean(np.isfinite(truth) != np.isfinite(known))
        denoised = of[f"{key} denoised"].mean(dtype=np.float64) / to[
            f"{key} denoised"
        ].mean(dtype=np.float64)
        cells += [
            f"{apart(raw[0], reference[0]):.3f}",
            f"{apart(raw[0], reference[1]):.2f}",
            f"{raw.mean() / light:.5f}",
            f"{denoised:.4f}",
            f"{np.abs(truth[both] - known[both]).max():.1e} ({100 * other:.3f} %)",
        ]
    return f"| {key.replace(' ', ', ')} | {backend} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backends", default="llvm,cuda")
    parser.add_argument("--scenes", default=",".join(BUNDLED))
    parser.add_argument(
        "--write", action="store_true", help=f"replace the table in {PAGE.name}"
    )
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    scenes = options.scenes.split(",")
    if options.measure:
        measure(options.measure, scenes)
        return
    backends, files = options.backends.split(","), {}
    with tempfile.TemporaryDirectory() as folder:
        for backend in backends:
            file = Path(folder) / f"{backend}.npz"
            child = [
                sys.executable,
                __file__,
                "--measure",
                str(file),
                "--scenes",
                options.scenes,
            ]
            subprocess.run(
                child, env={**os.environ, "TWINLENS_BACKEND": backend}, check=True
            )
            files[backend] = dict(np.load(file))
    lines = [HEAD, "|" + " --- |" * HEAD.count(" |")]
    for name in scenes:
        for lens in LENSES:
            lines += [
                compared(
                    files[of], files[backends[0]], f"{name} {lens}", of, backends[0]
                )
                for of in backends
            ]
    print("\n".join(lines))
    if options.write:
        before, _, rest = PAGE.read_text().partition("| scene, lens |")
        PAGE.write_text(
            before
            + "\n".join(lines)
            + (rest[rest.index("\n\n") :] if "\n\n" in rest else "\n")
        )


if __name__ == "__main__":
    main()
