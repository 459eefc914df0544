"""The dataset card: README.md with contents, recipe, licence and figures of a dataset.

The front matter follows Hugging Face, so that the folder can be uploaded. The same dataset gives the same card.

Source: https://huggingface.co/docs/hub/datasets-cards; Gebru et al., Datasheets for datasets, CACM 2021.
"""

import dataclasses
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

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
_MARKER = "<!-- Written by twinlens; `twinlens describe` rewrites it. -->"
_OLD_MARKER = "<!-- This card is twinlens's: it is written anew with the dataset. -->"
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*$")
_MAX_RECIPE = 20_000

_TEXT = """
![left images]({sheet})

{count} stereo {samples}, rendered with twinlens {version}: images of a physically based camera, and exact ground \
truth for every pixel.

## Contents

| | |
| --- | --- |
{facts}

![distributions of the ground truth]({figure})

Quantities are those of the left views; all samples have the same weight. Disparity is u_left - u_right in pixels, depth
is along the optical axis in metres, and the blur circle is the diameter, in pixels, of the image of a point.

## Loading

    import twinlens as tl
    data = tl.Dataset("path/to/this/folder")
    data[0].im0, data[0].im1, data[0].disp0, data[0].mask0_nonocc, data[0].calibration

Every sample is a folder of plain files with Middlebury's names (im0.png, disp0.pfm, calib.txt, ...), which other tools
can open. `twinlens export` writes the layouts of KITTI, ETH3D, SceneFlow and others. `twinlens verify` checks every
file against its SHA-256 and the truth of each view against the other's. croissant.json describes the files to
machine-learning tools.

## Recipe

{made}

## Limitations

- Ground truth is that of the ray through the pixel centre, not averaged over the pixel or the lens. Unknown is +inf.
- A ray ends at the first surface, also at glass and mirrors; `material_kind` in truth0.exr identifies them.
- The scenes are synthetic: scores on them do not replace scores on real images.

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
    """Write README.md, samples.jpg and statistics.png into a dataset's folder; returns their names.

    A README.md that twinlens did not write is kept, and the card is CARD.md. Statistics come from sample.json, or else
    from the truth, with one sample in memory at a time. Unreadable samples are listed and not counted. Raises FileError
    if no sample can be read, and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    given, manifest = about(dataset)
    many = {sample.name: each for sample in dataset if (each := _readable(sample, stored_statistics)) is not None}
    chosen = np.linspace(0, len(many) - 1, min(len(many), TILES)).round().astype(int)
    tiles = (_readable(dataset[list(many)[i]], lambda sample: tile(sample.im0)) for i in chosen)
    shown = [each for each in tiles if each is not None]
    if not shown:
        raise FileError(f"{dataset.path}: no sample can be read; see `twinlens verify`")
    stream = io.BytesIO()
    contact_sheet(shown).save(stream, "JPEG", quality=88)
    write_file(dataset.path / SHEET, stream.getvalue())
    write_file(dataset.path / FIGURE, statistics_figure(list(many.values())))
    name = _free_name(dataset.path)
    unreadable = [name for name in dataset.names if name not in many]
    write_file(dataset.path / name, _card(given, manifest, list(many.values()), unreadable).encode())
    return [name, SHEET, FIGURE]


def _readable(sample: StoredSample, read: Callable[[StoredSample], T]) -> T | None:
    """`read(sample)`, or None if a file cannot be read."""
    try:
        return read(sample)
    except FileError:
        return None


def _free_name(folder: Place) -> str:
    path = folder / _NAMES[0]
    if not path.is_file():
        return _NAMES[0]
    content = read_bytes(path)
    return _NAMES[0] if any(marker.encode() in content for marker in (_MARKER, _OLD_MARKER)) else _NAMES[1]


def _card(given: About, manifest: Manifest, many: Sequence[Statistics], unreadable: Sequence[str]) -> str:
    body = _TEXT.format(
        sheet=SHEET,
        figure=FIGURE,
        version=twinlens.__version__,
        count=len(many),
        samples="samples" if len(many) > 1 else "sample",
        facts="\n".join(f"| {key} | {value} |" for key, value in _facts(manifest, many).items()),
        made=_made(manifest) + (f"\n\nUnreadable, and not counted: {', '.join(unreadable)}." if unreadable else ""),
        license=_license(given),
    )
    head = f"# {given.title}\n" + (f"\n{given.description}\n" if given.description else "")
    return f"{_front_matter(given, len(many))}{_MARKER}\n\n{head}{body}"


def _front_matter(given: About, count: int) -> str:
    name = given.license.lower() if _SPDX.match(given.license) else "other" if given.license else "unknown"
    entries: dict[str, Any] = {"pretty_name": given.title, "license": name}
    if name == "other":
        entries["license_link"] = given.license
    entries |= {"task_categories": ["depth-estimation"], "tags": ["stereo", "synthetic", "twinlens"]}
    entries["size_categories"] = [next(text for limit, text in _CATEGORIES if count < limit)]
    # JSON is valid YAML, and escapes line breaks in the maker's texts.
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
    facts["blur circle, lenses that blur"] = _range(blurs, "px")
    for name, text in (
        ("visible", "visible in both views"),
        ("occluded", "visible in one view"),
        ("unknown", "unknown"),
    ):
        facts[f"pixels {text}"] = f"{100 * float(np.mean([each[name] for each in known])):.1f}%" if known else "-"
    return facts


def _counted(values: Any) -> str:
    """The values by frequency: ``640 x 480``, or ``2 (9), 3 (1)`` with their counts."""
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
    return f"{low:.4g} to {high:.4g} {unit}, median {middle:.4g} {unit}"


def _made(manifest: Manifest) -> str:
    parts = [f"Seed: {manifest.seed}."] if manifest.seed is not None else []
    versions = manifest.info.get("versions")
    if isinstance(versions, Mapping):
        parts.append("Versions: " + ", ".join(f"{name} {number}" for name, number in versions.items()) + ".")
    rejected = manifest.info.get("rejected")
    if isinstance(rejected, Mapping) and rejected:
        counts = ", ".join(f"{reason}: {count}" for reason, count in rejected.items())
        parts.append(f"Rejected draws - {counts}.")
    parts.append("sample.json of each sample lists its cameras, lenses, sensor, seed and backend.")
    recipe = json.dumps(plain(manifest.recipe), indent=2, ensure_ascii=False)
    if manifest.recipe and len(recipe) <= _MAX_RECIPE:
        parts.append("The recipe:\n\n" + "\n".join(f"    {line}" for line in recipe.splitlines()))
    elif manifest.recipe:
        parts.append("The recipe is in dataset.json.")
    return "\n\n".join(parts)


def _license(given: About) -> str:
    text = given.license or "Not stated by the maker of this dataset: ask before you redistribute it."
    creator = f"Made by {given.creator}." if given.creator else ""
    cite = "Citation:\n\n" + "\n".join(f"    {line}" for line in given.cite_as.splitlines()) if given.cite_as else ""
    return "\n\n".join(part for part in (text, creator, cite) if part)
