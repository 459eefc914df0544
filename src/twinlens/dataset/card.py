"""The dataset card: README.md with what the dataset holds, how it was made and under which licence, and its pictures.

The front matter is Hugging Face's, so that the folder can be uploaded as it is. The same dataset gives the same card.

Source: https://huggingface.co/docs/hub/datasets-cards; Gebru et al., Datasheets for datasets, CACM 2021.
"""

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from PIL import Image

import twinlens
from twinlens.dataset.about import KEY, About, about
from twinlens.dataset.croissant import write_croissant
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.figures import TILES, contact_sheet, statistics_figure, tile
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.manifest import Manifest, write_manifest
from twinlens.dataset.quantities import Statistics, mixed_counts, stored_statistics
from twinlens.dataset.record import plain
from twinlens.dataset.storage import Place, Where
from twinlens.dataset.stored import StoredSample
from twinlens.errors import FileError

T = TypeVar("T")

SHEET, FIGURE = "samples.jpg", "statistics.png"
_NAMES = ("README.md", "CARD.md")
_OURS = "<!-- This card is twinlens's: it is written anew with the dataset. -->"
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*$")
_LONGEST_RECIPE = 20_000

_TEXT = """
![left images]({sheet})

{count} stereo {samples}, rendered with twinlens {version}: images through a physically \
based camera, and the exact answer for every pixel.

## What it holds

| | |
| --- | --- |
{facts}

![distributions of what the truth holds]({figure})

Quantities are those of the left views, every sample weighing the same. Disparity is u_left - u_right in pixels, depth
is along the optical axis in metres, the blur circle is the diameter in pixels that a point is spread over by the lens.

## Reading it

    import twinlens as tl
    data = tl.Dataset("path/to/this/folder")
    data[0].im0, data[0].im1, data[0].disp0, data[0].mask0_nonocc, data[0].calibration

Every sample is a folder of plain files under Middlebury's names (im0.png, disp0.pfm, calib.txt, ...), so that other
tools open it as it is; `twinlens export` writes it in the layouts of KITTI, ETH3D, SceneFlow and others, and
`twinlens verify` checks every file against its SHA-256 and every view's truth against the other's. croissant.json
describes the files to machine-learning tools.

## How it was made

{made}

## What to know before using it

- The truth is that of the one ray through a pixel's centre; it is never averaged over the pixel or the lens. Unknown is
  +inf.
- A ray stops at the first surface, glass and mirrors included: `material_kind` in truth0.exr says where.
- The scenes are synthetic: what a matcher scores here is its score on such scenes.

## Licence

{license}
"""


def describe(dataset: Where | Dataset, given: About | None = None) -> list[str]:
    """Write the card and croissant.json into a dataset's folder; returns the names of the files.

    `given` is merged into dataset.json: texts that it leaves empty keep their value. Raises FileError if `given` is not
    empty and there is no dataset.json, and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    if given is not None and given.plain():
        manifest = dataset.manifest
        info = {**manifest.info, KEY: about(dataset)[0].plain() | given.plain()}
        write_manifest(dataset.path, dataclasses.replace(manifest, info=info))
    return [*write_card(dataset), write_croissant(dataset)]


def write_card(dataset: Where | Dataset) -> list[str]:
    """Write README.md, samples.jpg and statistics.png into a dataset's folder; their names.

    A README.md that is not twinlens's own is left alone: then the card is CARD.md. Statistics come from sample.json
    where they stand there, else from the truth; one sample is in memory at a time. Samples that cannot be read are not
    counted, and named. Raises FileError when none can be read, and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    said, manifest = about(dataset)
    many = {sample.name: told for sample in dataset if (told := _readable(sample, stored_statistics)) is not None}
    chosen = np.linspace(0, len(many) - 1, min(len(many), TILES)).round().astype(int)
    tiles = (_readable(dataset[list(many)[i]], _left_tile) for i in chosen)
    shown = [tile for tile in tiles if tile is not None]
    if not shown:
        raise FileError(f"{dataset.path}: none of its samples can be read; `twinlens verify` says why")
    write_file(dataset.path / SHEET, contact_sheet(shown))
    write_file(dataset.path / FIGURE, statistics_figure(list(many.values())))
    name = _free_name(dataset.path)
    lost = [name for name in dataset.names if name not in many]
    write_file(dataset.path / name, _card(said, manifest, list(many.values()), lost).encode())
    return [name, SHEET, FIGURE]


def _readable(sample: StoredSample, read: Callable[[StoredSample], T]) -> T | None:
    """What `read` answers of a sample, None where its files do not let it."""
    try:
        return read(sample)
    except FileError:
        return None


def _left_tile(sample: StoredSample) -> Image.Image:
    return tile(sample.im0)


def _free_name(folder: Place) -> str:
    path = folder / _NAMES[0]
    return _NAMES[1] if path.is_file() and _OURS.encode() not in read_bytes(path) else _NAMES[0]


