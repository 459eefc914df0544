"""Cost of `render` and `ground_truth` of a pair, relative to two bare `mi.render` calls.

The bare calls use Mitsuba's perspective sensor with its default film, filter and sampler, one call per camera, on the
same loaded scene, after a warm-up. Rounds are interleaved; the ratio is the median over rounds.

python benchmarks/bench_render.py [--scene staircase] [--rounds 5] [--spp 64] [--size 640x480]
"""

import argparse
import statistics
import time

import numpy as np

import twinlens as tl
from twinlens.factory import default_rig
from twinlens.rendering import backend
from twinlens.rendering.build import build


def bare(built, rig, spp, seed):
    import mitsuba as mi

    for camera, pose in zip(rig.cameras, rig.world_from_cams, strict=True):
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": camera.fov_x_deg,
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(
                    pose @ np.diag([-1.0, -1.0, 1.0, 1.0])
                ),
                "film": {
                    "type": "hdrfilm",
                    "width": camera.width,
                    "height": camera.height,
                    "pixel_format": "rgb",
                },
            }
        )
        np.asarray(
            mi.render(
                built.mi_scene,
                sensor=sensor,
                integrator=built.integrator,
                spp=spp,
                seed=seed,
            )
        )


def timed(work):
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="staircase")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--size", default="640x480")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    scene = tl.load_scene(options.scene)
    rig = default_rig(scene, width, height)
    built = build(scene)

    jobs = {
        "two bare mi.render": lambda seed: bare(built, rig, options.spp, seed),
        "tl.render": lambda seed: tl.render(scene, rig, spp=options.spp, seed=seed),
        "tl.ground_truth": lambda seed: tl.ground_truth(scene, rig),
    }
    times = {name: [] for name in jobs}
    for round_ in range(options.rounds + 1):
        for name, job in jobs.items():
            seconds = timed(lambda job=job, seed=round_: job(seed))
            if round_:  # the first round compiles
                times[name].append(seconds)
    print(
        f"{options.scene}, {options.size}, {options.spp} spp, {backend().variant}, {options.rounds} rounds, medians"
    )
    for name, values in times.items():
        print(
            f"  {name:<20} {statistics.median(values):7.2f} s   ({min(values):.2f} to {max(values):.2f})"
        )
    rounds = zip(*times.values(), strict=True)
    ratio = statistics.median(
        (photos + truth) / plain for plain, photos, truth in rounds
    )
    print(f"  (render + ground_truth) / bare = {ratio:.3f}   (asked: at most 1.15)")


if __name__ == "__main__":
    main()
