"""`aperture`: the best f-number for stereo, from f/1 to f/32, between blur, diffraction and noise.

The lenses of a scene and seed are rendered from one set of light paths (`render_lens_grid`). The images are exposed
(a) for the same time, so that shot noise grows as the aperture shrinks, and (b) to the same brightness; with and
without diffraction. Two theories predict the best f-number: `theory` for the median error, `evidence` for the share of
wrong pixels. `shots` documents the choice of parameters, `findings` the conclusions.
"""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.rendering import LensGrid, render_lens_grid
from twinlens.studies.aperture.evidence import SHARP_AT, SIDE, Evidence
from twinlens.studies.aperture.findings import conclude
from twinlens.studies.aperture.shots import (
    BLUR_PX,
    EXPOSED_AT,
    F_NUMBERS,
    GRAIN_AT,
    MODES,
    PIXEL_PITCH_UM,
    Model,
    Radiance,
    Shot,
    diffracted,
    level,
    shots,
)
from twinlens.studies.aperture.theory import SENSOR, best_f_number, grain_px, predicted_error
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row

_CROP, _ZOOM = 40, 3
_LAW_AT = 11.0


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, f-number, exposure, diffraction and matcher; crops along the sweep."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    saved: dict[str, dict[str, float]] = {}
    scales: dict[str, float] = {}
    places = [(name, seed) for name in setup.scenes for seed in setup.seeds]
    for done, (name, seed) in enumerate(places):
        setup.progress(done / len(places), name)
        model = Model.of(Stage.of(name, setup.width, setup.height, pixel_pitch_um=PIXEL_PITCH_UM))
        lenses = [model.full_size(model.lens(number)) for number in F_NUMBERS]
        start = time.perf_counter()
        grid = render_lens_grid(model.stage.scene, model.stage.rig, lenses, setup.spp, stream(seed, 0))
        seconds = time.perf_counter() - start
        rows += _sweep(setup, model, grid, seed, done / len(places))
        if seed == setup.seeds[0]:
            saved[name] = _saved(model, setup, grid, seconds)
            scales[name] = model.scale
            pictures.append(_crops(model, grid.images))
    setup.progress(1.0, "")
    notes = {"f_numbers": F_NUMBERS, "pixel_pitch_um": PIXEL_PITCH_UM, "blur_px": BLUR_PX, "scales": scales,
             "exposed_at_f": EXPOSED_AT, "theory_block_size": SIDE, "lens_grid_saved": saved}  # fmt: skip
    remarks = {
        "lens grid": ". ".join(_describe(name, each) for name, each in saved.items()),
        "models": ", ".join(f"{name} 1:{1 / scale:.0f}" for name, scale in scales.items()),
    }
    return Measured(rows, tuple(pictures), notes, remarks)


