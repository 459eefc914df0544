"""`aperture`: f/1 to f/32. Wide lenses blur what is out of focus, narrow ones diffract and starve: which is the best?

Each scene's lenses are photographed from one set of light paths (`render_lens_grid`); its radiances are then exposed
(a) all for the same time, where shot noise grows as the hole shrinks, and (b) each to the same brightness; with and
without diffraction.

Theory stands beside it: `aperture_theory`.
"""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.diffraction import diffract
from twinlens.rendering import LensGrid, render_lens_grid
from twinlens.sensor import Exposure, Sensor, auto_exposure
from twinlens.studies.aperture_theory import SENSOR, WAVELENGTH, best_f_number, grain_px, predicted_error
from twinlens.studies.bootstrap import log_slope, over_scenes, paired_difference
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, agrees
from twinlens.studies.pictures import crop
from twinlens.studies.stage import SCORES, Stage, stream
from twinlens.studies.table import Column, Row, Table

Float = NDArray[np.float64]
Radiance = list[NDArray[np.float32]]

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
FILM_WIDTH = 3.2e-3
"""A sensor of the 1/4-inch type, metres; the pixel pitch follows from the image's width."""
SCALE = 0.2
"""The scenes are photographed as models, 1:5, as a camera over a bench sees its work: near enough that f/1 blurs by
several pixels, small enough a sensor that f/32 does."""
LINEAR = Sensor.preset("machine_vision", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3)
EXPOSED_AT = 1.0
"""The fixed exposure is the automatic one of this f-number."""
_CROP, _ZOOM = 40, 3
_MOST_COST = 0.2
"""Theory is right when its f-number costs no more than this part of what the worst one costs over the best."""
_MODES = ("fixed exposure", "equal brightness")
_LAW_AT = 11.0


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, f-number, exposure, diffraction and matcher; crops along the sweep."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    saved: dict[str, dict[str, float]] = {}
    for done, name in enumerate(setup.scenes):
        setup.progress(done / len(setup.scenes), name)
        pitch_um = 1e6 * FILM_WIDTH / setup.width
        stage = Stage.of(name, setup.width, setup.height, pixel_pitch_um=pitch_um, scale=SCALE)
        lenses = [lens_of(stage, number) for number in F_NUMBERS]
        begun = time.perf_counter()
        grid = render_lens_grid(stage.scene, stage.rig, lenses, setup.spp, stream(setup.seeds[0], 0))
        saved[name] = _saved(stage, setup, grid, time.perf_counter() - begun)
        rows += _sweep(setup, stage, lenses, grid, done)
        pictures.append(_crops(stage, lenses, grid.images))
    setup.progress(1.0, "")
    notes = {"f_numbers": F_NUMBERS, "film_width_m": FILM_WIDTH, "scale": SCALE, "exposed_at_f": EXPOSED_AT}
    remarks = {"lens grid": ". ".join(_said(name, each) for name, each in saved.items())}
    return Measured(rows, tuple(pictures), notes | {"lens_grid_saved": saved}, remarks)


def lens_of(stage: Stage, f_number: float) -> ThinLens:
    """Of working f-number v/A, focused at the middle of the scene's disparities."""
    return ThinLens(stage.camera.film_distance / f_number, stage.middle_focus)


