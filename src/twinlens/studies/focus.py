"""`focus`: where to focus and how wide to open; the line between blur and disparity; and eyes focused unlike.

Blur and disparity are one law, c = (A/B) |d - d_focus|: Schechner and Kiryati, Depth from Defocus vs. Stereo, IJCV
39(2), 2000. Every scene's lenses are photographed from one set of light paths (`render_lens_grid`).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Rig, ThinLens
from twinlens.rendering import LensGrid, render_lens_grid
from twinlens.sensor import Sensor
from twinlens.studies.bootstrap import over_scenes, paired_difference, unsigned
from twinlens.studies.lamps import blur_and_disparity, straight_line
from twinlens.studies.model import Figure, Finding, Measured, Setup, Study, agrees, is_above
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table

FOCI = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Places of the focus between the far (0) and the near end (1) of a scene's disparities."""
BLURS_PX = (1.5, 3.0, 6.0, 12.0)
"""Apertures, said as the blur of a scene's near end when the focus is at its far end: pixels at f(z)."""
MISMATCH_BLUR_PX = 6.0
LINE_APERTURE, LINE_BASELINE, LINE_FOCUS = 0.08, 0.08, 2.0
LINE_DEPTHS = (0.8, 1.0, 1.25, 1.6, 2.6, 3.5, 5.0, 9.0)
SENSOR = Sensor.preset("machine_vision")
_LINE_SPP = 1024
_SLOPE_TOLERANCE = 0.01
_LINE_CAMERA = Camera(72, 56, 220.0, 220.0, 35.5, 27.5)
_NAN = math.nan


def measure(setup: Setup) -> Measured:
    """The line of blur and disparity, then maps of error over focus and aperture, then unlike eyes."""
    rows: list[Row] = []
    for seed in setup.seeds:
        rows += _line(seed)
    count = len(setup.scenes) * len(setup.seeds)
    places = [(scene, seed) for scene in setup.scenes for seed in setup.seeds]
    for done, (scene, seed) in enumerate(places):
        setup.progress(done / count, scene)
        stage = Stage.of(scene, setup.width, setup.height)
        lenses = [lens_at(stage, focus, blur) for blur in BLURS_PX for focus in FOCI]
        grid = render_lens_grid(stage.scene, stage.rig, lenses, setup.spp, stream(seed, 0))
        rows += _maps(setup, stage, lenses, grid, seed)
        rows += _unlike(setup, stage, lenses, grid, seed)
    return Measured(rows, notes={"foci": FOCI, "blurs_px": BLURS_PX, "line_aperture_m": LINE_APERTURE,
                                 "line_baseline_m": LINE_BASELINE, "line_focus_m": LINE_FOCUS})  # fmt: skip


def lens_at(stage: Stage, focus: float, blur_px: float) -> ThinLens:
    """The lens focused at this part of the scene's range of 1/z, so wide that its ends would differ by blur_px."""
    near, far = stage.scene.depth_range
    span = 1.0 / near - 1.0 / far
    return ThinLens(blur_px / (stage.camera.fx * span), 1.0 / (1.0 / far + focus * span))


def _line(seed: int) -> list[Row]:
    """Lamps at many depths: blur and disparity as measured on their images."""
    camera = _LINE_CAMERA
    rig = Rig.stereo(camera, LINE_BASELINE, np.eye(4))
    lens = ThinLens(LINE_APERTURE, LINE_FOCUS)
    at_focus = camera.fx * LINE_BASELINE / LINE_FOCUS
    rows: list[Row] = []
    for k, depth in enumerate(LINE_DEPTHS):
        blur, disparity = blur_and_disparity(rig, lens, depth, _LINE_SPP, stream(seed, 2, k))
        predicted = LINE_APERTURE / LINE_BASELINE * abs(disparity - at_focus)
        rows.append(_row("lamps", seed, "line", blur_px=blur, predicted_px=predicted, defocus_px=disparity - at_focus))
    return rows


