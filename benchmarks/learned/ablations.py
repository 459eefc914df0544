"""What in the data matters: the same training with one factor of the data changed, three seeds each.

    python benchmarks/learned/ablations.py [--work out/learned] [--threads 1] [--publish]

Run `run.py` first, with the same work folder. A small network is trained on the first 32 scenes.
Changes of the renderer, of the alignment and of the textures are rendered again. Finished trainings are kept.
"""

import json
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
from twinlens.families import FAMILIES
from twinlens.scoring import DatasetPairs, Pair, open_pairs

COUNT = 32
TRAINING = network.Training(channels=24, steps=150, crops=2, scale=1, shapes=0)
OPTIONS = {"base": "sad", "block_size": 9}


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
        "none": Ablation(),
        "no lens blur (f/32 only)": Ablation(uses=data.is_sharp),
        "no sensor noise": Ablation(data.Exposed(noise=False)),
        "no difference of exposure and colour": Ablation(data.Exposed(level="none")),
        "no difference of the cameras": lit("aligned", level="none"),
        "renderer noise (16 samples, not denoised)": lit("not denoised"),
        "random textures": lit("random textures"),
        **{f"without the family {name}": Ablation(uses=partial(is_not_of, name)) for name in FAMILIES},
        **{f"{count} scenes": Ablation(count=count) for count in (10, 100, 160)},
    }  # fmt: skip


def scores(file: Path, held_out: Sequence[Pair], real: dict[str, Sequence[Pair]]) -> dict[str, list[float]]:
    method = score.network(file, **OPTIONS)
    return {name: score.bad2(method, pairs) for name, pairs in {"held-out": held_out, **real}.items()}


def main() -> None:
    parser = run.arguments(__doc__)
    parser.add_argument("--threads", type=int, default=2, help="number of threads that train")
    parser.add_argument("--only", nargs="+", help="numbers of ablations, to divide the work between processes")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    dataset, folder = tl.Dataset(options.work / "train"), options.work / "ablations"
    folder.mkdir(exist_ok=True)
    held_out = list(DatasetPairs(tl.Dataset(options.work / "held-out")[::2]))
    real = {name: list(open_pairs([name])) for name in options.pairs}
    results: dict[str, list[dict[str, list[float]]]] = {}
    for number, (name, ablation) in enumerate(ablations(options.work).items()):
        if options.only and str(number) not in options.only:
            continue
        draws: list[dict[str, torch.Tensor]] = []
        for seed in run.SEEDS:
            file = folder / f"{number}-{seed}.json"
            if not file.exists():
                if not draws:
                    chosen = [i for i, stored in enumerate(dataset) if ablation.uses(stored)][: ablation.count]
                    draws = data.training_draws(dataset[chosen], ablation.exposed, draws=1)
                network.export(network.train(draws, TRAINING, seed), file.with_suffix(".onnx"))
                file.write_text(json.dumps(scores(file.with_suffix(".onnx"), held_out, real)))
            results.setdefault(name, []).append(json.loads(file.read_text()))
        print(name, [round(sum(each["held-out"]) / len(held_out), 2) for each in results[name]], flush=True)
    if options.publish:
        run.publish("ablations", results)


if __name__ == "__main__":
    command.run(main)
