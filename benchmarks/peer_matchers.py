"""CNES Pandora and the Machine Vision Toolbox on one pair. `bench_accuracy.py` runs this in their own environment.

    python peer_matchers.py PAIR.npz MAPS.npz

PAIR holds left, right (grey uint8) and count (disparities 0..count-1). MAPS gets one disparity map per method,
NaN where unknown, and <method>/seconds: wall time and processor time, medians of three calls (of one call if it takes
more than ten seconds). Does not import twinlens.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

Run = Callable[[], np.ndarray]
BLOCK = 9
REFINED = {
    "refinement": {"refinement_method": "vfit"},
    "filter": {"filter_method": "median", "filter_size": 3},
}
CHECKED = {"validation": {"validation_method": "cross_checking_accurate"}}
PIPELINES = {
    "sad": ("sad", BLOCK, {}),
    "zncc": ("zncc", BLOCK, {}),
    "census": ("census", 5, {}),
    "census, cbca, vfit, median": (
        "census",
        5,
        {"aggregation": {"aggregation_method": "cbca"}, "disparity": None, **REFINED},
    ),
    "zncc, vfit, median": ("zncc", BLOCK, {"disparity": None, **REFINED}),
    "zncc, vfit, median, cross-check": (
        "zncc",
        BLOCK,
        {"disparity": None, **REFINED, **CHECKED},
    ),
}


def pandora_runs(
    left: np.ndarray, right: np.ndarray, count: int
) -> Iterator[tuple[str, Run]]:
    import pandora
    from pandora.check_configuration import check_conf
    from pandora.constants import Criteria
    from pandora.img_tools import create_dataset_from_inputs
    from pandora.state_machine import PandoraMachine

    folder = Path(tempfile.mkdtemp())
    for name, image in (("left", left), ("right", right)):
        Image.fromarray(image).save(folder / f"{name}.png")
    winner = {"disparity_method": "wta", "invalid_disparity": "NaN"}

    def runner(cost: str, side: int, more: dict) -> Run:
        first = {
            "matching_cost": {
                "matching_cost_method": cost,
                "window_size": side,
                "subpix": 1,
            }
        }
        pipeline = first | (
            {"disparity": winner}
            if "disparity" not in more
            else more | {"disparity": winner}
        )
        machine = PandoraMachine()
        inputs = {
            "left": {"img": str(folder / "left.png"), "disp": [1 - count, 0]},
            "right": {"img": str(folder / "right.png")},
        }
        settings = check_conf({"input": inputs, "pipeline": pipeline}, machine)
        settings["input"]["right"]["disp"] = [0, count - 1]
        pair = [
            create_dataset_from_inputs(settings["input"][eye])
            for eye in ("left", "right")
        ]

        def run() -> np.ndarray:
            found, _ = pandora.run(machine, *pair, settings)
            disparity = -found["disparity_map"].values
            if "validation" not in more:
                return disparity
            return np.where(
                found["validity_mask"].values & Criteria.PANDORA_MSK_PIXEL_INVALID,
                np.nan,
                disparity,
            )

        return run

    for name, (cost, side, more) in PIPELINES.items():
        yield f"Pandora {name}", runner(cost, side, more)


def toolbox_runs(
    left: np.ndarray, right: np.ndarray, count: int
) -> Iterator[tuple[str, Run]]:
    from machinevisiontoolbox import Image as Picture

    pair = [Picture(image.astype(np.float64) / 255) for image in (left, right)]

    def run() -> np.ndarray:
        found = (
            pair[0].stereo_simple(pair[1], BLOCK // 2, [1, count])[0].A.astype(float)
        )  # 0 is refused by it
        rows, columns = (
            (have - want) // 2
            for have, want in zip(found.shape, left.shape, strict=True)
        )
        return found[rows : rows + left.shape[0], columns : columns + left.shape[1]]

    yield "Machine Vision Toolbox zncc", run


def timed(run: Run) -> tuple[np.ndarray, tuple[float, float]]:
    wall: list[float] = []
    processor: list[float] = []
    while len(wall) < 3 and (not wall or wall[0] < 10):
        start, used = time.perf_counter(), time.process_time()
        found = run()
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - used)
    return found, (statistics.median(wall), statistics.median(processor))


def main() -> None:
    source, target = sys.argv[1:]
    pair = np.load(source)
    maps = {}
    for runs in (pandora_runs, toolbox_runs):
        try:
            for name, run in runs(pair["left"], pair["right"], int(pair["count"])):
                maps[name], maps[f"{name}/seconds"] = timed(run)
        except Exception as problem:
            print(f"{runs.__name__}: {type(problem).__name__}: {problem}")
    np.savez(target, **maps)


if __name__ == "__main__":
    main()
