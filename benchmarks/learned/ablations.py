"""What in the data matters: the same training with one factor of the data changed, three seeds each.

    python benchmarks/learned/ablations.py [--work out/learned] [--publish]

Run `run.py` first, with the same work folder. The network of `run.py` is trained with a tenth of its steps, on the
first 64 scenes. Changes of the renderer, of the alignment and of the textures are rendered again. Finished trainings
are kept.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import command
import data
import network
import run
import score
import torch

import twinlens as tl
from twinlens.dataset.files import write_file
from twinlens.families import FAMILIES
from twinlens.scoring import DatasetPairs, Pair, open_pairs

COUNT = 64  # all families with all f-numbers are equally frequent in the first 16, 32, 48, ... scenes
MOST = 300
TRAINING = dataclasses.replace(run.TRAINING, steps=160)
OPTIONS = run.LEARNED["windows"]


@dataclass(frozen=True)
class Ablation:
    """Which scenes a network is trained on, and how they are exposed."""

    exposed: data.Exposed = field(default_factory=data.Exposed)
    uses: Callable[[tl.dataset.StoredSample], bool] = lambda stored: True
    count: int = COUNT


def is_not_of(name: str, stored: tl.dataset.StoredSample) -> bool:
    return data.family(stored) != name


def ablations(work: Path) -> dict[str, Ablation]:
    def lit(kind: str, **changes: object) -> Ablation:
        return Ablation(data.Exposed(light=kind, folder=work / "light", **changes))

    return {
        f"none ({COUNT} scenes)": Ablation(),
        "no lens blur (f/32 only)": Ablation(uses=data.is_sharp),
        "no sensor noise": Ablation(data.Exposed(noise=False)),
        "no difference of exposure and colour": Ablation(data.Exposed(level="none")),
        "no difference of the cameras": lit("aligned", level="none"),
        "renderer noise (16 samples, not denoised)": lit("not denoised"),
        "random textures": lit("random textures"),
        **{f"without the family {name}": Ablation(uses=partial(is_not_of, name)) for name in FAMILIES},
        **{f"{count} scenes": Ablation(count=count) for count in (10, 30, 100, MOST)},
    }  # fmt: skip


def scenes(work: Path, workers: int) -> tl.Dataset:
    """The scenes of `run.py`, and more of the same recipe."""
    folder = work / f"train-{MOST}"
    if not folder.exists():
        shutil.copytree(work / "train", work / "train.part", dirs_exist_ok=True)
        (work / "train.part").rename(folder)
    return data.make_dataset(run.HERE / "recipe.toml", folder, workers, count=MOST)


def scores(file: Path, held_out: Sequence[Pair], real: dict[str, Sequence[Pair]]) -> dict[str, list[float]]:
    method = score.network(file, **OPTIONS)
    return {name: score.bad2(method, pairs) for name, pairs in {"held-out": held_out, **real}.items()}


def main() -> None:
    parser = run.arguments(__doc__)
    parser.add_argument("--only", nargs="+", help="numbers of ablations, to divide the work between processes")
    options = parser.parse_args()
    torch.set_num_threads(1)
    held_out = list(DatasetPairs(tl.Dataset(options.work / "held-out")))
    real = {name: list(open_pairs([name])) for name in options.pairs}
    dataset, folder = scenes(options.work, options.workers), options.work / "ablations"
    folder.mkdir(exist_ok=True)
    made_with = {"training": vars(TRAINING), "draws": run.DRAWS, "scenes": COUNT, "options": OPTIONS}
    run.check_settings(folder / "training.json", made_with)
    results: dict[str, list[dict[str, list[float]]]] = {}
    for number, (name, ablation) in enumerate(ablations(options.work).items()):
        if options.only and str(number) not in options.only:
            continue
        draws: list[dict[str, torch.Tensor]] = []
        for seed in run.SEEDS:
            file = folder / f"seed-{seed}-{run.folder_name(name)}.json"
            if not file.exists():
                if not draws:
                    chosen = [i for i, stored in enumerate(dataset) if ablation.uses(stored)][: ablation.count]
                    draws = data.training_draws(dataset[chosen], ablation.exposed, run.DRAWS)
                network.export(network.train(draws, TRAINING, seed), file.with_suffix(".onnx"))
                found = scores(file.with_suffix(".onnx"), held_out, real)
                write_file(file, json.dumps(found).encode())
            results.setdefault(name, []).append(json.loads(file.read_text()))
        print(name, [round(sum(each["held-out"]) / len(held_out), 2) for each in results[name]], flush=True)
    if options.publish:
        run.publish("ablations", results)


if __name__ == "__main__":
    command.run(main)
