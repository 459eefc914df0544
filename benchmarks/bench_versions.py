"""Cost of a pair and of a dataset by this version, beside another one.

    python benchmarks/bench_versions.py [CHECKOUT] [--samples 100] [--write]

CHECKOUT is a folder with another version of twinlens, such as a git worktree; this environment must suit it. Each
command runs with its defaults, first with an empty kernel cache and then with its own. `--write` writes versions.md.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCENES = ("tabletop", "room", "cards", "staircase", "spheres", "fence")
FAMILIES = ("cards", "flying", "room", "tabletop")
SIZE = "640x480"
RECIPE = (
    f"seed = 31\ncount = {{}}\nfamilies = {list(FAMILIES)}\nwidth = 320\nheight = 240\n"
)


def cost(checkout: Path, work: Path, *arguments: object) -> tuple[float, float]:
    """Processor seconds and wall seconds of a command."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout.resolve() / "src"),
        "HOME": str(work),  # Dr.Jit caches kernels there
        "DRJIT_CACHE_DIR": str(work / "kernels"),
    }
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "twinlens", *map(str, arguments)]
    done = subprocess.run(
        command, env=environment, cwd=work, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{checkout}: {done.stderr}")
    after, wall = (
        resource.getrusage(resource.RUSAGE_CHILDREN),
        time.perf_counter() - start,
    )
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def pair(checkout: Path, scene: str) -> tuple[float, float]:
    """Processor seconds of a pair with an empty cache of kernels, and of another one with its kernels."""
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            cost(
                checkout, Path(folder), "render", scene, "--size", SIZE, "-o", f"out{i}"
            )[0]
            for i in range(2)
        )
    return first, second


def dataset(checkout: Path, samples: int) -> tuple[float, float]:
    """Processor and wall seconds for each sample of a dataset, from an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "recipe.toml").write_text(RECIPE.format(samples))
        used, wall = cost(
            checkout, Path(folder), "generate", "recipe.toml", "-o", "out"
        )
    return used / samples, wall / samples


def revision(checkout: Path) -> str:
    """The short hash of a checkout's commit."""
    command = ["git", "-C", str(checkout), "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(
        command, capture_output=True, text=True, check=True
    ).stdout.strip()


def row(label: str, unit: str, costs: list[float]) -> str:
    """A row of the table, with the quotient of the two versions if there are two."""
    ratio = f" {costs[0] / costs[1]:.3f} |" if len(costs) == 2 else ""
    return (
        f"| {label} | "
        + "".join(f"{each:.2f} {unit} | " for each in costs).rstrip()
        + ratio
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "checkout", type=Path, nargs="?", help="folder of another version"
    )
    parser.add_argument(
        "--samples", type=int, default=24, help="number of samples of the dataset"
    )
    parser.add_argument(
        "--scenes", nargs="*", default=SCENES, help="scenes of the pairs"
    )
    parser.add_argument("--write", action="store_true", help="write versions.md")
    options = parser.parse_args()
    versions = [HERE.parent, *([options.checkout] if options.checkout else [])]
    ratio = " this / other |" if options.checkout else ""
    lines = [
        f"| | {' | '.join(map(revision, versions))} |{ratio}",
        "| --- |" + " ---: |" * (len(versions) + bool(ratio)),
    ]
    totals = [[0.0, 0.0] for _ in versions]
    for scene in options.scenes:
        found = [pair(each, scene) for each in versions]
        for total, each in zip(totals, found, strict=True):
            total[:] = [a + b for a, b in zip(total, each, strict=True)]
        lines.append(
            row(f"pair of `{scene}`, kernels cached", "s", [each[1] for each in found])
        )
        lines.append(
            row(f"pair of `{scene}`, empty cache", "s", [each[0] for each in found])
        )
        print(*lines[-2:], sep="\n", flush=True)
    if options.scenes:
        lines.append(
            row("all pairs, kernels cached", "s", [total[1] for total in totals])
        )
        lines.append(row("all pairs, empty cache", "s", [total[0] for total in totals]))
    if options.samples:
        found = [dataset(each, options.samples) for each in versions]
        lines.append(
            row("random sample, processor time", "s", [each[0] for each in found])
        )
        lines.append(row("random sample, wall time", "s", [each[1] for each in found]))
    print(*lines, sep="\n")
    if options.write:
        command = f"`python benchmarks/bench_versions.py CHECKOUT --samples {options.samples} --write`"
        text = [
            "# Cost of this version and of another one",
            "",
            f"{command}, {os.cpu_count()} processors.",
            f"Commands with their defaults: `twinlens render SCENE --size {SIZE}` with truth and files, in processor",
            f"time; and `twinlens generate` of {options.samples} samples of 320x240 of the families",
            f"{', '.join(FAMILIES)}, from an empty kernel cache.",
            "",
        ]
        (HERE / "versions.md").write_text("\n".join([*text, *lines]) + "\n")


if __name__ == "__main__":
    main()
