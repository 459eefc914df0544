"""The dataset card: README.md with contents, recipe, licence and figures of a dataset.

The front matter follows Hugging Face, so that the folder can be uploaded. The same dataset gives the same files, with
the same versions of Pillow and matplotlib. `card_template.md` has the text.

Source: https://huggingface.co/docs/hub/datasets-cards; Gebru et al., Datasheets for datasets, CACM 2021.
"""

import bisect
import contextlib
import dataclasses
import io
import json
import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import twinlens
from twinlens.dataset.channels import DP_DISPARITY, parse_file
from twinlens.dataset.dataset import MANIFEST, Dataset, Manifest, write_manifest
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.metadata import KEY, About, Credit, about, stated, write_croissant
from twinlens.dataset.pictures import contact_sheet, statistics_figure, tile
from twinlens.dataset.record import plain
from twinlens.dataset.statistics import (
    Statistics,
    distributions,
    mixed_counts,
    quantiles,
    stored_statistics,
)
from twinlens.dataset.storage import Place, Where
from twinlens.dataset.stored import ReadOnce
from twinlens.errors import FileError

SHEET, FIGURE, ASSETS = "samples.jpg", "statistics.png", "ASSETS.md"
TILES = 64
"""At most so many images are on the contact sheet."""

_TEMPLATE = Path(__file__).with_name("card_template.md")
_MARKER = "<!-- Written by twinlens; `twinlens describe` rewrites it. -->"
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*$")
_SIZE_LIMITS = (1_000, 10_000, 100_000, 1_000_000)
_SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "n>1M")
_MAX_RECIPE = 20_000
_SHARES = {
    "visible": "visible in both views",
    "occluded": "visible in one view",
    "unknown": "unknown",
}


@dataclass
class Contents:
    """What the card says of the samples of a dataset.

    statistics : of each readable sample, by name.
    noise : renderer noise over sensor noise, of the lenses where it was measured.
    bands, powers, frames : the bands of the cameras, the power of each projector (W), and the number of frames, of each
        sample.
    """

    statistics: dict[str, Statistics] = field(default_factory=dict)
    noise: list[float] = field(default_factory=list)
    bands: list[tuple[str, ...]] = field(default_factory=list)
    powers: list[list[float]] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)


def describe(dataset: Where | Dataset, changes: About | None = None) -> list[str]:
    """Write the card, croissant.json, and the list of source files into a dataset's folder; returns the names.

    `changes` is merged into dataset.json: texts that it leaves empty keep their value. A README.md that twinlens did
    not write is kept, and the card is CARD.md. Statistics come from sample.json, or else from the truth, with one
    sample in memory at a time. Unreadable samples are listed and not counted. ASSETS.md lists the files that the
    dataset was made from, with SHA-256, licence and author as `About.credits` states them.

    Raises FileError if no sample can be read, or if `changes` is not empty and there is no dataset.json; and
    OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    texts, manifest = about(dataset)
    if changes is not None and changes.plain():
        texts = About.of(texts.plain() | changes.plain())
        merged = manifest.info.get(KEY, {}) | changes.plain()
        info = {**manifest.info, KEY: merged}
        manifest = dataclasses.replace(dataset.manifest, info=info)
        write_manifest(dataset.path, manifest)
    return [
        *_write_card(dataset, texts, manifest),
        *write_assets(dataset.path, manifest),
        write_croissant(dataset, texts, manifest),
    ]


def write_assets(folder: Place, manifest: Manifest) -> list[str]:
    """Write ASSETS.md if the dataset in `folder` has source files; one that twinlens did not write is kept.

    Returns the names of the files written.
    """
    sources = _sources(manifest)
    if not sources or not _is_replaceable(folder / ASSETS):
        return []
    credits = stated(manifest, folder / MANIFEST).credits + [
        Credit(files=name, license="MIT", creator="twinlens")
        for name in manifest.info.get("bundled", ())
    ]
    rows = [["file", "SHA-256", "licence", "author", "source"], ["---"] * 5]
    for name, digest in sources:
        covering = (credit for credit in credits if credit.covers(name))
        credit = next(covering, Credit(files=name))
        licence = credit.license or "not stated"
        cells = (name, f"`{digest}`", licence, credit.creator, credit.url)
        rows.append([_cell(text) for text in cells])
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    intro = "The files that this dataset was made from. They are not part of it."
    text = f"{_MARKER}\n\n# Assets\n\n{intro}\n\n{table}\n"
    write_file(folder / ASSETS, text.encode())
    return [ASSETS]


def _sources(manifest: Manifest) -> list[tuple[str, str]]:
    """Names and SHA-256 of the files of the recipe, and of samples that were made without one."""
    tables = [
        manifest.info.get("sources"),
        *(row.info.get("sources") for row in manifest.rows),
    ]
    pairs: dict[tuple[str, str], None] = {}
    for table in tables:
        if isinstance(table, Mapping):
            pairs |= dict.fromkeys((name, str(sha)) for name, sha in table.items())
    return list(pairs)


def _cell(text: str) -> str:
    """One line of a Markdown table's cell."""
    line = " ".join(text.split())
    return line.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;")


