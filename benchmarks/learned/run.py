"""A small network trained on twinlens data alone, judged on real pairs: data, training, ONNX, scores, published page.

    python benchmarks/learned/run.py [--work out/learned] [--workers 2] [--pairs motorcycle FOLDER ...] [--publish]

Needs the extra `train`. Everything is kept in the work folder, and the next run resumes it. `--trial` runs everything
with a few scenes, in a work folder of its own. `--pairs` takes "motorcycle" and any folder that `twinlens benchmark`
reads, such as downloads of Middlebury. `--publish` writes README.md and results.json of this folder, and the weights of
the package. Settings are chosen on validation scenes: `--choose` scores other windows, supports and penalties on
these, and stops before the test scenes and the real pairs. `ablations.py` continues with the same work folder.
"""

import argparse
import dataclasses
import hashlib
import json
import multiprocessing
import re
import signal
import subprocess
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import command
import data
import network
import numpy as np
import score
import tables
import torch

import twinlens as tl
from twinlens.dataset.files import write_file
from twinlens.errors import InputError
from twinlens.factory import read_recipe
from twinlens.matching.costs import LEARNED_FILE
from twinlens.scoring import DatasetPairs, Pair, open_pairs
from twinlens.scoring.samples import fingerprint

HERE = Path(__file__).parent
SEEDS = (0, 1, 2)
DRAWS = 2  # exposures of each scene
HELD_OUT: dict[str, dict[str, Any]] = {
    "validation": {"count": 24},
    "validation, 700x500": {"count": 8, "width": 700, "height": 500},
    "test": {"count": 24},
}
"""Changes of the recipe for scenes that are not of the training. Other sizes are for the published recipe alone."""
RECIPE = HERE.resolve() / "recipe.toml"
TRAINING = network.Training()
TRIAL_SCENES, TRIAL_STEPS = 4, 4
WINDOWS = (5, 7, 9, 11, 13, 15, 19, 23)
COSTS = (
    "sad",
    "ssd",
    "ncc",
    "zsad",
    "zssd",
    "zncc",
    "jaccard",
    "census",
    "rank",
    "birchfield_tomasi",
)
PENALTIES = (
    (0.1, 0.4),
    (0.2, 0.6),
    (0.2, 0.9),
    (0.3, 0.9),
    (0.3, 1.0),
    (0.4, 0.9),
    (0.4, 1.0),
)  # p1, p2 of sgm
SUPPORTS = {
    "shiftable": (5, 9, 13), "adaptive": (15, 21, 31), "cross": (15, 25, 35, 45, 55), "guided": (7, 11, 19, 27),
}  # fmt: skip
LEARNED: dict[str, dict[str, Any]] = {
    "windows": {"base": "guided", "block_size": 11},
    "semi-global": {"base": "sgm", "block_size": 1, "p1": 0.2, "p2": 0.9},
}
"""Options of the learned descriptors, chosen on validation scenes."""
OTHERS: dict[str, list[dict[str, Any]]] = {
    "guided": [{"base": "guided", "block_size": side} for side in (7, 11, 19)]
    + [{"base": "cross", "block_size": side} for side in (15, 25)],
    "sgm": [
        {"base": "sgm", "block_size": 1, "p1": p1, "p2": p2} for p1, p2 in PENALTIES
    ],
}
"""What `--choose` compares, beside the hand-made methods that are the keys."""


def folder_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name)


def held_out_changes(recipe: Path, trial: bool = False) -> dict[str, dict[str, Any]]:
    """The changes of the recipe for each held-out set."""
    first, count = (
        read_recipe(recipe).seed + 1,
        {"count": TRIAL_SCENES} if trial else {},
    )
    sets = {
        name: {**changes, "seed": first + i, **count}
        for i, (name, changes) in enumerate(HELD_OUT.items())
    }
    return {
        name: changes
        for name, changes in sets.items()
        if recipe == RECIPE or "width" not in changes
    }


def train_seed(draws: Path, settings: network.Training, seed: int, file: Path) -> None:
    """Write the ONNX file of one seed. Runs in a process of its own."""
    torch.set_num_threads(1)
    network.export(
        network.train(
            torch.load(draws, mmap=True), settings, seed, file.with_suffix(".pt")
        ),
        file,
    )


