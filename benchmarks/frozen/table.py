"""The published page of the frozen benchmark: a board's numbers as Markdown. Computes no score."""

import math
from collections.abc import Mapping
from typing import Any

from twinlens.scoring import Board, caption, failures, find_metric, standings

Evidence = Mapping[str, tuple[float, float]]
"""By sample: the median correlation of windows at the true disparity, and the brightness by which the eyes differ."""

METRIC = "totbad2.0"
REAL = "Motorcycle (real)"


def page(board: Board, definition: dict[str, Any], variant: str, findings: str, evidence: Evidence) -> str:
    """README.md; `findings` is what a person has to say about the numbers, `evidence` what the photographs say."""
    text = "\n".join([*_sections(board), *_evidence(evidence)])
    return HEAD.format(**definition, variant=variant) + findings + "\n" + text + "\n"


def _sections(board: Board) -> list[str]:
    groups, protocol = _groups(board), board.protocols[0]
    names = [m.method for m in standings(board, protocol, "nonocc", weights=_weights(board, groups["pinhole"]))]
    rules = f"```\n{caption(board, protocol, 'nonocc')}\n```\n"
    lost = [f"- {line}" for line in failures(board)] or ["No method failed on any pair."]
    return [
        "## Non-occluded pixels\n", rules,
        _table(board, names, {label: (samples, "nonocc") for label, samples in groups.items()}, times=True),
        "## By region\n",
        "Means over the six pinhole photographs; by the same protocol.\n",
        _table(board, names, {region: (groups["pinhole"], region) for region in board.regions}),
        "Motorcycle alone (real; its textureless and discontinuity regions by the same rules):\n",
        _table(board, names, {region: (groups[REAL], region) for region in board.regions}),
        "## Every sample\n",
        "Non-occluded pixels; by the same protocol.\n",
        _table(board, names, {_short(s): ((s,), "nonocc") for s in board.samples}),
        "## Without an estimate\n",
        "Pixels that a method leaves unknown, in %; they count as bad above.\n",
        _table(board, names, {
            "pinhole, nonocc": (groups["pinhole"], "nonocc"), "Motorcycle, nonocc": (groups[REAL], "nonocc"),
            "Motorcycle, all": (groups[REAL], "all"),
        }, metric="invalid"),
        "## Failures\n", *lost,
    ]  # fmt: skip


def _evidence(evidence: Evidence) -> list[str]:
    rows = [f"| {_short(name)} | {alike:.2f} | {offset:.2f} |" for name, (alike, offset) in evidence.items()]
    return [EVIDENCE, *rows]


def _groups(board: Board) -> dict[str, tuple[str, ...]]:
    return {
        "pinhole": tuple(s for s in board.samples if s.endswith("pinhole")),
        "wide lens": tuple(s for s in board.samples if " · lens" in s),
        "unequal gain": tuple(s for s in board.samples if s.endswith("-gain")),
        REAL: ("motorcycle",),
    }


def _short(sample: str) -> str:
    name, _, lens = sample.partition(" · ")
    return (
        f"{name}, wide"
        if lens.startswith("lens")
        else name.removesuffix("-gain") + (", gain" if name.endswith("-gain") else "")
    )


def _weights(board: Board, samples: tuple[str, ...]) -> dict[str, float]:
    return {name: float(name in samples) for name in board.samples}


def _table(
    board: Board, methods: list[str], columns: dict[str, tuple[tuple[str, ...], str]], *, times: bool = False,
    metric: str = METRIC,
) -> str:  # fmt: skip
    protocol = board.protocols[0]

    def mean(method: str, samples: tuple[str, ...], region: str, metric: str) -> float:
        return board.mean(method, protocol, region, _weights(board, samples)).metrics[metric]

    rows = [[mean(method, *place, metric) for place in columns.values()] for method in methods]
    heads = [f"{label}, {METRIC} %" if times else label for label in columns]
    if times:
        rows = [
            [*row, *(mean(m, columns["pinhole"][0], "nonocc", name) for name in ("avgerr", "invalid", "time"))]
            for m, row in zip(methods, rows, strict=True)
        ]
        heads += ["pinhole, avgerr px", "pinhole, invalid %", "pinhole, time s"]
    kinds = [metric] * len(columns) + (["avgerr", "invalid", "time"] if times else [])
    return _markdown(methods, heads, rows, kinds)


def _markdown(methods: list[str], heads: list[str], rows: list[list[float]], kinds: list[str]) -> str:
    best = [min((row[i] for row in rows if not math.isnan(row[i])), default=math.nan) for i in range(len(heads))]
    lines = [f"| method | {' | '.join(heads)} |", "| --- |" + " ---: |" * len(heads)]
    for method, row in zip(methods, rows, strict=True):
        shown = [find_metric(kind).show(value) for kind, value in zip(kinds, row, strict=True)]
        cells = [f"**{text}**" if value == top else text for text, value, top in zip(shown, row, best, strict=True)]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


EVIDENCE = """
## The photographs themselves

Medians over non-occluded pixels at their *true* partners (`evidence.py`): the correlation of 9x9 windows, and how many
grey levels the left eye is brighter.

| photograph | correlation | left - right, grey levels |
| --- | ---: | ---: |"""
HEAD = """# {title}

`python benchmarks/frozen/run.py` renders the dataset, runs the matchers and writes this page and `board.json`;
`benchmark.toml` is the definition. Six scenes at {width}x{height}, {spp} samples a pixel, seed {seed}, each through a
pinhole and through a lens with an aperture of {aperture_of_baseline} of the baseline; `{mismatch[scene]}` once more
with a right eye of {mismatch[gain]} of the left one's gain; and Middlebury's Motorcycle, a real pair with measured
truth. Rendered with {variant}. The settings of all matchers but two (see below) were fixed before their scores were
seen.

"""
