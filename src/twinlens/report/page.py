"""A board and its maps as one self-contained HTML page that works from file:// without network.

The skeleton, style and scripts are the files in `page/`. Names cannot inject markup: they appear escaped in the title,
and in a JSON block without `<`, `>` and `&`, which the script inserts as text. The content security policy allows only
the page's own script, by its hash.
"""

import base64
import hashlib
import html
import io
import json
import math
import os
import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from twinlens import scoring
from twinlens.dataset.files import write_file
from twinlens.dataset.pictures import NO_TRUTH, colourise, rgb8
from twinlens.dataset.record import plain
from twinlens.matching import StereoMatcher, grey
from twinlens.matching.matcher_options import PATHS
from twinlens.matching.methods import matcher_of_spec
from twinlens.matching.supports import SUPPORTS
from twinlens.scoring import (
    METRICS,
    PROTOCOLS,
    REGIONS,
    Board,
    Entry,
    Groups,
    Pair,
    ScoredSample,
)
from twinlens.scoring.board import Mean
from twinlens.scoring.evaluate import RegionScores
from twinlens.scoring.grouping import DIFFERENCES, Difference
from twinlens.scoring.intervals import MIN_UNITS
from twinlens.scoring.metrics import TIMES, Metric
from twinlens.scoring.protocols import AGREE_PX, Protocol
from twinlens.scoring.reasons import LIMITS
from twinlens.scoring.regions import occluded
from twinlens.scoring.sparsification import DENSITIES
from twinlens.scoring.tables import has_confidence

MAX_WIDTH = 800  # of the maps in the page, pixels
BUDGET_BYTES = 14_000_000  # of the page
BYTES_PER_PIXEL = 0.65 * 4 / 3  # measured size of a packed pixel, in base64
GREY_BUDGET_BYTES = 4_000_000  # of all full-resolution grey images; samples beyond it have no cost curves
STEP = 1 / 16  # unit of a stored map, pixels
UNKNOWN = 65535  # code of an unknown pixel
NO_ESTIMATE = (102, 112, 127)  # slate
COLORMAPS = {
    name: colourise(np.arange(256), 0, 255, name)
    for name in ("viridis", "magma", "berlin")
}
"""uint8 (256, 3) sRGB. All are perceptually uniform and readable with colour vision deficiencies; berlin diverges
around black."""
Maps = scoring.MapFolder | Mapping[tuple[str, str], NDArray[np.floating[Any]]]
"""The (H, W) maps by (method, sample), +inf unknown."""
MAPS_WITHOUT_TRUTH = 3  # for each method: disparity, left-right difference, residual
_COLOUR_ENDS = (1, 99)  # of disparities without truth, percentiles of the maps
_CURVE_OPTIONS = (
    "cost", "block_size", "census_window", "prefilter", "support", "contrast", "gamma_similar", "gamma_near", "epsilon",
    "noise",
)  # fmt: skip
_LENS = "lens"  # the recorded value whose groups are compared by default
_SCRIPTS = ("core.js", "table.js", "maps.js", "costs.js", "why.js", "drill.js")


def write_page(
    path: str | os.PathLike[str],
    board: Board,
    samples: Iterable[ScoredSample] = (),
    maps: Maps | None = None,
    **options: Any,
) -> Path:
    """Write the page atomically and return its path; see `page_html`. Raises OutputError if it cannot be written."""
    text = page_html(board, samples, maps, **options)
    write_file(path, text.encode("utf-8", "replace"))
    return Path(path)


def page_html(
    board: Board,
    samples: Iterable[ScoredSample] = (),
    maps: Maps | None = None,
    *,
    weights: Mapping[str, float] | None = None,
    groups: Groups | None = None,
    by: str = "",
    notes: Sequence[str] = (),
    max_width: int = MAX_WIDTH,
    budget_bytes: int = BUDGET_BYTES,
    right_maps: Maps | None = None,
) -> str:
    """The page as text.

    samples: samples of the board to show with images, truth and error maps, each in memory only while it is packed.
    maps: the methods' disparity maps; methods without one appear in the tables only. right_maps: those of the right
    view, for the left-right differences of samples without truth. weights: of the mean over samples, 1 by default.
    groups, notes: compare the means over these groups of samples, with lines of text below. by: the recorded value
    whose groups are compared at first, by default those of lenses. max_width, budget_bytes: maps are subsampled until
    they are at most this wide and the page about this large.
    """
    pictures = _all_pictures(board, samples, maps, right_maps, max_width, budget_bytes)
    document = _document(board, pictures, weights)
    document["groupings"] = [*_groupings(board, groups, by)]
    document["by"] = _first_grouping(document["groupings"], by)
    document["notes"] = list(notes)
    parts = {"title": html.escape(board.title)}
    return fill_page(
        "page.html", parts, ["page.css"], _SCRIPTS, document, "data: blob:"
    )


