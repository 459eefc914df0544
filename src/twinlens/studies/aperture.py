"""`aperture`: f/1 to f/32. Wide lenses blur what is out of focus, narrow ones diffract and starve: which is the best?

Each scene's lenses are photographed from one set of light paths a seed (`render_lens_grid`); its radiances are then
exposed (a) all for the same time, where shot noise grows as the hole shrinks, and (b) each to the same brightness; with
and without diffraction. Theory stands beside it: `aperture_theory`.

What is photographed, and why it was chosen so, is in `aperture_shots`.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.rendering import LensGrid, render_lens_grid
from twinlens.studies.aperture_shots import (
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
from twinlens.studies.aperture_theory import SENSOR, best_f_number, grain_px, predicted_error
from twinlens.studies.bootstrap import Interval, brief, log_slope, over_scenes
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, agrees, is_above
from twinlens.studies.pictures import crop
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row, Table

ALLOWED_STOPS = 1.5
"""How far theory's f-number may lie from a matcher's: there its own error, (N/N0 + N0/N) / 2 of its least, is 1.14."""
_CROP, _ZOOM = 40, 3
_LAW_AT = 11.0
_LAW_FROM, _LAW_TO = 2.8, 16.0


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
        begun = time.perf_counter()
        grid = render_lens_grid(model.stage.scene, model.stage.rig, lenses, setup.spp, stream(seed, 0))
        seconds = time.perf_counter() - begun
        rows += _sweep(setup, model, grid.images, seed, done / len(places))
        if seed == setup.seeds[0]:
            saved[name] = _saved(model, setup, grid, seconds)
            scales[name] = model.scale
            pictures.append(_crops(model, grid.images))
    setup.progress(1.0, "")
    notes = {"f_numbers": F_NUMBERS, "pixel_pitch_um": PIXEL_PITCH_UM, "blur_px": BLUR_PX, "scales": scales,
             "exposed_at_f": EXPOSED_AT, "lens_grid_saved": saved}  # fmt: skip
    remarks = {
        "lens grid": ". ".join(_said(name, each) for name, each in saved.items()),
        "models": ", ".join(f"{name} 1:{1 / scale:.0f}" for name, scale in scales.items()),
    }
    return Measured(rows, tuple(pictures), notes, remarks)


def _saved(model: Model, setup: Setup, grid: LensGrid, seconds: float) -> dict[str, float]:
    """What one set of light paths cost, beside as many direct photographs of the same error as there are lenses."""
    lens = model.full_size(model.lens(EXPOSED_AT))
    model.stage.photograph(lens, 1, stream(setup.seeds[0], 8))
    few = max(1, setup.spp // 4)
    begun = time.perf_counter()
    model.stage.photograph(lens, few, stream(setup.seeds[0], 9))
    direct = len(F_NUMBERS) * setup.spp / few * (time.perf_counter() - begun)
    paths = len(F_NUMBERS) * setup.spp * 2 * setup.width * setup.height
    return {"grid_s": round(seconds, 2), "direct_s": round(direct, 2), "grid_paths": grid.rays, "direct_paths": paths}


def _said(name: str, saved: Mapping[str, float]) -> str:
    return (
        f"{name}: {len(F_NUMBERS)} lenses from {saved['grid_paths'] / 1e6:.3g} million light paths in "
        f"{saved['grid_s']:.3g} s; one by one {saved['direct_paths'] / 1e6:.3g} million, "
        f"about {saved['direct_s']:.3g} s"
    )


def _sweep(setup: Setup, model: Model, images: Sequence[Radiance], seed: int, share: float) -> list[Row]:
    """A seed's rows of one scene."""
    grain = grain_px(images[F_NUMBERS.index(GRAIN_AT)][0])
    rows: list[Row] = []
    for shot in shots(model, images):
        setup.progress(share, f"{model.stage.scene.name} f/{shot.f_number:g}")
        case: Row = {
            "scene": model.stage.scene.name, "seed": seed, "f_number": shot.f_number, "exposure": shot.mode,
            "diffraction": shot.diffraction, "level": level(model.stage, shot),
            "predicted": _predicted(model, shot, grain),
        }  # fmt: skip
        draw = stream(seed, 1, F_NUMBERS.index(shot.f_number), MODES.index(shot.mode))
        pictures = model.stage.expose(shot.radiance, shot.lens, draw, SENSOR, shot.exposure)
        rows += [{**case, "method": method, **_scores(model.stage, pictures, method)} for method in setup.methods]
    return _with_theory(rows)


