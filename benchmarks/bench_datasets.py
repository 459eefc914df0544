"""Time and memory of the commands for whole datasets, at several numbers of samples.

    python benchmarks/bench_datasets.py [DATASET] [COUNT ...]

The samples of DATASET are repeated up to COUNT (by default 1,000 and 10,000), with records of their own: hard links of
all files but sample.json, which has another scene and another drawn value in each. Without DATASET, four samples of
160 x 120 are rendered. Processor time and peak memory are those of each command's own process, and its children.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from twinlens.dataset import Dataset, Manifest, Row, write_manifest
from twinlens.dataset.dataset import row_of

RECIPE = """
seed = 1
count = 4
families = ["tabletop", "room"]
width = 160
height = 120
spp = 4
"""


def twinlens(*arguments: Any) -> tuple[float, float]:
    """Run a command: processor seconds, and the peak of memory in MB."""
    process = subprocess.Popen(
        [sys.executable, "-m", "twinlens", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"twinlens {arguments[0]} ended with {status}")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def repeated(source: Dataset, folder: Path, numbers: range) -> Path:
    """A dataset of as many samples as numbers, which are copies of those of the source but for their records."""
    hashes = [row_of(source.path, sample.name).files for sample in source]
    rows = []
    for number in numbers:
        sample = source[number % len(source)]
        name = f"{number:07d}"
        files = hashes[number % len(source)]
        for file in files:
            target = folder / name / file
            target.parent.mkdir(parents=True, exist_ok=True)
            if file != "sample.json":
                target.hardlink_to(sample.path(file))
        record = sample.record
        record["record"]["scene"] = f"scene {number}"
        spec = record["record"].setdefault("spec", {"drawn": {}})
        spec["drawn"].setdefault("rig", {})["baseline"] = number / 1e5
        (folder / name / "sample.json").write_text(json.dumps(record))
        rows.append(Row(name, row_of(folder, name).files, {"index": number}))
    write_manifest(folder, Manifest(tuple(rows)))
    return folder


def measured(source: Dataset, home: Path, count: int) -> dict[str, tuple[float, float]]:
    """Command -> processor seconds and peak memory, for a dataset of so many samples."""
    half = count // 2
    first = repeated(source, home / "first", range(half))
    second = repeated(source, home / "second", range(half, count))
    whole, part = home / "all", home / "part"
    limit = f"rig.baseline < {half / 1e5}"
    return {
        "subset (merge, --link)": twinlens("subset", first, second, "-o", whole, "--link"),
        "verify": twinlens("verify", whole),
        "subset (half by a condition, a channel dropped, new splits)": twinlens(
            "subset", whole, "-o", part, "--where", limit, "--drop", "position", "--splits", "train=0.9,test=0.1"
        ),
        "browse": twinlens("browse", whole),
        "browse, again": twinlens("browse", whole),
    }  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Print a table of commands and numbers of samples."""
    counts = [int(text) for text in arguments if text.isdecimal()] or [1000, 10000]
    folders = [text for text in arguments if not text.isdecimal()]
    table = Table("command", "samples", "processor s", "ms a sample", "peak MB")
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR", ".")) as home:
        place = Path(home)
        if not folders:
            (place / "recipe.toml").write_text(RECIPE)
            twinlens("generate", place / "recipe.toml", "-o", place / "source")
        source = Dataset(folders[0] if folders else place / "source")
        for count in counts:
            for command, (seconds, peak) in measured(
                source, place / str(count), count
            ).items():
                cells = f"{seconds:.1f}", f"{1e3 * seconds / count:.1f}", f"{peak:.0f}"
                table.add_row(command, str(count), *cells)
    Console(width=120).print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
