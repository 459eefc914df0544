"""`window`: how large a block should be. Large blocks bridge missing texture; small ones keep depth edges.

Adaptive windows address this trade-off: Kanade and Okutomi, A Stereo Matching Algorithm with an Adaptive Window, PAMI
16(9), 1994. Images are rendered through a wide lens, so that parts of each scene are out of focus.
"""

import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.sensor import Sensor
from twinlens.studies.bootstrap import over_scenes, paired_difference
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, compared, is_above, sweep
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row, Table

SIZES = (3, 5, 7, 9, 13, 17, 21, 31)
REGIONS = ("nonocc", "textureless", "discontinuity", "out-of-focus")
COMPARED = {"ssd:block_size=21": "SSD, fixed 21x21", "adaptive": "adaptive window", "sgm": "semi-global"}
"""Methods shown side by side, and their captions."""
BLUR_PX = 6.0
"""Blur at the ends of a scene's depth range."""
SENSOR = Sensor.preset("machine_vision")
_MAX_ERROR_PX = 4.0
_UNKNOWN = "#c4c8ce"


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, matcher, block size and region; a panel of disparity maps for each scene."""
    rows: list[Row] = []
    panels: list[Picture] = []
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        lens = wide_lens(stage)
        radiance = stage.photograph(lens, setup.spp, stream(seed, 0))
        pictures = stage.expose(radiance, lens, stream(seed, 1), SENSOR)
        place = {"scene": scene, "seed": seed}
        for method in setup.methods:
            for size in SIZES:
                found = stage.match(pictures, with_block(method, size))
                rows += _rows(stage, found, pictures, lens, {**place, "method": method, "block_size": size})
        maps = {method: stage.match(pictures, method) for method in COMPARED}
        for method, found in maps.items():
            rows += _rows(stage, found, pictures, lens, {**place, "method": method})
        if seed == setup.seeds[0]:
            panels.append(_panel(stage, pictures, list(maps.values())))
    return Measured(rows, tuple(panels), {"blur_px": BLUR_PX, "compared": tuple(COMPARED)})


def wide_lens(stage: Stage) -> ThinLens:
    """The lens focused at the middle of the disparity range that blurs both ends by `BLUR_PX`."""
    near, far = stage.scene.depth_range
    half = 0.5 * (1.0 / near - 1.0 / far)
    return ThinLens(BLUR_PX / (stage.camera.fx * half), stage.middle_focus)


def with_block(method: str, size: int) -> str:
    """The method with this block size.

    >>> with_block("zncc", 9), with_block("sad:lr_check=1", 5)
    ('zncc:block_size=9', 'sad:lr_check=1,block_size=5')
    """
    return f"{method}{',' if ':' in method else ':'}block_size={size}"


def _rows(
    stage: Stage, found: NDArray[np.float32], pictures: Sequence[NDArray[Any]], lens: ThinLens, place: Row
) -> list[Row]:
    scores = stage.score(found, pictures, REGIONS, lens)
    regions = [region for region in REGIONS if region in scores.regions]
    return [{**place, "region": region, **score_columns(scores, region)} for region in regions]


def _panel(stage: Stage, pictures: Sequence[NDArray[Any]], maps: Sequence[NDArray[np.float32]]) -> Picture:
    truth, top = stage.truth.disparity, float(stage.ndisp)
    colours = [coloured(found, top, "viridis") for found in (truth, *maps)]
    images = (*pictures, *colours, *(error_picture(found, truth) for found in maps))
    errors = [f"error, black: {_MAX_ERROR_PX:g} px"] * len(maps)
    captions = ("left", "right", "true disparity", *COMPARED.values(), *errors)
    title = f"{stage.scene.name}: fixed block, adaptive window, semi-global"
    return Picture(f"panel-{stage.scene.name}", title, images, captions, columns=3)


def coloured(values: NDArray[Any], top: float, colormap: str) -> NDArray[np.uint8]:
    """(H, W) values from 0 to `top` as uint8 (H, W, 3); grey where not finite."""
    colours = matplotlib.colormaps[colormap].with_extremes(bad=_UNKNOWN)
    return np.asarray(colours(np.ma.masked_invalid(values / top), bytes=True)[..., :3])


def error_picture(found: NDArray[Any], truth: NDArray[Any], most: float = _MAX_ERROR_PX) -> NDArray[np.uint8]:
    """|found - truth| as uint8 (H, W, 3): white 0, black `most` px or unknown; light grey where truth is unknown."""
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(found), np.abs(found - truth), most)
    return coloured(np.where(np.isfinite(truth), error, np.nan), most, "gray_r")


def conclude(table: Table) -> list[Finding]:
    """The best block sizes without texture and without focus; the gain of other methods at discontinuities."""
    swept = table.where(lambda row: math.isfinite(float(row["block_size"])))
    methods = [str(method) for method in swept.values("method")]
    regions = (("textureless", "without texture"), ("out-of-focus", "out of focus"))
    findings = [_larger(swept.where(method=method), method, *region) for region in regions for method in methods]
    edges = table.where(lambda row: math.isnan(float(row["block_size"])), region="discontinuity")
    for better, name in (("adaptive", "an adaptive window"), ("sgm", "semi-global matching")):
        gain = paired_difference(edges, "totbad2", "method", next(iter(COMPARED)), better)
        text = f"At discontinuities, {name} has fewer wrong pixels than SSD with a fixed 21x21 block"
        findings.append(compared(text, gain, "fewer", "more", f"with {name}"))
    return findings


def _larger(rows: Table, method: str, region: str, words: str) -> Finding:
    """The ratio of the best block size in a region to the best one at discontinuities."""

    def ratio(unit: Table) -> float:
        return math.log(best_size(unit.where(region=region)) / best_size(unit.where(region="discontinuity")))

    times = over_scenes(rows, ratio, lambda values: math.exp(float(values.mean())))
    text = f"{method}: the best block {words} is larger than at discontinuities"
    return Finding(text, times, is_above(times, 1.0), result="{} times its width")


def best_size(rows: Table) -> float:
    """The block size with the fewest wrong pixels; NaN if there are no scores."""
    known = rows.where(lambda row: math.isfinite(float(row["totbad2"])))
    wrong = {float(size): known.where(block_size=size).numbers("totbad2").mean() for size in known.values("block_size")}
    return min(wrong, key=lambda size: float(wrong[size]), default=math.nan)


STUDY = Study(
    name="window",
    question="How large should the block be in textureless, discontinuous and out-of-focus regions?",
    columns=(
        Column("method", "", "matcher"),
        Column("block_size", "px", "block size"),
        Column("region", "", "region"),
        *SCORES,
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure(
            "window", "Wrong pixels against block size by region", "block_size", "totbad2", by="method",
            panel="region", log_x=True, best="least", where={"block_size": tuple(float(size) for size in SIZES)},
        ),
    ),
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "ssd", "zncc", "census"), (0, 1, 2)),
)  # fmt: skip
