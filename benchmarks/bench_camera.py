"""Speed of the camera plugin against Mitsuba's `thinlens`, and efficiency of the default sampler.

Times are medians over interleaved rounds in one process of the CPU seconds of all threads, which are more robust than
wall time on a busy machine.

    python benchmarks/bench_camera.py [--width 320] [--spp 64] [--rounds 11] [--write]

1. The camera plugin against Mitsuba's `thinlens` with the same disk lens: seconds per image for each scene. The ratio
   is the median over the rounds of the ratio within a round. Tests check that both images are equal.
2. The default sampler `multijitter` against `independent` through a wide lens: the variance between rounds, averaged
   over the pixels, times the render time.

`--write` writes the tables to benchmarks/camera.md.
"""

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import drjit
import numpy as np

import twinlens as tl
from twinlens.optics import fov_x_deg
from twinlens.rendering.backends import backend, mitsuba
from twinlens.rendering.build import build
from twinlens.rendering.sensors import make_sensor

PAGE = Path(__file__).with_name("camera.md")
WIDE = 0.03  # aperture diameter over the nearest depth


def wide_lens(scene: tl.Scene) -> tl.ThinLens:
    near, far = scene.depth_range
    return tl.ThinLens(WIDE * near, 2 / (1 / near + 1 / far))


def seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    drjit.sync_thread()
    return time.process_time() - start


def interleaved(
    runs: dict[str, Callable[[int], object]], rounds: int
) -> dict[str, list[float]]:
    """Seconds of each run in each round, after a warm-up; the order alternates between rounds."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for name in runs:
        seconds(lambda name=name: runs[name](0))
    for turn in range(rounds):
        for name in list(runs)[:: 1 if turn % 2 else -1]:
            times[name].append(
                seconds(lambda name=name, turn=turn: runs[name](turn + 1))
            )
    return times


def film(camera: tl.Camera) -> dict[str, object]:
    size = {"width": camera.width, "height": camera.height}
    return {
        "type": "hdrfilm",
        **size,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "sample_border": False,
    }


def mitsubas_thinlens(camera, pose, lens, film, sampler):  # type: ignore[no-untyped-def]
    mi = mitsuba()
    plugin = {
        "type": "thinlens",
        "aperture_radius": 0.5 * lens.aperture_diameter,
        "focus_distance": 1.0 / lens.vergence,
        "near_clip": 1e-3,
        "fov": fov_x_deg(camera.width, camera.fx),
        "fov_axis": "x",
        # Mitsuba's x points left, its y up.
        "to_world": mi.ScalarTransform4f(pose @ np.diag([-1.0, -1.0, 1.0, 1.0])),
        "film": film,
        "sampler": sampler,
    }
    return mi.load_dict(plugin)


def against_thinlens(names: list[str], width: int, spp: int, rounds: int) -> list[str]:
    lines = [
        "| scene | twinlens s | thinlens s | Msamples a CPU second | ratio |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in names:
        scene = tl.load_scene(name)
        camera = tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=40)
        built, lens = build(scene), wide_lens(scene)
        sampler = {"type": "multijitter", "sample_count": spp}
        view = camera, scene.world_from_left, lens
        sensors = {
            "twinlens": make_sensor(*view, spp, "multijitter"),
            "thinlens": mitsubas_thinlens(*view, film(camera), sampler),
        }
        runs: dict[str, Callable[[int], object]] = {}
        for kind, sensor in sensors.items():
            runs[kind] = lambda seed, sensor=sensor, built=built: drjit.eval(
                built.integrator.render(built.mi_scene, sensor, seed=seed, spp=spp)
            )
        times = interleaved(runs, rounds)
        ours, theirs = (statistics.median(times[kind]) for kind in runs)
        ratio = statistics.median(a / b for a, b in zip(*times.values(), strict=True))
        speed = camera.width * camera.height * spp / ours / 1e6
        lines.append(
            f"| {name} | {ours:.3f} | {theirs:.3f} | {speed:.2f} | **{ratio:.3f}** |"
        )
        print(lines[-1], flush=True)
    return lines


def against_independent(name: str, width: int, spp: int, rounds: int) -> list[str]:
    scene = tl.load_scene(name)
    rig = tl.Rig(
        [tl.Camera.from_fov(width, width * 3 // 4, fov_x_deg=40)],
        [scene.world_from_left],
    )
    lens = wide_lens(scene)
    images: dict[str, list[np.ndarray]] = {"multijitter": [], "independent": []}
    runs: dict[str, Callable[[int], object]] = {
        kind: lambda seed, kind=kind: images[kind].append(
            tl.render(scene, rig, lens, spp=spp, seed=seed, sampler=kind)[0]
        )
        for kind in images
    }
    times = interleaved(runs, rounds)
    lines = ["| sampler | s | MSE | MSE x s |", "| --- | --- | --- | --- |"]
    costs = []
    for kind, taken in images.items():
        took = statistics.median(times[kind])
        error = float(
            np.var(np.asarray(taken, dtype=np.float64), axis=0, ddof=1).mean()
        )
        costs.append(took * error)
        lines.append(f"| {kind} | {took:.3f} | {error:.3g} | {costs[-1]:.3g} |")
    lines += [
        "",
        f"**multijitter is {costs[1] / costs[0]:.2f}x as efficient as independent** (required: at least 1.8).",
    ]
    print("\n".join(lines))
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", action="append")
    parser.add_argument("--width", type=int, default=320)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    sizes = options.width, options.spp, options.rounds
    size = f"{options.width}x{options.width * 3 // 4}"
    setting = f"{backend().name}, {platform.machine()}, {size}, {options.spp} samples per pixel"
    page = [
        "# Camera plugin against Mitsuba's thinlens",
        "",
        f"`python benchmarks/bench_camera.py --write`: {setting},",
    ]
    page += [
        f"medians of {options.rounds} interleaved rounds.",
        "",
        "## Render time with a disk lens",
        "",
    ]
    page += against_thinlens(options.scene or ["room", "cards", "tabletop"], *sizes)
    page += [
        "",
        "Required ratio: at most 1.1.",
        "",
        "## Samplers, on `tabletop` through a wide lens",
        "",
    ]
    page += against_independent("tabletop", *sizes)
    if options.write:
        PAGE.write_text("\n".join(page) + "\n")


if __name__ == "__main__":
    main()