def _card(said: About, manifest: Manifest, many: Sequence[Statistics], lost: Sequence[str]) -> str:
    body = _TEXT.format(
        sheet=SHEET,
        figure=FIGURE,
        version=twinlens.__version__,
        count=len(many),
        samples="samples" if len(many) > 1 else "sample",
        facts="\n".join(f"| {key} | {value} |" for key, value in _facts(manifest, many).items()),
        made=_made(manifest) + (f"\n\nNot readable, and not counted here: {', '.join(lost)}." if lost else ""),
        license=_license(said),
    )
    head = f"# {said.title}\n" + (f"\n{said.description}\n" if said.description else "")
    return f"{_front_matter(said, len(many))}{_OURS}\n\n{head}{body}"


def _front_matter(said: About, count: int) -> str:
    named = said.license.lower() if _SPDX.match(said.license) else "other" if said.license else "unknown"
    entries: dict[str, Any] = {"pretty_name": said.title, "license": named}
    if named == "other":
        entries["license_link"] = said.license
    category = next(text for limit, text in _CATEGORIES if count < limit)
    entries |= {"task_categories": ["depth-estimation"], "tags": ["stereo", "synthetic", "twinlens"]}
    entries |= {"size_categories": [category]}
    # JSON is YAML, so no text of the maker's can end its line.
    return "---\n" + "".join(f"{key}: {json.dumps(value)}\n" for key, value in entries.items()) + "---\n"


_CATEGORIES = (
    (1_000, "n<1K"),
    (10_000, "1K<n<10K"),
    (100_000, "10K<n<100K"),
    (1_000_000, "100K<n<1M"),
    (float("inf"), "n>1M"),
)


def _facts(manifest: Manifest, many: Sequence[Statistics]) -> dict[str, str]:
    facts = {"samples": str(len(many)), "image size": _counted(tuple(each["size"]) for each in many)}
    facts |= {f"{kind} of a sample": _counted(each[kind] for each in many) for kind in ("cameras", "lenses")}
    splits = Counter(str(row.info["split"]) for row in manifest.rows if "split" in row.info)
    if splits:
        facts["splits"] = ", ".join(f"{name}: {count}" for name, count in sorted(splits.items()))
    known = [each for each in many if "disparity" in each]
    blurs = [blur for each in known for blur in each["blur_px"] if blur and blur[-1] > 0]
    facts["disparity"] = _range([each["disparity"] for each in known], "px")
    facts["depth"] = _range([each["depth"] for each in known], "m")
    facts["blur circle, through lenses that blur"] = _range(blurs, "px")
    for name, text in (("visible", "seen by both views"), ("occluded", "seen by one view"), ("unknown", "unknown")):
        facts[f"pixels {text}"] = f"{100 * float(np.mean([each[name] for each in known])):.1f}%" if known else "-"
    return facts


def _counted(values: Any) -> str:
    """The values that occur, the commonest first: ``640 x 480``, or ``2 (9 samples), 3 (1 sample)``."""
    counts = Counter(" x ".join(map(str, v)) if isinstance(v, tuple) else str(v) for v in values).most_common()
    if len(counts) == 1:
        return counts[0][0]
    shown = ", ".join(f"{value} ({count})" for value, count in counts[:6])
    return shown + (", ..." if len(counts) > 6 else "")


def _range(many: Sequence[Sequence[float]], unit: str) -> str:
    many = [each for each in many if each]
    if not many:
        return "-"
    low, high = min(each[0] for each in many), max(each[-1] for each in many)
    if high <= low:
        return f"{low:.4g} {unit}"
    edges = np.linspace(low, high, 1001) if low <= 0 else np.geomspace(low, high, 1001)
    below = np.cumsum(mixed_counts(edges, many)) / len(many)
    middle = edges[1 + int(np.searchsorted(below, 0.5))]
    return f"{low:.4g} to {high:.4g} {unit}, half of it below {middle:.4g} {unit}"


def _made(manifest: Manifest) -> str:
    parts = [f"Seed: {manifest.seed}."] if manifest.seed is not None else []
    versions = manifest.info.get("versions")
    if isinstance(versions, Mapping):
        parts.append("Versions: " + ", ".join(f"{name} {number}" for name, number in versions.items()) + ".")
    rejected = manifest.info.get("rejected")
    if isinstance(rejected, Mapping) and rejected:
        counts = ", ".join(f"{reason}: {count}" for reason, count in rejected.items())
        parts.append(f"Drawn, refused by the quality gates, and drawn anew - {counts}.")
    parts.append("sample.json of each sample says what made it: cameras, lens, sensor, seed, backend.")
    recipe = json.dumps(plain(manifest.recipe), indent=2, ensure_ascii=False)
    if manifest.recipe and len(recipe) <= _LONGEST_RECIPE:
        parts.append("The recipe:\n\n" + "\n".join(f"    {line}" for line in recipe.splitlines()))
    elif manifest.recipe:
        parts.append("The recipe stands in dataset.json.")
    return "\n\n".join(parts)


def _license(said: About) -> str:
    given = said.license or "Not stated by the maker of this dataset: ask before you pass it on."
    by = f"Made by {said.creator}." if said.creator else ""
    cite = "To cite it:\n\n" + "\n".join(f"    {line}" for line in said.cite_as.splitlines()) if said.cite_as else ""
    return "\n\n".join(part for part in (given, by, cite) if part)
