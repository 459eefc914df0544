"""`window`: how large a block should be. Large blocks match textureless areas; small ones keep depth edges.

Adaptive windows address this trade-off: Kanade and Okutomi, A Stereo Matching Algorithm with an Adaptive Window, PAMI
16(9), 1994. Images are rendered through a wide-aperture lens, so that parts of each scene are out of focus.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.pictures import colourise
from twinlens.sensor import Sensor
from twinlens.studies.findings import (
    REGIONS as REGION_NEEDS,
    Finding,
    bounded,
    fewer_wrong,
)
from twinlens.studies.intervals import over_scenes
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study, sweep
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row, Table

SIZES = (3, 5, 7, 9, 13, 17, 21, 31)
REGIONS = ("nonocc", "textureless", "discontinuity", "out-of-focus")
COMPARED = {
    "ssd:block_size=21": "SSD, fixed 21x21",
    "adaptive": "adaptive window",
    "sgm": "semi-global",
}
BLUR_PX = 6.0  # at the ends of a scene's depth range
SENSOR = Sensor.preset("machine_vision", vignetting=False)
_MAX_ERROR_PX = 4.0


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, matcher, block size and region; a panel of disparity maps for each scene."""
    rows: list[Row] = []
    panels: list[Picture] = []
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        lens = stage.lens(0.5, 2 * BLUR_PX)
        radiance = stage.photograph(lens, setup.spp, stream(seed, 0))
        pictures = stage.expose(radiance, lens, stream(seed, 1), SENSOR)
        maps: dict[str, NDArray[np.float32]] = {}
        for method, size, spec in _runs(setup.methods):
            maps[spec] = stage.match(pictures, spec)
            scores = stage.score(maps[spec], pictures, REGIONS, lens)
            case = {"scene": scene, "seed": seed, "method": method, "block_size": size}
            rows += [
                {
                    **case,
                    "region": region,
                    "pixels": scores.regions[region].evaluated,
                    **score_columns(scores, region),
                }
                for region in REGIONS
                if region in scores.regions
            ]
        if seed == setup.seeds[0]:
            panels.append(
                _panel(stage, pictures, [maps[method] for method in COMPARED])
            )
    return Measured(
        rows, tuple(panels), {"blur_px": BLUR_PX, "compared": tuple(COMPARED)}
    )


def _runs(methods: Sequence[str]) -> list[tuple[str, float, str]]:
    """(method, block size, specification) of every matcher with every size, and of those compared, without a size."""
    runs = []
    for method in methods:
        separator = "," if ":" in method else ":"
        runs += [
            (method, float(size), f"{method}{separator}block_size={size}")
            for size in SIZES
        ]
    return runs + [(method, math.nan, method) for method in COMPARED]


def _panel(
    stage: Stage, pictures: Sequence[NDArray[Any]], maps: Sequence[NDArray[np.float32]]
) -> Picture:
    """Images, disparity maps, and errors from white (0) to black (4 px or unknown); grey where truth is unknown."""
    truth, most = stage.truth.disparity, _MAX_ERROR_PX
    shown = [colourise(disparity, 0, stage.ndisp) for disparity in (truth, *maps)]
    for disparity in maps:
        with np.errstate(invalid="ignore"):
            error = np.abs(disparity - truth)
        error = np.where(np.isfinite(disparity), error, most)
        error = np.where(np.isfinite(truth), error, np.nan)
        shown.append(colourise(error, 0, most, "gray_r"))
    captions = (
        "left",
        "right",
        "true disparity",
        *COMPARED.values(),
        *[f"error, black: {most:g} px"] * len(maps),
    )
    title = f"{stage.scene.name}: fixed block, adaptive window, semi-global"
    return Picture(
        f"panel-{stage.scene.name}", title, (*pictures, *shown), captions, columns=3
    )


def conclude(table: Table) -> list[Finding]:
    """The best block sizes without texture and without focus; the gain of other methods at discontinuities."""
    swept = table.where(lambda row: math.isfinite(float(row["block_size"])))
    methods = [str(method) for method in swept.values("method")]
    regions = (("textureless", "without texture"), ("out-of-focus", "out of focus"))
    findings = [
        _larger(swept.where(method=method), method, *region)
        for region, method in itertools.product(regions, methods)
    ]
    edges = table.where(
        lambda row: math.isnan(float(row["block_size"])), region="discontinuity"
    )
    for better, name in (
        ("adaptive", "an adaptive window"),
        ("sgm", "semi-global matching"),
    ):
        text = f"At discontinuities, {name} has fewer wrong pixels than SSD with a fixed 21x21 block"
        findings.append(
            fewer_wrong(
                text,
                edges,
                better,
                next(iter(COMPARED)),
                f"with {name}",
                needs=REGION_NEEDS,
                region_pixels=_least_pixels(edges),
            )
        )
    return findings


def _larger(rows: Table, method: str, region: str, words: str) -> Finding:
    """The ratio of the best block size in a region to the best one at discontinuities."""

    def log_ratio(unit: Table) -> float:
        inside = best_size(unit.where(region=region))
        return math.log(inside / best_size(unit.where(region="discontinuity")))

    times = over_scenes(rows, log_ratio, lambda values: math.exp(float(values.mean())))
    text = f"{method}: the best block {words} is larger than at discontinuities"
    least = _least_pixels(rows.where(region=(region, "discontinuity")))
    return bounded(
        text, times, 1.0, math.inf, result="{} times its width", needs=REGION_NEEDS, region_pixels=least
    )  # fmt: skip


def _least_pixels(rows: Table) -> float:
    """The evaluated pixels of the smallest region."""
    return float(rows.numbers("pixels").min(initial=math.inf))


def best_size(rows: Table) -> float:
    """The block size with the fewest wrong pixels; NaN if there are no scores."""
    scored = rows.where(lambda row: math.isfinite(float(row["totbad2"])))
    wrong = {
        float(size): float(part.numbers("totbad2").mean())
        for (size,), part in scored.groups("block_size")
    }
    return min(wrong, key=lambda size: wrong[size], default=math.nan)


LAW = (
    "A matcher compares blocks of the two images and assumes that a block has one disparity. The error by noise "
    "falls as a block grows, because it averages more texture; the error at depth edges grows, because the block "
    "covers two surfaces. Where there is little texture, or where blur removed it, the best block is therefore "
    "larger than at depth discontinuities."
)
STUDY = Study(
    name="window",
    question="How large should the block be in textureless, discontinuous and out-of-focus regions?",
    columns=(
        Column("method", "", "matcher"),
        Column("block_size", "px", "block size"),
        Column("region", "", "region"),
        Column("pixels", "px", "evaluated pixels of the region"),
        *SCORES,
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("window", "Wrong pixels against block size by region", "block_size", "totbad2", by="method",
               panel="region", log_x=True, best="least", where={"block_size": tuple(map(float, SIZES))}),
    ),
    law=LAW, docs="docs/study_results.md#window", lesson="docs/course/12_matchers.py",
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "ssd", "zncc", "census"), (0, 1, 2)),
)  # fmt: skip
