"""The dataset card: README.md with contents, recipe, licence and figures of a dataset.

The front matter follows Hugging Face, so that the folder can be uploaded. The same dataset gives the same files, with
the same versions of Pillow and matplotlib.

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
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import twinlens
from twinlens.dataset.dataset import MANIFEST, Dataset, Manifest, write_manifest
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.metadata import KEY, About, Credit, about, stated, write_croissant
from twinlens.dataset.pictures import contact_sheet, tile
from twinlens.dataset.quantities import (
    Statistics,
    mixed_counts,
    quantiles,
    stored_statistics,
)
from twinlens.dataset.record import plain
from twinlens.dataset.storage import Place, Where
from twinlens.errors import FileError

_Lights = tuple[tuple[str, ...], list[float]]
"""Of a sample: the bands of its cameras, and the power of each projector, watts."""

SHEET, FIGURE, ASSETS = "samples.jpg", "statistics.png", "ASSETS.md"
_MARKER = "<!-- Written by twinlens; `twinlens describe` rewrites it. -->"
_MARKERS = (
    _MARKER,
    "<!-- This card is twinlens's: it is written anew with the dataset. -->",
)
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*$")
_SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "n>1M")
_MAX_RECIPE = 20_000
TILES = 64
_BINS = 60
_LABELS, _FILL, _AXES = "#1b2a3a", "#3b7dd8", "#6b7785"
_LOG_ABOVE = 8.0  # ratio of maximum to minimum depth
_GRIDS = ((1, 1), (1, 1), (1, 2), (1, 3), (2, 2))
"""Rows and columns by number of panels."""

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
    """Write the card, croissant.json, and the list of source files into a dataset's folder; returns the names.

    `given` is merged into dataset.json: texts that it leaves empty keep their value. A README.md that twinlens did not
    write is kept, and the card is CARD.md. Statistics come from sample.json, or else from the truth, with one sample in
    memory at a time. Unreadable samples are listed and not counted. ASSETS.md lists the files that the dataset was
    made from, with SHA-256, licence and author as `About.credits` states them.

    Raises FileError if no sample can be read, or if `given` is not empty and there is no dataset.json, and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    texts, manifest = about(dataset)
    if given is not None and given.plain():
        texts = About.of(texts.plain() | given.plain())
        stored = manifest.info.get(KEY, {}) | given.plain()
        manifest = dataclasses.replace(
            dataset.manifest, info={**manifest.info, KEY: stored}
        )
        write_manifest(dataset.path, manifest)
    written = [
        *_write_card(dataset, texts, manifest),
        *write_assets(dataset.path, manifest),
    ]
    return [*written, write_croissant(dataset, texts, manifest)]


def write_assets(folder: Place, manifest: Manifest) -> list[str]:
    """Write ASSETS.md if the dataset in `folder` has source files; one that twinlens did not write is kept.

    Returns the names of the files written.
    """
    sources, given = _sources(manifest), stated(manifest, folder / MANIFEST)
    if not sources or not _is_own(folder / ASSETS):
        return []
    bundled = [
        Credit(files=name, license="MIT", creator="twinlens")
        for name in manifest.info.get("bundled", ())
    ]
    rows = []
    for name, digest in sources:
        credit = next(
            (each for each in (*given.credits, *bundled) if each.covers(name)), None
        )
        texts = (
            (credit.license or "not stated", credit.creator, credit.url)
            if credit
            else ("not stated", "", "")
        )
        rows.append([_cell(text) for text in (name, f"`{digest}`", *texts)])
    heads = ["file", "SHA-256", "licence", "author", "source"]
    table = "\n".join(
        f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows)
    )
    text = f"{_MARKER}\n\n# Assets\n\nThe files that this dataset was made from. They are not part of it.\n\n{table}\n"
    write_file(folder / ASSETS, text.encode())
    return [ASSETS]


def _sources(manifest: Manifest) -> list[tuple[str, str]]:
    """Names and SHA-256 of the files of the recipe, and of samples that were made without one."""
    tables = [
        manifest.info.get("sources"),
        *(row.info.get("sources") for row in manifest.rows),
    ]
    pairs = (
        (name, str(digest))
        for table in tables
        if isinstance(table, Mapping)
        for name, digest in table.items()
    )
    return list(dict.fromkeys(pairs))


def _cell(text: str) -> str:
    """One line of a Markdown table's cell."""
    return (
        " ".join(text.split())
        .replace("\\", "\\\\")
        .replace("|", "\\|")
        .replace("<", "&lt;")
    )


def _is_own(path: Place) -> bool:
    """Whether a text file is missing or was written by twinlens."""
    return not path.is_file() or any(
        marker.encode() in read_bytes(path) for marker in _MARKERS
    )