def fill_page(
    skeleton: str,
    parts: Mapping[str, str],
    styles: Sequence[str],
    scripts: Sequence[str],
    document: Any,
    images: str,
) -> str:
    """A page of the files in `page/`, with the parts in their places and the document as its JSON block.

    images : where the content security policy allows images from; scripts are allowed by their hash.
    """
    script = "\n".join(_file(name) for name in scripts)
    digest = _base64(hashlib.sha256(script.encode()).digest())
    filled = {
        **parts,
        "policy": f"default-src 'none'; img-src {images}; style-src 'unsafe-inline'; script-src 'sha256-{digest}'",
        "style": "\n".join(_file(name) for name in styles),
        "script": script,
        "data": _json(document),
    }
    # A single pass, so that inserted text is not searched for placeholders.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: filled[match[1]], _file(skeleton))


def _json(document: Any) -> str:
    """JSON without a character that could end its script block, or open a comment or an entity."""
    values = plain(document, nan_as_null=True)
    text = json.dumps(values, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _file(name: str) -> str:
    return (
        resources.files("twinlens.report")
        .joinpath("page", name)
        .read_text(encoding="utf-8")
    )


def _all_pictures(
    board: Board,
    samples: Iterable[ScoredSample],
    maps: Maps | None,
    right_maps: Maps | None,
    max_width: int,
    budget_bytes: int,
) -> dict[str, Any]:
    """The pictures of every sample of the board, subsampled to fit the budget."""
    map_sizes = {}
    for entry in board.entries:
        is_scored = PROTOCOLS[entry.protocol].needs_truth
        count = 1 if is_scored else MAPS_WITHOUT_TRUTH
        map_sizes[entry.method, entry.sample] = count * entry.width * entry.height
    packed_bytes = sum(map_sizes.values()) * BYTES_PER_PIXEL
    least_stride = max(1, math.ceil(math.sqrt(packed_bytes / budget_bytes)))
    # Both grey images of a sample, in pixels of one.
    grey_room = min(GREY_BUDGET_BYTES, budget_bytes) / (2 * BYTES_PER_PIXEL)
    pictures = {}
    for sample in samples:
        if sample.name not in board.samples:
            continue
        pair = scoring.load_pair(sample)
        height, width = pair.shape
        stride = max(least_stride, math.ceil(width / max_width))
        with_grey = height * width <= grey_room
        method_maps = _maps_of(board, pair.name, maps)
        pictures[pair.name] = _pictures(pair, method_maps, stride, with_grey)
        if pair.disp0 is None:
            of_right = _maps_of(board, pair.name, right_maps)
            pictures[pair.name] |= _checks(pair, method_maps, of_right, stride)
        grey_room -= height * width
    return pictures


def _maps_of(
    board: Board, sample: str, maps: Maps | None
) -> dict[str, NDArray[np.floating[Any]]]:
    """The maps of a sample by method, of the methods that have one."""
    if maps is None:
        return {}
    available = {method: maps.get((method, sample)) for method in board.methods}
    return {name: values for name, values in available.items() if values is not None}


def _pictures(
    pair: Pair,
    maps: Mapping[str, NDArray[np.floating[Any]]],
    stride: int,
    with_grey: bool,
) -> dict[str, Any]:
    """Images, truth, occlusion and the methods' maps of one sample, as the page's script expects them."""
    height, width = pair.im0[::stride, ::stride].shape[:2]
    noise, hidden, grey_images = "", None, None
    if pair.renderer_noise is not None:
        noise = f"light paths {pair.renderer_noise:.2g} × sensor noise"
    if pair.mask0_nonocc is not None:
        hidden = pack(np.where(occluded(pair.mask0_nonocc), 1.0, 0.0), stride)
    if with_grey:
        grey_images = [pack_grey(grey(image)) for image in (pair.im0, pair.im1)]
    return {
        "w": width,
        "h": height,
        "stride": stride,
        "left": image_uri(pair.im0, stride),
        "right": image_uri(pair.im1, stride),
        "truth": None if pair.disp0 is None else pack(pair.disp0, stride),
        "noise": noise,
        "range": _colour_range(pair, maps.values()),
        "grey": grey_images,
        "hidden": hidden,
        "maps": {name: pack(values, stride) for name, values in maps.items()},
    }


def _checks(
    pair: Pair,
    maps: Mapping[str, NDArray[np.floating[Any]]],
    right_maps: Mapping[str, NDArray[np.floating[Any]]],
    stride: int,
) -> dict[str, Any]:
    """What a sample without truth has in addition: for each method its differences from the right map, and residuals.

    Both are unknown where there is no estimate, or no match in the right image.
    """
    differences, residuals = {}, {}
    for name, disparity in maps.items():
        if name in right_maps:
            of_right = scoring.of_right_map(disparity, right_maps[name])
            # NaN and +inf stay unknown.
            gaps = np.abs(
                disparity - of_right,
                where=np.isfinite(of_right),
                out=np.full(of_right.shape, np.inf),
            )
            differences[name] = pack(gaps, stride)
        residual = scoring.photometric_residual(pair.im0, pair.im1, disparity)
        residuals[name] = pack(residual, stride)
    return {"differences": differences, "residuals": residuals}


def _colour_range(pair: Pair, maps: Iterable[NDArray[np.floating[Any]]]) -> list[int]:
    """The ends of the colours: of the true disparities; else of most estimates, or of the search without estimates."""
    finite = pair.truth[np.isfinite(pair.truth)]
    if finite.size:
        return [math.floor(finite.min()), math.ceil(finite.max())]
    estimates = [values[np.isfinite(values)] for values in maps]
    if pair.disp0 is None and any(values.size for values in estimates):
        low, high = np.percentile(np.concatenate(estimates), _COLOUR_ENDS)
        return [math.floor(low), math.ceil(high)]
    return [0, pair.ndisp]


def pack(disp: NDArray[np.floating[Any]], stride: int = 1) -> dict[str, Any]:
    """Every `stride`-th pixel of an (H, W) disparity map, +inf unknown, as the page's script expects it.

    16-bit steps of 1/16 px from `offset` px, 65535 unknown, the largest saturated; differences along rows, low bytes
    before high bytes, zlib, base64. Not an image: privacy modes of browsers alter pixels read back from images.
    """
    values = np.asarray(disp[::stride, ::stride], np.float64)
    finite = np.isfinite(values)
    offset = float(np.floor(values[finite].min())) if finite.any() else 0.0
    steps = np.rint((np.where(finite, values, offset) - offset) / STEP)
    codes = np.where(finite, np.clip(steps, 0, UNKNOWN - 1), UNKNOWN)
    return {"stride": stride, "offset": offset, "step": STEP, **_packed(codes)}


def pack_grey(image: NDArray[Any]) -> dict[str, Any]:
    """An (H, W) uint8 or uint16 image without loss, in the format of `pack`. top: the largest value of its dtype."""
    top = int(np.iinfo(image.dtype).max)
    return {"stride": 1, "offset": 0, "step": 1, "top": top, **_packed(image)}


def _packed(codes: NDArray[Any]) -> dict[str, Any]:
    words: NDArray[np.uint16] = codes.astype(np.uint16)
    # Neighbours are alike, so differences and separate low and high bytes compress better; they wrap around 65536.
    differences = np.diff(words, axis=1, prepend=np.uint16(0)).ravel()
    low_bytes = (differences & 255).astype(np.uint8).tobytes()
    high_bytes = (differences >> 8).astype(np.uint8).tobytes()
    height, width = codes.shape
    return {"w": width, "h": height, "data": _deflated(low_bytes + high_bytes)}


def image_uri(image: NDArray[Any], stride: int = 1, quality: int = 82) -> str:
    """An (H, W[, 3]) 8- or 16-bit image as a WebP data URI, averaged over `stride` x `stride` pixels."""
    picture = Image.fromarray(rgb8(image))
    if stride > 1:
        picture = picture.reduce(stride)
    out = io.BytesIO()
    picture.save(out, format="WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + _base64(out.getvalue())


def _deflated(data: str | bytes) -> str:
    if isinstance(data, str):
        data = data.encode("utf-8", "replace")
    return _base64(zlib.compress(data, 6))


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _document(
    board: Board,
    pictures: Mapping[str, Any],
    weights: Mapping[str, float] | None,
) -> dict[str, Any]:
    """All that the page's script shows. It only formats these numbers."""
    return {
        "title": board.title,
        "meta": dict(board.meta),
        "methods": _methods(board),
        "samples": _samples(board, pictures),
        "protocols": [_protocol(board, PROTOCOLS[name]) for name in board.protocols],
        "regions": [_region(name) for name in board.regions],
        "metrics": {metric.name: _metric(metric) for metric in METRICS.values()},
        "times": list(TIMES),
        "densities": DENSITIES,
        "limits": LIMITS,
        "entries": [_entry(entry) for entry in board.entries],
        "doubts": scoring.map_warnings(board),
        "means": _means(board, board, weights),
        "differences": DIFFERENCES,
        "min_units": MIN_UNITS,
        "disagreements": [asdict(pair) for pair in board.disagreements],
        "agree_px": AGREE_PX,
        "weighted": bool(weights),
        "colormaps": {
            name: _base64(colours.tobytes()) for name, colours in COLORMAPS.items()
        },
        "unknown": {"truth": NO_TRUTH, "estimate": NO_ESTIMATE},
        "downloads": _downloads(board, weights),
    }


def _metric(metric: Metric) -> dict[str, Any]:
    return {
        "unit": metric.unit,
        "text": metric.text,
        "lower": metric.lower_is_better,
    }


def _groupings(
    board: Board, groups: Groups | None, by: str = ""
) -> Iterator[dict[str, Any]]:
    """The given groups, without a name, and those by each recorded value.

    Of the value `by` and of lenses also the differences from the first group: those of all values would take minutes.
    """
    if groups:
        titled = [_group(board, name, samples) for name, samples in groups.items()]
        yield {"by": "", "groups": titled}
        return
    for name, of_value in scoring.groupings(board).items():
        gaps = _gaps(board, of_value) if name in (by, _LENS) else {}
        members = [
            {**_group(board, title, samples), "gaps": gaps.get(title)}
            for title, samples in of_value.items()
        ]
        yield {"by": name, "groups": members}


def _first_grouping(groupings: Sequence[Mapping[str, Any]], by: str) -> str:
    """The grouping that the page shows at first: the one asked for, or that of lenses, or none."""
    names = [grouping["by"] for grouping in groupings]
    for name in (by, _LENS):
        if name in names:
            return name
    return ""


def _group(board: Board, name: str, samples: Collection[str]) -> dict[str, Any]:
    means = _means(board, board.subset(samples), None)
    return {"name": name, "samples": list(samples), "means": means}


def _gaps(board: Board, groups: Groups) -> dict[str, Any]:
    """Group -> protocol -> region -> the headline's differences from the protocol's first group, and their basis."""
    gaps: dict[str, Any] = {}
    for protocol in board.protocols:
        of_protocol = scoring.groups_of_protocol(board, protocol, groups)
        for region in board.regions_of(protocol) if of_protocol else ():
            comparison = scoring.compare_groups(board, protocol, region, of_protocol)
            for name, differences in comparison.differences.items():
                of_group = gaps.setdefault(name, {}).setdefault(protocol, {})
                of_group[region] = {
                    "basis": comparison.basis(name),
                    "methods": {
                        method: _gap(difference)
                        for method, difference in differences.items()
                    },
                }
    return gaps


def _gap(difference: Difference) -> list[Any]:
    """Value, ends, number of scenes, and basis."""
    interval = difference.interval
    ends = [interval.value, interval.low, interval.high]
    return [*map(_rounded, ends), interval.units, difference.basis]


def _samples(board: Board, pictures: Mapping[str, Any]) -> list[dict[str, Any]]:
    first_entries: dict[str, Entry] = {}
    for entry in board.entries:
        first_entries.setdefault(entry.sample, entry)
    return [
        {
            "name": name,
            "w": first_entries[name].width,
            "h": first_entries[name].height,
            "ndisp": first_entries[name].ndisp,
            "low": first_entries[name].min_disparity,
            "pictures": pictures.get(name),
        }
        for name in board.samples
    ]


def _protocol(board: Board, protocol: Protocol) -> dict[str, Any]:
    """A protocol with its columns; those of a confidence only if a method has one."""
    areas = protocol.auc_metrics
    metrics, columns = protocol.metrics, protocol.columns
    if has_confidence(board, protocol.name):
        columns = (*columns, *areas)
    else:
        metrics = tuple(name for name in metrics if name not in areas)
    return {
        "name": protocol.name,
        "title": protocol.title,
        "headline": protocol.headline,
        "metrics": metrics,
        "columns": columns,
        "truth": protocol.needs_truth,
        "regions": board.regions_of(protocol.name),
        "samples": board.samples_of(protocol.name),
        "lines": dict(protocol.lines()),
    }


def _region(name: str) -> dict[str, str]:
    return {"name": name, "text": REGIONS[name].text if name in REGIONS else ""}


def _downloads(board: Board, weights: Mapping[str, float] | None) -> dict[str, Any]:
    latex: dict[str, dict[str, str]] = {}
    for protocol in board.protocols:
        latex[protocol] = {
            region: _deflated(
                scoring.board_latex(board, protocol, region, weights=weights)
            )
            for region in board.regions
        }
    return {
        "csv": _deflated(scoring.board_csv(board)),
        "json": _deflated(scoring.board_to_json(board)),
        "latex": latex,
    }


def _methods(board: Board) -> list[dict[str, Any]]:
    specs: dict[str, str] = {}
    for entry in board.entries:
        specs.setdefault(entry.method, entry.spec)
    return [_method(name, specs[name]) for name in board.methods]


def _method(name: str, spec: str) -> dict[str, Any]:
    """A method, and the options of the cost that the page draws: ZNCC if the method is not twinlens's own."""
    matcher = matcher_of_spec(spec)
    shown = matcher or StereoMatcher()
    parts = [shown.cost, f"{shown.block_size} x {shown.block_size}"]
    if shown.support != "fixed":
        parts.append(shown.support)
    if shown.optimisation != "wta":
        parts.append(shown.optimisation)
    note = ", ".join(parts)
    if matcher is None:
        note += ": for comparison, not the method's own cost"
    p1, p2 = shown.penalties
    curve = {
        **{option: getattr(shown, option) for option in _CURVE_OPTIONS},
        "p1": p1,
        "p2": p2,
        "paths": PATHS[shown.optimisation],
        "pixelwise": SUPPORTS[shown.support].pixelwise,
        "radius": shown.window // 2,
        "note": note,
    }
    return {"name": name, "spec": spec, "curve": curve}


def _entry(entry: Entry) -> dict[str, Any]:
    """One entry; values are in the order of the protocol's metrics, whose names would be half of the page."""
    metrics = PROTOCOLS[entry.protocol].metrics
    failure = None
    if entry.failure is not None:
        failure = [entry.failure.kind, entry.failure.message]
    return {
        "method": entry.method,
        "sample": entry.sample,
        "protocol": entry.protocol,
        "failure": failure,
        "frames": entry.failure.frames if entry.failure else (),
        "times": {name: _rounded(value) for name, value in entry.times().items()},
        "regions": {
            name: _scores(scores, metrics) for name, scores in entry.regions.items()
        },
    }


def _scores(scores: RegionScores, metrics: Sequence[str]) -> dict[str, Any]:
    """Counts of pixels ("n"), values of the metrics ("v"), and the sparsification curve ("s") if there is one."""
    packed: dict[str, Any] = {
        "n": [scores.image, scores.evaluated, scores.estimated],
        "v": [_rounded(scores.get(metric, math.nan)) for metric in metrics],
    }
    if scores.sparsification:
        packed["s"] = [_rounded(rate) for rate in scores.sparsification]
    return packed


def _means(
    board: Board, part: Board, weights: Mapping[str, float] | None
) -> dict[str, Any]:
    """Protocol -> region -> method -> mean over the samples of a part of the board; all names are the board's.

    A board without scores has no regions; its failures are listed under "".
    """
    means: dict[str, dict[str, dict[str, Any]]] = {}
    for protocol in board.protocols:
        means[protocol] = {}
        for region in board.regions or ("",):
            of_methods = part.means(protocol, region, weights, board.methods)
            means[protocol][region] = {
                method: _mean(mean) for method, mean in of_methods.items()
            }
    return means


def _mean(mean: Mean) -> dict[str, Any]:
    return {
        "n": mean.counted,
        "failed": list(mean.failed),
        "missing": list(mean.missing),
        "v": {name: _rounded(value) for name, value in mean.metrics.items()},
    }


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