def _scores(stage: Stage, pictures: Sequence[NDArray[Any]], method: str) -> dict[str, float]:
    """The columns of every study, and the median error, whose bound it is that theory tells."""
    scores = stage.score(stage.match(pictures, method), pictures)
    return {**score_columns(scores), "a50": scores.regions["nonocc"]["A50"]}


def _predicted(model: Model, shot: Shot, grain: float) -> float:
    blur = model.stage.blur(model.full_size(shot.lens))
    diffracts = shot.diffraction == "with"
    return predicted_error(model.stage, shot.lens, shot.exposure, shot.radiance[0], blur, grain, diffracts)


def _with_theory(rows: Sequence[Row]) -> list[Row]:
    """A seed's rows of one scene and, beside them, the f-number of the least predicted error and the law of light."""
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


def _crops(model: Model, images: Sequence[Radiance]) -> Picture:
    """The nearest edge of the scene's middle, through every lens, exposed alike bright, with diffraction."""
    stage = model.stage
    depth = np.where(np.isfinite(stage.truth.depth), stage.truth.depth, np.inf)
    side = min(_CROP, *(length // 3 for length in depth.shape))
    inner = depth[side:-side, side:-side]
    y, x = np.unravel_index(int(np.argmin(inner)), inner.shape)
    parts = []
    for number, radiance in zip(F_NUMBERS, images, strict=True):
        seen = diffracted(stage, model.lens(number), radiance)
        picture = stage.expose(seen, model.lens(number), 0, SENSOR)[0]
        parts.append(crop(picture, int(x) + side // 2, int(y) + side // 2, side, side, _ZOOM))
    captions = tuple(f"f/{number:g}" for number in F_NUMBERS)
    title = f"{stage.scene.name}: the same crop from f/1 to f/32"
    return Picture(f"crops-{stage.scene.name}", title, tuple(parts), captions)


def conclude(table: Table) -> list[Finding]:
    """The best f-number of each matcher beside the predicted one; the square law of light."""
    findings = [_square_law(table)]
    for mode in MODES:
        rows = table.where(exposure=mode, diffraction="with")
        findings += [_optimum(rows.where(method=method), f"{method}, at {mode}") for method in rows.values("method")]
    return findings


def _optimum(rows: Table, text: str) -> Finding:
    """How far the f-number of the fewest wrong pixels lies from theory's, scene by scene.

    No scene's distance may pass the allowance. Where two stops beside the best cost no more than noise does, nor
    theory's f-number in the scenes where it is far, the matcher does not tell which is best: there is no verdict.
    """
    distance = over_scenes(rows, _stops_from_theory)
    best = best_of(rows)
    where = f"f/{best:g}" + (", the end of the sweep" if best in (F_NUMBERS[0], F_NUMBERS[-1]) else "")
    numbers, cost = rows.numbers("theory_best"), cost_over_best(rows, _of_theory)
    said = (
        f"{text}, has the fewest wrong pixels at {where}: {{}} narrower than theory's f/{numbers.min():.2g} to "
        f"f/{numbers.max():.2g}, scene by scene, which cost {brief(cost.value)} percent points"
    )
    far = [scene for scene in rows.values("scene") if abs(_mean_stops(rows.where(scene=scene))) > ALLOWED_STOPS]
    refuted = bool(far) and is_above(cost_over_best(rows.where(scene=far), _of_theory))
    if refuted or is_above(cost_over_best(rows, _two_stops_beside)):
        said += f"; {ALLOWED_STOPS} stops to either side are allowed in each scene"
        return Finding(said, distance, not far, "stops")
    return Finding(f"{said}; its basin is flatter than its noise: it does not decide", distance, False, "stops",
                   asked=False)  # fmt: skip


def best_of(rows: Table) -> float:
    """The f-number of the fewest wrong pixels in the mean."""
    return min(F_NUMBERS, key=lambda number: _wrong_at(rows, number))


def cost_over_best(rows: Table, places: Callable[[int, Table], list[int]]) -> Interval:
    """How many more wrong pixels the cheapest of some places of the sweep have than the best one, over scenes.

    The best is each scene's own, found on its other seeds (where one seed is all, on that): of mere noise, what is best
    under one seed is no better under another. places: from the best one's place and a scene and seed's rows.
    """

    def cost(unit: Table) -> float:
        own = unit.rows[0]
        others = rows.where(lambda row: row["seed"] != own["seed"], scene=own["scene"])
        at = F_NUMBERS.index(best_of(others if len(others) else unit))
        return min(_wrong_at(unit, F_NUMBERS[k]) for k in places(at, unit)) - _wrong_at(unit, F_NUMBERS[at])

    return over_scenes(rows, cost)


def _two_stops_beside(at: int, unit: Table) -> list[int]:
    return [k for k in (at - 2, at + 2) if 0 <= k < len(F_NUMBERS)]


def _of_theory(at: int, unit: Table) -> list[int]:
    theory = float(unit.numbers("theory_best")[0])
    return [min(range(len(F_NUMBERS)), key=lambda k: abs(math.log(F_NUMBERS[k] / theory)))]


def _wrong_at(rows: Table, f_number: float) -> float:
    return float(rows.where(f_number=f_number).numbers("totbad2").mean())


def _stops_from_theory(unit: Table) -> float:
    """Of the best f-number of one scene and seed, positive where it is narrower."""
    wrong = np.array([_wrong_at(unit, number) for number in F_NUMBERS])
    best = best_f_number(np.array(F_NUMBERS), wrong)
    return 2.0 * math.log2(best / float(unit.numbers("theory_best")[0]))


def _mean_stops(rows: Table) -> float:
    return over_scenes(rows, _stops_from_theory).value


def _square_law(table: Table) -> Finding:
    """Mean level against A, at the fixed exposure, where nothing burns out: the exponent."""
    rows = table.where(exposure=MODES[0], diffraction="without")
    rows = rows.where(lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO)
    fall = log_slope("f_number", "level")
    slope = over_scenes(rows, lambda unit: -fall(unit))
    text = "At a fixed exposure the picture's mean level grows as A^p, p = {}"
    return Finding(text, slope, agrees(slope, 2.0, 0.01), "", 2.0, 0.01)


def _wrong(name: str, mode: str, diffraction: str) -> Figure:
    return Figure(
        name, f"Wrong pixels at {mode}, {diffraction} diffraction", "f_number", "totbad2", by="method", panel="scene",
        log_x=True, best="least", marks=(("theory_best", "theory"),),
        where={"exposure": mode, "diffraction": diffraction},
    )  # fmt: skip


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
        Column("a50", "px", "median error"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        _wrong("fixed", MODES[0], "with"),
        _wrong("equal", MODES[1], "with"),
        _wrong("fixed-without", MODES[0], "without"),
        _wrong("equal-without", MODES[1], "without"),
        Figure("median", "Median error, with diffraction: what theory bounds", "f_number", "a50", by="method",
               panel="exposure", log_x=True, log_y=True, best="least", where={"diffraction": "with"}),
        Figure("predicted", "What theory expects of a matcher's error, with diffraction", "f_number", "predicted",
               by="scene", panel="exposure", log_x=True, log_y=True, best="least", where={"diffraction": "with"}),
        Figure("light", "Mean level at a fixed exposure, as far as noise is not cut at zero", "f_number", "level",
               by="scene", log_x=True, log_y=True,
               also=("square_law",), residual_of="square_law",
               where={"exposure": MODES[0], "diffraction": "without", "f_number": F_NUMBERS[:9]}),
    ),
    defaults=Setup(
        ("staircase", "cards", "tabletop"),
        ("sad", "ssd", "ncc", "zncc", "census", "rank", "birchfield_tomasi", "sgm"), (0, 1),
        width=400, height=300, spp=24,
    ),
)  # fmt: skip
