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
from collections.abc import Iterable, Mapping, Sequence
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
from twinlens.matching.matcher import PATHS
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
    Sample,
)
from twinlens.scoring.metrics import TIMES
from twinlens.scoring.protocols import Protocol
from twinlens.scoring.reasons import LIMITS
from twinlens.scoring.regions import occluded
from twinlens.scoring.sparsification import DENSITIES
from twinlens.scoring.tables import has_confidence

MAX_WIDTH, BUDGET_BYTES = 800, 14_000_000
BYTES_PER_PIXEL = 0.65  # measured size of a packed pixel, to choose the stride
GREY_BUDGET_BYTES = 4_000_000  # of all full-resolution grey images; samples beyond it have no cost curves
STEP, UNKNOWN = (
    1 / 16,
    65535,
)  # a stored map's unit in pixels, and its code of an unknown pixel
NO_ESTIMATE = (102, 112, 127)  # slate
COLORMAPS = {
    name: colourise(np.arange(256), 0, 255, name)
    for name in ("viridis", "magma", "berlin")
}
"""uint8 (256, 3) sRGB. All are perceptually uniform and readable with colour vision deficiencies; berlin diverges
around black."""
Maps = scoring.MapFolder | Mapping[tuple[str, str], NDArray[np.floating[Any]]]
"""The (H, W) maps by (method, sample), +inf unknown."""
_CURVE_OPTIONS = (
    "cost", "block_size", "census_window", "prefilter", "support", "contrast", "gamma_similar", "gamma_near", "epsilon",
    "noise",
)  # fmt: skip
_SCRIPTS = ("core.js", "table.js", "maps.js", "costs.js", "why.js", "drill.js")


def write_page(
    path: str | os.PathLike[str],
    board: Board,
    samples: Iterable[Sample] = (),
    maps: Maps | None = None,
    **options: Any,
) -> Path:
    """Write the page atomically and return its path; see `page_html`. Raises OutputError if it cannot be written."""
    write_file(
        path, page_html(board, samples, maps, **options).encode("utf-8", "replace")
    )
    return Path(path)


