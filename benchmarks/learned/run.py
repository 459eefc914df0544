"""A small network trained on twinlens data alone, judged on real pairs: data, training, ONNX, scores, published page.

    python benchmarks/learned/run.py [--work out/learned] [--workers 2] [--pairs motorcycle FOLDER ...] [--publish]

Needs the extra `train`. Everything is kept in the work folder, and the next run resumes it. `--pairs` takes
"motorcycle" and any folder that `twinlens benchmark` reads, such as downloads of Middlebury. `--publish` writes
README.md and results.json of this folder, and the weights of the package. Settings were chosen on held-out random
scenes alone; the scores of real pairs chose nothing. `ablations.py` continues with the same work folder.
"""

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import data
import network
import numpy as np
import score
import tables
import torch

import twinlens as tl
from twinlens.matching.costs import LEARNED_FILE
from twinlens.scoring import DatasetPairs, open_pairs

HERE = Path(__file__).parent
SEEDS = (0, 1, 2)
DRAWS = 2  # exposures of each scene
HELD_OUT: dict[str, Any] = {"seed": 22, "count": 24}
TRAINING = network.Training()
WINDOWS = (5, 7, 9, 11, 13, 15, 19, 23)
COSTS = ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard", "census", "rank", "birchfield_tomasi")
SUPPORTS = {"shiftable": (5, 9, 13), "adaptive": (15, 21, 31), "cross": (25, 35, 45), "guided": (11, 19, 27)}
LEARNED: dict[str, dict[str, Any]] = {
    "windows": {"base": "cross", "block_size": 35},
    "semi-global": {"base": "sgm", "block_size": 1, "p1": 0.2, "p2": 0.9},
}
"""Options of the learned descriptors, chosen on the held-out scenes."""


def trained(dataset: tl.Dataset, work: Path) -> list[Path]:
    """The ONNX file of each seed, trained if it does not exist."""
    files = [work / f"seed-{seed}.onnx" for seed in SEEDS]
    draws: list[dict[str, torch.Tensor]] = []
    for seed, file in zip(SEEDS, files, strict=True):
        if not file.exists():
            draws = draws or [data.load(dataset, data.Exposed(draw)) for draw in range(DRAWS)]
            network.export(network.train(draws, TRAINING, seed, file.with_suffix(".pt")), file)
    return files


def hand_made(pairs: Any) -> dict[str, list[Any]]:
    """Of each cost and support, the best window with its mean bad2.0: {name: [window, score]}; and of `sgm`."""
    found: dict[str, list[Any]] = {}
    for name, windows in {**dict.fromkeys(COSTS, WINDOWS), **SUPPORTS}.items():
        means = {window: np.mean(score.bad2(f"{name}:block_size={window}", pairs)) for window in windows}
        best = min(means, key=means.__getitem__)
        found[name] = [best, float(means[best])]
        print(f"{name}: {found[name]}", flush=True)
    return found | {"sgm": [1, float(np.mean(score.bad2("sgm", pairs)))]}


def learned(files: list[Path], pairs: Any) -> dict[str, list[float]]:
    """Of windows and of semi-global matching, the mean bad2.0 of each seed."""
    return {
        name: [float(np.mean(score.bad2(score.network(file, **options), pairs))) for file in files]
        for name, options in LEARNED.items()
    }


def arguments(description: str | None) -> argparse.ArgumentParser:
    """The options that both scripts have."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", type=Path, default=HERE / "recipe.toml", help="of the scenes, for your own cameras")
    parser.add_argument("--work", type=Path, default=Path("out/learned"), help="folder of data, checkpoints, networks")
    parser.add_argument("--workers", type=int, default=1, help="number of processes that render")
    parser.add_argument("--threads", type=int, default=2, help="number of threads that train")
    parser.add_argument("--pairs", nargs="+", default=["motorcycle"], help="motorcycle, or folders of real pairs")
    parser.add_argument("--publish", action="store_true", help="write the page and the weights of the repository")
    return parser


def main() -> None:
    options = arguments(__doc__).parse_args()
    torch.set_num_threads(options.threads)
    dataset = data.make_dataset(options.recipe, options.work / "train", options.workers)
    files = trained(dataset, options.work)
    held_out = data.make_dataset(options.recipe, options.work / "heldout", options.workers, **HELD_OUT)
    results: dict[str, Any] = {"scenes": len(dataset), "settings": {"training": vars(TRAINING), "learned": LEARNED}}
    sets = {"held-out": DatasetPairs(held_out), **{name: open_pairs([name]) for name in options.pairs}}
    for name, pairs in ((name, list(found)) for name, found in sets.items()):
        results[name] = {"pairs": len(pairs), "hand-made": hand_made(pairs), "learned": learned(files, pairs)}
    print(tables.comparison(results))
    if options.publish:
        best = int(np.argmin(results["held-out"]["learned"]["windows"]))
        shutil.copy(files[best], LEARNED_FILE)
        publish("scores", results | {"published seed": best})


def publish(key: str, value: object) -> None:
    """Replace one key of results.json, and write README.md from all published results."""
    file = HERE / "results.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(results | {key: value}, indent=1) + "\n")
    (HERE / "README.md").write_text(tables.page())


if __name__ == "__main__":
    main()