def _is_replaceable(path: Place) -> bool:
    """Whether a text file is missing or was written by twinlens."""
    return not path.is_file() or _MARKER.encode() in read_bytes(path)


def _write_card(dataset: Dataset, texts: About, manifest: Manifest) -> list[str]:
    contents = _contents(dataset)
    tiles = _tiles(dataset, list(contents.statistics))
    if not tiles:
        raise FileError(f"{dataset.path}: no sample can be read; see `twinlens verify`")
    sheet = io.BytesIO()
    contact_sheet(tiles).save(sheet, "JPEG", quality=88)
    figure = statistics_figure(list(contents.statistics.values()))
    unreadable = [name for name in dataset.names if name not in contents.statistics]
    card = card_text(texts, manifest, contents, unreadable)
    name = "README.md" if _is_replaceable(dataset.path / "README.md") else "CARD.md"
    files = {SHEET: sheet.getvalue(), FIGURE: figure, name: card.encode()}
    for file, data in files.items():
        write_file(dataset.path / file, data)
    return [name, SHEET, FIGURE]


def _contents(dataset: Dataset) -> Contents:
    contents = Contents()
    for stored in dataset:
        sample = ReadOnce.of(stored)
        with contextlib.suppress(FileError):
            contents.statistics[sample.name] = stored_statistics(sample)
            for number in range(sample.num_lenses):
                noise = sample.lens(number).renderer_noise
                if noise is not None:
                    contents.noise.append(noise)
            rig = sample.rig
            contents.bands.append(tuple(camera.band for camera in rig.cameras))
            contents.powers.append([projector.power for projector in rig.projectors])
            contents.frames.append(sample.num_frames)
    return contents


def _tiles(dataset: Dataset, names: Sequence[str]) -> list[Image.Image]:
    """Left images of up to `TILES` samples, evenly spaced."""
    tiles = []
    count = min(len(names), TILES)
    for index in np.linspace(0, len(names) - 1, count).round().astype(int):
        with contextlib.suppress(FileError):
            tiles.append(tile(dataset[names[index]].im0))
    return tiles


def card_text(
    texts: About,
    manifest: Manifest,
    contents: Contents,
    unreadable: Sequence[str] = (),
) -> str:
    """The card, with Hugging Face's front matter."""
    count = len(contents.statistics)
    facts = _facts(manifest, contents)
    made = _made(manifest)
    if unreadable:
        made += f"\n\nUnreadable, and not counted: {', '.join(unreadable)}."
    body = _TEMPLATE.read_text(encoding="utf-8").format(
        sheet=SHEET,
        figure=FIGURE,
        version=twinlens.__version__,
        count=count,
        samples="samples" if count > 1 else "sample",
        facts="\n".join(f"| {name} | {value} |" for name, value in facts),
        made=made,
        license=_licence(texts, manifest),
    )
    head = f"# {texts.title}\n"
    if texts.description:
        head += f"\n{texts.description}\n"
    return f"{_front_matter(texts, count)}{_MARKER}\n\n{head}\n{body}"


def _licence(texts: About, manifest: Manifest) -> str:
    """Licence, maker, citation, and the credits of the files that the dataset was made from."""
    unstated = (
        "Not stated by the maker of this dataset: ask before you redistribute it."
    )
    paragraphs = [texts.license or unstated]
    if texts.creator:
        paragraphs.append(f"Made by {texts.creator}.")
    if texts.cite_as:
        lines = "\n".join(f"    {line}" for line in texts.cite_as.splitlines())
        paragraphs.append(f"Citation:\n\n{lines}")
    if _sources(manifest):
        paragraphs.append(f"{ASSETS} lists the files that the dataset was made from.")
        for credit in texts.credits:
            licence = credit.license or "licence not stated"
            stated = filter(None, (licence, credit.creator, credit.url))
            paragraphs.append(f"- {_cell(credit.files)}: {_cell(', '.join(stated))}")
    return "\n\n".join(paragraphs)


def _front_matter(texts: About, count: int) -> str:
    entries: dict[str, Any] = {"pretty_name": texts.title, "license": "unknown"}
    if _SPDX.match(texts.license):
        entries["license"] = texts.license.lower()
    elif texts.license:
        entries |= {"license": "other", "license_link": texts.license}
    entries["task_categories"] = ["depth-estimation"]
    entries["tags"] = ["stereo", "synthetic", "twinlens"]
    entries["size_categories"] = [_SIZES[bisect.bisect(_SIZE_LIMITS, count)]]
    # JSON is valid YAML, and escapes line breaks in the maker's texts.
    lines = [f"{key}: {json.dumps(value)}\n" for key, value in entries.items()]
    return f"---\n{''.join(lines)}---\n"