def _write_card(dataset: Dataset, given: About, manifest: Manifest) -> list[str]:
    many: dict[str, Statistics] = {}
    noise: list[float] = []
    rigs: list[_Lights] = []
    for sample in dataset:
        with contextlib.suppress(FileError):
            many[sample.name] = stored_statistics(sample)
            ratios = [sample.lens(k).renderer_noise for k in range(sample.num_lenses)]
            noise += [ratio for ratio in ratios if ratio is not None]
            bands = tuple(camera.band for camera in sample.rig.cameras)
            rigs.append(
                (bands, [projector.power for projector in sample.rig.projectors])
            )
    tiles = []
    for i in np.linspace(0, len(many) - 1, min(len(many), TILES)).round().astype(int):
        with contextlib.suppress(FileError):
            tiles.append(tile(dataset[list(many)[i]].im0))
    if not tiles:
        raise FileError(f"{dataset.path}: no sample can be read; see `twinlens verify`")
    stream = io.BytesIO()
    contact_sheet(tiles).save(stream, "JPEG", quality=88)
    write_file(dataset.path / SHEET, stream.getvalue())
    write_file(dataset.path / FIGURE, statistics_figure(list(many.values())))
    readme = dataset.path / "README.md"
    name = readme.name if _is_own(readme) else "CARD.md"
    unreadable = [name for name in dataset.names if name not in many]
    write_file(
        dataset.path / name,
        _card(given, manifest, list(many.values()), noise, unreadable, rigs).encode(),
    )
    return [name, SHEET, FIGURE]


def _card(
    given: About,
    manifest: Manifest,
    many: Sequence[Statistics],
    noise: Sequence[float],
    unreadable: Sequence[str],
    rigs: Sequence[_Lights] = (),
) -> str:
    texts = [
        given.license
        or "Not stated by the maker of this dataset: ask before you redistribute it."
    ]
    texts += [f"Made by {given.creator}."] if given.creator else []
    if given.cite_as:
        texts.append(
            "Citation:\n\n"
            + "\n".join(f"    {line}" for line in given.cite_as.splitlines())
        )
    if _sources(manifest):
        texts.append(f"{ASSETS} lists the files that the dataset was made from.")
        for each in given.credits:
            stated = filter(
                None, (each.license or "licence not stated", each.creator, each.url)
            )
            texts.append(f"- {_cell(each.files)}: {_cell(', '.join(stated))}")
    body = _TEXT.format(
        sheet=SHEET,
        figure=FIGURE,
        version=twinlens.__version__,
        count=len(many),
        samples="samples" if len(many) > 1 else "sample",
        facts="\n".join(
            f"| {key} | {value} |"
            for key, value in _facts(manifest, many, noise, rigs).items()
        ),
        made=_made(manifest)
        + (
            f"\n\nUnreadable, and not counted: {', '.join(unreadable)}."
            if unreadable
            else ""
        ),
        license="\n\n".join(texts),
    )
    head = f"# {given.title}\n" + (
        f"\n{given.description}\n" if given.description else ""
    )
    return f"{_front_matter(given, len(many))}{_MARKER}\n\n{head}{body}"


def _front_matter(given: About, count: int) -> str:
    name = (
        given.license.lower()
        if _SPDX.match(given.license)
        else "other"
        if given.license
        else "unknown"
    )
    entries: dict[str, Any] = {"pretty_name": given.title, "license": name}
    if name == "other":
        entries["license_link"] = given.license
    entries |= {
        "task_categories": ["depth-estimation"],
        "tags": ["stereo", "synthetic", "twinlens"],
    }
    entries["size_categories"] = [
        _SIZES[bisect.bisect((1_000, 10_000, 100_000, 1_000_000), count)]
    ]
    # JSON is valid YAML, and escapes line breaks in the maker's texts.
    return (
        "---\n"
        + "".join(f"{key}: {json.dumps(value)}\n" for key, value in entries.items())
        + "---\n"
    )


def _facts(
    manifest: Manifest,
    many: Sequence[Statistics],
    noise: Sequence[float],
    rigs: Sequence[_Lights],
) -> dict[str, str]:
    facts = {
        "samples": str(len(many)),
        "image size": _counted(tuple(each["size"]) for each in many),
    }
    facts |= {
        f"{kind} of a sample": _counted(each[kind] for each in many)
        for kind in ("cameras", "lenses")
    }
    if {band for bands, _ in rigs for band in bands} - {"rgb"}:
        facts["bands of the cameras"] = _counted(", ".join(bands) for bands, _ in rigs)
    powers = [each for _, each in rigs]
    if any(powers):
        facts["projectors of a sample"] = _counted(map(len, powers))
        facts["power of a projector"] = _range(
            [quantiles([power]) for each in powers for power in each], "W"
        )
    splits = Counter(
        str(row.info["split"])
        for row in manifest.rows
        if row.info.get("split") is not None
    )
    if splits:
        facts["splits"] = ", ".join(
            f"{name}: {count}" for name, count in sorted(splits.items())
        )
    known = [each for each in many if "disparity" in each]
    disparities, depths, blurs = _quantiles(many)
    facts |= {"disparity": _range(disparities, "px"), "depth": _range(depths, "m")}
    facts["blur circle, lenses that blur"] = _range(blurs, "px")
    if noise:
        facts["renderer noise"] = _range([quantiles(noise)], "x sensor noise")
    if any("dp-disp" in name for row in manifest.rows for name in row.files):
        facts["dual pixels"] = (
            "halves and their disparity, for every lens with an aperture"
        )
    shares = {
        "visible": "visible in both views",
        "occluded": "visible in one view",
        "unknown": "unknown",
    }
    for name, text in shares.items():
        facts[f"pixels {text}"] = (
            f"{100 * float(np.mean([each[name] for each in known])):.1f}%"
            if known
            else "-"
        )
    return facts