def page_html(
    board: Board,
    samples: Iterable[Sample] = (),
    maps: Maps | None = None,
    *,
    weights: Mapping[str, float] | None = None,
    groups: Groups | None = None,
    notes: Sequence[str] = (),
    max_width: int = MAX_WIDTH,
    budget_bytes: int = BUDGET_BYTES,
) -> str:
    """The page as text.

    samples: samples of the board to show with images, truth and error maps, each in memory only while it is packed.
    maps: the methods' disparity maps; methods without one appear in the tables only. weights: of the mean over samples,
    1 by default. groups, notes: compare the means over these groups of samples, with lines of text below. max_width,
    budget_bytes: maps are subsampled until they are at most this wide and the page about this large.
    """
    mapped = {
        (entry.method, entry.sample): entry.width * entry.height
        for entry in board.entries
    }
    packed_bytes = sum(mapped.values()) * BYTES_PER_PIXEL * 4 / 3
    least_stride = max(1, math.ceil(math.sqrt(packed_bytes / budget_bytes)))
    pictures, room = (
        {},
        min(GREY_BUDGET_BYTES, budget_bytes) / (2 * BYTES_PER_PIXEL * 4 / 3),
    )
    for sample in (s for s in samples if s.name in board.samples):
        pair = scoring.load_pair(sample)
        pictures[pair.name] = _pictures(
            board, pair, maps, max_width, least_stride, pair.disp0.size <= room
        )
        room -= pair.disp0.size
    document = _document(board, pictures, weights, groups or {}) | {
        "notes": list(notes)
    }
    data = json.dumps(
        plain(document, nan_as_null=True), allow_nan=False, separators=(",", ":")
    )
    # No character that could end the script block around the data, or open a comment or an entity.
    data = data.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    script = "\n".join(_file(name) for name in _SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    parts = {
        "title": html.escape(board.title),
        "policy": f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'",
        "style": _file("page.css"),
        "script": script,
        "data": data,
    }
    # A single pass, so that inserted text is not searched for placeholders.
    return re.sub(r"\{\{(\w+)\}\}", lambda place: parts[place[1]], _file("page.html"))


def _file(name: str) -> str:
    return (
        resources.files("twinlens.report")
        .joinpath("page", name)
        .read_text(encoding="utf-8")
    )


def _pictures(
    board: Board,
    sample: Pair,
    maps: Maps | None,
    max_width: int,
    least_stride: int,
    with_grey: bool,
) -> dict[str, Any]:
    stride = max(least_stride, -(-sample.disp0.shape[1] // max_width))
    method_maps = (
        {m: maps.get((m, sample.name)) for m in board.methods}
        if maps is not None
        else {}
    )
    known = sample.disp0[np.isfinite(sample.disp0)]
    hidden = (
        None
        if sample.mask0_nonocc is None
        else np.where(occluded(sample.mask0_nonocc), 1.0, 0.0)
    )
    return {
        "left": image_uri(sample.im0, stride),
        "right": image_uri(sample.im1, stride),
        "truth": pack(sample.disp0, stride),
        "noise": ""
        if sample.renderer_noise is None
        else f"light paths {sample.renderer_noise:.2g} × sensor noise",
        "range": [math.floor(known.min()), math.ceil(known.max())]
        if known.size
        else [0, sample.ndisp],
        "grey": [pack_grey(grey(image)) for image in (sample.im0, sample.im1)]
        if with_grey
        else None,
        "hidden": None if hidden is None else pack(hidden, stride),
        "maps": {m: pack(d, stride) for m, d in method_maps.items() if d is not None},
    }


def pack(disp: NDArray[np.floating[Any]], stride: int = 1) -> dict[str, Any]:
    """Every `stride`-th pixel of an (H, W) disparity map, +inf unknown, as the page's script expects it.

    16-bit steps of 1/16 px from `offset` px, 65535 unknown, the largest saturated; differences along rows, low bytes
    before high bytes, zlib, base64. Not an image: privacy modes of browsers alter pixels read back from images.
    """
    thin = np.asarray(disp[::stride, ::stride], np.float64)
    known = np.isfinite(thin)
    offset = float(np.floor(thin[known].min())) if known.any() else 0.0
    steps = np.clip(
        np.rint((np.where(known, thin, offset) - offset) / STEP), 0, UNKNOWN - 1
    )
    return {"stride": stride, "offset": offset, "step": STEP} | _packed(
        np.where(known, steps, UNKNOWN)
    )


def pack_grey(image: NDArray[Any]) -> dict[str, Any]:
    """An (H, W) uint8 or uint16 image without loss, in the format of `pack`. top: the largest value of its dtype."""
    return {
        "stride": 1,
        "offset": 0,
        "step": 1,
        "top": int(np.iinfo(image.dtype).max),
    } | _packed(image)


def _packed(codes: NDArray[Any]) -> dict[str, Any]:
    words: NDArray[np.uint16] = codes.astype(np.uint16)
    differences = np.diff(words, axis=1, prepend=np.uint16(0)).ravel()
    planes = (differences & 255).astype(np.uint8).tobytes() + (differences >> 8).astype(
        np.uint8
    ).tobytes()
    return {"w": codes.shape[1], "h": codes.shape[0], "data": _deflated(planes)}


def image_uri(image: NDArray[Any], stride: int = 1, quality: int = 82) -> str:
    """An (H, W[, 3]) 8- or 16-bit image as a WebP data URI, averaged over `stride` x `stride` pixels."""
    picture = Image.fromarray(rgb8(image))
    out = io.BytesIO()
    (picture.reduce(stride) if stride > 1 else picture).save(
        out, format="WEBP", quality=quality, method=4
    )
    return "data:image/webp;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def _deflated(data: str | bytes) -> str:
    data = data.encode("utf-8", "replace") if isinstance(data, str) else data
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _document(
    board: Board,
    pictures: Mapping[str, Any],
    weights: Mapping[str, float] | None,
    groups: Groups,
) -> dict[str, Any]:
    first = {e.sample: e for e in reversed(board.entries)}
    return {
        "title": board.title,
        "meta": dict(board.meta),
        "methods": [
            _method(m, next(e.spec for e in board.entries if e.method == m))
            for m in board.methods
        ],
        "samples": [
            {
                "name": s,
                "w": first[s].width,
                "h": first[s].height,
                "ndisp": first[s].ndisp,
                "low": first[s].min_disparity,
                "pictures": pictures.get(s),
            }
            for s in board.samples
        ],
        "protocols": [
            {key: getattr(rules, key) for key in ("name", "title", "headline")}
            | _columns(board, rules)
            | {"lines": dict(rules.lines())}
            for rules in (PROTOCOLS[name] for name in board.protocols)
        ],
        "regions": [
            {"name": r, "text": REGIONS[r].text if r in REGIONS else ""}
            for r in board.regions
        ],
        "metrics": {
            m.name: {"unit": m.unit, "text": m.text, "lower": m.lower_is_better}
            for m in METRICS.values()
        },
        "times": list(TIMES),
        "densities": DENSITIES,
        "limits": LIMITS,
        "entries": [_entry(e) for e in board.entries],
        "means": _means(board, weights),
        "groups": [
            {
                "name": name,
                "samples": list(samples),
                "means": _means(board.subset(samples), None),
            }
            for name, samples in groups.items()
        ],
        "weighted": bool(weights),
        "colormaps": {
            n: base64.b64encode(t.tobytes()).decode("ascii")
            for n, t in COLORMAPS.items()
        },
        "unknown": {"truth": NO_TRUTH, "estimate": NO_ESTIMATE},
        "downloads": {
            "csv": _deflated(scoring.board_csv(board)),
            "json": _deflated(scoring.board_to_json(board)),
            "latex": {
                p: {
                    r: _deflated(scoring.board_latex(board, p, r, weights=weights))
                    for r in board.regions
                }
                for p in board.protocols
            },
        },
    }


def _method(name: str, spec: str) -> dict[str, Any]:
    """A method, and the options of the cost that the page draws: ZNCC if the method is not twinlens's own."""
    matcher = matcher_of_spec(spec)
    shown = matcher or StereoMatcher()
    parts = [shown.cost, f"{shown.block_size} x {shown.block_size}"]
    parts += [
        value
        for value in (shown.support, shown.optimisation)
        if value not in ("fixed", "wta")
    ]
    note = ", ".join(parts) + (
        "" if matcher else ": for comparison, not the method's own cost"
    )
    curve = {option: getattr(shown, option) for option in _CURVE_OPTIONS}
    p1, p2 = shown.penalties
    more = {
        "p1": p1,
        "p2": p2,
        "paths": PATHS[shown.optimisation],
        "pixelwise": SUPPORTS[shown.support].pixelwise,
    }
    return {
        "name": name,
        "spec": spec,
        "curve": {**curve, **more, "radius": shown.window // 2, "note": note},
    }


def _columns(board: Board, rules: Protocol) -> dict[str, Any]:
    """The metrics and the main columns; those of a confidence only if a method has one."""
    areas, confident = rules.auc_metrics, has_confidence(board, rules.name)
    metrics = (
        rules.metrics
        if confident
        else tuple(name for name in rules.metrics if name not in areas)
    )
    return {
        "metrics": metrics,
        "columns": (*rules.columns, *areas) if confident else rules.columns,
    }


def _entry(entry: Entry) -> dict[str, Any]:
    """One entry; values are in the order of the protocol's metrics, whose names would be half of the page."""
    names = PROTOCOLS[entry.protocol].metrics
    regions = {
        name: {
            "n": [s.image, s.evaluated, s.estimated],
            "v": [_rounded(s.get(metric, math.nan)) for metric in names],
        }
        | (
            {"s": [_rounded(rate) for rate in s.sparsification]}
            if s.sparsification
            else {}
        )
        for name, s in entry.regions.items()
    }
    return {
        **{name: getattr(entry, name) for name in ("method", "sample", "protocol")},
        "failure": None
        if entry.failure is None
        else [entry.failure.kind, entry.failure.message],
        "times": {name: _rounded(value) for name, value in entry.times().items()},
        "regions": regions,
    }


def _means(board: Board, weights: Mapping[str, float] | None) -> dict[str, Any]:
    """Protocol -> region -> method -> mean. A board without scores has no regions; its failures are listed under ""."""

    def mean(method: str, protocol: str, region: str) -> dict[str, Any]:
        mean = board.mean(method, protocol, region, weights)
        values = {name: _rounded(value) for name, value in mean.metrics.items()}
        return {
            "n": mean.counted,
            "failed": list(mean.failed),
            "missing": list(mean.missing),
            "v": values,
        }

    return {
        p: {
            r: {m: mean(m, p, r) for m in board.methods} for r in board.regions or ("",)
        }
        for p in board.protocols
    }