def _facts(manifest: Manifest, contents: Contents) -> Iterator[tuple[str, str]]:
    """The rows of the table of contents."""
    samples = list(contents.statistics.values())
    yield "samples", str(len(samples))
    sizes = [" x ".join(map(str, sample["size"])) for sample in samples]
    yield "image size", _counted(sizes)
    yield "cameras of a sample", _counted(sample["cameras"] for sample in samples)
    yield "lenses of a sample", _counted(sample["lenses"] for sample in samples)
    if any(set(bands) - {"rgb"} for bands in contents.bands):
        yield "bands of the cameras", _counted(map(", ".join, contents.bands))
    if any(contents.powers):
        powers = [[power] for sample in contents.powers for power in sample]
        yield "projectors of a sample", _counted(map(len, contents.powers))
        yield "power of a projector", _range(map(quantiles, powers), "W")
    if any(frames > 1 for frames in contents.frames):
        yield "frames of a sample", _counted(contents.frames)
    splits = [row.info.get("split") for row in manifest.rows]
    counts = Counter(str(split) for split in splits if split is not None)
    if counts:
        named = [f"{name}: {count}" for name, count in sorted(counts.items())]
        yield "splits", ", ".join(named)
    disparities, depths, blurs = distributions(samples)
    yield "disparity", _range(disparities, "px")
    yield "depth", _range(depths, "m")
    yield "blur circle, lenses that blur", _range(blurs, "px")
    if contents.noise:
        yield "renderer noise", _range([quantiles(contents.noise)], "x sensor noise")
    if _has_dual_pixels(manifest):
        text = "halves and their disparity, for every lens with an aperture"
        yield "dual pixels", text
    with_truth = [sample for sample in samples if "disparity" in sample]
    for name, text in _SHARES.items():
        shares = [sample[name] for sample in with_truth]
        share = f"{100 * float(np.mean(shares)):.1f}%" if shares else "-"
        yield f"pixels {text}", share


def _has_dual_pixels(manifest: Manifest) -> bool:
    for row in manifest.rows:
        for name in row.files:
            parsed = parse_file(name)
            if parsed is not None and parsed.file is DP_DISPARITY:
                return True
    return False


def _counted(values: Iterable[Any]) -> str:
    """The values by frequency: ``640 x 480``, or ``2 (9), 3 (1)`` with their counts."""
    counts = Counter(map(str, values)).most_common()
    if len(counts) == 1:
        return counts[0][0]
    shown = [f"{value} ({count})" for value, count in counts[:6]]
    return ", ".join([*shown, "..."] if len(counts) > 6 else shown)


def _range(distributions: Iterable[Sequence[float]], unit: str) -> str:
    """Minimum, maximum and median of several distributions of weight one, given by their quantiles."""
    many = list(distributions)
    if not many:
        return "-"
    low, high = min(levels[0] for levels in many), max(levels[-1] for levels in many)
    if high <= low:
        return f"{low:.4g} {unit}"
    spaced = np.linspace if low <= 0 else np.geomspace
    edges = spaced(low, high, 1001)
    below = np.cumsum(mixed_counts(edges, many)) / len(many)
    median = edges[1 + int(np.searchsorted(below, 0.5))]
    return f"{low:.4g} to {high:.4g} {unit}, median {median:.4g} {unit}"


def _made(manifest: Manifest) -> str:
    """Seed, versions, rejections and recipe; of a subset, what it is of and those of its sources."""
    subset = manifest.info.get("subset")
    if isinstance(subset, Mapping):
        return _made_from(subset)
    parts = [f"Seed: {manifest.seed}."] if manifest.seed is not None else []
    versions = manifest.info.get("versions")
    if isinstance(versions, Mapping):
        named = ", ".join(f"{name} {number}" for name, number in versions.items())
        parts.append(f"Versions: {named}.")
    rejections = manifest.info.get("rejections")
    if isinstance(rejections, Mapping) and rejections:
        counts = ", ".join(f"{reason}: {count}" for reason, count in rejections.items())
        parts.append(f"Rejected draws - {counts}.")
    parts.append(
        "sample.json of each sample lists its cameras, lenses, sensor, seed and backend."
    )
    recipe = json.dumps(plain(manifest.recipe), indent=2, ensure_ascii=False)
    if manifest.recipe and len(recipe) <= _MAX_RECIPE:
        parts.append("The recipe:\n\n" + textwrap.indent(recipe, "    "))
    elif manifest.recipe:
        parts.append("The recipe is in dataset.json.")
    return "\n\n".join(parts)


def _made_from(subset: Mapping[str, Any]) -> str:
    """The sources of a subset, and how its samples were chosen."""
    parts = ["Made by `twinlens subset` of samples of other datasets."]
    if conditions := subset.get("where"):
        parts.append(f"Conditions: {'; '.join(f'`{text}`' for text in conditions)}.")
    if dropped := subset.get("dropped"):
        parts.append(f"Channels left out: {', '.join(dropped)}.")
    if splits := subset.get("splits"):
        parts.append(f"Splits: no two of them share a value of `{splits['by']}`.")
    for source in subset.get("sources", ()):
        head = f"### {source['name']}\n\n{source['samples']} of {source['of']} samples."
        info = source["info"]
        licence = info.get(KEY, {}) or source["recipe"].get(KEY, {})
        if licence.get("license"):
            head += f" Licence: {licence['license']}."
        made = _made(Manifest((), source["recipe"], source["seed"], info))
        parts += [head, made]
    return "\n\n".join(parts)