def check_settings(file: Path, settings: dict[str, Any]) -> bytes:
    """What the file, which keeps the settings of a work folder, is to contain. Raises InputError if it has others."""
    text = json.dumps(settings, indent=1, sort_keys=True, default=str)
    if file.exists() and file.read_text() != text:
        raise InputError(
            f"{file}: this folder was made with other settings or another recipe (--trial has its own); "
            "choose another --work"
        )
    return text.encode()


def trained(dataset: tl.Dataset, work: Path, settings: network.Training) -> list[Path]:
    """The ONNX file of each seed; those that do not exist are trained side by side."""
    files = [work / f"seed-{seed}.onnx" for seed in SEEDS]
    missing = [
        (seed, file)
        for seed, file in zip(SEEDS, files, strict=True)
        if not file.exists()
    ]
    if missing:
        draws = work / "draws.pt"
        pairs = data.training_draws(dataset, data.Exposed(), DRAWS)
        torch.save(pairs, draws)
        settings = settings.covering(float(pairs[0]["disparity"].max()))
        with ProcessPoolExecutor(
            len(missing), multiprocessing.get_context("spawn")
        ) as pool:
            before = signal.signal(
                signal.SIGINT, signal.SIG_IGN
            )  # workers inherit it; this process stops them
            waiting = [
                pool.submit(train_seed, draws, settings, seed, file)
                for seed, file in missing
            ]
            signal.signal(signal.SIGINT, before)
            try:
                for done in waiting:
                    done.result()
            except BaseException:
                for worker in multiprocessing.active_children():
                    worker.terminate()
                raise
    return files


def hand_made(
    pairs: Sequence[Pair], file: Path, options_each: int | None = None
) -> dict[str, list[Any]]:
    """The best options of each hand-made method with their mean bad2.0: {name: [option, score]}.

    file : keeps the scores. options_each : number of windows or penalties that are tried, by default all.
    """
    methods = {
        name: {str(window): f"{name}:block_size={window}" for window in windows}
        for name, windows in {**dict.fromkeys(COSTS, WINDOWS), **SUPPORTS}.items()
    }
    methods["sgm"] = {f"{p1}, {p2}": f"sgm:p1={p1},p2={p2}" for p1, p2 in PENALTIES}
    found: dict[str, list[Any]] = {}
    for name, options in methods.items():
        scores = score.kept([*options.values()][:options_each], pairs, file)
        means = {
            option: float(np.mean(scores[method]))
            for option, method in options.items()
            if method in scores
        }
        best = min(means, key=means.__getitem__)
        found[name] = [best, means[best]]
    return found


def learned(
    files: list[Path], pairs: Sequence[Pair], kept: Path
) -> dict[str, list[float]]:
    """The mean bad2.0 of each seed's network with windows and with semi-global matching; `kept` keeps the scores."""
    methods = {
        name: [score.method_of(file, **options) for file in files]
        for name, options in LEARNED.items()
    }
    scores = score.kept(
        [method for each in methods.values() for method in each], pairs, kept
    )
    return {
        name: [float(np.mean(scores[method])) for method in each]
        for name, each in methods.items()
    }


def choose(file: Path, sets: dict[str, Any]) -> None:
    """Print the errors of a network with other options, and their mean ratio to the errors of a hand-made method."""
    for reference, candidates in OTHERS.items():
        known = [
            float(np.mean(score.bad2(reference, pairs))) for pairs in sets.values()
        ]
        print(f"{reference}: {np.round(known, 2)}", flush=True)
        for options in candidates:
            found = [
                float(np.mean(score.bad2(score.method_of(file, **options), pairs)))
                for pairs in sets.values()
            ]
            print(
                f"{np.mean(np.divide(found, known)):.3f} {options}: {np.round(found, 2)}",
                flush=True,
            )