def _saved(model: Model, setup: Setup, grid: LensGrid, seconds: float) -> dict[str, float]:
    """Time and light paths of the lens grid, and of direct renders with as many samples."""
    lens = model.full_size(model.lens(EXPOSED_AT))
    model.stage.photograph(lens, 1, stream(setup.seeds[0], 8))
    few = max(1, setup.spp // 4)
    start = time.perf_counter()
    model.stage.photograph(lens, few, stream(setup.seeds[0], 9))
    direct = len(F_NUMBERS) * setup.spp / few * (time.perf_counter() - start)
    paths = len(F_NUMBERS) * setup.spp * 2 * setup.width * setup.height
    return {"grid_s": round(seconds, 2), "direct_s": round(direct, 2), "grid_paths": grid.rays, "direct_paths": paths}


def _describe(name: str, saved: Mapping[str, float]) -> str:
    return (
        f"{name}: {len(F_NUMBERS)} lenses from {saved['grid_paths'] / 1e6:.3g} million light paths in "
        f"{saved['grid_s']:.3g} s; direct renders need {saved['direct_paths'] / 1e6:.3g} million, "
        f"about {saved['direct_s']:.3g} s"
    )


def _sweep(setup: Setup, model: Model, grid: LensGrid, seed: int, done: float) -> list[Row]:
    """The rows of one scene and seed."""
    stage, images = model.stage, grid.images
    paths = _rendering_noise(grid)
    grain = grain_px(images[F_NUMBERS.index(GRAIN_AT)][0])
    sharp = model.lens(SHARP_AT)
    evidence = Evidence.of(stage, sharp, model.blur(sharp), images[F_NUMBERS.index(SHARP_AT)])
    rows: list[Row] = []
    for shot in shots(model, images):
        setup.progress(done, f"{stage.scene.name} f/{shot.f_number:g}")
        k = F_NUMBERS.index(shot.f_number)
        case: Row = {
            "scene": stage.scene.name, "seed": seed, "f_number": shot.f_number, "exposure": shot.mode,
            "diffraction": shot.diffraction, "level": level(stage, shot),
            **_predictions(model, shot, grain, evidence, paths[k]),
        }  # fmt: skip
        draw = stream(seed, 1, k, MODES.index(shot.mode))
        pictures = stage.expose(shot.radiance, shot.lens, draw, SENSOR, shot.exposure)
        rows += [{**case, "method": method, **_scores(stage, pictures, method)} for method in setup.methods]
    return _with_curves(rows)


def _scores(stage: Stage, pictures: Sequence[NDArray[Any]], method: str) -> dict[str, float]:
    scores = stage.score(stage.match(pictures, method), pictures)
    return {**score_columns(scores), "a50": scores.regions["nonocc"]["A50"]}


def _rendering_noise(grid: LensGrid) -> list[float]:
    """Rms noise of the light paths relative to the rms radiance, an upper bound, for each lens."""
    lights = [math.sqrt(np.mean([np.square(image, dtype=np.float64).mean() for image in pair])) for pair in grid.images]
    return [float(np.mean(error)) / light for error, light in zip(grid.standard_error, lights, strict=True)]


def _predictions(model: Model, shot: Shot, grain: float, evidence: Evidence, paths: float) -> dict[str, float]:
    blur = model.blur(shot.lens)
    diffracts = shot.diffraction == "with"
    error = predicted_error(model.stage, shot.lens, shot.exposure, shot.radiance[0], blur, grain, diffracts)
    expected = evidence.expected(shot.lens, shot.exposure, blur, diffracts, paths)
    return {"predicted": error, "predicted_wrong": expected.wrong, "path_noise": expected.path_noise}


def _with_curves(rows: Sequence[Row]) -> list[Row]:
    """The rows of one scene and seed with the f-numbers that the theories predict, and the square law of light."""
    curves: dict[tuple[Any, Any], dict[float, Row]] = {}
    for row in rows:
        curves.setdefault((row["exposure"], row["diffraction"]), {})[float(row["f_number"])] = row
    best = {
        key: {"theory_best": _least(curve, "predicted"), "theory_best_wrong": _least(curve, "predicted_wrong")}
        for key, curve in curves.items()
    }
    light = {key: float(curve[_LAW_AT]["level"]) for key, curve in curves.items()}
    return [
        {**row, **best[key], "square_law": light[key] * (_LAW_AT / float(row["f_number"])) ** 2}
        for row in rows
        for key in [(row["exposure"], row["diffraction"])]
    ]


def _least(curve: Mapping[float, Row], column: str) -> float:
    return best_f_number(np.array(list(curve)), np.array([float(row[column]) for row in curve.values()]))


def _crops(model: Model, images: Sequence[Radiance]) -> Picture:
    """The nearest part of the scene's middle through every lens, at equal brightness with diffraction."""
    stage = model.stage
    depth = np.where(np.isfinite(stage.truth.depth), stage.truth.depth, np.inf)
    side = min(_CROP, *(length // 3 for length in depth.shape))
    inner = depth[side:-side, side:-side]
    y, x = (int(k) + side // 2 for k in np.unravel_index(int(np.argmin(inner)), inner.shape))
    parts = []
    for number, radiance in zip(F_NUMBERS, images, strict=True):
        seen = diffracted(stage, model.lens(number), radiance)
        picture = stage.expose(seen, model.lens(number), 0, SENSOR)[0]
        parts.append(picture[y : y + side, x : x + side].repeat(_ZOOM, axis=0).repeat(_ZOOM, axis=1))
    captions = tuple(f"f/{number:g}" for number in F_NUMBERS)
    title = f"{stage.scene.name}: the same crop from f/1 to f/32"
    return Picture(f"crops-{stage.scene.name}", title, tuple(parts), captions)


def _wrong(name: str, mode: str, diffraction: str) -> Figure:
    return Figure(
        name, f"Wrong pixels at {mode}, {diffraction} diffraction", "f_number", "totbad2", by="method", panel="scene",
        log_x=True, best="least", marks=(("theory_best_wrong", "theory"),),
        where={"exposure": mode, "diffraction": diffraction},
    )  # fmt: skip


def _theory(name: str, title: str, y: str, by: str = "scene", **more: Any) -> Figure:
    return Figure(name, f"{title}, with diffraction", "f_number", y, by=by, panel="exposure", log_x=True, best="least",
                  where={"diffraction": "with"}, **more)  # fmt: skip


STUDY = Study(
    name="aperture",
    question="Which f-number is best for stereo, given blur, diffraction and noise?",
    columns=(
        Column("f_number", "", "f-number"),
        Column("exposure", "", "exposure"),
        Column("diffraction", "", "diffraction"),
        Column("method", "", "matcher"),
        Column("level", "", "mean linear level"),
        Column("square_law", "", "A², scaled to the level at f/11"),
        Column("predicted", "a.u.", "predicted error"),
        Column("theory_best", "", "f-number of the least predicted error"),
        Column("predicted_wrong", "%", "predicted wrong by > 2 px"),
        Column("theory_best_wrong", "", "f-number of the fewest predicted wrong pixels"),
        Column("path_noise", "", "rendering noise over sensor noise, before diffraction"),
        *SCORES,
        Column("a50", "px", "median error"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        _wrong("fixed", MODES[0], "with"),
        _wrong("equal", MODES[1], "with"),
        _wrong("fixed-without", MODES[0], "without"),
        _wrong("equal-without", MODES[1], "without"),
        _theory("median", "Median error and its theory", "a50", by="method", log_y=True,
                marks=(("theory_best", "theory"),)),
        _theory("predicted-wrong", "Predicted wrong pixels", "predicted_wrong"),
        _theory("predicted", "Cramer-Rao bound of the error", "predicted", log_y=True),
        Figure("light", "Mean level at a fixed exposure", "f_number", "level", by="scene", log_x=True, log_y=True,
               also=("square_law",), residual_of="square_law",
               where={"exposure": MODES[0], "diffraction": "without", "f_number": F_NUMBERS[:9]}),
    ),
    defaults=Setup(
        ("staircase", "cards", "tabletop"),
        ("sad", "ssd", "ncc", "zncc", "census", "rank", "birchfield_tomasi", "sgm"), (0, 1),
        width=240, height=180, spp=80,
    ),
)  # fmt: skip
