"""`focus`: where to focus a stereo pair, how blur depends on disparity, and two cameras with different focus.

Blur and disparity obey c = (A/B) |d - d_focus| (Schechner and Kiryati, Depth from Defocus vs. Stereo, IJCV 39(2),
2000), tested on lamps: small spheres at known depths, which a wide-aperture lens images as disks.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from twinlens.camera import Paraxial, Rig, ThinLens
from twinlens.geometry import Float
from twinlens.rendering import render, render_lens_grid
from twinlens.sensor import Sensor
from twinlens.studies.findings import SHARES, Finding, compared, predicted
from twinlens.studies.intervals import over_scenes, paired_difference
from twinlens.studies.model import Figure, Measured, Setup, Study, sweep
from twinlens.studies.stage import GLOW, Stage, centred_camera, glowing, stream
from twinlens.studies.table import Column, Row, Table

FOCI = (0.0, 0.25, 0.5, 0.75, 1.0)
"""In 1/z, from the far end (0) to the near end (1) of the depth range."""
BLURS_PX = (1.5, 3.0, 6.0, 12.0)
"""Apertures, as the blur of the near end with the focus at the far end."""
MISMATCH_BLUR_PX = 6.0
LINE_APERTURE, LINE_BASELINE, LINE_FOCUS = 0.08, 0.08, 2.0
LINE_DEPTHS = (0.8, 1.0, 1.25, 1.6, 2.6, 3.5, 5.0, 9.0)
LAMP_PX = 3.0  # diameter of a lamp's image through a pinhole
SENSOR = Sensor.preset("machine_vision", vignetting=False)
_LINE_SPP = 1024
_SLOPE_TOLERANCE = 0.01


def measure(setup: Setup) -> Measured:
    """Lamps at many depths, then wrong pixels over focus and aperture, then cameras with different focus."""
    rows: list[Row] = []
    for seed in setup.seeds:
        rows += _line(seed)
    for scene, seed in sweep(setup, setup.seeds):
        rows += _rows(setup, Stage.of(scene, setup.width, setup.height), seed)
    return Measured(rows, notes={"foci": FOCI, "blurs_px": BLURS_PX, "line_aperture_m": LINE_APERTURE,
                                 "line_baseline_m": LINE_BASELINE, "line_focus_m": LINE_FOCUS})  # fmt: skip


def _line(seed: int) -> list[Row]:
    """Measured blur and disparity of lamps at many depths."""
    camera, lens = centred_camera(72, 56, 220.0), ThinLens(LINE_APERTURE, LINE_FOCUS)
    rig = Rig.stereo(camera, LINE_BASELINE, np.eye(4))
    rows: list[Row] = []
    for number, depth in enumerate(LINE_DEPTHS):
        blur, disparity = blur_and_disparity(
            rig, lens, depth, _LINE_SPP, stream(seed, 2, number)
        )
        defocus = disparity - camera.fx * LINE_BASELINE / LINE_FOCUS
        rows.append(
            {
                "scene": "lamps",
                "seed": seed,
                "part": "line",
                "blur_px": blur,
                "defocus_px": defocus,
                "predicted_px": LINE_APERTURE / LINE_BASELINE * abs(defocus),
            }
        )
    return rows


def blur_and_disparity(
    rig: Rig, lens: Paraxial, depth: float, spp: int, seed: int
) -> tuple[float, float]:
    """(blur diameter, disparity) in pixels, measured on rendered images of a lamp between the two cameras."""
    pose = np.eye(4)
    pose[:3, :3] *= 0.5 * LAMP_PX * depth / rig.cameras[0].fx
    pose[:3, 3] = 0.5 * rig.baseline(0, 1), 0.0, depth
    scene = glowing("lamp", [("lamp", {"type": "sphere"}, pose, GLOW)], depth)
    left, right = (
        image.mean(axis=-1).astype(np.float64)
        for image in render(scene, rig, lens, spp, seed)
    )
    disparity = ndimage.center_of_mass(left)[1] - ndimage.center_of_mass(right)[1]
    return float(np.mean([disk_diameter(left), disk_diameter(right)])), disparity


def disk_diameter(image: Float, sharp_px: float = LAMP_PX) -> float:
    """Diameter D of the blur, pixels, from the variance of the image of a disk that is `sharp_px` wide without blur.

    The variance along each axis is D^2/16 + sharp_px^2/16 + 1/12 for blur, disk and pixel.
    """
    v, u = ndimage.center_of_mass(image)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    squares = (columns - u) ** 2 + (rows - v) ** 2
    both_axes = float((squares * image).sum() / image.sum())
    return math.sqrt(max(8.0 * (both_axes - 2.0 / 12.0) - sharp_px**2, 0.0))


def _rows(setup: Setup, stage: Stage, seed: int) -> list[Row]:
    """Every lens, then both cameras focused at the far end, both at the near end, and one at each."""
    cases = itertools.product(BLURS_PX, FOCI)
    lenses = [stage.lens(focus, blur) for blur, focus in cases]
    grid = render_lens_grid(
        stage.scene, stage.rig, lenses, setup.spp, stream(seed, 0), denoise=True
    )
    finite = np.isfinite(stage.truth.depth)
    blurs = [float(np.abs(stage.blur(lens))[finite].mean()) for lens in lenses]
    rows: list[Row] = []
    for pair in _pairs():
        radiance = [grid[pair.left][0], grid[pair.right][1]]
        pictures = stage.expose(
            radiance, lenses[pair.left], stream(seed, *pair.key), SENSOR
        )
        case = {
            "scene": stage.scene.name,
            "seed": seed,
            **pair.columns,
            "aperture_px": BLURS_PX[pair.left // len(FOCI)],
            "mean_blur_px": 0.5 * (blurs[pair.left] + blurs[pair.right]),
        }
        for method, scores in stage.errors(pictures, setup.methods).items():
            totbad2, avgerr = scores["totbad2"], scores["avgerr"]
            rows.append(
                {**case, "method": method, "totbad2": totbad2, "avgerr": avgerr}
            )
    return rows


@dataclass(frozen=True)
class _Pair:
    """Two lenses by their numbers in the grid of BLURS_PX x FOCI; the key of the pair's noise."""

    columns: Row
    left: int
    right: int
    key: tuple[int, ...]


