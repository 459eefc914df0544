"""What the dataset factory costs beside bare rendering, and whether it stays as it began over many samples.

    python benchmarks/bench_generate.py             # both, short
    python benchmarks/bench_generate.py cost 20     # making a sample / the two mi.render calls, interleaved
    python benchmarks/bench_generate.py flat 1000   # memory and speed of the last tenth against the first

`cost` makes whole samples (rig, gates, both images, both truths, all files encoded and written) at 640x480 and 64
samples a pixel, and between them renders the same two images with Mitsuba alone: a busy machine slows both alike.

`flat` makes small samples of random families, each a new scene, in a process of its own that does nothing else. After
each it takes the machine's pace, the processor time of a fixed piece of work, so that what else runs meanwhile does not
pass for a change of speed.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from twinlens.factory import make, recipe_from_table
from twinlens.factory.work import Work, written
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build
from twinlens.rendering.radiance import make_sensor
from twinlens.scenes import load_scene

COST = {"seed": 1, "scenes": ["cards", "staircase"], "width": 640, "height": 480, "spp": 64}
FLAT = {
    "seed": 2,
    "families": ["tabletop", "flying", "room", "cards"],
    "width": 64,
    "height": 48,
    "spp": 4,
    "gates": {"attempts": 1, "texture": 0.0},
}


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
    for i, (camera, pose) in enumerate(zip(sample.rig.cameras, sample.rig.world_from_cams, strict=True)):
        sensor = make_sensor(camera, pose, sample.shots[0].lens, COST["spp"], "multijitter")
        np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=COST["spp"], seed=i))


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
                print(f"{index - 1:3d}: {made[1]:6.2f} s, bare {alone[1]:6.2f} s; so far {ratio:.3f}", flush=True)
    print(f"processor time of {count} samples: {totals[1] / totals[3]:.3f} of the two renders alone")
    print(f"wall time, nothing overlapped:     {totals[0] / totals[2]:.3f}")


def flat(count: int) -> None:
    """Print peak memory and processor time by tenths of a run of `count` samples, and the last against the first."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recipe.json"
        path.write_text(json.dumps({**FLAT, "count": count}))
        run = [sys.executable, __file__, "_flat", str(path), str(Path(folder) / "set")]
        rows = [
            json.loads(line) for line in subprocess.run(run, stdout=subprocess.PIPE, check=True).stdout.splitlines()
        ]
    tenths = np.array_split(np.array(rows), 10)
    for k, part in enumerate(tenths, start=1):
        peak, used, pace = part[:, 0].max(), part[:, 1].mean(), part[:, 2].mean()
        print(f"tenth {k:2d}: peak {peak:7.1f} MiB, {used:.3f} s of processor a sample, pace {1e3 * pace:.1f} ms")
    first, last = tenths[0], tenths[-1]
    used, pace = (first[:, column].mean() / last[:, column].mean() for column in (1, 2))
    print(f"memory, last against first: {last[:, 0].max() / first[:, 0].max():.3f}")
    print(f"throughput, last against first: {used:.3f}; at equal pace {used / pace:.3f}")


def _flat(path: str, folder: str) -> None:
    """Run the factory; a line [resident MiB, processor s, pace s] a sample."""
    from twinlens.factory import generate
    from twinlens.factory.work import work_here

    recipe = recipe_from_table(json.loads(Path(path).read_text()))

    def engine(*arguments):
        before = cpu_s()
        for entry in work_here(*arguments):
            used = cpu_s() - before
            print(json.dumps([resident_mib(), used, pace_s()]), flush=True)
            before = cpu_s()
            yield entry

    generate(recipe, folder, engine=engine)


def pace_s() -> float:
    """Processor time of a fixed piece of work."""
    numbers = np.random.default_rng(0).random(400_000)
    start = time.thread_time()
    np.sort(numbers)
    return time.thread_time() - start


def resident_mib() -> float:
    """Memory of this process that is really there."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "all"
    if what == "_flat":
        _flat(*sys.argv[2:4])
    if what in ("cost", "all"):
        cost(int(sys.argv[2]) if len(sys.argv) > 2 else 3)
    if what in ("flat", "all"):
        flat(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