def _saved(stage: Stage, setup: Setup, grid: LensGrid, seconds: float) -> dict[str, float]:
    """What one set of light paths cost, beside as many direct photographs of the same error as there are lenses."""
    lens = lens_of(stage, EXPOSED_AT)
    stage.photograph(lens, 1, stream(setup.seeds[0], 8))
    few = max(1, setup.spp // 4)
    begun = time.perf_counter()
    stage.photograph(lens, few, stream(setup.seeds[0], 9))
    direct = len(F_NUMBERS) * setup.spp / few * (time.perf_counter() - begun)
    paths = len(F_NUMBERS) * setup.spp * 2 * setup.width * setup.height
    return {"grid_s": round(seconds, 2), "direct_s": round(direct, 2), "grid_paths": grid.rays, "direct_paths": paths}


def _said(name: str, saved: Mapping[str, float]) -> str:
    return (
        f"{name}: {len(F_NUMBERS)} lenses from {saved['grid_paths'] / 1e6:.3g} million light paths in "
        f"{saved['grid_s']:.3g} s; one by one {saved['direct_paths'] / 1e6:.3g} million, "
        f"about {saved['direct_s']:.3g} s"
    )


def _sweep(setup: Setup, stage: Stage, lenses: Sequence[ThinLens], grid: LensGrid, done: int) -> list[Row]:
    images = grid.images
    grain = grain_px(images[len(images) // 2][0])
    middle = F_NUMBERS.index(EXPOSED_AT)
    fixed = _automatic(stage, lenses[middle], images[middle])
    rows: list[Row] = []
    for k, (number, lens, sharp) in enumerate(zip(F_NUMBERS, lenses, images, strict=True)):
        share = (done + k / len(F_NUMBERS)) / len(setup.scenes)
        setup.progress(share, f"{stage.scene.name} f/{number:g}")
        for diffraction, radiance in (("without", sharp), ("with", _diffracted(stage, lens, sharp))):
            for mode in _MODES:
                exposure = fixed if mode == _MODES[0] else _automatic(stage, lens, radiance)
                predicted = predicted_error(stage, lens, exposure, radiance[0], grain, diffraction == "with")
                level = _level(stage, lens, exposure, radiance)
                case: Row = {
                    "scene": stage.scene.name, "f_number": number, "exposure": mode, "diffraction": diffraction,
                    "level": level, "predicted": predicted,
                }  # fmt: skip
                rows += _photograph(setup, stage, lens, radiance, exposure, case)
    return _with_theory(rows)


def _photograph(
    setup: Setup, stage: Stage, lens: ThinLens, radiance: Radiance, exposure: Exposure, case: Row
) -> list[Row]:  # fmt: skip
    rows: list[Row] = []
    for seed in setup.seeds:
        draw = stream(seed, 1, F_NUMBERS.index(float(case["f_number"])), _MODES.index(str(case["exposure"])))
        pictures = stage.expose(radiance, lens, draw, SENSOR, exposure)
        found = stage.errors(pictures, setup.methods)
        rows += [{**case, "seed": seed, "method": method, **scores} for method, scores in found.items()]
    return rows


def _with_theory(rows: Sequence[Row]) -> list[Row]:
    """One scene's rows and, beside them, the f-number of the least predicted error and the square law of light."""
    curves: dict[tuple[Any, Any], dict[float, Row]] = {}
    for row in rows:
        curves.setdefault((row["exposure"], row["diffraction"]), {})[float(row["f_number"])] = row
    best = {
        key: best_f_number(np.array(list(curve)), np.array([float(row["predicted"]) for row in curve.values()]))
        for key, curve in curves.items()
    }
    return [
        {
            **row,
            "theory_best": best[row["exposure"], row["diffraction"]],
            "square_law": (
                float(curves[row["exposure"], row["diffraction"]][_LAW_AT]["level"])
                * (_LAW_AT / float(row["f_number"])) ** 2
            ),
        }
        for row in rows
    ]


def _level(stage: Stage, lens: ThinLens, exposure: Exposure, radiance: Radiance) -> float:
    """Mean level of the left picture before its tone curve, white 1, noise and all."""
    photo = LINEAR.expose(radiance[0], camera=stage.camera, lens=lens, seed=0, exposure=exposure)
    return float(photo.image.mean()) / 65535.0


def _automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def _diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance]


def _crops(stage: Stage, lenses: Sequence[ThinLens], images: Sequence[Radiance]) -> Picture:
    """The nearest edge of the scene's middle, through every lens, exposed alike bright, with diffraction."""
    depth = np.where(np.isfinite(stage.truth.depth), stage.truth.depth, np.inf)
    side = min(_CROP, *(length // 3 for length in depth.shape))
    inner = depth[side:-side, side:-side]
    y, x = np.unravel_index(int(np.argmin(inner)), inner.shape)
    parts = []
    for lens, radiance in zip(lenses, images, strict=True):
        seen = _diffracted(stage, lens, radiance)
        picture = stage.expose(seen, lens, 0, SENSOR)[0]
        parts.append(crop(picture, int(x) + side // 2, int(y) + side // 2, side, side, _ZOOM))
    captions = tuple(f"f/{number:g}" for number in F_NUMBERS)
    title = f"{stage.scene.name}: the same crop from f/1 to f/32"
    return Picture(f"crops-{stage.scene.name}", title, tuple(parts), captions)


def conclude(table: Table) -> list[Finding]:
    """The best f-number of each matcher beside the predicted one; the square law of light."""
    findings = [_square_law(table)]
    for mode in _MODES:
        rows = table.where(exposure=mode, diffraction="with")
        findings += [_optimum(rows.where(method=method), f"{method}, at {mode}") for method in rows.values("method")]
    return findings


def _optimum(rows: Table, text: str) -> Finding:
    """What stopping at the predicted f-number costs over the best of the sweep."""
    numbers = [float(number) for number in rows.values("f_number")]
    wrong = {number: float(rows.where(f_number=number).numbers("totbad2").mean()) for number in numbers}
    predicted = math.exp(float(np.log(rows.numbers("theory_best")).mean()))
    best = min(numbers, key=lambda number: wrong[number])
    chosen = min(numbers, key=lambda number: abs(math.log(number / predicted)))
    cost = paired_difference(rows, "totbad2", "f_number", chosen, best)
    allowed = _MOST_COST * (max(wrong.values()) - wrong[best])
    said = (
        f"{text}, is best at f/{best:g}; at f/{chosen:g}, the nearest to theory's f/{predicted:.2g}, it has {{}} more "
        f"wrong pixels, where {allowed:.2g} are allowed: a fifth of what the worst f-number costs"
    )
    return Finding(said, cost, cost.value <= allowed, "percent points")


def _square_law(table: Table) -> Finding:
    """Mean level against A, at the fixed exposure, where nothing burns out: the exponent."""
    rows = table.where(exposure=_MODES[0], diffraction="without")
    rows = rows.where(lambda row: 2 * EXPOSED_AT <= float(row["f_number"]) <= 16)
    fall = log_slope("f_number", "level")
    slope = over_scenes(rows, lambda unit: -fall(unit))
    text = "At a fixed exposure the picture's mean level grows as A^p, p = {}"
    return Finding(text, slope, agrees(slope, 2.0, 0.01), "", 2.0, 0.01)


_ALL = ("f_number", "totbad2")
_LOOK: dict[str, Any] = {
    "by": "method", "panel": "exposure", "log_x": True, "best": "least", "marks": (("theory_best", "theory"),)
}  # fmt: skip
STUDY = Study(
    name="aperture",
    question="Which f-number is best for stereo, when blur, diffraction and noise are weighed?",
    columns=(
        Column("f_number", "", "f-number"),
        Column("exposure", "", "exposure"),
        Column("diffraction", "", "diffraction"),
        Column("method", "", "matcher"),
        Column("level", "", "mean level of the linear picture"),
        Column("square_law", "", "A² through the level at f/11"),
        Column("predicted", "a.u.", "predicted error"),
        Column("theory_best", "", "f-number of the least predicted error"),
        *SCORES,
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("wrong", "Wrong pixels from f/1 to f/32, with diffraction", *_ALL,
               where={"diffraction": "with"}, **_LOOK),
        Figure("without", "Wrong pixels from f/1 to f/32, without diffraction", *_ALL,
               where={"diffraction": "without"}, **_LOOK),
        Figure("predicted", "What theory expects of a matcher's error", "f_number", "predicted", by="diffraction",
               panel="exposure", log_x=True, log_y=True, best="least"),
        Figure("light", "Mean level at a fixed exposure, as far as noise is not cut at zero", "f_number", "level",
               by="scene", log_x=True, log_y=True,
               also=("square_law",), residual_of="square_law",
               where={"exposure": _MODES[0], "diffraction": "without", "f_number": F_NUMBERS[:9]}),
    ),
    defaults=Setup(
        ("staircase", "cards"), ("sad", "ssd", "ncc", "zncc", "census", "rank", "birchfield_tomasi", "sgm"), (0, 1),
        width=480, height=360, spp=64,
    ),
)  # fmt: skip