def _pairs() -> list[_Pair]:
    pairs = []
    columns: Row
    for lens in range(len(BLURS_PX) * len(FOCI)):
        columns = {"part": "map", "focus": FOCI[lens % len(FOCI)]}
        pairs.append(_Pair(columns, lens, lens, (1, lens)))
    far = BLURS_PX.index(MISMATCH_BLUR_PX) * len(FOCI)
    near = far + len(FOCI) - 1
    for eyes, left, right in (
        ("both far", far, far),
        ("both near", near, near),
        ("far and near", far, near),
    ):
        columns = {"part": "eyes", "eyes": eyes}
        pairs.append(_Pair(columns, left, right, (3, left, right)))
    return pairs


def conclude(table: Table) -> list[Finding]:
    """The slope of blur over disparity; the best focus; different focus against equal focus."""
    methods = [str(name) for name in table.where(part="map").values("method")]
    text = "The blur of lamps is linear in the disparity from the focus, with slope A/B: the slope is {}"
    measured = over_scenes(table.where(part="line"), _blur_slope)
    return [
        predicted(text, measured, LINE_APERTURE / LINE_BASELINE, _SLOPE_TOLERANCE),
        *(_best_focus(table, method) for method in methods),
        *(_worse_if_different(table, method) for method in methods),
    ]


def _blur_slope(rows: Table) -> float:
    """The slope of blur over the distance of the disparity from that of the focus."""
    defocus = np.abs(rows.numbers("defocus_px"))
    return float(np.polyfit(defocus, rows.numbers("blur_px"), 1)[0])


def _best_focus(table: Table, method: str) -> Finding:
    """At the widest aperture: the focus with the fewest wrong pixels, compared with the better end of the range."""
    rows = table.where(part="map", method=method, aperture_px=BLURS_PX[-1])

    def wrong(focus: float) -> float:
        return float(rows.where(focus=focus).numbers("totbad2").mean())

    best = min(FOCI, key=wrong)
    gains = [
        paired_difference(rows, "totbad2", "focus", end, best)
        for end in (FOCI[0], FOCI[-1])
    ]
    text = f"{method}, widest aperture: a focus inside the depth range gives fewer wrong pixels than either end"
    rest = f"at the best focus, {100 * best:.0f} % of the way from far to near in 1/z, than at the better end"
    return compared(
        text,
        min(gains, key=lambda gain: gain.value),
        "fewer",
        "more",
        rest,
        answer=f"{best:g}",
        needs=SHARES,
    )


def _worse_if_different(table: Table, method: str) -> Finding:
    def gap(unit: Table) -> float:
        wrong = {
            eyes: unit.where(eyes=eyes).numbers("totbad2").mean()
            for eyes in unit.values("eyes")
        }
        equal_focus = 0.5 * (wrong["both far"] + wrong["both near"])
        return float(wrong["far and near"] - equal_focus)

    difference = over_scenes(table.where(part="eyes", method=method), gap)
    text = f"{method}: cameras with different focus give more wrong pixels than with equal focus and mean blur"
    return compared(
        text, difference, "more", "fewer", "with different focus", needs=SHARES
    )


LAW = (
    "Blur and disparity are one law: a lens of aperture A in a pair of baseline B blurs a point by c = (A/B) |d - "
    "d_focus| pixels, where d is its disparity. Blur is therefore least in the mean if the focus is inside the "
    "range of disparities, 1/z, not of depths. Cameras with different focus blur the same point differently, so "
    "that their windows differ even where the mean blur is the same."
)
STUDY = Study(
    name="focus",
    question="Where should a stereo pair focus, and what if the two cameras focus differently?",
    columns=(
        Column("part", "", "part"),
        Column("method", "", "matcher"),
        Column("focus", "", "focus, from the far end (0) to the near end (1)"),
        Column("aperture_px", "px", "aperture, as the blur across the depth range"),
        Column("eyes", "", "focus of the two cameras"),
        Column("mean_blur_px", "px", "mean blur circle of both images"),
        Column("totbad2", "%", "wrong by > 2 px or unknown"),
        Column("avgerr", "px", "mean error"),
        Column("defocus_px", "px", "disparity from the focus"),
        Column("blur_px", "px", "blur circle, measured"),
        Column("predicted_px", "px", "(A/B) |d - d_focus|"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("line", "Blur against disparity from the focus", "defocus_px", "blur_px", kind="scatter",
               where={"part": "line"}, also=("predicted_px",), residual_of="predicted_px"),
        Figure("map", "Wrong pixels over focus and aperture", "focus", "aperture_px", kind="heatmap", z="totbad2",
               panel="method", where={"part": "map"}),
        Figure("eyes", "Wrong pixels with equal and different focus against mean blur", "mean_blur_px",
               "totbad2", by="eyes", panel="method", kind="scatter", where={"part": "eyes"}),
    ),
    law=LAW, docs="docs/study_results.md#focus", lesson="docs/course/05_aperture_and_depth_of_field.py",
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1, 2), spp=32),
)  # fmt: skip
