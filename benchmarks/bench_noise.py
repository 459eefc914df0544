"""Rendering noise and wrong pixels: raw images and denoised ones against nearly converged references.

    python benchmarks/bench_noise.py --references folder [--scenes tabletop,cards] [--write]

Six bundled and eight random scenes at 320x240 through a pinhole and through an f/1.4 lens on a film 36 mm wide, focused
at the middle of the scene's depths. The same sensor (10,000 electrons, the same noise) exposes every pair at the
reference's exposure. Differences are absolute, in percentage points of non-occluded wrong pixels, over ZNCC, census,
SGM and SAD at 1 and 2 px; the mean and the largest of the eight. Costs are processor time, relative to raw 16.

References have 2048 samples and take 3 to 8 CPU minutes a scene and lens; they are kept in the folder. `--write`
replaces the tables in benchmarks/noise.md.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import twinlens as tl
from twinlens.camera import Lens
from twinlens.factory import default_rig
from twinlens.families import random_scene
from twinlens.rendering import render_measured, use_threads
from twinlens.sensor import Exposure

BUNDLED = ("tabletop", "staircase", "spheres", "cards", "room", "fence")
RANDOM = tuple(
    f"{family}-{seed}"
    for family in ("tabletop", "flying", "room", "cards")
    for seed in (8001, 8002)
)
SCENES = BUNDLED + RANDOM
METHODS = ("zncc:block_size=9", "census:block_size=9", "sgm", "sad:block_size=9")
REFERENCE_SPP, PASS = 2048, 256
KINDS = {
    "raw 16": {"spp": 16},
    "raw 24": {"spp": 24},
    "raw 64": {"spp": 64},
    "raw 256": {"spp": 256},
    "8, denoised": {"spp": 8, "denoise": True},
    "12, denoised": {"spp": 12, "denoise": True},
    "16, denoised": {"spp": 16, "denoise": True},
    "32, denoised": {"spp": 32, "denoise": True},
}
SEED = 2
PAGE = Path(__file__).with_name("noise.md")


def view(name: str, kind: str) -> tuple[tl.Scene, tl.Rig, Lens]:
    """Scene, rig and lens of one row; FAMILY-SEED is a random scene."""
    family, _, seed = name.partition("-")
    scene = random_scene(family, int(seed), width=320) if seed else tl.load_scene(name)
    rig = default_rig(scene, 320, 240, intrinsics={"sensor_width_mm": 36})
    camera = rig.cameras[0]
    focus = tl.optics.middle_focus(*scene.depth_range)
    lens = (
        tl.Pinhole()
        if kind == "pinhole"
        else tl.ThinLens.from_f_number(1.4, focus, 0.036 / 320 * camera.fx)
    )
    return scene, rig, lens


def reference(folder: Path, name: str, kind: str) -> np.ndarray:
    """The pair (2, H, W, 3) of REFERENCE_SPP samples, rendered in passes if it is not in the folder."""
    file = folder / f"{name}-{kind}-{REFERENCE_SPP}.npy"
    if not file.exists():
        passes = [
            np.array(tl.render(*view(name, kind), PASS, 1000 + i))
            for i in range(REFERENCE_SPP // PASS)
        ]
        folder.mkdir(parents=True, exist_ok=True)
        np.save(file, np.mean(passes, axis=0, dtype=np.float64).astype(np.float32))
    return np.load(file)


def scorer(
    scene: tl.Scene, rig: tl.Rig, lens: Lens, exposed_for: np.ndarray
) -> Callable[..., np.ndarray]:
    """A function from a pair to its eight percentages, at the exposure that suits `exposed_for`."""
    sensor, truth = tl.Sensor(full_well=10_000), tl.ground_truth(scene, rig)[0]
    known = truth.disparity[np.isfinite(truth.disparity)]
    ndisp = int(known.max()) + 4
    record = sensor.expose_rig(exposed_for, rig=rig, lens=lens, seed=SEED)[0].record
    exposure = Exposure(record["time_s"], record["gain"])

    def score(pair: np.ndarray) -> np.ndarray:
        left, right = (
            photo.image
            for photo in sensor.expose_rig(
                pair, rig=rig, lens=lens, seed=SEED, exposure=exposure
            )
        )
        found = []
        for method in METHODS:
            disparity = tl.match(left, right, method=method, num_disparities=ndisp)
            scores = tl.evaluate(
                disparity, truth.disparity, mask_nonocc=truth.visible, ndisp=ndisp
            ).nonocc
            found += [scores["bad1.0"], scores["bad2.0"]]
        return np.array(found)

    return score


def rendered(
    scene: tl.Scene, rig: tl.Rig, lens: Lens, seed: int, spp: int, denoise: bool = False
) -> list[np.ndarray]:
    """The pair as commands render it: denoised images in two halves, for an estimate of their noise."""
    if not denoise:
        return tl.render(scene, rig, lens, spp, seed)
    return [
        view.image
        for view in render_measured(scene, rig, lens, spp, seed, denoise=True)[0]
    ]


def row(
    folder: Path, name: str, kind: str, kinds: list[str]
) -> dict[str, tuple[float, float, float]]:
    """(mean difference, largest difference, CPU seconds) of each kind of image."""
    scene, rig, lens = view(name, kind)
    converged = reference(folder, name, kind)
    score = scorer(scene, rig, lens, converged)
    expected, found = score(converged), {}
    for spp, denoise in ((16, False), (4, True), (6, True)):  # compiles
        rendered(scene, rig, lens, 0, spp, denoise)
    for label in kinds:
        start = time.process_time()
        pair = rendered(scene, rig, lens, SEED, **KINDS[label])
        seconds = time.process_time() - start
        apart = np.abs(score(pair) - expected)
        found[label] = float(apart.mean()), float(apart.max()), seconds
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--references", type=Path, required=True, help="folder of the references"
    )
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument(
        "--kinds",
        default=",".join(KINDS).replace(", d", "; d"),
        help="columns, ';' for a comma inside",
    )
    parser.add_argument(
        "--write", action="store_true", help=f"replace the table in {PAGE.name}"
    )
    options = parser.parse_args()
    use_threads(1)
    kinds = [label.replace(";", ",") for label in options.kinds.split(",")]
    lines = [
        "| scene, lens | " + " | ".join(kinds) + " |",
        "| --- |" + " --- |" * len(kinds),
    ]
    print("\n".join(lines), flush=True)
    rows = []
    for name in options.scenes.split(","):
        for lens in ("pinhole", "f/1.4"):
            found = row(options.references, name, lens.replace("/", ""), kinds)
            rows.append(found)
            cells = (
                f"{mean:.2f} (largest {most:.1f}; {cpu:.1f} s)"
                for mean, most, cpu in found.values()
            )
            lines.append(f"| {name}, {lens} | " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    means = {label: [found[label][0] for found in rows] for label in kinds}
    costs = {label: np.mean([found[label][2] for found in rows]) for label in kinds}
    lines.append(
        "| **mean** (worst) | "
        + " | ".join(f"**{np.mean(m):.2f}** ({max(m):.2f})" for m in means.values())
        + " |"
    )
    lines.append(
        "| cost | "
        + " | ".join(f"{cost / costs[kinds[0]]:.2f}" for cost in costs.values())
        + " |"
    )
    print("\n".join(lines[-2:]))
    if options.write:
        before, _, rest = PAGE.read_text().partition("| scene, lens |")
        after = rest[rest.index("\n\n") :] if "\n\n" in rest else "\n"
        PAGE.write_text(before + "\n".join(lines) + after)


if __name__ == "__main__":
    main()
