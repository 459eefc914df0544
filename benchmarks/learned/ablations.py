"""What in the data matters: the same training with one factor of the data changed, three seeds each.

    python benchmarks/learned/ablations.py [--work out/learned] [--publish]

Run `run.py` first, with the same work folder. The network of `run.py` is trained with a tenth of its steps, on the
first 64 scenes. Changes of the renderer, of the alignment and of the textures are rendered again. Finished trainings
and scores are kept.
"""

import dataclasses
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
from twinlens.factory import read_recipe
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
        "none, rendered again": lit("unchanged"),
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
    return data.make_dataset(
        data.checked_recipe(run.RECIPE, count=MOST), folder, workers
    )


def main() -> None:
    parser = run.arguments(__doc__)
    options = parser.parse_args()
    if options.publish and options.pairs != ["motorcycle"]:
        parser.error("--publish is for the published protocol, without --pairs")
    torch.set_num_threads(1)
    sets: dict[str, Sequence[Pair]] = {
        "validation": list(DatasetPairs(tl.Dataset(options.work / "validation")))
    }
    sets |= {name: list(open_pairs([name])) for name in options.pairs}
    dataset, folder = scenes(options.work, options.workers), options.work / "ablations"
    folder.mkdir(exist_ok=True)
    recipe = read_recipe(run.RECIPE).written
    made_with = {
        "training": vars(TRAINING),
        "draws": run.DRAWS,
        "scenes": COUNT,
        "recipe": recipe,
    }
    write_file(
        folder / "training.json",
        run.check_settings(folder / "training.json", made_with),
    )
    results: dict[str, list[dict[str, list[float]]]] = {}
    for name, ablation in ablations(options.work).items():
        draws: list[dict[str, torch.Tensor]] = []
        for seed in run.SEEDS:
            file = folder / f"seed-{seed}-{run.folder_name(name)}.onnx"
            if not file.exists():
                if not draws:
                    chosen = [
                        i for i, stored in enumerate(dataset) if ablation.uses(stored)
                    ][: ablation.count]
                    draws = data.training_draws(
                        dataset[chosen], ablation.exposed, run.DRAWS
                    )
                network.export(network.train(draws, TRAINING, seed), file)
            method = score.method_of(file, **OPTIONS)
            found = {
                key: score.kept(
                    [method], pairs, folder / f"scores-{run.folder_name(key)}.json"
                )[method]
                for key, pairs in sets.items()
            }
            results.setdefault(name, []).append(found)
    if options.publish:
        run.publish("ablations", results)


if __name__ == "__main__":
    command.run(main)