def _counted(values: Any) -> str:
    """The values by frequency: ``640 x 480``, or ``2 (9), 3 (1)`` with their counts."""
    counts = Counter(
        " x ".join(map(str, v)) if isinstance(v, tuple) else str(v) for v in values
    ).most_common()
    shown = [
        f"{value} ({count})" if len(counts) > 1 else value
        for value, count in counts[:6]
    ]
    return ", ".join(shown + ["..."] * (len(counts) > 6))


def _range(many: Sequence[Sequence[float]], unit: str) -> str:
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
        parts.append(
            "Versions: "
            + ", ".join(f"{name} {number}" for name, number in versions.items())
            + "."
        )
    rejected = manifest.info.get("rejections")
    if isinstance(rejected, Mapping) and rejected:
        counts = ", ".join(f"{reason}: {count}" for reason, count in rejected.items())
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


Panel = tuple[str, str, list[list[float]], float]
"""A histogram over distributions of weight one: labels of x and y, their quantiles, and the ratio of maximum to minimum
above which the axis is logarithmic."""


def statistics_figure(many: Sequence[Statistics]) -> bytes:
    """A PNG of the distributions of disparity, depth, blur circle and occluded pixels; all samples weigh the same.

    Quantities that no sample has are left out: disparity of single cameras, blur of pinholes.
    """
    from matplotlib.figure import Figure

    drawn = panels(many)
    rows, columns = _GRIDS[len(drawn)]
    figure = Figure(figsize=(9.0, 2.8 * rows), dpi=110, layout="constrained")
    if not drawn:
        figure.text(0.5, 0.5, "no sample has truth", ha="center", color=_AXES)
    else:
        for panel, axes in zip(
            drawn, figure.subplots(rows, columns, squeeze=False).ravel(), strict=True
        ):
            _draw(axes, *panel)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def panels(many: Sequence[Statistics]) -> list[Panel]:
    """The panels of the figure that have data."""
    share = "share of the pixels (%)"
    disparities, depths, blurs = _quantiles(many)
    occluded = [
        100 * each["occluded"]
        for each in many
        if "disparity" in each and each["cameras"] > 1
    ]
    every = (
        ("disparity (px)", share, disparities, np.inf),
        ("depth (m)", share, depths, _LOG_ABOVE),
        ("blur circle diameter (px)", share, blurs, np.inf),
        (
            "pixels visible in one view only (%)",
            "share of samples (%)",
            [[each, each] for each in occluded],
            np.inf,
        ),
    )
    return [panel for panel in every if panel[2]]


def _draw(
    axes: Any,
    xlabel: str,
    ylabel: str,
    many: Sequence[Sequence[float]],
    log_above: float,
) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xlabel(xlabel, color=_LABELS)
    axes.set_ylabel(ylabel, color=_LABELS, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_AXES)
    axes.tick_params(colors=_AXES, labelsize=8)
    low, high = min(each[0] for each in many), max(each[-1] for each in many)
    logarithmic = low > 0 and high > log_above * low
    if high - low < 1e-9 * max(abs(low), abs(high), 1.0):
        low, high = low - 0.5, high + 0.5
    edges = (np.geomspace if logarithmic else np.linspace)(low, high, _BINS + 1)
    axes.stairs(
        100 * mixed_counts(edges, many) / len(many), edges, fill=True, color=_FILL
    )
    if (
        logarithmic
    ):  # plain numbers at 1, 2, 5 of each decade, or at 1 only over many decades
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if high < 1000 * low else (1.0,))
        )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlim(edges[0], edges[-1])


def _quantiles(
    many: Sequence[Statistics],
) -> tuple[list[list[float]], list[list[float]], list[list[float]]]:
    """Those of disparity, depth, and blur circle, of the samples that have them."""
    known = [each for each in many if "disparity" in each]
    blurs = [
        blur for each in known for blur in each["blur_px"] if blur and blur[-1] > 0
    ]
    disparities, depths = (
        [each[name] for each in known if each[name]] for name in ("disparity", "depth")
    )
    return disparities, depths, blurs
