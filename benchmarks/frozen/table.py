"""The published page of the frozen benchmark: the scores of a board as Markdown."""

import math
from collections.abc import Mapping
from typing import Any

from twinlens.scoring import Board, caption, failures, find_metric, standings

Evidence = Mapping[str, tuple[float, float]]
"""By sample, at the true disparity: median correlation of windows, and median of left minus right grey levels."""

METRIC = "totbad2.0"
REAL = "Motorcycle (real)"


def page(board: Board, definition: dict[str, Any], variant: str, findings: str, evidence: Evidence) -> str:
    """The text of README.md, with `findings` (written by hand) and the image statistics `evidence`."""
    text = "\n".join([*_sections(board), *_evidence(evidence)])
    return HEAD.format(**definition, variant=variant) + findings + "\n" + text + "\n"


def _sections(board: Board) -> list[str]:
    groups, protocol = _groups(board), board.protocols[0]
    names = [m.method for m in standings(board, protocol, "nonocc", weights=_weights(board, groups["pinhole"]))]
    rules = f"```\n{caption(board, protocol, 'nonocc')}\n```\n"
    failed = [f"- {line}" for line in failures(board)] or ["No method failed on any pair."]
    return [
        "## Non-occluded pixels\n", rules,
        _table(board, names, {label: (samples, "nonocc") for label, samples in groups.items()}, times=True),
        "## By region\n",
        "Means over the six pinhole images; same protocol.\n",
        _table(board, names, {region: (groups["pinhole"], region) for region in board.regions}),
        "Motorcycle only (real; regions defined in the same way):\n",
        _table(board, names, {region: (groups[REAL], region) for region in board.regions}),
        "## Every sample\n",
        "Non-occluded pixels; same protocol.\n",
        _table(board, names, {_short(s): ((s,), "nonocc") for s in board.samples}),
        "## Unknown pixels\n",
        "Pixels without an estimate, in %. They count as bad in the tables above.\n",
        _table(board, names, {
            "pinhole, nonocc": (groups["pinhole"], "nonocc"), "Motorcycle, nonocc": (groups[REAL], "nonocc"),
            "Motorcycle, all": (groups[REAL], "all"),
        }, metric="invalid"),
        "## Failures\n", *failed,
    ]  # fmt: skip


def _evidence(evidence: Evidence) -> list[str]:
    rows = [
        f"| {_short(name)} | {correlation:.2f} | {offset:.2f} |" for name, (correlation, offset) in evidence.items()
    ]
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
## Image statistics

Medians over non-occluded pixels at their *true* matches (`evidence.py`): the correlation of 9x9 windows, and the
difference of the grey levels.

| image | correlation | left - right, grey levels |
| --- | ---: | ---: |"""
HEAD = """# {title}

`python benchmarks/frozen/run.py` renders the dataset, runs the matchers and writes this page and `board.json`.
`benchmark.toml` defines the benchmark:

- six scenes at {width}x{height}, {spp} samples per pixel, seed {seed}, each through a pinhole and
  through a wide lens, whose aperture is {aperture_of_baseline} of the baseline;
- the scene `{mismatch[scene]}` again through the pinhole, where the right camera has {mismatch[gain]} of the left
  camera's gain;
- Middlebury's Motorcycle, a real pair with measured ground truth.

Rendered with {variant}. The settings of all matchers except two (see Findings) were fixed before their scores were
known.

"""