def arguments(description: str | None) -> argparse.ArgumentParser:
    """The options that both scripts have."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--work",
        type=Path,
        default=Path("out/learned"),
        help="folder of data, checkpoints, networks",
    )
    parser.add_argument(
        "--workers", type=int, default=2, help="number of processes that render"
    )
    parser.add_argument(
        "--pairs",
        nargs="+",
        default=["motorcycle"],
        help="motorcycle, or folders of real pairs",
    )
    parser.add_argument(
        "--publish",
        action="store_true",
        help="write the page and the weights of the repository",
    )
    return parser


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument(
        "--recipe",
        type=lambda text: Path(text).resolve(),
        default=RECIPE,
        help="recipe of the scenes and cameras",
    )
    parser.add_argument(
        "--trial",
        action="store_true",
        help="four scenes a set, four steps: check a recipe in minutes",
    )
    parser.add_argument(
        "--choose",
        nargs="*",
        help="compare options on validation scenes, and on these pairs",
    )
    options = parser.parse_args()
    others = (
        options.trial,
        options.choose is not None,
        options.recipe != RECIPE,
        options.pairs != ["motorcycle"],
    )
    if options.publish and any(others):
        parser.error(
            "--publish is for the published protocol, without --trial, --choose, --recipe and --pairs"
        )
    changes = {"count": TRIAL_SCENES} if options.trial else {}
    settings = (
        dataclasses.replace(TRAINING, steps=TRIAL_STEPS) if options.trial else TRAINING
    )
    real = {
        name: list(open_pairs([name]))
        for name in (options.pairs if options.choose is None else options.choose)
    }
    held_out_sets = held_out_changes(options.recipe, options.trial)
    if options.choose is not None:
        del held_out_sets["test"]
    recipes = {
        name: data.checked_recipe(options.recipe, **changed)
        for name, changed in {"train": changes, **held_out_sets}.items()
    }
    made_with = {
        "training": vars(settings),
        "draws": DRAWS,
        "recipe": recipes["train"].written,
    }
    kept_settings = check_settings(options.work / "training.json", made_with)
    datasets = {
        name: data.make_dataset(
            recipe, options.work / folder_name(name), options.workers
        )
        for name, recipe in recipes.items()
    }
    dataset = datasets.pop("train")
    write_file(options.work / "training.json", kept_settings)
    files = trained(dataset, options.work, settings)
    sets = {name: list(DatasetPairs(found)) for name, found in datasets.items()}
    if options.choose is not None:
        larger = {**sets, **real}
        halves = {
            f"half {name}": [data.halved(pair) for pair in pairs]
            for name, pairs in [*larger.items()][1:]
        }
        choose(files[0], {**larger, **halves})
        return
    results: dict[str, Any] = {
        "scenes": len(dataset),
        "settings": {"training": vars(settings), "learned": LEARNED},
    }
    for name, pairs in {**sets, **real}.items():
        kept = options.work / f"scores-{folder_name(name)}.json"
        best_options = hand_made(pairs, kept, 1 if options.trial else None)
        results[name] = {
            "pairs": len(pairs),
            "hand-made": best_options,
            "learned": learned(files, pairs, kept),
        }
    print(tables.comparison(results))
    if options.publish:
        best = int(np.argmin(results["validation"]["learned"]["windows"]))
        write_file(LEARNED_FILE, files[best].read_bytes())
        publish(
            "scores",
            {
                **results,
                "published seed": best,
                "commit": commit(),
                "data_sha256": digest(dataset),
            },
        )


def publish(key: str, value: object) -> None:
    """Replace one key of results.json, and write README.md from all published results."""
    file = HERE / "results.json"
    results = json.loads(file.read_text()) if file.exists() else {}
    write_file(file, (json.dumps(results | {key: value}, indent=1) + "\n").encode())
    write_file(HERE / "README.md", tables.page().encode())


def commit() -> str:
    """The short hash of this checkout's commit."""
    command = ["git", "-C", str(HERE), "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(
        command, capture_output=True, text=True, check=True
    ).stdout.strip()


def digest(dataset: tl.Dataset) -> str:
    """SHA-256 of all images and truth of a dataset, but not of the stored light."""
    return hashlib.sha256(
        "".join(map(fingerprint, DatasetPairs(dataset))).encode()
    ).hexdigest()


if __name__ == "__main__":
    command.run(main)
