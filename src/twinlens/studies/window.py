"""`window`: how large should a block be? Large ones bridge what has no texture and smear every edge.

The dilemma that adaptive windows answer: Kanade and Okutomi, A Stereo Matching Algorithm with an Adaptive Window, PAMI
16(9), 1994. A wide lens takes the pictures, so that some of each lies out of focus.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.sensor import Sensor
from twinlens.studies.bootstrap import over_scenes, paired_difference, unsigned
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, is_above, sweep
from twinlens.studies.pictures import disparity_picture, error_picture
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row, Table, Value

SIZES = (3, 5, 7, 9, 13, 17, 21, 31)
REGIONS = ("nonocc", "textureless", "discontinuity", "out-of-focus")
BESIDE = ("ssd:block_size=21", "adaptive", "sgm")
"""A large fixed window, the adaptive one, and semi-global matching (the classical state of the art): the panel."""
BLUR_PX = 6.0
"""Of the nearest or farthest point of a scene, whichever is more."""
SENSOR = Sensor.preset("machine_vision")


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, matcher, block size and region; and the panel of each scene."""
    rows: list[Row] = []
    panels: list[Picture] = []
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        lens = wide_lens(stage)
        radiance = stage.photograph(lens, setup.spp, stream(seed, 0))
        pictures = stage.expose(radiance, lens, stream(seed, 1), SENSOR)
        for method in setup.methods:
            for size in SIZES:
                found = stage.match(pictures, with_block(method, size))
                rows += _rows(stage, found, pictures, lens, scene, seed, method, size)
        beside = {method: stage.match(pictures, method) for method in BESIDE}
        for method, found in beside.items():
            rows += _rows(stage, found, pictures, lens, scene, seed, method, math.nan)
        if seed == setup.seeds[0]:
            panels.append(_panel(stage, pictures, beside))
    return Measured(rows, tuple(panels), {"blur_px": BLUR_PX, "beside": BESIDE})


def wide_lens(stage: Stage) -> ThinLens:
    """Focused at the middle of the disparities, as wide as blurs the ends of the depth range by `BLUR_PX`."""
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
    stage: Stage, found: NDArray[np.float32], pictures: Sequence[NDArray[Any]], lens: ThinLens, scene: str, seed: int,
    method: str, size: float,
) -> list[Row]:  # fmt: skip
    scores = stage.score(found, pictures, REGIONS, lens)
    place: dict[str, Value] = {"scene": scene, "seed": seed, "method": method, "block_size": size}
    return [
        {**place, "region": region, **score_columns(scores, region)} for region in REGIONS if region in scores.regions
    ]


def _panel(stage: Stage, pictures: Sequence[NDArray[Any]], maps: dict[str, NDArray[np.float32]]) -> Picture:
    truth, top = stage.truth.disparity, float(stage.ndisp)
    images = [pictures[0], pictures[1], disparity_picture(truth, top)]
    captions = ["left", "right", "true disparity"]
    images += [disparity_picture(found, top) for found in maps.values()]
    captions += ["SSD, fixed 21x21", "adaptive window", "semi-global"]
    images += [error_picture(found, truth) for found in maps.values()]
    captions += ["its error, black: 4 px"] * len(maps)
    return Picture(f"panel-{stage.scene.name}", f"{stage.scene.name}: fixed, adaptive, semi-global", tuple(images),
                   tuple(captions), columns=3)  # fmt: skip


def conclude(table: Table) -> list[Finding]:
    """Where large blocks serve and where small ones do; and what bending windows win at edges."""
    swept = table.where(lambda row: math.isfinite(float(row["block_size"])))
    methods = [str(method) for method in swept.values("method")]
    findings = [_larger(swept.where(method=method), method, "textureless", "no texture") for method in methods]
    findings += [_larger(swept.where(method=method), method, "out-of-focus", "no focus") for method in methods]
    edges = table.where(lambda row: math.isnan(float(row["block_size"])), region="discontinuity")
    for better, name in (("adaptive", "an adaptive window"), ("sgm", "semi-global matching")):
        gain = paired_difference(edges, "totbad2", "method", BESIDE[0], better)
        text = f"At discontinuities {name} has fewer wrong pixels than SSD with a fixed block of 21x21"
        said, way = unsigned(gain, "fewer", "more")
        findings.append(Finding(f"{text}: {{}} {way}", said, is_above(gain), "percent points"))
    return findings


def _larger(rows: Table, method: str, region: str, words: str) -> Finding:
    """How many times as wide the best block of a region is as the best at discontinuities."""

    def ratio(unit: Table) -> float:
        return math.log(best_size(unit.where(region=region)) / best_size(unit.where(region="discontinuity")))

    times = over_scenes(rows, ratio, lambda values: math.exp(float(values.mean())))
    text = f"{method}: where there is {words} the best block is {{}} times as wide as at discontinuities"
    return Finding(text, times, is_above(times, 1.0))


def best_size(rows: Table) -> float:
    """The block size with the fewest wrong pixels; NaN where there is none."""
    known = rows.where(lambda row: math.isfinite(float(row["totbad2"])))
    wrong = {float(size): known.where(block_size=size).numbers("totbad2").mean() for size in known.values("block_size")}
    return min(wrong, key=lambda size: float(wrong[size]), default=math.nan)


STUDY: Study = Study(
    name="window",
    question="How large should the block be, in textureless, discontinuous and out-of-focus parts?",
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
            "window", "Wrong pixels against block size, part by part", "block_size", "totbad2", by="method",
            panel="region", log_x=True, best="least", where={"block_size": tuple(float(size) for size in SIZES)},
        ),
    ),
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "ssd", "zncc", "census"), (0, 1, 2)),
)  # fmt: skip
