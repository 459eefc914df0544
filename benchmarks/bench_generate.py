"""Cost of the dataset factory relative to bare rendering, and its memory and speed over many samples.

    python benchmarks/bench_generate.py             # both, short
    python benchmarks/bench_generate.py cost 20     # making a sample / the two mi.render calls, interleaved
    python benchmarks/bench_generate.py flat 1000   # memory and speed of the last tenth against the first

`cost` makes whole samples (rig, gates, both images, both ground truths, all files) at 640x480 and 64
samples per pixel. Between them it renders the same two images with Mitsuba alone, so that other load affects both.

`flat` runs `twinlens generate` on small samples of random families, each a new scene, with an empty kernel cache. From
outside (Linux) it samples the memory and processor time of the command with its worker processes. The minimum memory
during a sample is what the run keeps; the maximum is that of compiling a kernel, which depends on the scene. After each
sample it measures the processor time of a fixed task (`pace`), to separate other load from a change of speed.
"""

import contextlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from twinlens.factory import make, recipe_from_table
from twinlens.factory.workers import Work, written
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build
from twinlens.rendering.sensors import make_sensor
from twinlens.scenes import load_scene

COST = {
    "seed": 1,
    "scenes": ["cards", "staircase"],
    "width": 640,
    "height": 480,
    "spp": 64,
}
FLAT = """
seed = 2
count = {count}
families = ["tabletop", "flying", "room", "cards"]
width = 64
height = 48
spp = 4

[gates]
attempts = 1
texture = 0.0
"""


def cpu_s() -> float:
    """Processor time of this process, all threads."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def timed(function):
    """(wall s, processor s, answer) of a call."""
    wall, cpu = time.perf_counter(), cpu_s()
    answer = function()
    return time.perf_counter() - wall, cpu_s() - cpu, answer


def bare(sample) -> None:
    """The two renders that a sample cannot do without: the same scene, cameras and samples, by Mitsuba alone."""
    mi = mitsuba()
    scene = build(load(sample.record["scene"])).mi_scene
    integrator = build(load(sample.record["scene"])).integrator
    for i, (camera, pose) in enumerate(
        zip(sample.rig.cameras, sample.rig.world_from_cams, strict=True)
    ):
        sensor = make_sensor(
            camera, pose, sample.shots[0].lens, COST["spp"], "multijitter"
        )
        np.asarray(
            mi.render(
                scene, sensor=sensor, integrator=integrator, spp=COST["spp"], seed=i
            )
        )


_loaded = {}


def load(name):
    """A scene, kept."""
    return _loaded.setdefault(name, load_scene(name))


def cost(count: int) -> None:
    """Print the ratio over `count` samples, after one of each scene to compile."""
    recipe = recipe_from_table({**COST, "count": count + 2})
    totals = np.zeros(4)
    with tempfile.TemporaryDirectory() as folder:
        work = Work(recipe, folder, {})
        for index in range(count + 2):

            def whole(index=index):
                sample = make(recipe, index)
                written(work, index, sample)
                return sample

            made = timed(whole)
            alone = timed(lambda made=made: bare(made[2]))
            if index >= 2:
                totals += [*made[:2], *alone[:2]]
                ratio = totals[1] / totals[3]
                print(
                    f"{index - 1:3d}: {made[1]:6.2f} s, bare {alone[1]:6.2f} s; so far {ratio:.3f}",
                    flush=True,
                )
    print(
        f"processor time of {count} samples: {totals[1] / totals[3]:.3f} of the two renders alone"
    )
    print(f"wall time, nothing overlapped:     {totals[0] / totals[2]:.3f}")


def flat(count: int) -> None:
    """Print peak memory and processor time by tenths of a run of `count` samples, and the last against the first."""
    with tempfile.TemporaryDirectory() as folder:
        path, target = Path(folder) / "recipe.toml", Path(folder) / "set"
        path.write_text(FLAT.format(count=count))
        command = [
            sys.executable,
            "-m",
            "twinlens",
            "generate",
            str(path),
            "-o",
            str(target),
            "--workers",
            "1",
        ]
        with subprocess.Popen(
            command, env={**os.environ, "HOME": folder}
        ) as run:  # an empty kernel cache
            rows = list(watched(run, target / ".rows"))
    tenths = np.array_split(np.array(rows), 10)
    for k, part in enumerate(tenths, start=1):
        kept, peak, used, pace = (
            part[:, 0].max(),
            part[:, 1].max(),
            part[:, 2].mean(),
            part[:, 3].mean(),
        )
        said = f"kept at most {kept:.1f} MiB, peak {peak:.1f} MiB, {used:.3f} s of processor a sample"
        print(f"tenth {k:2d}: {said}, pace {1e3 * pace:.1f} ms")
    first, last = tenths[0], tenths[-1]
    kept, peak = (last[:, column].max() / first[:, column].max() for column in (0, 1))
    used, pace = (first[:, column].mean() / last[:, column].mean() for column in (2, 3))
    print(f"memory, last against first: kept {kept:.3f}, peak {peak:.3f}")
    print(
        f"throughput, last against first: {used:.3f}; at equal pace {used / pace:.3f}"
    )


def watched(run, folder):
    """(least MiB, most MiB, processor s, pace s) of each sample, observed by the rows that appear in `folder`.

    `folder` is removed when the dataset is finished, so the last samples may be missing.
    """
    seen, before, held = 0, 0.0, []
    while run.poll() is None:
        with contextlib.suppress(OSError):  # the process, or the folder, may be gone
            used = used_s(run.pid)
            held.append(resident_mib(run.pid))
            there = sum(1 for _ in folder.iterdir())
            for _ in range(seen, there):
                yield min(held), max(held), (used - before) / (there - seen), pace_s()
            if there > seen:
                seen, before, held = there, used, []
        time.sleep(0.02)


def pace_s() -> float:
    """Processor time of a fixed piece of work."""
    numbers = np.random.default_rng(0).random(400_000)
    start = time.thread_time()
    np.sort(numbers)
    return time.thread_time() - start


def family_of(process: int) -> list[int]:
    """A process and those it has started, directly or not."""
    found = [process]
    with contextlib.suppress(OSError):
        for tasks in Path(f"/proc/{process}/task").glob("*/children"):
            for child in tasks.read_text().split():
                found += family_of(int(child))
    return found


def resident_mib(process: int) -> float:
    """Resident memory of a process and its children."""
    pages = sum(
        int(Path(f"/proc/{each}/statm").read_text().split()[1])
        for each in family_of(process)
    )
    return pages * resource.getpagesize() / 2**20


def used_s(process: int) -> float:
    """Processor time of a process with all threads and children, also those that have ended, since it started."""
    total = 0
    for each in family_of(process):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        total += sum(
            int(field) for field in fields[11:15]
        )  # user, system, and the same of children waited for
    return total / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "all"
    if what in ("cost", "all"):
        cost(int(sys.argv[2]) if len(sys.argv) > 2 else 3)
    if what in ("flat", "all"):
        flat(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