def _maps(setup: Setup, stage: Stage, lenses: Sequence[ThinLens], grid: LensGrid, seed: int) -> list[Row]:
    rows: list[Row] = []
    for k, lens in enumerate(lenses):
        blur, focus = BLURS_PX[k // len(FOCI)], FOCI[k % len(FOCI)]
        pictures = stage.expose(grid[k], lens, stream(seed, 1, k), SENSOR)
        for method, scores in stage.errors(pictures, setup.methods).items():
            rows.append(
                _row(stage.scene.name, seed, "map", method=method, focus=focus, aperture_px=blur,
                     mean_blur_px=_mean_blur(stage, lens), totbad2=scores["totbad2"], avgerr=scores["avgerr"])
            )  # fmt: skip
    return rows


def _unlike(setup: Setup, stage: Stage, lenses: Sequence[ThinLens], grid: LensGrid, seed: int) -> list[Row]:
    """Both eyes at the far end, both at the near end, or one at each: the same blurs, but not at the same places."""
    first = BLURS_PX.index(MISMATCH_BLUR_PX) * len(FOCI)
    far, near = first, first + len(FOCI) - 1
    rows: list[Row] = []
    for eyes, left, right in (("both far", far, far), ("both near", near, near), ("far and near", far, near)):
        radiance: list[NDArray[np.float32]] = [grid[left][0], grid[right][1]]
        pictures = stage.expose(radiance, lenses[left], stream(seed, 3, left, right), SENSOR)
        for method, scores in stage.errors(pictures, setup.methods).items():
            rows.append(
                _row(stage.scene.name, seed, "eyes", method=method, eyes=eyes, aperture_px=MISMATCH_BLUR_PX,
                     mean_blur_px=0.5 * (_mean_blur(stage, lenses[left]) + _mean_blur(stage, lenses[right])),
                     totbad2=scores["totbad2"], avgerr=scores["avgerr"])
            )  # fmt: skip
    return rows


def _mean_blur(stage: Stage, lens: ThinLens) -> float:
    return float(np.abs(stage.blur(lens))[np.isfinite(stage.truth.depth)].mean())


def _row(scene: str, seed: int, part: str, **values: float | str) -> Row:
    empty: dict[str, float | str] = {column.name: _NAN for column in COLUMNS} | {"method": "", "eyes": ""}
    return {**empty, "scene": scene, "seed": seed, "part": part, **values}


def conclude(table: Table) -> list[Finding]:
    """The line's slope; the best focus; unlike eyes against equal blur."""
    methods = [str(name) for name in table.where(part="map").values("method")]
    return [
        _slope(table.where(part="line")),
        *(_best_focus(table, method) for method in methods),
        *(_worse_unlike(table, method) for method in methods),
    ]


def _slope(rows: Table) -> Finding:
    def slope(unit: Table) -> float:
        return straight_line(np.abs(unit.numbers("defocus_px")).tolist(), unit.numbers("blur_px").tolist())[0]

    expected = LINE_APERTURE / LINE_BASELINE
    measured = over_scenes(rows, slope)
    text = "Blur is a straight line over the disparity from the focus, of slope A/B: for lamps the slope is {}"
    return Finding(text, measured, agrees(measured, expected, _SLOPE_TOLERANCE), "", expected, _SLOPE_TOLERANCE)


def _best_focus(table: Table, method: str) -> Finding:
    """At the widest aperture, the focus with the fewest wrong pixels; and what the middle wins over the ends."""
    rows = table.where(part="map", method=method, aperture_px=BLURS_PX[-1])
    best = min(FOCI, key=lambda focus: float(rows.where(focus=focus).numbers("totbad2").mean()))
    worst_gain = min(
        (paired_difference(rows, "totbad2", "focus", end, best) for end in (FOCI[0], FOCI[-1])),
        key=lambda gain: gain.value,
    )
    said, way = unsigned(worst_gain, "fewer", "more")
    text = (
        f"{method}, wide open: the best focus lies {100 * best:.0f} % of the way from a scene's far to its near end, "
        f"with {{}} {way} wrong pixels than at the better end"
    )
    return Finding(text, said, is_above(worst_gain), "percent points", answer=f"{best:g}")


def _worse_unlike(table: Table, method: str) -> Finding:
    """Against the mean of the two alike pairs, whose mean blur is that of the unlike one."""

    def gap(unit: Table) -> float:
        wrong = {eyes: unit.where(eyes=eyes).numbers("totbad2").mean() for eyes in unit.values("eyes")}
        return float(wrong["far and near"] - 0.5 * (wrong["both far"] + wrong["both near"]))

    measured = over_scenes(table.where(part="eyes", method=method), gap)
    said, way = unsigned(measured, "more", "fewer")
    text = f"{method}: eyes focused unlike have {{}} {way} wrong pixels than eyes focused alike, at the same mean blur"
    return Finding(text, said, is_above(measured), "percent points")


COLUMNS = (
    Column("part", "", "part"),
    Column("method", "", "matcher"),
    Column("focus", "", "focus, from the far end (0) to the near (1)"),
    Column("aperture_px", "px", "aperture, as blur at the other end"),
    Column("eyes", "", "focus of the eyes"),
    Column("mean_blur_px", "px", "mean blur circle of both eyes"),
    Column("totbad2", "%", "wrong by > 2 px or unknown"),
    Column("avgerr", "px", "mean error"),
    Column("defocus_px", "px", "disparity from the focus"),
    Column("blur_px", "px", "blur circle, measured"),
    Column("predicted_px", "px", "(A/B) |d - d_focus|"),
)
STUDY: Study = Study(
    name="focus",
    question="Where should a stereo pair focus, and what if its eyes focus unlike?",
    columns=COLUMNS,
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("line", "Blur and disparity are one law", "defocus_px", "blur_px", kind="scatter",
               where={"part": "line"}, also=("predicted_px",), residual_of="predicted_px"),
        Figure("map", "Wrong pixels over focus and aperture", "focus", "aperture_px", kind="heatmap", z="totbad2",
               panel="method", where={"part": "map"}),
        Figure("eyes", "Wrong pixels of eyes focused alike and unlike, against their mean blur", "mean_blur_px",
               "totbad2", by="eyes", panel="method", kind="scatter", where={"part": "eyes"}),
    ),
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1), spp=32),
)  # fmt: skip
