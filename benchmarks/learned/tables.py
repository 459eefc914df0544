"""The published page, from results.json in this folder."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import score

HERE = Path(__file__).parent
FINDINGS = """`python benchmarks/learned/ablations.py --publish`. One factor of the data is changed at a time. In the
rows of renderer noise and of random textures both cameras also had the same lens, without tolerances, and the light was
rounded to 16 bits; the script no longer does either. The network is that of the first table, trained for 160 steps of 4
crops, a tenth of its training, on 64 scenes, with the same loss and crops; 3 seeds; bad2.0 of winner takes all, mean
(smallest to largest). All rows have the same number of steps, and the same shares of families and f-numbers as far as
their numbers of scenes allow. The rows of f/32 and of fewer families have other scenes in place of those that they
leave out.

Differences on the validation pairs have bootstrap intervals over seeds and pairs, with the quantiles of 95 % for all
rows together (Bonferroni). Three seeds are too few for that coverage, and the intervals do not include another choice
of training scenes. On Motorcycle, a single pair, the brackets are the smallest and the largest difference of three
seeds, which have the same sign by chance in a quarter of the rows.

- **Sensor noise.** Without it the errors on the validation pairs, which have this noise, rise by 2.2, on 23 of 24 pairs
  and by 1.0 in the median. On Motorcycle they fall by 0.5. Why is not known: by `twinlens statistics`, Motorcycle has
  as much noise as the random scenes (1.27 and 1.23 grey levels) but twice the contrast (15.3 and 7.8). The recipe is
  unchanged, because scores of real pairs choose nothing.
- **Renderer noise.** Images of 16 samples that are not denoised make the network worse on all validation pairs (+1.4)
  and on Motorcycle (+2.1). The recipe denoises.
- **Number of scenes.** These 10 scenes are worse than 64 for every seed (+0.1 to +0.3). With 30, 100 and 300 no
  difference was found.
- **All else.** No difference was found at this precision for lens blur, each single family, random textures in place of
  the families', differences of exposure and colour, and all differences of the cameras. That those of exposure and
  colour are not needed fits the input, which is locally normalised. Without the family `tabletop` every seed is a
  little worse (+0.02 to +0.20). On Motorcycle these rows differ by -0.14 to +0.14; one pair and three seeds do not
  settle such differences.

Longer trainings may depend more on these.
"""


def page() -> str:
    """The text of README.md."""
    results = json.loads((HERE / "results.json").read_text())
    made = "Published at commit {commit}. SHA-256 of the training scenes' images and truth:\n{data_sha256}\n"
    parts = [
        (HERE / "about.md").read_text(),
        "## Scores\n",
        comparison(results["scores"]),
    ]
    parts.append(made.format(**results["scores"]))
    if "ablations" in results:
        parts += [
            "## What in the data matters\n",
            FINDINGS,
            ablations(results["ablations"]),
        ]
    return "\n".join(parts)


def comparison(scores: Mapping[str, Any]) -> str:
    """bad2.0 of the hand-made costs with their best options, and of the networks, for each set of pairs."""
    sets = {
        name: value
        for name, value in scores.items()
        if isinstance(value, dict) and "hand-made" in value
    }
    names = [name for name in next(iter(sets.values()))["hand-made"] if name != "sgm"]
    rows = [
        [f"`{name}`", *(_best(found["hand-made"][name]) for found in sets.values())]
        for name in names
    ]
    rows.append(
        [
            "**learned, winner takes all**",
            *(_seeds(found["learned"]["windows"]) for found in sets.values()),
        ]
    )
    rows.append(
        [
            "`sgm` (census)",
            *(_best(found["hand-made"]["sgm"]) for found in sets.values()),
        ]
    )
    rows.append(
        [
            "**learned, semi-global**",
            *(_seeds(found["learned"]["semi-global"]) for found in sets.values()),
        ]
    )
    heads = [
        f"{name} ({found['pairs']} pair{'s' * (found['pairs'] != 1)})"
        for name, found in sets.items()
    ]
    return markdown(["bad2.0 %, nonocc", *heads], rows)


def _best(option_and_score: Sequence[Any]) -> str:
    return f"{option_and_score[1]:.2f} ({option_and_score[0]})"


def _seeds(values: Sequence[float]) -> str:
    return f"**{np.mean(values):.2f}** ({min(values):.2f} to {max(values):.2f})"


def ablations(results: Mapping[str, Sequence[Mapping[str, Sequence[float]]]]) -> str:
    """bad2.0 of each ablation on each set of pairs, and its difference to the first, the unchanged data."""
    base, rows = next(iter(results.values())), []
    for name, seeds in results.items():
        cells = []
        for key in seeds[0]:
            values, reference = (
                np.array([each[key] for each in some]) for some in (seeds, base)
            )
            cells.append(_seeds(values.mean(axis=1)))
            low, high = score.interval(values - reference, len(results) - 1)
            difference = (
                f"{(values - reference).mean():+.2f} ({low:+.2f} to {high:+.2f})"
            )
            cells.append("" if seeds is base else difference)
        rows.append([name, *cells])
    heads = [head for key in base[0] for head in (key, "difference")]
    return markdown(["change", *heads], rows)


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
